"""Pictures of flat textured targets by plain rays: shares no code with the model, the picture
package or the depth map but the camera's description.

A ray leaves a point of a pixel through a point of a microlens, is bent there and at the main lens,
and ends on the first target it meets.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter
from scipy.stats import qmc

from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]

WHITE_E = 7000.0  # electrons at white
READ_E = 3.0
DN_PER_E = 0.4
DARK_DN = 64.0


@dataclass(frozen=True)
class Card:
    """A flat target at a distance (mm) on the axis; ``slope`` is how much further a place lies per
    mm along x; ``size`` (width, height) mm, None for a boundless one.
    """

    distance: float
    texture: Array
    texel: float
    slope: float = 0.0
    size: tuple[float, float] | None = None


@dataclass(frozen=True)
class Build:
    """A camera as built: where its microlenses really are."""

    camera: Camera
    centres: Array
    focal: Array
    light: Array
    rise: Array = field(default_factory=lambda: np.zeros(0))


def build(camera: Camera, seed: int | None) -> Build:
    """The camera with real workmanship drawn from a seed: 0.3 um in place, 1 % in focal length,
    1 % in brightness; None: as described.
    """
    array = camera.array
    columns, rows = array.count
    k, row = (part.ravel() for part in np.meshgrid(np.arange(columns), np.arange(rows)))
    x, y = k.astype(float), row.astype(float)
    if array.layout == "hexagonal":
        x, y = x - 0.5 * (row % 2), y * np.sqrt(3) / 2
    x, y = x - (x.min() + x.max()) / 2, y - (y.min() + y.max()) / 2
    x, y = array.pitch[0] * x, array.pitch[1] * y
    cos, sin = np.cos(array.roll), np.sin(array.roll)
    centres = np.stack([cos * x - sin * y, sin * x + cos * y], axis=1) + array.offset
    tile = np.array(array.pattern)
    kind = tile[row % len(tile), k % tile.shape[1]]
    focal = np.array(array.focal_lengths)[kind]
    light = np.ones(len(focal))
    if seed is not None:
        rng = np.random.default_rng(seed)
        centres = centres + 0.3e-3 * rng.standard_normal(centres.shape)
        focal = focal * (1 + 0.01 * rng.standard_normal(len(focal)))
        light = light * (1 + 0.01 * rng.standard_normal(len(light)))
    return Build(camera, centres, focal, light, centres @ np.array(array.tilt))


def texture(seed: int, width: float, texel: float, contrast: float = 0.2) -> Array:
    """Random radiance about 0.5 with equal parts of detail at four scales, rms ``contrast``."""
    rng = np.random.default_rng(seed)
    side = round(width / texel)
    parts = [
        gaussian_filter(rng.standard_normal((side, side)), scale, mode="wrap")
        for scale in (0.8, 2, 5, 14)
    ]
    total = sum(part / part.std() for part in parts)
    return np.asarray(np.clip(0.5 + contrast * total / np.std(total), 0, 1), dtype=np.float64)


@numba.njit(nogil=True, error_model="numpy", fastmath=True)
def _form(
    picture: Array,
    first: int,
    last: int,
    lenses: Array,
    sensor: tuple[float, ...],
    sets: Array,
    cards: Array,
    textures: tuple[Array, ...],
) -> None:
    pixel, left, top, F, half_stop, own = sensor
    columns = picture.shape[1]
    for index in range(len(lenses)):
        lx, ly, focal, light, L, b = lenses[index]
        scale = 1 + b / L
        reach = half_stop * b / L + own * abs(1 + b / L - b / focal) + pixel
        cx, cy = (lx * scale - left) / pixel, (ly * scale - top) / pixel
        r0, r1 = max(first, int(cy - reach / pixel)), min(last, int(cy + reach / pixel) + 2)
        c0, c1 = max(0, int(cx - reach / pixel)), min(columns, int(cx + reach / pixel) + 2)
        for r in range(r0, r1):
            for c in range(c0, c1):
                if (c - cx) ** 2 + (r - cy) ** 2 > (reach / pixel + 1) ** 2:
                    continue
                rays = sets[(r * 7919 + c * 104729) % len(sets)]
                total = 0.0
                for k in range(len(rays)):
                    sx, sy = left + (c + rays[k, 0]) * pixel, top + (r + rays[k, 1]) * pixel
                    qx, qy = own * rays[k, 2], own * rays[k, 3]
                    outx, outy = (sx - lx - qx) / b, (sy - ly - qy) / b
                    inx, iny = outx + qx / focal, outy + qy / focal
                    mx, my = lx + qx - L * inx, ly + qy - L * iny
                    if mx * mx + my * my > half_stop * half_stop:
                        continue
                    ax, ay = inx + mx / F, iny + my / F
                    weight = light / (1 + outx * outx + outy * outy) ** 2
                    for n in range(len(cards)):
                        D, slope, texel, wide, tall = cards[n]
                        away = (D + slope * mx) / (1 + slope * ax)
                        ox, oy = mx - away * ax, my - away * ay
                        ox *= np.sqrt(1 + slope * slope)
                        if abs(ox) > wide / 2 or abs(oy) > tall / 2:
                            continue
                        if texel <= 0:
                            total += weight
                            break
                        surface = textures[n]
                        u = (ox / texel) % surface.shape[1]
                        v = (oy / texel) % surface.shape[0]
                        i, j = int(v), int(u)
                        fy, fx = v - i, u - j
                        i, j = i % surface.shape[0], j % surface.shape[1]
                        i1, j1 = (i + 1) % surface.shape[0], (j + 1) % surface.shape[1]
                        total += weight * (
                            (1 - fy) * ((1 - fx) * surface[i, j] + fx * surface[i, j1])
                            + fy * ((1 - fx) * surface[i1, j] + fx * surface[i1, j1])
                        )
                        break
                picture[r, c] += total / len(rays)


def _rays(seed: int, count: int) -> Array:
    """Places in a pixel, from -1/2 to 1/2, and in a disc of radius 1; shape (count, 4)."""
    points = qmc.Sobol(4, rng=np.random.default_rng(seed)).random(count)
    rho, phi = np.sqrt(points[:, 2]), 2 * np.pi * points[:, 3]
    return np.column_stack([points[:, :2] - 0.5, rho * np.cos(phi), rho * np.sin(phi)])


def form(built: Build, cards: Sequence[Card], rays: int = 128) -> Array:
    """Light of a picture, [row, col], where full light through a microlens is 1; the nearest card
    first; no card: white.
    """
    camera = built.camera
    columns, rows = camera.sensor.resolution
    pixel = camera.sensor.pixel
    left = -(columns - 1) / 2 * pixel + camera.sensor.offset[0]
    top = -(rows - 1) / 2 * pixel + camera.sensor.offset[1]
    stop = camera.main_lens.focal_length / camera.main_lens.f_number / 2
    sensor = (pixel, left, top, camera.main_lens.focal_length, stop, camera.array.aperture / 2)
    L = camera.optical_distance + built.rise
    b = camera.optical_gap - built.rise
    lenses = np.column_stack([built.centres, built.focal, built.light, L, b])
    described = np.array(
        [(c.distance, c.slope, c.texel, *(c.size or (np.inf, np.inf))) for c in cards]
        or [(500.0, 0.0, 0.0, np.inf, np.inf)]
    )
    textures = tuple(card.texture for card in cards) or (np.ones((1, 1)),)
    sets = np.stack([_rays(seed, rays) for seed in range(64)])
    picture = np.zeros((rows, columns))
    bands = [(at, min(at + 32, rows)) for at in range(0, rows, 32)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(
            pool.map(
                lambda band: _form(
                    picture, band[0], band[1], lenses, sensor, sets, described, textures
                ),
                bands,
            )
        )
    return picture


def expose(light: Array, full: float, seed: int) -> npt.NDArray[np.uint16]:
    """Numbers of 12 bits: ``WHITE_E`` electrons where the light is ``full``, and noise."""
    rng = np.random.default_rng(seed)
    electrons = rng.poisson(np.maximum(light / full * WHITE_E, 0)) + READ_E * rng.standard_normal(
        light.shape
    )
    return np.clip(np.rint(DN_PER_E * electrons + DARK_DN), 0, 4095).astype(np.uint16)


def pair(
    built: Build, cards: Sequence[Card], seed: int, rays: int = 128
) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint16]]:
    """Picture of a scene and white picture, each with noise of its own."""
    white = form(built, [], rays)
    full = float(np.quantile(white, 0.99))
    return expose(form(built, cards, rays), full, 2 * seed), expose(white, full, 2 * seed + 1)


def plane(camera: Camera, distance: float, seed: int, **more: Any) -> Card:
    """A textured card with detail at 0.8 px of the sensor and coarser."""
    virtual = 1 / camera.main_lens.focal_length - 1 / distance
    image = 1 / virtual
    a = abs(camera.optical_distance - image)
    texel = camera.sensor.pixel * a / camera.optical_gap * distance / image
    return Card(distance, texture(seed, 900 * texel, texel), texel, **more)
