"""What one would write first: rays from a pixel through thin lenses to the chart, drawn at random
or on a regular grid, and their mean.

The methods ``render`` is compared with. Every ray is one sample of four coordinates, two on the
pixel and two on the microlens.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.scene import Scene, one_plane
from flflab.optics.camera import microlens_centres, pixel_positions
from flflab.targets import Chirp

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Geometry:
    """A scene as these sums see it: thin lenses, and every pair of a pixel and a microlens whose
    light may reach it; mm.

    Attributes:
        pairs: pixel (x, y), microlens (x, y), shape (N, 4).
        pixel: to which pixel each pair belongs, shape (N,).
        white: mean over a microlens at the white level.
        chart: the target.
        pixel_width: side of a pixel.
        radius: of a microlens.
        stop: radius of the main lens's stop.
        depth: main lens to microlenses.
        gap: microlenses to sensor.
        focal: of the microlenses.
        main_focal: of the main lens.
        distance: target to main lens.
    """

    pairs: Array
    pixel: Whole
    white: float
    chart: Chirp
    pixel_width: float
    radius: float
    stop: float
    depth: float
    gap: float
    focal: float
    main_focal: float
    distance: float

    @property
    def kappa(self) -> float:
        """Slope of the place on the sensor over that on the microlens."""
        return 1 + self.gap / self.depth - self.gap / self.focal

    @property
    def lengths(self) -> Array:
        """The lengths in the order that the kernels take them."""
        return np.array(
            [
                self.pixel_width,
                self.radius,
                self.stop,
                self.depth,
                self.gap,
                self.focal,
                self.main_focal,
                self.distance,
            ]
        )

    @property
    def law(self) -> Array:
        """What the kernels know of the chart: frequencies at its edges, width, height."""
        return np.array([*self.chart.cycles_per_mm, self.chart.width, self.chart.height])


def chart_geometry(scene: Scene, pixels: Whole) -> Geometry:
    """Read a scene.

    Raises:
        InputError: it is more than a chart of sines before an aligned, ideal camera.
    """
    camera, plane = scene.camera, scene.planes[0]
    chart, array = plane.target, camera.array
    plain = (
        scene == one_plane(camera, chart, plane.distance)
        and array.tilt == (0, 0)
        and len(array.focal_lengths) == 1
    )
    if not (plain and isinstance(chart, Chirp)):
        raise InputError(
            "ray sums: the scene is more than one chart of sines before an ideal camera; leave the"
            " rest out"
        )
    focal = array.focal_lengths[0]
    depth, gap, radius, stop = (
        camera.optical_distance,
        camera.optical_gap,
        array.aperture / 2,
        camera.main_lens.aperture / 2,
    )
    shadow, own = stop * gap / depth, radius * abs(1 + gap / depth - gap / focal)
    xs, ys = pixel_positions(camera.sensor)
    places, centres = (
        np.stack([xs[pixels[:, 0]], ys[pixels[:, 1]]], axis=1),
        microlens_centres(array),
    )
    apart = np.linalg.norm(places[:, None] - centres * (1 + gap / depth), axis=2)
    pixel, lens = np.nonzero(apart < shadow + own + camera.sensor.pixel)
    return Geometry(
        pairs=np.column_stack([places[pixel], centres[lens]]),
        pixel=pixel,
        white=(shadow / max(shadow, own)) ** 2,
        chart=chart,
        pixel_width=camera.sensor.pixel,
        radius=radius,
        stop=stop,
        depth=depth,
        gap=gap,
        focal=focal,
        main_focal=camera.main_lens.focal_length,
        distance=plane.distance,
    )


def random_rays(scene: Scene, pixels: Whole, rays: int, rng: np.random.Generator) -> Array:
    """Mean of independent random rays; the error falls as their number to the power -1/2.

    Args:
        scene: a chart of sines before an aligned, ideal camera.
        pixels: (column, row) of each, shape (K, 2).
        rays: for a pixel and a microlens.
        rng: what draws them.

    Returns:
        Irradiance in units of the white level, shape (K,).

    Raises:
        InputError: the scene has more than a chart of sines.
    """
    geometry = chart_geometry(scene, pixels)
    light = _sum_random(geometry.pairs, geometry.lengths, geometry.law, rays, rng)
    return np.bincount(geometry.pixel, light, minlength=len(pixels)) / geometry.white


def grid_rays(scene: Scene, pixels: Whole, across: int) -> Array:
    """Mean over a regular grid, ``across`` places in each of the four coordinates, each in the
    middle of its share.

    Args:
        scene: a chart of sines before an aligned, ideal camera.
        pixels: (column, row) of each, shape (K, 2).
        across: places in a coordinate; their fourth power is the number of rays for a pixel and a
            microlens.

    Returns:
        Irradiance in units of the white level, shape (K,).

    Raises:
        InputError: the scene has more than a chart of sines.
    """
    geometry = chart_geometry(scene, pixels)
    light = _sum_grid(geometry.pairs, geometry.lengths, geometry.law, across)
    return np.bincount(geometry.pixel, light, minlength=len(pixels)) / geometry.white


@numba.njit(cache=True, nogil=True, inline="always")
def _radiance(
    pair: Array, lengths: Array, law: Array, a: float, b: float, c: float, d: float
) -> float:  # pragma: no cover - compiled
    """Of the ray at the shares (a, b) of the pixel and (c, d) of the microlens's area and angle; 0
    where the stop holds it back.
    """
    pixel, radius, stop, depth, gap, focal, main_focal, distance = lengths
    left, right, width, height = law
    out, turn = radius * math.sqrt(c), 2 * math.pi * d
    off_x, off_y = out * math.cos(turn), out * math.sin(turn)
    x, y = pair[2] + off_x, pair[3] + off_y
    slope_x = (pair[0] + (a - 0.5) * pixel - x) / gap + off_x / focal
    slope_y = (pair[1] + (b - 0.5) * pixel - y) / gap + off_y / focal
    x -= depth * slope_x
    y -= depth * slope_y
    if x * x + y * y > stop * stop:
        return 0.0
    x -= distance * (slope_x + x / main_focal)
    y -= distance * (slope_y + y / main_focal)
    if abs(x) > width / 2 or abs(y) > height / 2:
        return 0.0
    along = x + width / 2
    return 0.5 + 0.5 * math.sin(2 * math.pi * along * (left + (right - left) * along / (2 * width)))


@numba.njit(cache=True, nogil=True)
def _sum_random(
    pairs: Array, lengths: Array, law: Array, rays: int, rng: np.random.Generator
) -> Array:  # pragma: no cover - compiled
    means = np.zeros(len(pairs))
    for number in range(len(pairs)):
        total = 0.0
        for _ in range(rays):
            total += _radiance(
                pairs[number], lengths, law, rng.random(), rng.random(), rng.random(), rng.random()
            )
        means[number] = total / rays
    return means


@numba.njit(cache=True, nogil=True)
def _sum_grid(
    pairs: Array, lengths: Array, law: Array, across: int
) -> Array:  # pragma: no cover - compiled
    means = np.zeros(len(pairs))
    for number in range(len(pairs)):
        total = 0.0
        for i in range(across):
            for j in range(across):
                for k in range(across):
                    for m in range(across):
                        total += _radiance(
                            pairs[number],
                            lengths,
                            law,
                            (i + 0.5) / across,
                            (j + 0.5) / across,
                            (k + 0.5) / across,
                            (m + 0.5) / across,
                        )
        means[number] = total / across**4
    return means
