"""What natural fall-off leaves of a blurred dot's look in a picture that is even where white is.

A pixel at e from the micro-image's centre gets of white the mean of w(e, v) = (1 + |slant +
s|^2)^-2 over the pupil, s = by_place e + rim v / small as in ``Cone``, and of a dot that over the
part of the pupil through which the dot is seen. Pictures are read over the first, so the dot's
light is off by the one mean over the other: out of focus it looks drawn aside, towards where less
steep rays land, and as light falls off towards the pupil's rim, a little less blurred. How far it
looks elsewhere is for the fit to say, which weighs pixels by their noise and has a spot's other
parameters and the focus free: so what is too much is taken out of the picture.
"""

import math
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from flflab.measurement.lattice.falloff import slants_of
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.spots.clipping import Pupils
from flflab.measurement.spots.cut_light import Nodes, pixel_in_disc
from flflab.measurement.spots.fit import Lit, Spots, light_share
from flflab.measurement.spots.focus import Focus
from flflab.optics.camera import Camera
from flflab.optics.discs import common_row, common_span
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]

NODES: Nodes = np.polynomial.legendre.leggauss(
    8
)  # along the pupil, on either side of its corners, and across it: 20 tell no more


@dataclass(frozen=True)
class Steepness:
    """How steeply rays land in micro-images, one entry a spot.

    Attributes:
        slants: slope of the micro-image's middle ray, shape (n, 2).
        share: of what slopes within a micro-image take, that there is.
        by_place: slope per px from the micro-image's centre.
        rim: at the rim of the microlens's disc.
    """

    slants: Array
    share: float
    by_place: float
    rim: float


def steepness_of(lattice: Lattice, lens: npt.NDArray[np.int64], camera: Camera) -> Steepness | None:
    """That of micro-images at positions ``lens`` as the white picture's lattice shows it; None
    where it knows no fall-off.
    """
    if lattice.cone is None:
        return None
    smms, tilting = central_smms(camera), lattice.cone.tilting
    rim = -math.copysign(float(smms.aperture) / 2 / float(smms.gap), float(smms.kappa))
    return Steepness(
        slants_of(lattice)[lens],
        float(lattice.slants[0]),
        tilting.per_px * (1 + 1 / tilting.gap),
        rim,
    )


def evenly_blurred(
    picture: npt.NDArray[Any],
    spots: Spots,
    half: int,
    own: Lit,
    pupils: Pupils,
    focus: Focus,
    radius: float,
    steepness: Steepness,
    noise: SensorNoise,
) -> npt.NDArray[Any]:
    """The picture as it would be if all of a pupil sent as much light to a pixel.

    Args:
        picture: DN, [row, col], floating, even where white is.
        spots: as they are known.
        half: half width of the windows round them, px.
        own: their micro-images.
        pupils: what the dots are seen through.
        focus: as it is known.
        radius: of a spot in focus, px.
        steepness: how light falls off.
        noise: of the sensor; saturated pixels stay as they are.
    """
    even, seen = picture.copy(), np.flatnonzero(spots.seen)
    _take_out(
        even,
        spots.centres[seen],
        (own.light * spots.brightness)[seen],
        half,
        own.centres[seen],
        own.sizes[seen],
        own.shares[seen],
        own.step,
        radius,
        np.stack([pupils.main, pupils.small, pupils.by_chief, pupils.seen_in(focus)[0]], axis=1)[
            seen
        ],
        steepness.slants[seen],
        np.array([steepness.share, steepness.by_place, steepness.rim]),
        NODES,
        noise.full_scale_dn,
    )
    return even


def as_softened(
    picture: npt.NDArray[Any], even: npt.NDArray[Any], softness: float, noise: SensorNoise
) -> npt.NDArray[Any]:
    """The picture less what ``even`` takes out of it, softened: by rays it is too near to the dots'
    edges where light bends.

    Args:
        picture: DN, [row, col].
        even: the same after ``evenly_blurred``.
        softness: diameter of the disc that softens edges beyond their blur, px; a normal
            distribution of a quarter of it is as wide.
        noise: of the sensor; saturated pixels stay as they are.
    """
    softened = picture + gaussian_filter(even - picture, softness / 4)
    return np.where(picture >= noise.full_scale_dn, picture, softened)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _take_out(
    picture: npt.NDArray[np.floating[Any]],
    spots: Array,
    lights: Array,
    half: int,
    centres: Array,
    sizes: Array,
    shares: Array,
    step: float,
    radius: float,
    pupils: Array,
    slants: Array,
    falling: Array,
    nodes: Nodes,
    ceiling: float,
) -> None:  # pragma: no cover - compiled
    """Take out of windows round spots what the pupil's fall-off makes too much; ``pupils``: discs
    of both, by_chief, signed blur.
    """
    for n in range(len(spots)):
        main, small, by_chief, signed = pupils[n]
        beta = signed / (2 * small)
        blurred = abs(beta) * min(small, main) + 0.71
        disc = radius * sizes[n] * abs(by_chief)
        left, top = int(np.rint(spots[n, 0])) - half, int(np.rint(spots[n, 1])) - half
        for row in range(max(0, top), min(picture.shape[0], top + 2 * half + 1)):
            for column in range(max(0, left), min(picture.shape[1], left + 2 * half + 1)):
                x, y = column - centres[n, 0], row - centres[n, 1]
                dx, dy = (
                    x - (spots[n, 0] - centres[n, 0]) * by_chief,
                    y - (spots[n, 1] - centres[n, 1]) * by_chief,
                )
                if abs(math.hypot(dx, dy) - disc) >= blurred or picture[row, column] >= ceiling:
                    continue
                share = light_share(x, y, shares[n], step)
                if share > 0.0:
                    too_much = _too_much(
                        x, y, dx, dy, disc, main, small, beta, slants[n], falling, nodes
                    )
                    picture[row, column] -= lights[n] * share * too_much


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _too_much(
    x: float,
    y: float,
    dx: float,
    dy: float,
    disc: float,
    main: float,
    small: float,
    beta: float,
    slant: Array,
    falling: Array,
    nodes: Nodes,
) -> float:  # pragma: no cover - compiled
    """Share of its white that a pixel at (x, y), (dx, dy) from the spot, sees through the pupil
    weighed, less that through an even one.
    """
    r = math.hypot(x, y)
    low, corners, high = common_span(small, main, r)
    to_x, to_y = (x / r, y / r) if r > 0 else (1.0, 0.0)
    share, by_place, by_pupil = falling[0], falling[1], falling[2] / small
    steep = slant[0] ** 2 + slant[1] ** 2
    even, even_seen, weighed, weighed_seen = 0.0, 0.0, 0.0, 0.0
    for part in range(2):
        start, end = (low, corners) if part == 0 else (corners, high)
        if end <= start:
            continue
        for n in range(len(nodes[0])):
            u, reach, area_of_one = common_row(small, main, r, start, end, nodes[0][n])
            for m in range(len(nodes[0])):
                w = reach * nodes[0][m]
                area = nodes[1][n] * nodes[1][m] * area_of_one
                vx, vy = u * to_x - w * to_y, u * to_y + w * to_x
                sx, sy = by_place * x + by_pupil * vx, by_place * y + by_pupil * vy
                weight = (
                    area
                    / (
                        1
                        + steep
                        + 2 * (slant[0] * sx + slant[1] * sy)
                        + share * (sx * sx + sy * sy)
                    )
                    ** 2
                )
                seen, _, _ = pixel_in_disc(disc, dx + beta * vx - 0.5, dy + beta * vy - 0.5)
                even, even_seen = even + area, even_seen + area * seen
                weighed, weighed_seen = weighed + weight, weighed_seen + weight * seen
    return weighed_seen / weighed - even_seen / even if even > 0.0 else 0.0
