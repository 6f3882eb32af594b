"""Are the stated uncertainties true? Many small simulated benches, each with its own hidden errors
of stages, angles and light.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import MeasurementError
from flflab.optics.camera import Camera
from flflab.verdict.comparison import Comparison
from flflab.verdict.diagnosis import likeliest
from flflab.verdict.evaluation import Evaluation

Change = Callable[[Camera], Camera]
OneRun = Callable[..., Evaluation]
TURNED = [
    {"f_number": 4, "distance": "507 mm", "yaw": ["0 deg", "-0.2 deg", "0.2 deg"]},
    {"f_number": 4, "distance": "507 mm", "pitch": "0.2 deg", "roll": "1 deg"},
    {"f_number": 2.8, "distance": "507 mm", "yaw": "0.1 deg", "pitch": "-0.15 deg"},
]


@pytest.fixture(scope="module")
def runs(one_bench: OneRun) -> Callable[[int], list[Comparison]]:
    def take(count: int) -> list[Comparison]:
        with ThreadPoolExecutor(2) as pool:
            return [run.comparison for run in pool.map(one_bench, range(count))]

    return take


def pooled(comparisons: list[Comparison], quantity: str) -> npt.NDArray[np.float64]:
    return np.array(
        [row.z for comparison in comparisons for row in comparison.rows if row.quantity == quantity]
    )


def print_table(comparisons: list[Comparison]) -> None:
    """What stands in docs/accuracy.md: every quantity's z, and every property's verdicts."""
    for quantity in dict.fromkeys(
        row.quantity for comparison in comparisons for row in comparison.rows
    ):
        z = pooled(comparisons, quantity)
        z = z[np.isfinite(z)]
        print(
            f"{quantity}: {len(z)} values, rms of z {np.sqrt(np.mean(z**2)):.3f}, beyond 2:"
            f" {100 * np.mean(np.abs(z) > 2):.1f} %"
        )
    verdicts = [verdict for comparison in comparisons for verdict in comparison.verdicts]
    for quantity in dict.fromkeys(verdict.quantity for verdict in verdicts):
        p = np.array([verdict.p_value for verdict in verdicts if verdict.quantity == quantity])
        print(
            f"{quantity}: {len(p)} verdicts, p below 0.05 in {100 * np.mean(p < 0.05):.1f} %,"
            f" median {np.median(p):.2f}"
        )
    rejected = [
        sorted(one.quantity for one in comparison.verdicts if not one.accepted)
        for comparison in comparisons
    ]
    print(
        f"rejected {sum(map(bool, rejected))} of {len(rejected)} benches:"
        f" { {n: what for n, what in enumerate(rejected) if what} }"
    )


@pytest.mark.full
@pytest.mark.timeout(600)
def test_a_few_honest_benches_are_measured_within_their_uncertainties(
    runs: Callable[[int], list[Comparison]],
) -> None:
    comparisons = runs(3)
    z = pooled(comparisons, "mtf")
    # All values of a run share its few stage errors, so three runs say only this much.
    assert 0.3 < z.std() < 2.0
    assert np.mean(np.abs(z) < 3) > 0.8
    views = [
        row for comparison in comparisons for row in comparison.rows if row.quantity == "views"
    ]
    assert np.mean([row.measured == row.predicted for row in views]) >= 0.95


def longer_microlenses(camera: Camera) -> Camera:
    return replace(
        camera, array=replace(camera.array, focal_lengths=(1.02 * camera.array.focal_lengths[0],))
    )


def narrower_iris(camera: Camera) -> Camera:
    return replace(
        camera, main_lens=replace(camera.main_lens, f_number=1.03 * camera.main_lens.f_number)
    )


def longer_main_lens(camera: Camera) -> Camera:
    return replace(
        camera,
        main_lens=replace(camera.main_lens, focal_length=1.004 * camera.main_lens.focal_length),
    )


def tilted_array(camera: Camera) -> Camera:
    return replace(camera, array=replace(camera.array, tilt=(math.tan(math.radians(0.3)), 0.0)))


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("change", "named", "size", "hidden"),
    [
        pytest.param(
            longer_microlenses, "focal length of the microlenses", 0.02, 0.0, marks=pytest.mark.full
        ),
        pytest.param(
            narrower_iris,
            "aperture of the main lens (the f-number the other way)",
            1 / 1.03 - 1,
            0.0,
            marks=pytest.mark.full,
        ),
        pytest.param(
            tilted_array,
            "yaw of the array (its tilt along x)",
            math.radians(0.3),
            5e-4,
            marks=pytest.mark.full,
        ),
        pytest.param(
            longer_main_lens, "focal length of the main lens", 0.004, 0.0, marks=pytest.mark.full
        ),
    ],
)
def test_a_planted_error_is_found_and_named(
    one_bench: OneRun, change: Change, named: str, size: float, hidden: float
) -> None:
    """``hidden`` is the standard uncertainty of what the honest bench has of the same error
    beside.
    """
    run = one_bench(3, change)
    assert not run.comparison.accepted
    assert run.suspects[0].what == named
    assert run.suspects[0].size == pytest.approx(size, abs=0.02 * abs(size) + 3 * hidden)
    assert likeliest(run.suspects) == run.suspects[:1]


@pytest.mark.full
@pytest.mark.timeout(300)
def test_longer_microlenses_are_named_where_the_array_is_turned_step_by_step_too(
    one_bench: OneRun,
) -> None:
    """They scale the turns that are read beside the fields, and turns alone do not explain it."""
    turned = [
        {"f_number": 4, "distance": "507 mm", "yaw": ["-0.3 deg", "0.3 deg"], "pitch": "0.3 deg"}
    ]
    run = one_bench(3, longer_microlenses, file="full.yaml", configurations=turned)
    assert not run.comparison.accepted
    assert "focal length of the microlenses" in [
        suspect.what for suspect in likeliest(run.suspects)
    ]


def spread(camera: Camera, times: float) -> Camera:
    x, y = camera.array.pitch
    return replace(
        camera,
        array=replace(
            camera.array, pitch=(times * x, times * y), aperture=times * camera.array.aperture
        ),
    )


@pytest.mark.ci
@pytest.mark.parametrize(
    ("times", "units"), [(10.0, "centimetres and millimetres"), (2.54, "inches and centimetres")]
)
def test_swapped_units_are_found_and_named(one_bench: OneRun, times: float, units: str) -> None:
    with pytest.raises(MeasurementError, match=f"were {units} mixed up"):
        one_bench(
            3, change=partial(spread, times=1 / times), described=partial(spread, times=times)
        )


IN_FOCUS_IN_WAVES = [{"f_number": 4, "distance": "507 mm"}]
IN_WAVES = [{"f_number": 4, "distance": ["500 mm", "507 mm"], "focused_at": "507 mm"}]


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "configurations",
    [
        pytest.param(IN_FOCUS_IN_WAVES, id="in focus", marks=pytest.mark.ci),
        pytest.param(IN_WAVES, id="and out", marks=pytest.mark.full),
    ],
)
def test_an_honest_bench_in_light_of_550_nm_is_accepted_where_its_file_says_so(
    one_bench: OneRun, configurations: list[dict[str, object]]
) -> None:
    comparison = one_bench(0, configurations=configurations, wavelength=550e-6).comparison
    assert comparison.accepted
    assert np.abs(pooled([comparison], "mtf")).max() < 3


@pytest.mark.full
@pytest.mark.timeout(600)
def test_the_same_bench_is_rejected_on_contrast_where_its_file_does_not(one_bench: OneRun) -> None:
    comparison = one_bench(0, configurations=IN_WAVES, wavelength=550e-6, told=False).comparison
    assert "mtf" in [one.quantity for one in comparison.verdicts if not one.accepted]
    assert pooled([comparison], "mtf").min() < -30


@pytest.mark.full
@pytest.mark.timeout(7200)
def test_the_error_bars_of_300_honest_benches_are_honest(
    runs: Callable[[int], list[Comparison]],
) -> None:
    comparisons = runs(300)
    print_table(comparisons)
    z = np.concatenate([pooled(comparisons, "mtf"), pooled(comparisons, "ratio_mtf")])
    views = [
        row for comparison in comparisons for row in comparison.rows if row.quantity == "views"
    ]
    exact = float(np.mean([row.measured == row.predicted for row in views]))
    rejected = float(np.mean([not comparison.accepted for comparison in comparisons]))
    assert 0.9 <= z.std() <= 1.1
    assert 0.03 <= np.mean(np.abs(z) > 2) <= 0.06
    assert exact >= 0.95
    assert rejected <= 0.05 + 3 * (0.05 * 0.95 / 300) ** 0.5


def swept(one_bench: OneRun, seed: int) -> Comparison:
    return one_bench(seed, file="full.yaml", configurations=TURNED).comparison


@pytest.mark.full
@pytest.mark.timeout(300)
def test_an_honest_bench_whose_array_is_turned_step_by_step_is_accepted(one_bench: OneRun) -> None:
    # Hard for the bars' fit: of the one views are blurred by 0.3 px more and less, of the other the
    # target fills a part.
    for seed in (101, 105):
        comparison = swept(one_bench, seed)
        assert comparison.accepted, [
            one.sentence for one in comparison.verdicts if not one.accepted
        ]
        assert np.abs(pooled([comparison], "mtf")).max() < 3


@pytest.mark.full
@pytest.mark.timeout(7200)
def test_of_100_honest_benches_whose_array_is_turned_no_more_are_rejected_than_stated(
    one_bench: OneRun,
) -> None:
    with ThreadPoolExecutor(2) as pool:
        comparisons = list(pool.map(lambda seed: swept(one_bench, seed), range(100)))
    rejected = [
        sorted(v.quantity for v in comparison.verdicts if not v.accepted)
        for comparison in comparisons
        if not comparison.accepted
    ]
    print(f"rejected {len(rejected)} of 100: {rejected}")
    assert len(rejected) <= 5 + 3 * (100 * 0.05 * 0.95) ** 0.5
