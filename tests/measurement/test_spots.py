"""The centre of a single dot, against pictures integrated on a fine grid and the Cramer-Rao
bound.
"""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import convolve1d

from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.spots.fit import Lit, Spots, fit_spots
from flflab.measurement.spots.profile import defocused_dot, softened_dot

Array = npt.NDArray[np.float64]

SIZE, MIDDLE, FINE = 33, 16.0, 16
RADIUS, SIGMA, LIGHT = 4.0, 0.8, 1000.0


def dot(x: float, y: float) -> Array:
    """A dot of radius 4 px blurred by a normal distribution of 0.8 px, summed over pixels."""
    places = (np.arange(SIZE * FINE) + 0.5) / FINE - 0.5
    sharp = np.clip(0.5 + (RADIUS - np.hypot(places[None] - x, places[:, None] - y)) * FINE, 0, 1)
    kernel = np.exp(-0.5 * (np.arange(-5 * FINE, 5 * FINE + 1) / (SIGMA * FINE)) ** 2)
    soft = convolve1d(
        convolve1d(sharp, kernel / kernel.sum(), axis=0), kernel / kernel.sum(), axis=1
    )
    return soft.reshape(SIZE, FINE, SIZE, FINE).mean(axis=(1, 3))


def fitted(windows: Array, sigma: float) -> tuple[Array, Spots]:
    """Centres in windows stacked one above the other."""
    n = len(windows)
    down: Array = (np.array([0.0, SIZE]) * np.arange(n)[:, None]).astype(np.float64)
    middles: Array = (MIDDLE + down).astype(np.float64)
    own = Lit(middles, np.full(n, LIGHT), np.ones(n), np.ones((n, 8 * SIZE)), 1.0)
    noise = SensorNoise(1e-9, max(sigma, 1e-6) * LIGHT, 0.0, 1e9)
    spots = fit_spots(
        windows.reshape(-1, SIZE), middles, 12, own, softened_dot(RADIUS, SIGMA), noise
    )
    return spots.centres - down, spots


@pytest.fixture(scope="module")
def pictured() -> tuple[Array, Array]:
    """Places of dots, and their pictures."""
    places = np.random.default_rng(5).uniform(MIDDLE - 0.5, MIDDLE + 0.5, (20, 2))
    return places, np.array([dot(x, y) for x, y in places])


def bound(sigma: float) -> float:
    """Least standard deviation of one coordinate in independent noise of ``sigma`` of white
    (Cramer-Rao).
    """
    slope = (dot(MIDDLE + 0.05, MIDDLE) - dot(MIDDLE - 0.05, MIDDLE)) / 0.1
    return float(sigma / np.sqrt((slope**2).sum()))


def test_without_noise_a_dot_of_four_pixels_is_placed_to_half_a_thousandth(
    pictured: tuple[Array, Array],
) -> None:
    places, pictures = pictured
    found, _ = fitted(LIGHT * pictures, 0.0)
    assert np.median(np.hypot(*(found - places).T)) < 5e-4


@pytest.mark.parametrize(("sigma", "goal"), [(0.01, 0.006), (0.03, 0.020)])
def test_with_noise_a_dot_is_placed_as_well_as_its_pixels_allow(
    pictured: tuple[Array, Array], sigma: float, goal: float
) -> None:
    places, pictures = pictured
    rng = np.random.default_rng(1)
    errors: list[Array] = []
    stated: list[float] = []
    for _ in range(200):
        found, spots = fitted(
            LIGHT * (pictures + sigma * rng.standard_normal(pictures.shape)), sigma
        )
        errors.append(found - places)
        stated.append(
            float(np.sqrt(spots.covariance[:, :2, :2].trace(axis1=1, axis2=2).mean() / 2))
        )
    every = np.concatenate(errors)
    assert np.median(np.hypot(*every.T)) < goal
    assert np.sqrt(np.mean(every**2)) < 1.1 * bound(sigma)
    assert np.mean(stated) == pytest.approx(
        np.sqrt(np.mean(every**2)), rel=0.04
    )  # 8000 coordinates: 0.008


def test_opencvs_blob_detector_places_the_same_dots_several_times_worse(
    pictured: tuple[Array, Array],
) -> None:
    places, pictures = pictured
    detector = blob_detector()
    rng = np.random.default_rng(7)
    far: list[float] = []
    for place, picture in zip(places, pictures, strict=True):
        seen = detector.detect(
            np.clip(
                40 + 180 * (picture + 0.01 * rng.standard_normal(picture.shape)), 0, 255
            ).astype(np.uint8)
        )
        far += [min(float(np.hypot(*(np.array(one.pt) - place))) for one in seen)]
    assert np.median(far) > 2 * 0.006


def blob_detector() -> Any:
    """Set for one bright dot of about this size."""
    opencv: Any = cv2  # its own types lack what is used here
    wanted = opencv.SimpleBlobDetector_Params()
    wanted.blobColor, wanted.minArea, wanted.maxArea = 255, 10, 400
    wanted.filterByCircularity = wanted.filterByConvexity = wanted.filterByInertia = False
    wanted.minThreshold, wanted.maxThreshold, wanted.thresholdStep = 20, 235, 5
    return opencv.SimpleBlobDetector_create(wanted)


def test_a_dot_with_a_sharp_edge_is_averaged_as_its_area_in_each_pixel() -> None:
    profile = defocused_dot(4.0, 0.0)
    fine = (np.arange(200) + 0.5) / 200 - 0.5
    for x, y in [(3.6, 0.0), (2.9, 2.7), (4.2, 1.1), (1.0, 3.8)]:
        area = np.mean(np.hypot(x + fine[None], y + fine[:, None]) <= 4.0)
        turn = np.arctan2(min(x, y), max(x, y)) * 4 / np.pi * (len(profile.values) - 1)
        low = min(int(turn), len(profile.values) - 2)
        radial = np.arange(profile.values.shape[1]) * profile.step
        near, far = (np.interp(np.hypot(x, y), radial, profile.values[low + n]) for n in (0, 1))
        assert near + (turn - low) * (far - near) == pytest.approx(area, abs=0.01)
