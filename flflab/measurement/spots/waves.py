"""Spots in light that bends, whole or cut: fitted with what diffraction leaves of a defocused
dot.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.spots.bent_light import BY_BENT, BY_BLUR, LIGHT, BentLight, bent_light
from flflab.measurement.spots.clipping import Pupils
from flflab.measurement.spots.fit import Lit, Spots, light_share
from flflab.measurement.spots.focus import Focus
from flflab.measurement.spots.law import Square
from flflab.measurement.spots.sharing import count_pixel, on_all_cores, stepped

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.generic]
Whole = npt.NDArray[np.int64]

THIRDS = math.sqrt(0.15)  # px from a pixel's middle, of Gauss's rule of three
# from a dot's edge, beyond which a pixel's middle stands for it: at 3 px depth at F/5.6 is 0.01 mm
# off
EDGE_PX = 5.0
LEAST_BENT_PX = 0.1  # of softness: less moves blur and softness together
# of the softness, as a standard uncertainty of the focus: 470 to 640 nm together lead it astray by
# 0.004
LEFT_ASTRAY = 0.02


def light_of(focus: Focus, pupils: Pupils, radius: float, half: int) -> BentLight:
    """The light of a frame's dots in windows ``half`` px wide to each side, as far as focus and a
    spot's radius, px, are known.
    """
    return bent_light(
        float(pupils.main.mean()),
        float(pupils.small.mean()),
        focus.blur_px,
        bent_px(focus),
        radius,
        half,
    )


def bent_px(focus: Focus) -> float:
    """Softness beyond the blur's, px."""
    return math.sqrt(max(focus.softness_px**2 - focus.blur_px**2, LEAST_BENT_PX**2))


def step_of_diffracted_spots(
    picture: Picture,
    spots: Spots,
    which: Whole,
    half: int,
    own: Lit,
    pupils: Pupils,
    focus: Focus,
    radius: float,
    square: Square,
    noise: SensorNoise,
    moved: float,
    light: BentLight,
) -> tuple[Spots, Focus, float]:
    """A step of Gauss-Newton for spots and for the focus, softness and radius that they share; the
    other spots stay as they are.

    Args:
        picture: DN, [row, col].
        spots: as they are known.
        which: positions of those to fit.
        half: half width of the windows round them, px.
        own: their micro-images.
        pupils: what the dots are seen through.
        focus: as it is known.
        radius: of a spot in focus, px, as it is known.
        square: what the law says of it.
        noise: of the sensor.
        moved: by how much spots moved last, px; infinite as long as they are not where they belong.
        light: tabulated for nearly this focus and radius.
    """
    half = min(
        half, int(light.fields.shape[1] / (3 * light.samples)) - 2
    )  # whose corners the table holds
    now = np.concatenate([spots.centres, spots.brightness[:, None]], axis=1)
    bent = bent_px(focus)
    blurs = 2 * pupils.beta * pupils.small - pupils.blur + focus.blur_px
    off = np.stack(
        [
            np.ones(len(blurs)),
            blurs - light.blur,
            np.full(len(blurs), bent - light.bent),
            radius * own.sizes - light.radius,
        ],
        axis=1,
    )

    def sums(part: Whole) -> tuple[Array, Array, Array, Array]:
        mine = own.those(part)
        return _sums(
            picture,
            half,
            now[part],
            mine.centres,
            mine.light,
            mine.sizes,
            mine.shares,
            mine.step,
            off[part],
            light.fields,
            light.first,
            light.spacing,
            light.samples,
            light.radius,
            noise.dark_variance,
            noise.dn_per_electron,
            noise.offset_dn,
            noise.full_scale_dn,
        )

    normal, right, chi2 = on_all_cores(sums, which)
    # softness s, blur b and what waves add, s^2 = b^2 + bent^2
    turn = np.eye(6)
    turn[4, 3], turn[4, 4] = -focus.blur_px / bent, focus.softness_px / bent
    summed = turn.T @ normal @ turn, right @ turn, chi2
    return stepped(spots, which, own, summed, focus, radius, square, moved, LEFT_ASTRAY)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _read(
    fields: npt.NDArray[np.float32],
    place: float,
    u: float,
    v: float,
    off: Array,
    weight: float,
    seen: Array,
) -> None:  # pragma: no cover - compiled
    """Add light at a way (u, v) from the spot, in samples, and its slopes along u and v, by blur,
    softness and radius, to ``seen``.
    """
    k, side = int(place), 1.0 if v > 0.0 else -1.0
    v = abs(v)
    i, j = int(u), int(v)
    p, q = u - i, v - j
    for m in range(2):
        part = weight * (place - k if m == 1 else 1 - place + k)
        for kind in range(4):
            near, far = fields[k + m, i, j, kind], fields[k + m, i, j + 1, kind]
            next_near, next_far = fields[k + m, i + 1, j, kind], fields[k + m, i + 1, j + 1, kind]
            value = part * (
                (1 - p) * ((1 - q) * near + q * far) + p * ((1 - q) * next_near + q * next_far)
            )
            seen[0] += off[kind] * value
            if kind == LIGHT:
                seen[1] += part * ((1 - q) * (next_near - near) + q * (next_far - far))
                seen[2] += part * side * ((1 - p) * (far - near) + p * (next_far - next_near))
            elif kind == BY_BLUR:
                seen[3] += value
            elif kind == BY_BENT:
                seen[4] += value
            else:
                seen[5] += value


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sums(
    picture: Picture,
    half: int,
    spots: Array,
    centres: Array,
    lights: Array,
    sizes: Array,
    shares: Array,
    step: float,
    off: Array,
    fields: npt.NDArray[np.float32],
    first: float,
    spacing: float,
    samples: int,
    radius: float,
    dark: float,
    gain: float,
    offset: float,
    ceiling: float,
) -> tuple[Array, Array, Array, Array]:  # pragma: no cover - compiled
    """What ``on_all_cores`` asks for, by (x, y, brightness, blur, bent softness, radius) of each,
    in windows round spots.
    """
    normal, right = np.zeros((len(spots), 6, 6)), np.zeros((len(spots), 6))
    chi2, count = np.zeros(len(spots)), np.zeros(len(spots))
    g, seen = np.zeros(6), np.zeros(6)
    middle = fields.shape[1] // 2
    for n in range(len(spots)):
        left, top = int(np.rint(spots[n, 0])) - half, int(np.rint(spots[n, 1])) - half
        for row in range(max(0, top), min(picture.shape[0], top + 2 * half + 1)):
            for column in range(max(0, left), min(picture.shape[1], left + 2 * half + 1)):
                x, y = column - centres[n, 0], row - centres[n, 1]
                share = light_share(x, y, shares[n], step)
                if share == 0.0 or picture[row, column] >= ceiling:
                    continue
                r = math.hypot(x, y)
                to_x, to_y = (x / r, y / r) if r > 0 else (1.0, 0.0)
                place = min(max((r - first) / spacing, 0.0), fields.shape[0] - 1.001)
                dx, dy = column - spots[n, 0], row - spots[n, 1]
                seen[:] = 0.0
                if abs(math.hypot(dx, dy) - radius) > EDGE_PX:
                    _read(
                        fields,
                        place,
                        samples * (dx * to_x + dy * to_y) + middle,
                        samples * (dy * to_x - dx * to_y),
                        off[n],
                        share,
                        seen,
                    )
                # a pixel on a slope of both spot and micro-image sees more of the one where it is
                # brighter in the other
                else:
                    for i in range(-1, 2):
                        for j in range(-1, 2):
                            there = light_share(x + i * THIRDS, y + j * THIRDS, shares[n], step)
                            weight = (
                                (8.0 - 3.0 * abs(i))
                                * (8.0 - 3.0 * abs(j))
                                / 324
                                * (there if there > 0.0 else share)
                            )
                            ex, ey = dx + i * THIRDS, dy + j * THIRDS
                            u, v = (
                                samples * (ex * to_x + ey * to_y) + middle,
                                samples * (ey * to_x - ex * to_y),
                            )
                            _read(fields, place, u, v, off[n], weight, seen)
                level = lights[n] * spots[n, 2]
                g[0], g[1] = (
                    -level * samples * (seen[1] * to_x - seen[2] * to_y),
                    -level * samples * (seen[1] * to_y + seen[2] * to_x),
                )
                g[2], g[3], g[4] = lights[n] * seen[0], level * seen[3], level * seen[4]
                g[5] = level * sizes[n] * seen[5]
                weight = 1 / (dark + gain * max(level * seen[0], 0.0))
                rest = picture[row, column] - offset - level * seen[0]
                count_pixel(normal[n], right[n], g, rest, weight)
                chi2[n] += weight * rest * rest
                count[n] += 1
    return normal, right, chi2, count
