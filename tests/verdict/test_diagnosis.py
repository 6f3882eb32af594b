"""Which change of a bench is named, told from numbers that are the errors themselves: a pitch as a
share, an angle in mrad.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from flflab.bench import Bench, read_bench
from flflab.verdict.diagnosis import diagnose, not_told_apart
from flflab.verdict.prediction import Errors
from flflab.verdict.properties.values import Values, single

BENCH = Path(__file__).parents[2] / "examples" / "benches" / "full.yaml"


@pytest.fixture(scope="module")
def bench() -> Bench:
    return read_bench(BENCH)


def numbers(
    share: float, angle: float, pitches: npt.NDArray[np.float64], angles: npt.NDArray[np.float64]
) -> list[Values]:
    """Measured pitches of microlenses (over those described) and of the array (mrad), with the
    model's draws of them.
    """
    return [
        single(0, "image_pitch_mm", "white", share, 1e-5, pitches),
        single(0, "array_pitch_mrad", "white", angle, 0.01, 1e3 * angles),
    ]


@pytest.mark.parametrize(
    ("share", "angle", "named", "size"),
    [
        (1.01, 0.0, "pitch of the microlenses", 0.01),
        (1.0, 4.0, "pitch of the array (its tilt along y)", 0.004),
    ],
)
def test_a_pitch_of_the_microlenses_and_a_pitch_of_the_array_are_two_things(
    bench: Bench, share: float, angle: float, named: str, size: float
) -> None:
    drawn = np.random.default_rng(1).normal(size=(2, 1000))

    def told(errors: Errors) -> list[Values]:
        return numbers(share, angle, errors.optics.pitch, errors.attitude[:, 2])

    suspects = not_told_apart(
        diagnose(numbers(share, angle, 1 + 1e-4 * drawn[0], 1e-4 * drawn[1]), told, bench)
    )
    assert [suspect.what for suspect in suspects] == [named]
    assert suspects[0].size == pytest.approx(size, rel=0.05)
    assert suspects[0].chi2 < 2
