"""Slanted edges against closed forms integrated by other means than the package's."""

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from scipy.special import erf, j1

from flflab.errors import MeasurementError
from flflab.measurement.edges.curve import FREQUENCIES as F
from flflab.measurement.edges.curve import curve_of
from flflab.measurement.edges.edge import Edge, fit_edge

Array = npt.NDArray[np.float64]
SIDE = 100
STARVED = math.degrees(math.atan(0.25))
ANGLES = (2.0, 5.0, 10.0, STARVED)


def distances(angle: float, offset: float, side: int = SIDE) -> Array:
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    return x * math.cos(angle) + y * math.sin(angle) - offset


def sharp_edge(angle: float, offset: float, side: int = SIDE) -> Array:
    """Exact: the part of a unit square on one side of a line, by clipping its corners' polygon."""
    t = distances(angle, offset, side)
    c, s = abs(math.cos(angle)), abs(math.sin(angle))
    lower = [
        np.maximum(t + sign, 0.0) ** 2
        for sign in ((c + s) / 2, (c - s) / 2, (s - c) / 2, -(c + s) / 2)
    ]
    return 0.2 + 0.6 * (lower[0] - lower[1] - lower[2] + lower[3]) / (2 * c * s)


def transfer(angle: float) -> Array:
    return np.abs(np.sinc(F * math.cos(angle)) * np.sinc(F * math.sin(angle)))


def disc(z: Array) -> Array:
    """An edge blurred by a disc of radius 1."""
    z = np.clip(z, -1.0, 1.0)
    return 0.5 + (z * np.sqrt(1 - z * z) + np.arcsin(z)) / math.pi


def disc_transfer(f: Array, radius: float) -> Array:
    argument = 2 * math.pi * radius * f + 1e-12
    return np.abs(2 * j1(argument) / argument)


@pytest.mark.parametrize("degrees", ANGLES)
@pytest.mark.parametrize("blur", [0.35, 0.7, 1.5])
def test_a_noiseless_edge_of_gaussian_blur_is_measured_to_two_thousandths(
    degrees: float, blur: float
) -> None:
    angle = math.radians(degrees)
    picture = gaussian_edge(angle, blur, 0.3, order=12)
    truth = transfer(angle) * np.exp(-2 * (math.pi * blur * F) ** 2)
    assert np.abs(curve_of([fit_edge(picture)]).mtf - truth).max() < 0.002


@pytest.mark.parametrize("degrees", ANGLES)
@pytest.mark.parametrize("offset", [-0.4, 0.0, 0.21])
def test_a_noiseless_edge_without_blur_is_measured_to_two_thousandths(
    degrees: float, offset: float
) -> None:
    angle = math.radians(degrees)
    picture = sharp_edge(angle, offset)
    assert np.abs(curve_of([fit_edge(picture)]).mtf - transfer(angle)).max() < 0.002


@pytest.mark.parametrize("radius", [1.0, 3.0])
def test_a_blur_of_another_kind_is_measured_by_the_free_form(radius: float) -> None:
    angle = math.radians(5)
    picture = over_pixel(lambda t: disc(t / radius), 12, distances(angle, 0.2), angle)
    truth = transfer(angle) * disc_transfer(F, radius)
    assert np.abs(curve_of([fit_edge(picture)]).mtf - truth).max() < 0.002


@pytest.mark.full
def test_one_per_cent_of_noise_leaves_little_and_the_stated_uncertainty_says_how_much() -> None:
    """Four angles, four blurs, ten places each; the median root mean square error from 0 to half a
    cycle a pixel.
    """
    blurs, places = (0.0, 0.35, 0.7, 1.5), 10
    rms, z = (
        np.zeros((len(blurs), len(ANGLES), places)),
        np.zeros((len(blurs), len(ANGLES), places)),
    )
    for place in np.ndindex(rms.shape):
        rng = np.random.default_rng(place)
        blur, angle, offset = (
            blurs[place[0]],
            math.radians(ANGLES[place[1]]),
            rng.uniform(-0.5, 0.5),
        )
        clean = gaussian_edge(angle, blur, offset) if blur else sharp_edge(angle, offset)
        noisy = clean + 0.01 * rng.standard_normal(clean.shape)
        curve = curve_of([fit_edge(noisy)])
        error = curve.mtf - transfer(angle) * np.exp(-2 * (math.pi * blur * F) ** 2)
        rms[place] = math.sqrt(float(np.mean(error**2)))
        z[place] = error[10] / curve.uncertainty[10]
    print(f"all {np.median(rms):.5f}, by blur {np.median(rms, axis=(1, 2)).round(5)}")
    assert np.median(rms) < 0.0025
    # without blur its variance, 0 or more, scatters on one side
    assert 0.7 < math.sqrt(float(np.mean(np.square(z[1:])))) < 1.35


def gaussian_edge(
    angle: float, blur: float, offset: float, side: int = SIDE, order: int = 6
) -> Array:
    """A blur of a third of a pixel and more is smooth enough for six nodes."""
    t = distances(angle, offset, side)
    return over_pixel(lambda t: 0.5 * (1 + erf(t / (math.sqrt(2) * blur))), order, t, angle)


def over_pixel(profile: Callable[[Array], Array], order: int, t: Array, angle: float) -> Array:
    """The mean of an edge's profile over each pixel less than 10 px from it, by Gauss's rule along
    both sides; farther away it is dark or bright.
    """
    nodes, weights = np.polynomial.legendre.leggauss(order)
    shifts = (nodes[:, None] * math.cos(angle) + nodes[None, :] * math.sin(angle)).ravel() / 2
    parts = (weights[:, None] * weights[None, :]).ravel() / 4
    near = np.abs(t) < 10
    picture = (t > 0).astype(np.float64)
    picture[near] = (profile(t[near, None] + shifts) * parts).sum(axis=1)
    return 0.2 + 0.6 * picture


@pytest.mark.parametrize("degrees", [5.0, 85.0, 95.0, 175.0, -5.0, -95.0])
def test_the_normal_points_to_the_bright_side_whatever_the_turn(degrees: float) -> None:
    found = fit_edge(gaussian_edge(math.radians(degrees), 0.7, 0.3))
    assert math.remainder(found.angle - math.radians(degrees), 2 * math.pi) == pytest.approx(
        0, abs=1e-6
    )
    assert found.offset_px == pytest.approx(0.3, abs=1e-5)
    assert (found.dark, found.height) == pytest.approx((0.2, 0.6), abs=1e-5)


def test_only_the_pixels_asked_for_count() -> None:
    angle = math.radians(5)
    picture = gaussian_edge(angle, 0.7, 0.3)
    y, x = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    mask = x**2 + y**2 < 40**2
    spoiled = np.where(mask, picture, 5.0)
    truth = transfer(angle) * np.exp(-2 * (math.pi * 0.7 * F) ** 2)
    assert np.abs(curve_of([fit_edge(spoiled, mask)]).mtf - truth).max() < 0.002


@pytest.mark.parametrize(
    ("picture", "says"),
    [
        (np.full((20, 20), 3.0), "equally bright"),
        (np.zeros((3, 3)), "at least 50"),
        (np.random.default_rng(0).standard_normal((40, 40)), "edge"),
    ],
)
def test_a_picture_without_an_edge_is_refused(picture: Array, says: str) -> None:
    with pytest.raises(MeasurementError, match=says):
        fit_edge(picture)


COVERED = [2, 5, 10, 15, 20]  # which frequencies: 0.04, 0.1, 0.2, 0.3 and 0.4 cycles/px
# px, side of the edges that are measured again and again: as many pixels as a small bright field
# has
FEW = 40
TOGETHER = 8  # edges that are pooled


def edge_scores(kind: str, groups: int) -> tuple[Array, Array]:
    """Errors over stated uncertainties at 1 % of noise, the angles in turn, a blur of its own for
    every eight edges.

    Returns:
        Of the transfer at ``COVERED``, of every edge, shape (8 groups, 5), and of eight together,
        shape (groups, 5).
    """
    alone, together = list[Array](), list[Array]()
    for group in range(groups):
        rng = np.random.default_rng([ord(kind[0]), group])
        angle, width = math.radians(ANGLES[group % len(ANGLES)]), rng.uniform(0.33, 1.5)
        edges, truth = list[Edge](), transfer(angle)
        if kind == "gaussian":
            truth = truth * np.exp(-2 * (math.pi * width * F) ** 2)
        elif kind == "disc":
            truth = truth * disc_transfer(F, 2 * width)
        for _ in range(TOGETHER):
            offset = rng.uniform(-0.5, 0.5)
            if kind == "gaussian":
                clean = gaussian_edge(angle, width, offset, FEW)
            elif kind == "disc":
                clean = over_pixel(
                    lambda t, radius=2 * width: disc(t / radius),
                    10,
                    distances(angle, offset, FEW),
                    angle,
                )
            else:
                clean = sharp_edge(angle, offset, FEW)
            edges.append(fit_edge(clean + 0.01 * rng.standard_normal(clean.shape)))
        for curves, some in ((alone, [[edge] for edge in edges]), (together, [edges])):
            for curve in map(curve_of, some):
                curves.append(((curve.mtf - truth) / curve.uncertainty)[COVERED])
    return np.array(alone), np.array(together)


def covered(scores: Array) -> Array:
    """Share of intervals of 95 % that hold the truth, column by column."""
    return np.mean(np.abs(scores) < 1.959964, axis=0)


@pytest.mark.full
@pytest.mark.timeout(0)
@pytest.mark.parametrize("edges", [320, 10_000])
@pytest.mark.parametrize("blur", ["gaussian", "disc", "sharp"])
def test_intervals_of_edges_cover_alone_and_together(blur: str, edges: int) -> None:
    """Of a deviation that is not there the fit is too unsure, never too sure."""
    alone, together = edge_scores(blur, edges // TOGETHER)
    print(f"{blur}: alone {covered(alone)}, together {covered(together)}")
    off = 4 * math.sqrt(0.95 * 0.05 / edges)
    for scores in (alone, together):
        some = 0.95 - 4 * math.sqrt(0.95 * 0.05 / len(scores))
        assert np.all(covered(scores) > min(some, 0.93 if blur == "disc" else 0.94))
    assert blur != "disc" or abs(covered(alone).mean() - 0.95) < max(0.01, off)
