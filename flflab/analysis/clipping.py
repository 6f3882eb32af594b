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
from flflab.analysis.spots import Lit, Spots, gauss_newton, light_share
from flflab.optics.camera import Camera
from flflab.optics.discs import arc_share, disc_rectangle_area, three_disc_area, two_disc_area
from flflab.optics.focus import blur, microlens_limits
from flflab.optics.resolution import central_smms
from flflab.optics.smms import image_offset

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.generic]
Whole = npt.NDArray[np.int64]
Nodes = tuple[Array, Array]

SHARP_PX, WIDE_PX = 0.02, 1.5  # of blur: one ray stands for the cone, a few points for a pixel
FAR_PX = 0.05  # from where a spot is: so long fewer points do


@dataclass(frozen=True)
class Pupils:
    """What defocused dots are seen through, one entry a spot; px on the sensor.

    Attributes:
        main: radius of the main lens's disc, shape (n,).
        small: radius of the microlens's disc, shape (n,).
        beta: by how much a pupil point moves what it sees, shape (n,).
        by_chief: a spot's place over its chief ray's: 1 where the microlens limits, shape (n,).
        spread: diameter of the blur, that of the widest.
    """

    main: Array
    small: Array
    beta: Array
    by_chief: Array
    spread: float


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
    spread = float(np.broadcast_to(blur(each, 1 / distance), lattice.rises.shape)[lens].max(initial=0.0)) / camera.sensor.pixel
    return Pupils(np.maximum(main, 1e-3), np.maximum(microlens, 1e-3), beta, by_chief, spread)


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
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Light in the pixel at (x, y) and its slopes by the spot's place, where the blur is narrow.

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
    total, seen, by_x, by_y = 0.0, 0.0, 0.0, 0.0
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
                left, bottom = x - 0.5 - spot[0] + beta * (u * to_x - w * to_y), y - 0.5 - spot[1] + beta * (u * to_y + w * to_x)
                total += weight
                share = disc_rectangle_area(radius, left, left + 1, bottom, bottom + 1)
                seen += weight * share
                if 0.0 < share < 1.0:
                    by_x += weight * (_chord(radius, left, bottom, bottom + 1) - _chord(radius, left + 1, bottom, bottom + 1))
                    by_y += weight * (_chord(radius, bottom, left, left + 1) - _chord(radius, bottom + 1, left, left + 1))
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
    return light, scale * by_x, scale * by_y


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _pull(
    x: float, y: float, radius: float, to_x: float, to_y: float, own: float, other_x: float, other_y: float, other: float
) -> tuple[bool, float, float]:  # pragma: no cover - compiled
    """Where the rim of the disc at (x, y) runs into the disc ``own`` at (to_x, to_y) and out of it, within the disc ``other``.

    Returns:
        False where the rim lies outside ``own``; the sum of (y, -x) of the ends less that of the starts, from the disc's middle.
    """
    dx, dy = to_x - x, to_y - y
    distance = math.hypot(dx, dy)
    if distance >= radius + own or distance + own <= radius:
        return False, 0.0, 0.0
    if distance + radius <= own:
        return True, 0.0, 0.0
    along = ((radius - own) * (radius + own) / distance + distance) / 2
    across = math.sqrt(max((radius - along) * (radius + along), 0.0))
    dx, dy = dx / distance, dy / distance
    pull_x, pull_y = 0.0, 0.0
    for side in (1.0, -1.0):
        at_x, at_y = along * dx - side * across * dy, along * dy + side * across * dx
        if (x + at_x - other_x) ** 2 + (y + at_y - other_y) ** 2 <= other * other:
            pull_x += side * at_y
            pull_y -= side * at_x
    return True, pull_x, pull_y


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _wide(
    x: float, y: float, spot: Array, radius: float, main: float, small: float, beta: float, within: Nodes
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Light in the pixel at (x, y) and its slopes by the spot's place: the mean of a few of its points, each in closed form.

    As the dot's disc moves, the common area grows by the normals along that part of its rim which lies in the other two discs.
    """
    light, by_x, by_y = 0.0, 0.0, 0.0
    size = radius / abs(beta)
    for n in range(len(within[0])):
        for m in range(len(within[0])):
            ex, ey = x + within[0][n] / 2, y + within[0][m] / 2
            weight = within[1][n] * within[1][m] / 4
            ax, ay = (spot[0] - ex) / beta, (spot[1] - ey) / beta
            light += weight * three_disc_area(0.0, 0.0, small, ex, ey, main, ax, ay, size)
            by_small = _pull(ax, ay, size, 0.0, 0.0, small, ex, ey, main)
            by_main = _pull(ax, ay, size, ex, ey, main, 0.0, 0.0, small)
            if by_small[0] and by_main[0]:
                by_x += weight * (by_small[1] + by_main[1]) / beta
                by_y += weight * (by_small[2] + by_main[2]) / beta
    return light, by_x, by_y


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sums(
    picture: Picture,
    at: Array,
    half: int,
    spots: Array,
    centres: Array,
    lights: Array,
    table: Array,
    step: float,
    radius: float,
    pupils: Array,
    wide: bool,
    along: Nodes,
    across: Nodes,
    dark: float,
    gain: float,
    offset: float,
    ceiling: float,
) -> tuple[Array, Array, Array, Array]:  # pragma: no cover - compiled
    """Normal matrices, right sides, chi^2 and numbers of pixels of (x, y, brightness) in windows round ``at``.

    ``pupils`` holds radii of main lens's and microlens's disc, beta and by_chief of each.
    """
    normal, right = np.zeros((len(at), 3, 3)), np.zeros((len(at), 3))
    chi2, count = np.zeros(len(at)), np.zeros(len(at))
    g, spot = np.zeros(3), np.zeros(2)
    for n in range(len(at)):
        main, small, beta, by_chief = pupils[n]
        blurred = abs(beta) * min(small, main) + 0.71
        full = math.pi * min(small, main) ** 2
        disc = radius * abs(by_chief)
        spot[0], spot[1] = (spots[n, 0] - centres[n, 0]) * by_chief, (spots[n, 1] - centres[n, 1]) * by_chief
        left, top = int(np.rint(at[n, 0])) - half, int(np.rint(at[n, 1])) - half
        for row in range(max(0, top), min(picture.shape[0], top + 2 * half + 1)):
            for column in range(max(0, left), min(picture.shape[1], left + 2 * half + 1)):
                x, y = column - centres[n, 0], row - centres[n, 1]
                share = light_share(x, y, table, step)
                if share == 0.0 or picture[row, column] >= ceiling:
                    continue
                light, by_x, by_y = 0.0, 0.0, 0.0
                away = math.hypot(x - spot[0], y - spot[1])
                if away < disc - blurred:
                    light = share
                elif away < disc + blurred:
                    if wide:
                        light, by_x, by_y = _wide(x, y, spot, disc, main, small, beta, along)
                    else:
                        light, by_x, by_y = _narrow(x, y, spot, disc, main, small, beta, along, across)
                    light, by_x, by_y = light / full, by_x * by_chief / full, by_y * by_chief / full
                level = lights[n] * spots[n, 2]
                weight = 1 / (dark + gain * max(level * light, 0.0))
                rest = picture[row, column] - offset - level * light
                g[0], g[1], g[2] = level * by_x, level * by_y, lights[n] * light
                for i in range(3):
                    right[n, i] += weight * rest * g[i]
                    for j in range(3):
                        normal[n, i, j] += weight * g[i] * g[j]
                chi2[n] += weight * rest * rest
                count[n] += 1
    return normal, right, chi2, count


def cut_spots(spots: Spots, own: Lit, lattice: Lattice, reach: float) -> Whole:
    """Positions of the spots, ``reach`` px wide to each side, that an aperture cuts."""
    away = np.hypot(*(spots.centres - own.centres).T)
    cut = (away + reach + 1 > lattice.inside_radius_px) & (away < lattice.outside_radius_px)
    return np.flatnonzero(cut & spots.seen)


def step_of_cut_spots(
    picture: Picture,
    spots: Spots,
    cut: Whole,
    half: int,
    own: Lit,
    pupils: Pupils | None,
    radius: float,
    noise: SensorNoise,
    moved: float,
) -> Spots:
    """The spots after a step of Gauss-Newton for those that an aperture cuts; the others stay as they are.

    Args:
        picture: DN, [row, col].
        spots: as they are known.
        cut: positions of those that are cut.
        half: half width of the windows round them, px.
        own: their micro-images.
        pupils: what the dots are seen through; None leaves the spots as they are.
        radius: of a spot in focus, px.
        noise: of the sensor.
        moved: by how much spots moved last, px.
    """
    if pupils is None or len(cut) == 0:
        return spots
    wide, more = pupils.spread > WIDE_PX, math.ceil(4.5 * pupils.spread)
    if wide:
        nodes = (2 if moved > FAR_PX else 4 if pupils.spread < 4 else 3, 1)
    else:
        nodes = (3 + more, 1 + more) if pupils.spread > SHARP_PX else (1, 1)
    seen_through = np.stack([pupils.main, pupils.small, pupils.beta, pupils.by_chief], axis=1)
    along, across = (np.polynomial.legendre.leggauss(count) for count in nodes)

    def stepped(part: Whole) -> Spots:
        mine = own.those(part)

        def sums(which: Whole, at: Array, now: Array) -> tuple[Array, Array, Array, Array]:
            return _sums(
                picture,
                at,
                half,
                now,
                mine.centres[which],
                mine.light[which],
                mine.table.values,
                mine.table.step,
                radius,
                seen_through[part[which]],
                wide,
                along,
                across,
                noise.dark_variance,
                noise.dn_per_electron,
                noise.offset_dn,
                noise.full_scale_dn,
            )

        return gauss_newton(spots.centres[part], spots.brightness[part], half, sums, 1)

    parts = np.array_split(cut, numba.get_num_threads())
    with ThreadPoolExecutor(len(parts)) as pool:
        for part, new in zip(parts, pool.map(stepped, parts), strict=True):
            spots = spots.with_those(part, new)
    return spots
