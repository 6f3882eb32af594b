"""The light across a micro-image of a white target: two overlapping discs and the fall-off of
slanted rays, averaged over the pixel.

At e from the micro-image's centre the pupil points v with |v| <= small and |v - e| <= large send
light, each along a ray that meets the sensor at the slope slant + s, s linear in e and v; it brings
cos^4 = (1 + |slant + s|^2)^-2 of its light. ``slant``, the slope of the micro-image's middle ray,
grows with its distance from the axis. Tabulated against |e| is the light to first order in it:
symmetric(|e|) + (slant . e/|e|) lopsided(|e|). Source: physics.md, "One SMMS" and "Exact
image of a flat target".
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.tilting import Tilting, tilting_of
from flflab.optics.camera import Camera
from flflab.optics.discs import common_row, common_span, two_disc_area
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]

VALUE, FALLOFF, LOPSIDED = range(3)
SMALLEST_PX = 0.05  # radius of a disc: a smaller one cannot be told from it
_GAUSS, _CHORD = np.polynomial.legendre.leggauss(6), np.polynomial.legendre.leggauss(12)
_RADII = 193  # at which the fall-off is averaged over the pupil


@dataclass(frozen=True)
class Cone:
    """How rays land in a micro-image: their slopes beside that of its middle ray, s = by_place e +
    rim v / small.

    Where the microlens's disc is the smaller one, v = kappa (q - y) and s = e / b - v / (kappa b),
    at its rim d / (2 b), in the exit pupil too, where the disc is a point; where the main lens's
    is, v is counted in that: s = (1 - 1 / kappa) e / b + v / (kappa b).

    Attributes:
        by_place: per px from the micro-image's centre.
        rim: at the rim of the smaller disc.
        tilting: what a tilt of the array does to the micro-images.
    """

    by_place: float
    rim: float
    tilting: Tilting


def cone_of(camera: Camera) -> Cone:
    """That of the camera's central microlens."""
    smms = central_smms(camera)
    b, kappa = float(smms.gap), float(smms.kappa)
    if float(smms.microlens_width) <= float(smms.lens_width):
        return Cone(
            camera.sensor.pixel / b,
            -math.copysign(float(smms.aperture) / 2 / b, kappa),
            tilting_of(camera),
        )
    return Cone(
        camera.sensor.pixel / b * (1 - 1 / kappa),
        float(smms.lens_width) / 2 / b / kappa,
        tilting_of(camera),
    )


@dataclass(frozen=True)
class ProfileTable:
    """The pixel-averaged profile against the distance of the pixel's centre from the micro-image's,
    in the mean over directions of square pixels.

    Attributes:
        step: distance between entries, px.
        values: columns: value, what all of the fall-off adds to it, and what a unit of slant adds
            along its direction; (n, 3).
    """

    step: float
    values: Array

    @property
    def reach(self) -> float:
        """Distance from which on the profile is 0, px."""
        return self.step * (len(self.values) - 2)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add_ray(
    means: Array, weight: float, s: float, w: float
) -> None:  # pragma: no cover - compiled
    """(1 + |slant + s|^2)^-2 by powers of the slant: q^-2 - 4 (slant . s) q^-3, q = 1 + s^2."""
    q = 1 + s * s + w * w
    second = weight / (q * q)
    means[0] += second
    means[1] -= 4 * s * second / q


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _pupil_means(
    means: Array,
    r: float,
    large: float,
    small: float,
    by_place: float,
    rim: float,
    nodes: Array,
    weights: Array,
) -> None:  # pragma: no cover - compiled
    """Means over the common region of the light, even and odd in the slant."""
    by_pupil = rim / small
    low, corners, high = common_span(small, large, r)
    area = 0.0
    if high - low > 1e-9 * small:
        for part in range(2):
            start, end = (low, corners) if part == 0 else (corners, high)
            for n in range(len(nodes) if end > start else 0):
                u, half, area_of_one = common_row(small, large, r, start, end, nodes[n])
                weight = weights[n] * area_of_one
                area += weight
                s = r * by_place + u * by_pupil
                _add_ray(
                    means, weight * 4 / 9, s, 0.0
                )  # three Gauss points of the chord; the outer two are alike
                _add_ray(means, weight * 5 / 9, s, math.sqrt(0.6) * half * by_pupil)
    if area > 0.0:
        means /= area
    else:  # at the rim one ray is left
        means[:] = 0.0
        _add_ray(means, 1.0, r * by_place + min(r, small) * by_pupil, 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _tabulate(
    large: float,
    small: float,
    by_place: float,
    rim: float,
    step: float,
    gauss: tuple[Array, Array],
    chord: tuple[Array, Array],
) -> Array:  # pragma: no cover - compiled
    outside, finer = large + small, step / 4
    count = math.ceil((outside + 1.0) / step) + 1
    means, spacing = np.zeros((_RADII, 2)), outside / (_RADII - 1)
    for n in range(_RADII):
        _pupil_means(means[n], n * spacing, large, small, by_place, rim, chord[0], chord[1])
    means /= means[0, 0]
    fine = np.zeros((math.ceil((step * count + 1.0) / finer) + 2, 3))
    for n in range(min(len(fine), math.ceil(outside / finer))):
        place = min(n * finer / spacing, _RADII - 1.001)
        k = int(place)
        mean = means[k] + (place - k) * (means[k + 1] - means[k])
        fine[n] = two_disc_area(large, small, n * finer) / (math.pi * small * small)
        fine[n, FALLOFF] *= mean[0] - 1
        fine[n, LOPSIDED] *= mean[1]
    table = np.zeros((count, 3))
    for turn in range(3):
        # along a side, along the diagonal and between: so that the eighth of a turn of the
        # direction is averaged out of the value
        angle, part = 0.125 * math.pi * turn, 0.5 if turn == 1 else 0.25
        cos, sin = math.cos(angle), math.sin(angle)
        for p in range(len(gauss[0])):
            for q in range(len(gauss[0])):
                x, y = 0.5 * gauss[0][p], 0.5 * gauss[0][q]
                weight = 0.25 * gauss[1][p] * gauss[1][q] * part
                for n in range(count - 2):
                    place = math.hypot(n * step + cos * x - sin * y, sin * x + cos * y) / finer
                    k = int(place)
                    for c in range(3):
                        mean = fine[k, c] + (place - k) * (fine[k + 1, c] - fine[k, c])
                        table[n, c] += weight * mean
    # straight lines between points of a bend lie to one side of it: entries between which they lie
    # on both sides alike
    for c in range(3):
        before = table[1, c]
        for n in range(count - 2):
            here = table[n, c]
            table[n, c] -= (table[n + 1, c] - 2 * here + before) / 12
            before = here
    return table


def profile_table(
    large: float,
    small: float,
    cone: Cone | None = None,
    pixel: float = 1.0,
) -> ProfileTable:
    """Tabulate the profile of two radii in px.

    Args:
        large: radius of the one disc, the main lens's shadow, px.
        small: of the other, the microlens's, px; above 0.
        cone: how steeply rays land; None where fall-off is not asked for.
        pixel: side of the squares over which it is averaged, px.
    """
    large, small = large / pixel, small / pixel
    step = min(0.0625, max(0.01, (large + small) / 400))
    by_place, rim = (0.0, 0.0) if cone is None else (cone.by_place, cone.rim)
    values = _tabulate(large, small, by_place * pixel, rim, step, _GAUSS, _CHORD)
    return ProfileTable(step * pixel, values)
