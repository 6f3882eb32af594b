"""What one SMMS does with a target at a distance: image position, virtual depth, magnification, blur, depth of field.

Works in the object vergence V = 1/D and in x = L W = -a/D', so that a target at infinity, an image on the array and an afocal
array are ordinary values. Lengths in mm. Source: paper, "Depth of field" and "MTF function"; thin lenses, first order.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.optics.smms import Smms, image_offset

Array = npt.NDArray[np.float64]
Interval = tuple[float, float]


def vergence_of(distance: float) -> float:
    """1/D of a target's distance in mm; 0 at infinity."""
    return 0.0 if math.isinf(distance) else 1.0 / distance


def image_distance(smms: Smms, vergence: Array | float) -> Array:
    """Main lens to the target's image, mm: D' = L / (1 - x); infinite for an object in the front focal plane."""
    with np.errstate(divide="ignore"):
        return smms.distance / (1 - image_offset(smms, vergence))


def virtual_depth(smms: Smms, vergence: Array | float) -> Array:
    """|a| / b: distance from the array to the main lens's image over the gap to the sensor (eq. 3 and reference [6])."""
    with np.errstate(divide="ignore"):
        x = image_offset(smms, vergence)
        return np.abs(x / (1 - x)) * smms.distance / smms.gap


def limiting_aperture(smms: Smms, vergence: Array | float) -> Array:
    """Width of the narrower stop seen in the main lens, mm: min(A, d/|x|)."""
    with np.errstate(divide="ignore"):
        return np.minimum(smms.lens_aperture, smms.aperture / np.abs(image_offset(smms, vergence)))


def microlens_limits(smms: Smms, vergence: Array | float) -> npt.NDArray[np.bool_]:
    """True where the microlens is the limiting stop (d < A |x|), False where the main lens is."""
    return smms.aperture < smms.lens_aperture * np.abs(image_offset(smms, vergence))


def magnification(smms: Smms, vergence: Array | float) -> Array:
    """Image size over object size along the ray through the centre of the limiting stop.

    b V / |x| where the microlens limits, |kappa L V| where the main lens does; equal in focus.
    """
    x = image_offset(smms, vergence)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_microlens = smms.gap * vergence / np.abs(x)
    by_lens = np.abs(smms.kappa * smms.distance * vergence)
    return np.where(microlens_limits(smms, vergence), by_microlens, by_lens)


def blur(smms: Smms, vergence: Array | float) -> Array:
    """Diameter of the geometric blur of a point on the sensor, mm: |kappa x - b/L| min(A, d/|x|)."""
    x = image_offset(smms, vergence)
    return np.abs(smms.kappa * x - smms.gap / smms.distance) * limiting_aperture(smms, vergence)


def sharp_vergence(smms: Smms) -> Array:
    """Vergence of the object plane in focus, 1/mm: kappa x = b/L; infinite where the sensor lies in the exit pupil."""
    with np.errstate(divide="ignore"):
        x = smms.gap / smms.distance / smms.kappa
    return 1 / smms.lens_focal - (1 - x) / smms.distance


def depth_of_field(smms: Smms, circle: float) -> list[Interval]:
    """Object vergences (low, high) with blur <= circle, for one SMMS, as a sorted union of intervals with V >= 0.

    |kappa x - b/L| <= c max(1/A, |x|/d) is the union of two sets with closed-form ends; ends at infinity are allowed.

    Args:
        smms: one system (fields of shape ()).
        circle: permitted blur diameter c on the sensor, mm.

    Returns:
        Vergence intervals in 1/mm, disjoint, rising; empty when nothing real is sharp.
    """
    kappa, slope = float(smms.kappa), float(smms.gap / smms.distance)
    by_lens, by_microlens = circle / float(smms.lens_aperture), circle / float(smms.aperture)
    sets: list[Interval] = []
    if kappa != 0:
        ends = sorted(((slope - by_lens) / kappa, (slope + by_lens) / kappa))
        sets.append((ends[0], ends[1]))
    elif slope <= by_lens:
        sets.append((-math.inf, math.inf))
    roots = sorted(slope / k if k != 0 else math.copysign(math.inf, kappa) for k in (kappa + by_microlens, kappa - by_microlens))
    if abs(kappa) > by_microlens:
        sets.append((roots[0], roots[1]))
    elif abs(kappa) == by_microlens:
        half = slope / (2 * kappa) if kappa else math.inf
        sets.append((half, math.inf) if kappa > 0 else (-math.inf, half))
    else:
        sets += [(-math.inf, roots[0]), (roots[1], math.inf)]
    distance, focal = float(smms.distance), float(smms.lens_focal)
    vergences = [(1 / focal - (1 - low) / distance, 1 / focal - (1 - high) / distance) for low, high in sets]
    return merge_intervals([(max(low, 0.0), high) for low, high in vergences if high >= 0])


def merge_intervals(intervals: list[Interval]) -> list[Interval]:
    """The union of closed intervals as disjoint rising intervals."""
    merged: list[Interval] = []
    for low, high in sorted(intervals):
        if merged and low <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], high))
        else:
            merged.append((low, high))
    return merged


def marginal_angle(smms: Smms) -> Array:
    """Full plane angle of the cone on each micro-image's centre, rad (paper, Figs. 8 and 9).

    atan((t + g)/b) - atan((t - g)/b) with t = y b/L the shift of the centre and g the half width of the limiting stop, written as
    one angle so that far off the axis no digits cancel.
    """
    with np.errstate(divide="ignore"):
        half = np.minimum(smms.aperture, smms.lens_width / np.abs(smms.kappa)) / 2
    shift = np.hypot(smms.centre_x, smms.centre_y) * smms.gap / smms.distance
    return np.arctan2(2 * smms.gap * half, smms.gap**2 + (shift - half) * (shift + half))
