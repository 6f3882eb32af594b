"""Pictures made here by brute force, sharing no code with the package."""

import math
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
import pytest
from white_pictures.drawing import draw_light
from white_pictures.kernel import LENS, add_micro_images
from white_pictures.profiles import OverlappingDiscs, tabulate
from white_pictures.spec import WhiteSpec

from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, Layout, MainLens, MicrolensArray, Sensor, Useful

Array = npt.NDArray[np.float64]


def vectors_of(layout: str, pitch: float, angle: float) -> Array:
    """Lattice vectors as columns."""
    turn = angle + (math.pi / 2 if layout == "square" else math.pi / 3)
    return pitch * np.array([[math.cos(angle), math.cos(turn)], [math.sin(angle), math.sin(turn)]])


def white_picture(
    shape: tuple[int, int],
    layout: Layout,
    pitch: float,
    angle: float,
    origin: tuple[float, float],
    a: float,
    b: float,
) -> Array:
    """White picture, 1 at the middle of a micro-image; a, b: radii of the two discs, px."""
    along: Any = "square" if layout == "square" else "hexagonal along x"
    aside = origin[0] - (shape[1] - 1) / 2, origin[1] - (shape[0] - 1) / 2
    spec = WhiteSpec(
        shape, along, pitch, math.degrees(angle), aside, profile=OverlappingDiscs(a, b)
    )
    light, _ = draw_light(spec, np.random.default_rng(0))
    return light * min(a / b, 1.0) ** 2


def micro_image(shape: tuple[int, int], centre: Array, a: float, b: float) -> Array:
    """One micro-image of a white picture."""
    picture, lens = np.zeros(shape), np.zeros(1, LENS)
    for name, value in zip("xy", centre, strict=True):
        lens[name] = value
    for name in ("light", "xx", "yy", "longest"):
        lens[name] = 1.0
    lens["across"] = lens["down"] = a + b + 1
    add_micro_images(picture, lens, tabulate(OverlappingDiscs(a, b)))
    return picture * min(a / b, 1.0) ** 2


def edges_picture(size: int, angle: float) -> Array:
    """A sharp slanted edge from 0.1 to 0.9 in nine bright fields of the worked example, exact:
    the part of each pixel beyond a line.
    """
    y, x = np.mgrid[:size, :size].astype(np.float64)
    a, b, picture = math.cos(angle), math.sin(angle), np.zeros((size, size))
    middle, pitch = (size - 1) / 2, 0.4 * (1 + 1.15 / 60) / 0.00166
    for centre in [
        (middle + i * pitch, middle + j * pitch) for i in (-1, 0, 1) for j in (-1, 0, 1)
    ]:
        t = (x - centre[0] - 2.3) * a + (y - centre[1]) * b
        ramps = [
            np.maximum(t + at, 0.0) ** 2
            for at in ((a + b) / 2, (a - b) / 2, (b - a) / 2, -(a + b) / 2)
        ]
        inside = np.hypot(x - centre[0], y - centre[1]) < 60
        picture += inside * (0.1 + 0.8 * (ramps[0] - ramps[1] - ramps[2] + ramps[3]) / (2 * a * b))
    return picture


def landings(one: Camera, distance: float, dot: Array) -> tuple[Array, Array]:
    """Microlens centres (mm) and where the ray of a dot through each lands on the sensor
    (px).
    """
    grid = 0.4 * np.arange(-12.0, 13.0)
    lenses = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2).astype(np.float64)
    # straight through the microlens's centre, bent by the main lens only: solve o = m - D
    # (slope + m/F), q = m + L slope
    away, main = one.array.distance, one.main_lens.focal_length
    m = (dot + distance / away * lenses) / (1 + distance / away - distance / main)
    landed = lenses + one.gap * (lenses - m) / away
    middle = (np.asarray(one.sensor.resolution) - 1) / 2
    return lenses, landed / one.sensor.pixel + middle


def expose(
    image: Array, noise: SensorNoise, level: float, rng: np.random.Generator
) -> npt.NDArray[np.uint16]:
    """A noisy picture in DN of an image in units of the white level, which reads ``level`` DN
    above the offset.
    """
    electrons = rng.poisson(image * level / noise.dn_per_electron)
    dn = (
        electrons * noise.dn_per_electron
        + noise.offset_dn
        + rng.normal(0, noise.read_noise_dn, image.shape)
    )
    return np.clip(np.rint(dn), 0, noise.full_scale_dn).astype(np.uint16)


def camera(
    f_number: float, resolution: tuple[int, int], minimum_illumination: float = 0.5
) -> Camera:
    """The worked example on a smaller sensor."""
    useful = Useful(minimum_illumination)
    array = MicrolensArray("square", (25, 25), (0.4, 0.4), 0.336, (0.917,), 60.0)
    return Camera(
        MainLens(50.0, f_number), array, Sensor(resolution, 0.00166, 61.15), "round", useful
    )


def trace(one: Camera, distance: float, s: Array, q: Array, centre: Array) -> tuple[Array, Array]:
    """A ray from sensor point s through microlens point q, by two thin lenses: where it crosses
    main lens and target.
    """
    slope = (s - q) / one.gap + (q - centre) / one.array.focal_lengths[0]
    m = q - one.array.distance * slope
    return m, m - distance * (slope + m / one.main_lens.focal_length)


def bars_edges(cycles_per_mm: tuple[float, float], width: float, sine: bool) -> tuple[Array, Array]:
    """Integral of the target from its left edge: positions and values between which it is straight
    (bars) or nearly so (sine).
    """
    low, rate = cycles_per_mm[0], (cycles_per_mm[1] - cycles_per_mm[0]) / width
    if sine:
        x = np.linspace(0, width, 200_001)
        value = 0.5 + 0.5 * np.sin(2 * np.pi * (low * x + rate * x * x / 2))
        return (x - width / 2).astype(np.float64), np.concatenate(
            [[0], np.cumsum((value[1:] + value[:-1]) / 2 * np.diff(x))]
        )
    half_cycles = np.arange(0, (low + rate * width / 2) * width, 0.5)
    edges = np.append(2 * half_cycles / (low + np.sqrt(low**2 + 2 * rate * half_cycles)), width)
    return edges - width / 2, np.concatenate(
        [[0], np.cumsum(np.diff(edges) * (np.arange(len(edges) - 1) % 2 == 0))]
    )


def bars_picture(
    one: Camera,
    distance: float,
    cycles_per_mm: tuple[float, float],
    width: float,
    sine: bool = False,
    shift: float = 0.0,
) -> tuple[Array, Array]:
    """White picture, and bars seen by strips of the microlens in every bright field (half light
    elsewhere).
    """
    columns, rows = one.sensor.resolution
    pixel, gap, away = one.sensor.pixel, one.gap, one.array.distance
    scale = 1 + gap / away
    lens, cone = (
        one.main_lens.aperture * gap / away / 2,
        one.array.aperture * abs(scale - gap / one.array.focal_lengths[0]) / 2,
    )
    middle = ((columns - 1) / 2, (rows - 1) / 2)
    white = white_picture(
        (rows, columns), "square", 0.4 * scale / pixel, 0.0, middle, lens / pixel, cone / pixel
    )
    image = white / 2
    x: Array = ((np.arange(columns) - middle[0]) * pixel).astype(np.float64)
    y: Array = ((np.arange(rows) - middle[1]) * pixel).astype(np.float64)
    edges, integral = bars_edges(cycles_per_mm, width, sine)
    nodes, weights = np.polynomial.legendre.leggauss(300)
    strips, shares = np.sin(nodes * np.pi / 2), weights * np.cos(nodes * np.pi / 2) ** 2
    shares /= shares.sum()
    for qx in 0.4 * np.arange(-12, 13):
        at = np.flatnonzero(np.abs(x - qx * scale) < lens - cone)
        row = np.zeros(len(at))
        for strip, share in zip(strips, shares, strict=True):
            q = np.full(len(at), qx + strip * one.array.aperture / 2)
            left, right = (
                trace(one, distance, x[at] + side * pixel / 2, q, np.full(len(at), qx))[1] - shift
                for side in (1, -1)
            )
            row += (
                share
                * (np.interp(right, edges, integral) - np.interp(left, edges, integral))
                / (right - left)
            )
        for qy in 0.4 * np.arange(-12, 13):
            high = np.flatnonzero(np.abs(y - qy * scale) < lens - cone)
            inside = (
                np.hypot(x[at][None, :] - qx * scale, y[high][:, None] - qy * scale) < lens - cone
            )
            part = image[np.ix_(high, at)]
            image[np.ix_(high, at)] = np.where(inside, row[None, :], part)
    return white, image


@numba.njit(cache=True)
def _dots(
    x: Array,
    y: Array,
    lenses: Array,
    dots: Array,
    radius: float,
    f: float,
    away: float,
    gap: float,
    main: float,
    lens_radius: float,
    aperture: float,
    distance: float,
    pixel: float,
    pupil: Array,
) -> Array:
    image = np.zeros((len(y), len(x)))
    footprint = pixel * abs(away / gap * (1 - distance / main) + distance / gap)
    for n in range(len(lenses)):
        qx0, qy0 = lenses[n]
        for row in range(len(y)):
            if abs(y[row] - qy0 * (1 + gap / away)) > 0.25:
                continue
            for column in range(len(x)):
                if abs(x[column] - qx0 * (1 + gap / away)) > 0.25:
                    continue
                # the ray through the microlens centre says whether a dot is near
                sx, sy = (x[column] - qx0) / gap, (y[row] - qy0) / gap
                mx, my = qx0 - away * sx, qy0 - away * sy
                ox, oy = mx - distance * (sx + mx / main), my - distance * (sy + my / main)
                near = False
                for k in range(len(dots)):
                    near = (
                        near
                        or (ox - dots[k, 0]) ** 2 + (oy - dots[k, 1]) ** 2 < (radius + 0.6) ** 2
                    )
                if not near:
                    continue
                for p in range(len(pupil)):
                    qx, qy = qx0 + pupil[p, 0] * aperture / 2, qy0 + pupil[p, 1] * aperture / 2
                    sx = (x[column] - qx) / gap + (qx - qx0) / f
                    sy = (y[row] - qy) / gap + (qy - qy0) / f
                    mx, my = qx - away * sx, qy - away * sy
                    if mx * mx + my * my > lens_radius * lens_radius:
                        continue
                    ox, oy = mx - distance * (sx + mx / main), my - distance * (sy + my / main)
                    for k in range(len(dots)):
                        # share of the pixel within the dot, its edge taken as straight
                        beyond = math.hypot(ox - dots[k, 0], oy - dots[k, 1]) - radius
                        image[row, column] += min(1.0, max(0.0, 0.5 - beyond / footprint)) / len(
                            pupil
                        )
    return image


def dots_picture(one: Camera, distance: float, dots: Array, diameter: float) -> Array:
    """Dots by 200 rays through the microlens to each pixel's centre, the pixel's area as the edge's
    softness.
    """
    columns, rows = one.sensor.resolution
    n = np.arange(200) + 0.5
    pupil = np.sqrt(n / 200)[:, None] * np.stack(
        [np.cos(n * 2.399963), np.sin(n * 2.399963)], axis=1
    )
    grid = 0.4 * np.arange(-12.0, 13.0)
    lenses = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2).astype(np.float64)
    x, y = (
        ((np.arange(size) - (size - 1) / 2) * one.sensor.pixel).astype(np.float64)
        for size in (columns, rows)
    )
    return _dots(
        x,
        y,
        lenses,
        dots,
        diameter / 2,
        one.array.focal_lengths[0],
        one.array.distance,
        one.gap,
        one.main_lens.focal_length,
        one.main_lens.aperture / 2,
        one.array.aperture,
        distance,
        one.sensor.pixel,
        pupil,
    )


@pytest.fixture(scope="session")
def brute() -> SimpleNamespace:
    """The makers of pictures."""
    makers = (
        vectors_of,
        white_picture,
        micro_image,
        edges_picture,
        landings,
        expose,
        camera,
        bars_picture,
        dots_picture,
    )
    return SimpleNamespace(**{maker.__name__: maker for maker in makers})
