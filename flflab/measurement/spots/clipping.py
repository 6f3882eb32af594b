"""Spots that main lens or microlens cut: fitted as what both let through of a defocused dot."""

import math
from dataclasses import dataclass, replace
from functools import cache

import numba
import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import tilted_smms
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.spots.cut_light import Nodes, narrow, wide
from flflab.measurement.spots.fit import Lit, Spots, light_share
from flflab.measurement.spots.focus import SHARPEST_PX, Focus, by_common_focus
from flflab.measurement.spots.law import Square
from flflab.measurement.spots.sharing import count_pixel, on_all_cores, stepped
from flflab.optics.camera import Camera
from flflab.optics.focus import microlens_limits
from flflab.optics.resolution import central_smms
from flflab.optics.smms import image_offset

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.generic]
Whole = npt.NDArray[np.int64]

WIDE_PX = 1.5  # of blur, from which a few points stand for a pixel, not a few rays for the cone
# rays for the cone, and 4.5 more a pixel of blur: by one or two fewer each way the focus is 0.006
# px off
ALONG, ACROSS = (
    5,
    3,
)
SPARE_PX = (
    3.0  # how much further a spot may reach where the frame is out of focus, and a pixel's side
)
# of blur: places of spots with sharp edges are off by a thousandth of a pixel if they are taken for
# as sharp as others
UNLIKE_PX = 0.03
MINOR = 0.1  # share of a spot's light up to which few do as well
FAR_PX = 0.05  # from where a spot is: so long fewer points do


@dataclass(frozen=True)
class Pupils:
    """What defocused dots are seen through, one entry a spot; px on the sensor.

    Attributes:
        main: radius of the main lens's disc, shape (n,).
        small: radius of the microlens's disc, shape (n,).
        beta: by how much a pupil point moves what it sees, shape (n,).
        by_chief: a spot's place over its chief ray's: 1 where the microlens limits, shape (n,).
        blur: diameter of the blur, signed as beta, their mean.
    """

    main: Array
    small: Array
    beta: Array
    by_chief: Array
    blur: float

    def seen_in(self, focus: Focus) -> tuple[Array, Array]:
        """Blur of each, signed, and how soft its edges are, px, where the frame's are those of
        ``focus``; shape (n,) each.
        """
        signed = self.beta * 2 * self.small + focus.blur_px - self.blur
        if focus.uncertainty_px == 0:
            signed = np.where(np.abs(signed) < SHARPEST_PX, SHARPEST_PX, signed)
            return signed, np.abs(signed)
        soft = np.sqrt(
            np.maximum(focus.softness_px**2 + signed**2 - focus.blur_px**2, SHARPEST_PX**2)
        )
        return signed, soft


def pupils_of(lattice: Lattice, lens: Whole, camera: Camera, distance: float) -> Pupils | None:
    """Those of micro-images at positions ``lens``; None where the dots lie on the array's
    conjugate, or the sensor in the exit pupil.
    """
    central = central_smms(camera)
    if float(image_offset(central, 1 / distance)) == 0 or float(central.kappa) == 0:
        return None
    each = tilted_smms(lattice, central)
    if lattice.kinds is not None:
        each = replace(
            each,
            focal=float(central.distance)
            * lattice.kinds.focal[lattice.kinds.of(lattice.centres_px)],
        )
    beta = (each.gap / each.distance / (image_offset(each, 1 / distance) * each.kappa) - 1)[lens]
    main, microlens = (
        lattice.discs_px[lens].T
        if central.lens_width >= central.microlens_width
        else lattice.discs_px[lens, ::-1].T
    )
    # where the main lens limits, the chief ray goes through its middle, and the disc is seen
    # smaller by as much
    by_chief = np.ones(len(beta)) if bool(microlens_limits(central, 1 / distance)) else 1 + beta
    main, microlens = np.maximum(main, 1e-3), np.maximum(microlens, 1e-3)
    return Pupils(
        main, microlens, beta, by_chief, float((2 * beta * microlens).mean()) if len(lens) else 0.0
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sums(
    picture: Picture,
    at: Array,
    half: int,
    spots: Array,
    centres: Array,
    lights: Array,
    sizes: Array,
    shares: Array,
    step: float,
    radius: float,
    pupils: Array,
    fitted: bool,
    narrow_nodes: tuple[tuple[Nodes, Nodes], tuple[Nodes, Nodes]],
    wide_nodes: tuple[tuple[Nodes, Nodes], tuple[Nodes, Nodes]],
    dark: float,
    gain: float,
    offset: float,
    ceiling: float,
) -> tuple[Array, Array, Array, Array]:  # pragma: no cover - compiled
    """What ``on_all_cores`` asks for, by (x, y, brightness, focus, softness, radius) of each, in
    windows round ``at``.

    ``pupils`` holds radii of main lens's and microlens's disc, by_chief, focus and softness of
    each. A dot that is seen as far on this side of the focus as edges are soft, and one as far on
    the other, make up one between, as soft as both. How large the dot is, only broad blur is asked:
    sharp spots stand still as it grows.
    """
    normal, right = np.zeros((len(at), 6, 6)), np.zeros((len(at), 6))
    chi2, count = np.zeros(len(at)), np.zeros(len(at))
    g, spot, seen = np.zeros(6), np.zeros(2), np.zeros((2, 5))
    for n in range(len(at)):
        main, small, by_chief, focus, softness = pupils[n]
        part, unit, broad = focus / softness, 2 * small, softness > WIDE_PX
        fine, rough = wide_nodes if broad else narrow_nodes
        sides = ((1 + part) / 2, (1 - part) / 2)
        blurred = softness / unit * min(small, main) + 0.71
        full = math.pi * min(small, main) ** 2
        disc = radius * sizes[n] * abs(by_chief)
        spot[0], spot[1] = (
            (spots[n, 0] - centres[n, 0]) * by_chief,
            (spots[n, 1] - centres[n, 1]) * by_chief,
        )
        left, top = int(np.rint(at[n, 0])) - half, int(np.rint(at[n, 1])) - half
        for row in range(max(0, top), min(picture.shape[0], top + 2 * half + 1)):
            for column in range(max(0, left), min(picture.shape[1], left + 2 * half + 1)):
                x, y = column - centres[n, 0], row - centres[n, 1]
                share = light_share(x, y, shares[n], step)
                if share == 0.0 or picture[row, column] >= ceiling:
                    continue
                light = 0.0
                g[:] = 0.0
                away = math.hypot(x - spot[0], y - spot[1])
                if away < disc - blurred:
                    light = share
                elif away < disc + blurred:
                    seen[:] = 0.0
                    for side in range(2):
                        if fitted or sides[side] != 0.0:
                            beta = (1 - 2 * side) * softness / unit
                            along, across = fine if abs(sides[side]) > MINOR else rough
                            if broad:
                                seen[side] = wide(x, y, spot, disc, main, small, beta, along)
                            else:
                                seen[side, :4] = narrow(
                                    x, y, spot, disc, main, small, beta, along, across
                                )
                    light = (sides[0] * seen[0, 0] + sides[1] * seen[1, 0]) / full
                    g[0] = (sides[0] * seen[0, 1] + sides[1] * seen[1, 1]) * by_chief / full
                    g[1] = (sides[0] * seen[0, 2] + sides[1] * seen[1, 2]) * by_chief / full
                    g[3] = (seen[0, 0] - seen[1, 0]) / (2 * softness) / full
                    g[4] = (sides[0] * seen[0, 3] - sides[1] * seen[1, 3]) / (
                        unit * full
                    ) - part * g[3]
                    g[5] = (
                        (sides[0] * seen[0, 4] + sides[1] * seen[1, 4])
                        * sizes[n]
                        * abs(by_chief)
                        / full
                    )
                level = lights[n] * spots[n, 2]
                weight = 1 / (dark + gain * max(level * light, 0.0))
                rest = picture[row, column] - offset - level * light
                g *= level
                g[2] = lights[n] * light
                count_pixel(normal[n], right[n], g, rest, weight)
                chi2[n] += weight * rest * rest
                count[n] += 1
    return normal, right, chi2, count


@cache
def _gauss(count: int) -> Nodes:
    """Nodes from -1 to 1 and their weights."""
    return np.polynomial.legendre.leggauss(count)


def cut_spots(
    places: Array, own: Lit, lattice: Lattice, reach: float, pupils: Pupils | None
) -> Whole:
    """Positions of the spots at ``places``, ``reach`` px wide to each side, that an aperture cuts
    or a tilt blurs unlike the others.
    """
    away = np.hypot(*(places - own.centres).T)
    cut = (away + reach + SPARE_PX > lattice.inside_radius_px) & (away < lattice.outside_radius_px)
    if pupils is not None:
        cut |= np.abs(2 * pupils.beta * pupils.small - pupils.blur) > UNLIKE_PX
    return np.flatnonzero(cut)


def step_of_cut_spots(
    picture: Picture,
    spots: Spots,
    cut: Whole,
    half: int,
    own: Lit,
    pupils: Pupils | None,
    focus: Focus,
    radius: float,
    square: Square,
    noise: SensorNoise,
    moved: float,
) -> tuple[Spots, Focus, float]:
    """A step of Gauss-Newton for the spots that an aperture cuts, and for focus and radius, which
    they share; other spots stay as they are.

    Args:
        picture: DN, [row, col].
        spots: as they are known.
        cut: positions of those that are cut.
        half: half width of the windows round them, px.
        own: their micro-images.
        pupils: what the dots are seen through; None leaves spots and focus as they are, and the
            radius to the law.
        focus: as it is known.
        radius: of a spot in focus, px, as it is known.
        square: what the law says of it.
        noise: of the sensor.
        moved: by how much spots moved last, px.
    """
    if pupils is None or len(cut) == 0:
        return spots, focus, square.radius_px
    signed, soft = pupils.seen_in(focus)
    # kinds of microlenses are as far out of focus as they are: what does for the most blurred is
    # too little for the sharp
    more = math.ceil(4.5 * min(float(soft.max()), WIDE_PX))
    seen_through = np.stack([pupils.main, pupils.small, pupils.by_chief, signed, soft], axis=1)
    narrow_nodes = (_gauss(ALONG + more), _gauss(ACROSS + more)), (_gauss(4), _gauss(2))
    wide_nodes = (
        (_gauss(2 if moved > FAR_PX else 4 if float(soft.max()) < 4 else 3), _gauss(1)),
        (_gauss(2), _gauss(1)),
    )
    now = np.concatenate([spots.centres, spots.brightness[:, None]], axis=1)

    def sums(part: Whole) -> tuple[Array, Array, Array, Array]:
        mine = own.those(part)
        return _sums(
            picture,
            spots.centres[part],
            half,
            now[part],
            mine.centres,
            mine.light,
            mine.sizes,
            mine.shares,
            mine.step,
            radius,
            seen_through[part],
            focus.uncertainty_px > 0,
            narrow_nodes,
            wide_nodes,
            noise.dark_variance,
            noise.dn_per_electron,
            noise.offset_dn,
            noise.full_scale_dn,
        )

    normal, right, chi2 = on_all_cores(sums, cut)
    if focus.uncertainty_px > 0:
        normal, right = by_common_focus(normal, right, signed[cut], soft[cut], focus)
    return stepped(spots, cut, own, (normal, right, chi2), focus, radius, square, moved)
