"""Spots that main lens or microlens cut: fitted as what both let through of a defocused dot.

At e from the micro-image's centre the pupil points v with |v| <= microlens disc and |v - e| <= main lens disc see the dot where
|(e - spot) + beta v| <= radius, beta = b / (L x kappa) - 1: an area common to three discs. From s = kappa q - (b/L) m + (b/f) y_i and
o V = m W - q/L (physics.md, "One SMMS") with v = kappa (q - y_i).
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from flflab.analysis.lattice import Lattice
from flflab.analysis.noise import SensorNoise
from flflab.analysis.registration import tilted_smms
from flflab.analysis.spot_focus import SHARPEST_PX, Focus, common_step
from flflab.analysis.spots import DARKEST, LIT, Lit, Spots, illumination, light_share, moved_by
from flflab.optics.camera import Camera
from flflab.optics.discs import arc_share, disc_rectangle_area, three_disc_area, two_disc_area
from flflab.optics.focus import microlens_limits
from flflab.optics.resolution import central_smms
from flflab.optics.smms import image_offset

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.generic]
Whole = npt.NDArray[np.int64]
Nodes = tuple[Array, Array]

SHARP_PX, WIDE_PX = 0.06, 1.5  # of blur: few rays stand for the cone, a few points for a pixel
SPARE_PX = 3.0  # how much further a spot may reach where the frame is out of focus, and a pixel's side
UNLIKE_PX = 0.03  # of blur: places of spots with sharp edges are off by a thousandth of a pixel if they are taken for as sharp as others
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
        """Blur of each, signed, and how soft its edges are, px, where the frame's are those of ``focus``; shape (n,) each."""
        signed = self.beta * 2 * self.small + focus.blur_px - self.blur
        if focus.uncertainty_px == 0:
            signed = np.where(np.abs(signed) < SHARPEST_PX, SHARPEST_PX, signed)
            return signed, np.abs(signed)
        soft = np.sqrt(np.maximum(focus.softness_px**2 + signed**2 - focus.blur_px**2, SHARPEST_PX**2))
        return signed, soft


def pupils_of(lattice: Lattice, lens: Whole, camera: Camera, distance: float) -> Pupils | None:
    """Those of micro-images at positions ``lens``; None where the dots lie on the array's conjugate, or the sensor in the exit pupil."""
    central = central_smms(camera)
    if float(image_offset(central, 1 / distance)) == 0 or float(central.kappa) == 0:
        return None
    each = tilted_smms(lattice, central)
    beta = (each.gap / each.distance / (image_offset(each, 1 / distance) * each.kappa) - 1)[lens]
    main, microlens = lattice.discs_px[lens].T if central.lens_width >= central.microlens_width else lattice.discs_px[lens, ::-1].T
    # where the main lens limits, the chief ray goes through its middle, and the disc is seen smaller by as much
    by_chief = np.ones(len(beta)) if bool(microlens_limits(central, 1 / distance)) else 1 + beta
    main, microlens = np.maximum(main, 1e-3), np.maximum(microlens, 1e-3)
    return Pupils(main, microlens, beta, by_chief, float((2 * beta * microlens).mean()) if len(lens) else 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _chord(radius: float, at: float, low: float, high: float) -> float:  # pragma: no cover - compiled
    """Length of the line at ``at`` from ``low`` to ``high`` within the disc round the origin."""
    if abs(at) >= radius:
        return 0.0
    half = math.sqrt((radius - at) * (radius + at))
    return max(0.0, min(high, half) - max(low, -half))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _narrow(
    x: float, y: float, spot: Array, radius: float, main: float, small: float, beta: float, along: Nodes, across: Nodes
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled
    """Light in the pixel at (x, y) and its slopes by the spot's place and by beta, where the blur is narrow.

    The share of the pixel, closed form, that sees the dot through v, integrated over the pupil of its middle. A pixel on the spot's edge
    is lit on its inner side only, and there the main lens's disc lies a little elsewhere: share by share, an integral along that disc's
    rim. Nodes and weights of Gauss ``along`` the line from the micro-image's centre, on either side of the pupil's corners, and
    ``across`` it.
    """
    r = math.hypot(x, y)
    area = two_disc_area(small, main, r)
    low, high = max(-small, r - main), min(small, r + main)
    middle = low
    if abs(main - small) < r:
        middle = min(max((r * r + small * small - main * main) / (2 * r), low), high)
    to_x, to_y = (x / r, y / r) if r > 0 else (1.0, 0.0)
    total, seen, by_x, by_y, by_beta = 0.0, 0.0, 0.0, 0.0, 0.0
    for part in range(2):
        start, length = (low, middle - low) if part == 0 else (middle, high - middle)
        if length <= 0.0:
            continue
        for n in range(len(along[0])):
            angle = 0.5 * math.pi * (1 + along[0][n])
            u = start + length * 0.5 * (1 - math.cos(angle))
            half = math.sqrt(max(min(small * small - u * u, main * main - (u - r) ** 2), 0.0))
            for m in range(len(across[0])):
                w = half * across[0][m]
                weight = along[1][n] * across[1][m] * math.sin(angle) * length * half
                vx, vy = u * to_x - w * to_y, u * to_y + w * to_x
                left, bottom = x - 0.5 - spot[0] + beta * vx, y - 0.5 - spot[1] + beta * vy
                total += weight
                share = disc_rectangle_area(radius, left, left + 1, bottom, bottom + 1)
                seen += weight * share
                if 0.0 < share < 1.0:
                    more_x = weight * (_chord(radius, left, bottom, bottom + 1) - _chord(radius, left + 1, bottom, bottom + 1))
                    more_y = weight * (_chord(radius, bottom, left, left + 1) - _chord(radius, bottom + 1, left, left + 1))
                    by_x, by_y, by_beta = by_x + more_x, by_y + more_y, by_beta - vx * more_x - vy * more_y
    scale = area / max(total, 1e-300)
    light = scale * seen
    turn, opening = arc_share(x, y, main, 0.0, 0.0, small)
    if opening > 0.0:
        for n in range(len(along[0])):
            angle = turn + opening * along[0][n]
            out_x, out_y = math.cos(angle), math.sin(angle)
            cx, cy = x - spot[0] + beta * (x + main * out_x), y - spot[1] + beta * (y + main * out_y)
            share = disc_rectangle_area(radius, cx - 0.5, cx + 0.5, cy - 0.5, cy + 0.5)
            inwards = -(cx * out_x + cy * out_y) / max(math.hypot(cx, cy), 1e-9)
            light += along[1][n] * opening * main * share * (1 - share) / 2 * inwards
    return light, scale * by_x, scale * by_y, scale * by_beta


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _rim(
    x: float, y: float, radius: float, small: float, main_x: float, main_y: float, main: float
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """The part of a disc's rim that lies in the disc ``small`` round the origin and in another, ``main``: length, sum of normals."""
    middle, half = arc_share(x, y, radius, 0.0, 0.0, small)
    if half < 0.0:
        return 0.0, 0.0, 0.0
    other, opening = arc_share(x, y, radius, main_x, main_y, main)
    if opening < 0.0:
        return 0.0, 0.0, 0.0
    if half == math.pi:
        middle, half, other, opening = other, opening, middle, half
    if half == math.pi:
        return 2 * math.pi * radius, 0.0, 0.0
    turn = other - middle
    turn -= 2 * math.pi * math.floor(turn / (2 * math.pi) + 0.5)
    length, out_x, out_y = 0.0, 0.0, 0.0
    for full in (-2 * math.pi, 0.0, 2 * math.pi):
        start, end = max(-half, turn + full - opening), min(half, turn + full + opening)
        if opening == math.pi:
            start, end = (-half, half) if full == 0.0 else (0.0, 0.0)
        if end > start:
            length += end - start
            out_x += math.sin(middle + end) - math.sin(middle + start)
            out_y += math.cos(middle + start) - math.cos(middle + end)
    return radius * length, radius * out_x, radius * out_y


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _wide(
    x: float, y: float, spot: Array, radius: float, main: float, small: float, beta: float, within: Nodes
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled
    """Light in the pixel at (x, y) and its slopes by the spot's place and by beta: the mean of a few of its points, each in closed form.

    As the dot's disc moves or grows, the common area grows by as much along that part of its rim which lies in the other two discs.
    """
    light, by_x, by_y, by_beta = 0.0, 0.0, 0.0, 0.0
    size = radius / abs(beta)
    for n in range(len(within[0])):
        for m in range(len(within[0])):
            ex, ey = x + within[0][n] / 2, y + within[0][m] / 2
            weight = within[1][n] * within[1][m] / 4
            ax, ay = (spot[0] - ex) / beta, (spot[1] - ey) / beta
            light += weight * three_disc_area(0.0, 0.0, small, ex, ey, main, ax, ay, size)
            length, out_x, out_y = _rim(ax, ay, size, small, ex, ey, main)
            by_x += weight * out_x / beta
            by_y += weight * out_y / beta
            by_beta -= weight * (ax * out_x + ay * out_y + size * length) / beta
    return light, by_x, by_y, by_beta


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sums(
    picture: Picture,
    at: Array,
    half: int,
    spots: Array,
    centres: Array,
    lights: Array,
    sizes: Array,
    table: Array,
    step: float,
    radius: float,
    pupils: Array,
    wide: bool,
    fitted: bool,
    fine: tuple[Nodes, Nodes],
    rough: tuple[Nodes, Nodes],
    dark: float,
    gain: float,
    offset: float,
    ceiling: float,
) -> tuple[Array, Array, Array, Array]:  # pragma: no cover - compiled
    """Normal matrices, right sides, chi^2 and numbers of pixels of (x, y, brightness, focus, softness) in windows round ``at``.

    ``pupils`` holds radii of main lens's and microlens's disc, by_chief, focus and softness of each. A dot that is seen as far on this
    side of the focus as edges are soft, and one as far on the other, make up one between, as soft as both.
    """
    normal, right = np.zeros((len(at), 5, 5)), np.zeros((len(at), 5))
    chi2, count = np.zeros(len(at)), np.zeros(len(at))
    g, spot, seen = np.zeros(5), np.zeros(2), np.zeros((2, 4))
    for n in range(len(at)):
        main, small, by_chief, focus, softness = pupils[n]
        part, unit = focus / softness, 2 * small
        shares = ((1 + part) / 2, (1 - part) / 2)
        blurred = softness / unit * min(small, main) + 0.71
        full = math.pi * min(small, main) ** 2
        disc = radius * sizes[n] * abs(by_chief)
        spot[0], spot[1] = (spots[n, 0] - centres[n, 0]) * by_chief, (spots[n, 1] - centres[n, 1]) * by_chief
        left, top = int(np.rint(at[n, 0])) - half, int(np.rint(at[n, 1])) - half
        for row in range(max(0, top), min(picture.shape[0], top + 2 * half + 1)):
            for column in range(max(0, left), min(picture.shape[1], left + 2 * half + 1)):
                x, y = column - centres[n, 0], row - centres[n, 1]
                share = light_share(x, y, table, step)
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
                        if fitted or shares[side] != 0.0:
                            beta = (1 - 2 * side) * softness / unit
                            along, across = fine if abs(shares[side]) > MINOR else rough
                            if wide:
                                seen[side] = _wide(x, y, spot, disc, main, small, beta, along)
                            else:
                                seen[side] = _narrow(x, y, spot, disc, main, small, beta, along, across)
                    light = (shares[0] * seen[0, 0] + shares[1] * seen[1, 0]) / full
                    g[0] = (shares[0] * seen[0, 1] + shares[1] * seen[1, 1]) * by_chief / full
                    g[1] = (shares[0] * seen[0, 2] + shares[1] * seen[1, 2]) * by_chief / full
                    g[3] = (seen[0, 0] - seen[1, 0]) / (2 * softness) / full
                    g[4] = (shares[0] * seen[0, 3] - shares[1] * seen[1, 3]) / (unit * full) - part * g[3]
                level = lights[n] * spots[n, 2]
                weight = 1 / (dark + gain * max(level * light, 0.0))
                rest = picture[row, column] - offset - level * light
                g *= level
                g[2] = lights[n] * light
                for i in range(5):
                    right[n, i] += weight * rest * g[i]
                    for j in range(i + 1):
                        normal[n, i, j] += weight * g[i] * g[j]
                chi2[n] += weight * rest * rest
                count[n] += 1
        for i in range(5):
            for j in range(i):
                normal[n, j, i] = normal[n, i, j]
    return normal, right, chi2, count


def cut_spots(spots: Spots, own: Lit, lattice: Lattice, reach: float, pupils: Pupils | None) -> Whole:
    """Positions of the spots, ``reach`` px wide to each side, that an aperture cuts or a tilt of the array blurs unlike the others."""
    away = np.hypot(*(spots.centres - own.centres).T)
    cut = (away + reach + SPARE_PX > lattice.inside_radius_px) & (away < lattice.outside_radius_px)
    if pupils is not None:
        cut |= np.abs(2 * pupils.beta * pupils.small - pupils.blur) > UNLIKE_PX
    return np.flatnonzero(cut & spots.seen)


def step_of_cut_spots(
    picture: Picture,
    spots: Spots,
    cut: Whole,
    half: int,
    own: Lit,
    pupils: Pupils | None,
    focus: Focus,
    radius: float,
    noise: SensorNoise,
    moved: float,
) -> tuple[Spots, Focus]:
    """A step of Gauss-Newton for the spots that an aperture cuts and for the focus that they share; the other spots stay as they are.

    Args:
        picture: DN, [row, col].
        spots: as they are known.
        cut: positions of those that are cut.
        half: half width of the windows round them, px.
        own: their micro-images.
        pupils: what the dots are seen through; None leaves spots and focus as they are.
        focus: as it is known.
        radius: of a spot in focus, px.
        noise: of the sensor.
        moved: by how much spots moved last, px.
    """
    if pupils is None or len(cut) == 0:
        return spots, focus
    signed, soft = pupils.seen_in(focus)
    spread = float(soft.max())
    wide, more = spread > WIDE_PX, math.ceil(4.5 * spread)
    nodes = (2 if moved > FAR_PX else 4 if spread < 4 else 3, 1) if wide else (3 + more, 1 + more) if spread > SHARP_PX else (2, 1)
    seen_through = np.stack([pupils.main, pupils.small, pupils.by_chief, signed, soft], axis=1)
    gauss = np.polynomial.legendre.leggauss
    fine, rough = ((gauss(one), gauss(other)) for one, other in (nodes, (2, 1)))
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
            mine.table.values,
            mine.table.step,
            radius,
            seen_through[part],
            wide,
            focus.uncertainty_px > 0,
            fine,
            rough,
            noise.dark_variance,
            noise.dn_per_electron,
            noise.offset_dn,
            noise.full_scale_dn,
        )

    parts = np.array_split(cut, numba.get_num_threads())
    with ThreadPoolExecutor(len(parts)) as pool:
        normal, right, misfit, count = (np.concatenate(part) for part in zip(*pool.map(sums, parts), strict=True))
    chi2 = misfit / np.maximum(count - 3, 1)
    lit = illumination(own.table, np.hypot(*(spots.centres - own.centres)[cut].T)) > LIT
    step = common_step(normal, right, chi2, spots.brightness[cut] > DARKEST, lit, focus, math.isinf(moved))
    new = moved_by(now[cut], step.steps)
    return spots.with_those(cut, Spots(new[:, :2], new[:, 2], step.covariance, chi2, step.by_focus)), step.focus
