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

from flflab.optics.camera import Camera
from flflab.optics.discs import two_disc_areas
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]

VALUE, FALLOFF, LOPSIDED = range(3)
STRIPS = np.polynomial.legendre.leggauss(12)  # across the pupil
CHORD = np.array([0.0, 0.6]), np.array([4 / 9, 5 / 9])  # squares of Gauss's points, weights
RADII = 193  # at which the fall-off is averaged over the pupil


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
    """

    by_place: float
    rim: float


def cone_of(camera: Camera) -> Cone:
    """That of the camera's central microlens."""
    smms, pixel = central_smms(camera), camera.sensor.pixel
    b, kappa = float(smms.gap), float(smms.kappa)
    if float(smms.microlens_width) <= float(smms.lens_width):
        return Cone(pixel / b, -math.copysign(float(smms.aperture) / 2 / b, kappa))
    return Cone(pixel / b * (1 - 1 / kappa), float(smms.lens_width) / 2 / b / kappa)


def _pixel_points() -> Array:
    """Gauss's points (x, y) of half of a square pixel, the other being alike, and their weights:
    along a side, along the diagonal and between, which averages the direction out.
    """
    node, weight = np.polynomial.legendre.leggauss(6)
    points = []
    for angle, share in ((0.0, 0.25), (math.pi / 8, 0.5), (math.pi / 4, 0.25)):
        x, y = np.meshgrid(node / 2, node / 2)
        cos, sin = math.cos(angle), math.sin(angle)
        each = share * np.outer(weight, weight) / 4
        points.append([cos * x - sin * y, sin * x + cos * y, each])
    return np.ascontiguousarray(np.array(points).transpose(1, 0, 2, 3).reshape(3, -1))


PIXEL = _pixel_points()


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _averaged(
    fine: Array, finer: float, step: float, count: int, points: Array
) -> Array:  # pragma: no cover - compiled
    """Means over pixels at every ``step`` of curves against the distance, tabulated finer."""
    table = np.zeros((count, 3))
    for n in range(count - 2):
        for p in range(points.shape[1]):
            place = math.hypot(n * step + points[0, p], points[1, p]) / finer
            k = int(place)
            for c in range(3):
                mean = fine[k, c] + (place - k) * (fine[k + 1, c] - fine[k, c])
                table[n, c] += points[2, p] * mean
    return table


def _pupil_means(r: Array, large: float, small: float, cone: Cone) -> Array:
    """Means of (1 + |slant + s|^2)^-2 = q^-2 - 4 (slant . s) q^-3, q = 1 + s^2, over the common
    region of both discs by powers of the slant, shape (n, 2); over its strips, bounded by the one
    disc or the other, each by the angle in which they are smooth.
    """
    node, weight = STRIPS
    corner = (r * r + small * small - large * large) / (2 * r)
    of_small = np.arccos(np.clip(corner / small, -1, 1))[:, None] * (1 + node) / 2
    of_large = np.arccos(np.clip((r - corner) / large, -1, 1))[:, None] * (1 + node) / 2
    at = np.hstack([small * np.cos(of_small), r[:, None] - large * np.cos(of_large)])
    half = np.hstack([small * np.sin(of_small), large * np.sin(of_large)])
    area = half**2 * np.hstack([weight * of_small[:, -1:], weight * of_large[:, -1:]])
    means = np.zeros((len(r), 2))
    along = r[:, None] * cone.by_place + at * cone.rim / small
    for square, share in zip(*CHORD, strict=True):
        q = 1 + along**2 + square * (half * cone.rim / small) ** 2
        means += share * np.stack([area / q**2, -4 * area * along / q**3]).sum(axis=2).T
    return means / np.maximum(area.sum(axis=1), 1e-300)[:, None]


def light_across(
    large: float, small: float, cone: Cone | None = None, pixel: float = 1.0
) -> tuple[float, Array]:
    """The pixel-averaged light of two discs against the distance of the pixel's centre from the
    micro-image's, in the mean over directions of square pixels.

    Args:
        large: radius of the one disc, the main lens's shadow, px.
        small: of the other, the microlens's, px; above 0.
        cone: how steeply rays land; None where fall-off is not asked for.
        pixel: side of the squares over which it is averaged, px.

    Returns:
        Distance between entries, px; and in columns value, what all of the fall-off adds to it,
        and what a unit of slant adds along its direction, 0 from the last but one on, shape (n, 3).
    """
    large, small = max(large, small) / pixel, min(large, small) / pixel
    cone = Cone(0.0, 0.0) if cone is None else Cone(cone.by_place * pixel, cone.rim)
    outside = large + small
    step = min(0.0625, max(0.01, outside / 400))
    count, finer = math.ceil((outside + 1.0) / step) + 1, step / 4
    r = np.arange(math.ceil((step * count + 1.0) / finer) + 2) * finer
    fine = np.repeat(two_disc_areas(large, small, r)[:, None] / (math.pi * small**2), 3, axis=1)
    # at the rim itself nothing is left to average over
    places = np.linspace(1e-6, 1 - 1e-6, RADII) * outside
    even, odd = _pupil_means(places, large, small, cone).T
    fine[:, FALLOFF] *= np.interp(r, places, even / even[0]) - 1
    fine[:, LOPSIDED] *= np.interp(r, places, odd / even[0])
    table = _averaged(fine, finer, step, count, PIXEL)
    # straight lines between points of a bend lie to one side of it: entries between which they lie
    # on both sides alike
    table[1:-1] -= np.diff(table, 2, axis=0) / 12
    table[-2:] = 0.0
    return step * pixel, table
