"""What one SMMS does with a target at a distance: image position, virtual depth, magnification,
blur, depth of field.

Works in the object vergence V = 1/D and in x = L W = -a/D', so that a target at infinity, an image
on the array and an afocal array are ordinary values. Lengths in mm. Source: paper, "Depth of field"
and "MTF function"; thin lenses, first order.
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
    """Main lens to the target's image, mm: D' = L / (1 - x); infinite for an object in the front
    focal plane.
    """
    with np.errstate(divide="ignore"):
        return smms.distance / (1 - image_offset(smms, vergence))


def virtual_depth(smms: Smms, vergence: Array | float) -> Array:
    """|a| / b: distance from the array to the main lens's image over the gap to the sensor (eq. 3
    and reference [6]).
    """
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
    """Diameter of the geometric blur of a point on the sensor, mm: |kappa x - b/L| min(A,
    d/|x|).
    """
    return np.abs(signed_blur(smms, vergence))


def signed_blur(smms: Smms, vergence: Array | float) -> Array:
    """``blur`` with the sign of the defocus, which is not the same on both sides of the focus,
    mm.
    """
    x = image_offset(smms, vergence)
    return (smms.kappa * x - smms.gap / smms.distance) * limiting_aperture(smms, vergence)


def sharp_vergence(smms: Smms) -> Array:
    """Vergence of the object plane in focus, 1/mm; infinite where the sensor lies in the exit
    pupil.

    V = 1/F - e/(1 + L e) with e = 1/b - 1/f, the vergence that the microlens brings to a point on
    the sensor: kappa x = b/L.
    """
    e = 1 / smms.gap - 1 / smms.focal
    with np.errstate(divide="ignore"):
        return 1 / smms.lens_focal - e / (1 + smms.distance * e)


def depth_of_field(smms: Smms, circle: float) -> list[Interval]:
    """Object vergences (low, high) with blur <= circle, for one SMMS, as a sorted union of
    intervals with V >= 0.

    |kappa x - b/L| <= c max(1/A, |x|/d) is the union of two sets with closed-form ends; ends at infinity are allowed. With
    e = 1/b - 1/f the ends of the main lens's set lie at V = 1/F - (e -+ c/(A b))/(1 + L e), those
    of the microlens's at V = 1/F - e'/(1 + L e') with e' = (1 +- c/d)/b - 1/f: nothing cancels
    there that does not cancel in the result's condition.

    Args:
        smms: one system (fields of shape ()).
        circle: permitted blur diameter c on the sensor, mm.

    Returns:
        Vergence intervals in 1/mm, disjoint, rising; empty when nothing real is sharp.
    """  # noqa: E501
    F, A, L, b, f, d = (
        float(part)
        for part in (
            smms.lens_focal,
            smms.lens_aperture,
            smms.distance,
            smms.gap,
            smms.focal,
            smms.aperture,
        )
    )
    sets: list[Interval] = []
    e = 1 / b - 1 / f
    middle, spread = 1 + L * e, circle / A / b
    if middle != 0:
        ends = sorted((1 / F - (e - spread) / middle, 1 / F - (e + spread) / middle))
        sets.append((ends[0], ends[1]))
    elif b / L <= circle / A:
        sets.append((-math.inf, math.inf))
    # 1 + L e' is kappa +- c/d times L/b: of one sign the set lies between its ends, of two outside
    # them.
    plus, minus = ((1 + sign * circle / d) / b - 1 / f for sign in (1, -1))
    above, below = 1 + L * plus, 1 + L * minus
    high = 1 / F - plus / above if above != 0 else math.inf
    low = 1 / F - minus / below if below != 0 else math.inf
    if below > 0 or above < 0:
        sets.append((min(low, high), max(low, high)))
    else:
        sets += [(-math.inf, low)] * (below < 0) + [(high, math.inf)] * (above > 0)
    return merge_intervals([(max(first, 0.0), last) for first, last in sets if last >= 0])


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

    atan((t + g)/b) - atan((t - g)/b) with t = y b/L the shift of the centre and g the half width of
    the limiting stop, written as one angle so that far off the axis no digits cancel.
    """
    with np.errstate(divide="ignore"):
        half = np.minimum(smms.aperture, smms.lens_width / np.abs(smms.kappa)) / 2
    shift = np.hypot(smms.centre_x, smms.centre_y) * smms.gap / smms.distance
    return np.arctan2(2 * smms.gap * half, smms.gap**2 + (shift - half) * (shift + half))
