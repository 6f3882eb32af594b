"""The transfer function of clipped, defocused pupils against closed forms, counted grids and
50-digit arithmetic.
"""

import math
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pytest
from scipy.special import j0, j1

from flflab.errors import InputError
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.optics.contrast import disc_transfer, lost_over_edges, transfer
from flflab.optics.diffraction import pupil_transfer
from flflab.optics.focus import magnification
from flflab.optics.smms import camera_smms

Array = npt.NDArray[np.float64]

CLIPS = [
    (0.0, 0.0, 2.0),
    (2.5, 0.0, 3.0),
    (1.5, 2.0, 3.0),
    (-2.0, 0.5, 2.0),
    (0.3, 0.2, 1.05),
    (0.1, -0.6, 0.7),
    (1.0, -1.0, 1.0),
]


def test_a_sharp_whole_disc_has_the_airy_patterns_transfer() -> None:
    half = np.linspace(0, 1, 101)
    expected = 2 / math.pi * (np.arccos(half) - half * np.sqrt(1 - half**2))
    assert np.abs(pupil_transfer(2 * half, 0.0) - expected).max() < 1e-6


def test_nothing_passes_beyond_twice_the_pupil() -> None:
    assert np.all(pupil_transfer([2.0, 2.5, 100.0], 0.3) == 0)
    assert np.all(pupil_transfer(0.5, 0.0, 5.0, 0.0, 3.0) == 0)


@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.parametrize("waves", [0.0, 0.7, 5.0])
def test_the_transfer_is_the_autocorrelation_of_the_pupil(
    clip: tuple[float, float, float], waves: float
) -> None:
    """Counted on a grid: the shift is a whole number of its columns."""
    count = 1024
    step = 2.2 / count
    places = (np.arange(count) - count / 2 + 0.5) * step
    fine = places + step * (np.arange(4)[:, None] - 1.5) / 4
    x, y = places, fine[:, :, None]
    pupil = ((x**2 + y**2 <= 1) & ((x - clip[0]) ** 2 + (y - clip[1]) ** 2 <= clip[2] ** 2)).mean(
        axis=0
    )
    defocused = pupil.astype(complex)
    for columns in (0, 9, 50, 150, 400, 800):
        shift = columns * step
        both = np.minimum(defocused[:, columns:], defocused[:, : count - columns].real)
        middle = (places[columns:] + places[: count - columns]) / 2
        counted = (both * np.exp(2j * np.pi * waves * middle)).sum() / pupil.sum()
        assert abs(pupil_transfer(shift, waves, *clip) - counted) < 2e-4


def test_without_shift_the_transfer_is_that_of_the_geometric_disc() -> None:
    for waves in (np.linspace(0, 12, 25), np.linspace(12, 90, 14)):
        assert np.abs(pupil_transfer(0.0, waves) - disc_transfer(2.0, waves)).max() < 1e-7


@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.parametrize("waves", [3.0, 17.0, -60.0])
def test_many_waves_across_a_clipped_pupil_are_resolved(
    clip: tuple[float, float, float], waves: float
) -> None:
    """Counted over 200,000 rows, whose chords are summed exactly."""
    x, y, radius = clip
    rows = (np.arange(200_000) + 0.5) / 100_000 - 1
    half, other = np.sqrt(1 - rows**2), np.sqrt(np.maximum(radius**2 - (rows - y) ** 2, 0))
    left, right = np.maximum(-half, x - other), np.minimum(half, x + other)
    for shift in (0.0, 0.05, 0.7):
        kept = np.maximum(right - left - shift, 0)
        counted = (
            kept * np.sinc(waves * kept) * np.exp(1j * np.pi * waves * (left + right))
        ).sum() / np.maximum(right - left, 0).sum()
        assert abs(complex(pupil_transfer(shift, waves, *clip)) - counted) < 2e-6


@pytest.mark.parametrize(("a", "b"), [(0.1, 0.15), (0.17, 0.12), (0.5, 0.2)])
def test_the_light_lost_over_a_targets_edges_is_what_the_airy_pattern_has_beyond_them(
    a: float, b: float
) -> None:
    """Encircled by the rectangle of 2 a by 2 b: Rayleigh's 1 - J0^2 - J1^2 integrated over the
    directions of its border.
    """
    wavelength, half_angle = 550e-6, 0.146
    angle = (np.arange(20_000) + 0.5) / 20_000 * math.pi / 2
    border = np.minimum(a / np.cos(angle), b / np.sin(angle))
    v = 2 * math.pi * half_angle * border / wavelength
    beyond = float(np.mean(j0(v) ** 2 + j1(v) ** 2))
    lost = lost_over_edges(np.array([a, a, b, b]), half_angle, wavelength)
    assert lost == pytest.approx(beyond, rel=2e-3)


def test_a_small_shift_costs_what_the_height_of_the_pupil_says() -> None:
    assert float(pupil_transfer(1e-6, 0.0).real) == pytest.approx(1 - 1e-6 * 2 / math.pi, abs=1e-10)


@pytest.mark.parametrize(
    ("shift", "waves", "clip"),
    [(0.4, 1.3, (1.5, 2.0, 3.0)), (1.1, -2.2, (2.5, 0.3, 3.0)), (0.2, 6.0, (0.3, 0.2, 1.05))],
)
def test_fifty_digits_agree(shift: float, waves: float, clip: tuple[float, float, float]) -> None:
    x, y, radius = (mpmath.mpf(part) for part in clip)
    root: Any = mpmath.sqrt
    with mpmath.workdps(50):

        def chord(at: Any) -> Any:
            half, other = 1 - at**2, radius**2 - (at - y) ** 2
            if half <= 0 or other <= 0:
                return mpmath.mpf(1), mpmath.mpf(0)
            return max(-root(half), x - root(other)), min(root(half), x + root(other))

        def row(at: Any) -> Any:
            left, right = chord(at)
            left, right = left + mpmath.mpf(shift) / 2, right - mpmath.mpf(shift) / 2
            if left >= right:
                return mpmath.mpc(0)
            turn = 2j * mpmath.pi * waves
            return (mpmath.exp(turn * right) - mpmath.exp(turn * left)) / turn

        def length(at: Any) -> Any:
            left, right = chord(at)
            return max(right - left, mpmath.mpf(0))

        cuts = [mpmath.mpf(k) / 16 for k in range(-16, 17)]
        light: Any = mpmath.quad(row, cuts, maxdegree=3)
        area: Any = mpmath.quad(length, cuts, maxdegree=3)
    assert abs(complex(pupil_transfer(shift, waves, *clip)) - complex(light / area)) < 2e-5


def test_turning_the_pupil_about_reverses_the_phase() -> None:
    shift = np.linspace(0, 1.5, 16)
    there, back = (
        pupil_transfer(shift, 2 * shift, 2.4, 0.7, 3.0),
        pupil_transfer(shift, 2 * shift, -2.4, 0.7, 3.0),
    )
    assert np.abs(there - np.conj(back)).max() < 1e-12


@pytest.mark.parametrize(
    "bad", [(-0.1, 0.0, 2.0), (math.nan, 0.0, 2.0), (0.1, math.inf, 2.0), (0.1, 0.0, -1.0)]
)
def test_impossible_numbers_are_refused(bad: tuple[float, float, float]) -> None:
    with pytest.raises(InputError, match="pupil_transfer"):
        pupil_transfer(bad[0], bad[1], 0.0, 0.0, bad[2])


def osinski(f_number: float) -> Camera:
    array = MicrolensArray(
        layout="square",
        count=(1, 1),
        pitch=(0.4, 0.4),
        aperture=0.336,
        focal_lengths=(0.917,),
        distance=60.0,
    )
    return Camera(MainLens(50.0, f_number), array, Sensor((3664, 2748), 0.00166, 61.15))


@pytest.mark.parametrize(
    ("f_number", "half_angle"), [(4.0, 0.168 / 1.15), (32.0, 50 / 32 / 2 / (60 * 0.234923))]
)
def test_contrast_in_focus_is_airys_times_the_pixels(f_number: float, half_angle: float) -> None:
    smms, vergence = camera_smms(osinski(f_number)), 1 / 506.7016
    frequency = np.linspace(0, 6, 25)
    on_sensor = frequency / magnification(smms, vergence)
    half = np.minimum(on_sensor * 550e-6 / (2 * half_angle), 1.0)
    airy = 2 / math.pi * (np.arccos(half) - half * np.sqrt(1 - half**2))
    found = transfer(smms, vergence, 0.00166, frequency, wavelength=550e-6)
    assert np.abs(found - np.sinc(on_sensor * 0.00166) * airy).max() < 1e-5


def test_contrast_with_short_waves_is_that_of_rays() -> None:
    smms, frequency = camera_smms(osinski(4.0)), np.linspace(0, 6, 25)
    rays = transfer(smms, 1 / 490.0, 0.00166, frequency)
    errors = [
        np.abs(transfer(smms, 1 / 490.0, 0.00166, frequency, wavelength=length) - rays).max()
        for length in (550e-6, 550e-8)
    ]
    assert errors[1] < 0.02 * errors[0]
