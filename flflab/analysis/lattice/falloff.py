"""How natural fall-off shades each micro-image within itself, as a measured lattice has it, and what it does to blurred dots.

Steep rays bring less light, so a white target is darker on that side of a micro-image which lies away from the axis, by some per cent at
F/4. What is read there of bars and dots is shaded alike. A dot out of focus is drawn besides towards where its less steep rays land.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from flflab.analysis.lattice.profile import FALLOFF, LOPSIDED, ORDERS, VALUE, profile_table
from flflab.analysis.lattice.white import Lattice
from flflab.analysis.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

LEAST_LIGHT = 1e-3  # of the middle's: what is darker than that is not shaded
PUPIL, EDGE = 24, 801  # points across a pupil, across a blurred edge


def shade(lattice: Lattice, lens: npt.NDArray[np.int64], away_px: Array) -> Array:
    """What fall-off leaves of the light at places of micro-images, over what a picture without fall-off has there.

    Args:
        lattice: measured, or nominal: without a cone nothing is shaded.
        lens: position of each micro-image in the lattice, shape (n,).
        away_px: place from its centre, shape (n, 2).

    Returns:
        Shape (n,), 1 in the middle of a micro-image on the axis and beyond all micro-images.
    """
    if lattice.cone is None:
        return np.ones(len(lens))
    shades, step = _shades(lattice)
    return _shade_at(np.ascontiguousarray(away_px), slants_of(lattice)[lens], shades, step)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _left(dx: float, dy: float, slant: Array, shades: Array, step: float) -> float:  # pragma: no cover - compiled
    """What fall-off leaves at a place from a micro-image's centre."""
    r = np.sqrt(dx * dx + dy * dy)
    k = min(int(r / step + 0.5), len(shades) - 1)
    along, steep = (slant[0] * dx + slant[1] * dy) / max(r, 1e-9), slant[0] ** 2 + slant[1] ** 2
    left = shades[k, 0] + along * shades[k, 1] + steep * (shades[k, 2] + along * shades[k, 4])
    return left + along * along * (shades[k, 3] + along * shades[k, 5])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _shade_at(away: Array, slants: Array, shades: Array, step: float) -> Array:  # pragma: no cover - compiled
    shade = np.empty(len(away))
    for n in range(len(away)):
        shade[n] = _left(away[n, 0], away[n, 1], slants[n], shades, step)
    return shade


def unshaded(picture: npt.NDArray[Any], lattice: Lattice, noise: SensorNoise) -> npt.NDArray[Any]:
    """The picture as it would be without fall-off within the micro-images; where they overlap, by the nearest one's.

    Args:
        picture: DN, [row, col].
        lattice: measured; without a cone the picture is handed back as it is.
        noise: of the sensor; saturated pixels stay as they are.
    """
    if lattice.cone is None:
        return picture
    shades, step = _shades(lattice)
    even = picture.astype(np.float32)
    reach = min(lattice.outside_radius_px, lattice.pitch_px / 2)
    arguments = slants_of(lattice), shades, step, reach, noise.offset_dn, noise.full_scale_dn
    parts = np.array_split(np.arange(len(lattice.centres_px)), numba.get_num_threads())
    with ThreadPoolExecutor(len(parts)) as pool:
        list(pool.map(lambda part: _unshade(even, np.ascontiguousarray(lattice.centres_px), part, *arguments), parts))
    return even


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _unshade(
    picture: npt.NDArray[np.float32],
    centres: Array,
    lenses: Whole,
    slants: Array,
    shades: Array,
    step: float,
    reach: float,
    offset: float,
    ceiling: float,
) -> None:  # pragma: no cover - compiled
    for n in lenses:
        cx, cy = centres[n]
        for row in range(max(0, int(np.ceil(cy - reach))), min(picture.shape[0] - 1, int(np.floor(cy + reach))) + 1):
            dy = row - cy
            half = np.sqrt(max(reach * reach - dy * dy, 0.0))
            for column in range(max(0, int(np.ceil(cx - half))), min(picture.shape[1] - 1, int(np.floor(cx + half))) + 1):
                # dark ones too: which is dark would be for the noise to say, and what it left out put the focus 0.008 px off
                if picture[row, column] >= ceiling:
                    continue
                left = _left(column - cx, dy, slants[n], shades, step)
                picture[row, column] = offset + (picture[row, column] - offset) / left


def drawn_by_falloff(places_px: Array, lens: Whole, lattice: Lattice, main_px: Array, small_px: Array, rim: float) -> Array:
    """Where on the pupil the light of a blurred dot comes from on average with fall-off, over where it comes from without.

    The pupil points v with |v| <= small and |v - e| <= main send light, each by (1 + |slant + s|^2)^-2 as in ``profile``; the share of
    it that there is, is the lattice's.

    Args:
        places_px: of the dots on the sensor, shape (n, 2).
        lens: position of each one's micro-image in the lattice, shape (n,).
        lattice: measured.
        main_px: radius of the main lens's disc, shape (n,).
        small_px: of the microlens's, shape (n,).
        rim: slope of a ray from the microlens's rim beside that from its middle, signed as in ``Cone``.

    Returns:
        In radii of the microlens's disc, shape (n, 2).
    """
    if lattice.cone is None:
        return np.zeros((len(lens), 2))
    side = (np.arange(PUPIL) + 0.5) * 2 / PUPIL - 1
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    points = points[np.hypot(*points.T) <= 1]
    away, slant, share = places_px - lattice.centres_px[lens], slants_of(lattice)[lens], float(lattice.slants[0])
    passing = np.hypot(*np.moveaxis(points * small_px[:, None, None] - away[:, None], -1, 0)) <= main_px[:, None]
    beside = rim * points + lattice.cone.tilting.per_px * (1 + 1 / lattice.cone.tilting.gap) * away[:, None]
    steep = (slant**2).sum(axis=1)[:, None] + 2 * (slant[:, None] * beside).sum(axis=2) + share * (beside**2).sum(axis=2)
    means = [
        (weight[..., None] * points).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)[:, None]
        for weight in (passing / (1 + steep) ** 2, passing)
    ]
    return means[0] - means[1]


def followed(blur_radius_px: float, dark: float) -> float:
    """By how much of it least squares move a spot whose blur is drawn aside: not all, because the dark side of an edge is the less noisy.

    Across an edge the light is the integral E of the blur's line spread l, what is drawn adds M = -integral of t l, and with the weights
    of the noise, 1 / (dark + E), the edge moves by sum(l M w) / sum(l^2 w), where the blur's own middle moves by R^2 / 4.

    Args:
        blur_radius_px: R.
        dark: variance in the dark over what the light of a whole dot adds to it.
    """
    across = np.linspace(-blur_radius_px - 1, blur_radius_px + 1, EDGE)
    sharp = np.sqrt(np.maximum(blur_radius_px**2 - across**2, 0.0))
    pixel = (np.abs(across) <= 0.5) / np.count_nonzero(np.abs(across) <= 0.5)
    spread, drawn = (np.convolve(one / sharp.sum(), pixel, "same") for one in (sharp, across * sharp))
    light, added = np.cumsum(spread), -np.cumsum(drawn)
    weight = 1 / (dark + light)
    step = across[1] - across[0]
    return float((spread * added * weight).sum() / (spread**2 * weight).sum() * step / (blur_radius_px**2 / 4))


def slants_of(lattice: Lattice) -> Array:
    """Slope of each micro-image's middle ray, as far as light falls off with it, shape (n, 2)."""
    return lattice.slants[1:3] + lattice.slants[3] * (lattice.centres_px - lattice.origin_px)


def _shades(lattice: Lattice) -> tuple[Array, float]:
    """Fall-off against the distance from a micro-image's centre, by the powers of its slant as in ``ProfileTable``, and the step."""
    large, small = (lattice.outside_radius_px + lattice.inside_radius_px) / 2, (lattice.outside_radius_px - lattice.inside_radius_px) / 2
    share = float(lattice.slants[0])
    table = profile_table(large, max(0.05, small), lattice.cone, share)
    plain = table.values[:, VALUE] - share * table.values[:, FALLOFF]
    lit = plain > LEAST_LIGHT
    columns = [VALUE, LOPSIDED, *range(ORDERS.start, ORDERS.stop)]
    shades = np.where(lit[:, None], table.values[:, columns] / np.where(lit, plain, 1.0)[:, None], np.eye(len(columns))[0])
    return np.ascontiguousarray(shades), table.step
