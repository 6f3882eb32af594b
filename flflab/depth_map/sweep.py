"""The sweep: which virtual disparity makes the views of a place agree best."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter

from flflab.depth_map.geometry import MicrolensKind, disparity_of
from flflab.depth_map.views import Views
from flflab.errors import InputError
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]

WINDOW = 9  # places a side over which what views say is averaged
EVERY = 2  # places of the map to one of the sweep, each way
STEP_PX = 2.0  # between hypotheses, at the longest baseline
FEWEST_VIEWS = 0.6  # pitches that a microlens reaches on the array, at the nearest distance
MOST_BLUR = 0.45  # of a micro-image's used width
LEAST_DISPARITY = 0.05  # a virtual depth of 20: hundreds of views, and their depth is lost
IN_EXIT_PUPIL = 0.01  # of kappa
UNFOCUSED = 0.02  # of the focal length: nearer to it is a gap of no focused camera


@dataclass(frozen=True)
class Swept:
    """What the sweep found at every place of the map; NaN where nothing.

    Attributes:
        disparity: of the smallest cost.
        ratio: the second smallest local minimum of the cost, or the cost at an end, over the
            smallest.
    """

    disparity: Array
    ratio: Array


def hypotheses(
    camera: Camera, kinds: tuple[MicrolensKind, ...], distances: tuple[float, float] | None
) -> Array:
    """Virtual disparities to try, in steps that move no view by more than ``STEP_PX``.

    Args:
        camera: the camera.
        kinds: its kinds of microlenses.
        distances: nearest and farthest to look at, mm; None: where two views overlap and are not
            blurred beyond use.

    Raises:
        InputError: the camera is not focused, or no distance in the range gives two views that
            overlap.
    """
    unfocused = [abs(camera.optical_gap / f - 1) < UNFOCUSED for f in camera.array.focal_lengths]
    if all(unfocused):
        raise InputError(
            f"camera: the gap, {camera.optical_gap:g} mm, is the microlenses' focal length: this is"
            " an unfocused (plenoptic 1.0) camera, whose micro-images hold directions and no"
            " pictures; no views overlap to be compared"
        )
    kappa = float(np.mean([kind.kappa for kind in kinds]))
    used = max(kind.reach for kind in kinds)
    if abs(kappa) < IN_EXIT_PUPIL:
        raise InputError(
            "camera: the sensor lies in the microlenses' exit pupil; no view is cut there and none"
            " is sharp: check the gap and the microlenses' focal length"
        )
    side = -math.copysign(1.0, kappa)
    pitch = min(camera.array.pitch) / camera.sensor.pixel
    nearest = used / (FEWEST_VIEWS * pitch)
    blur = MOST_BLUR * 2 * used / min(kind.blur for kind in kinds)
    low, high = max(abs(kappa) - blur, LEAST_DISPARITY), min(abs(kappa) + blur, nearest)
    far = float(disparity_of(math.inf, camera)) * side
    if side > 0:
        low = max(low, far)  # a Keplerian camera sees smaller disparities beyond infinity
    if distances is not None:
        ends = sorted(side * float(disparity_of(one, camera)) for one in distances)
        low, high = max(low, ends[0]), min(high, ends[1])
    if not low < high:
        raise InputError(_no_overlap(camera, kappa, nearest, distances))
    count = max(5, math.ceil(math.log(high / low) * 2 * used / STEP_PX))
    return side * np.geomspace(low, high, count)


def _no_overlap(
    camera: Camera, kappa: float, nearest: float, distances: tuple[float, float] | None
) -> str:
    if abs(kappa) > nearest or distances is None:
        return (
            "camera: where this camera is sharp no point is seen by two microlenses, there is"
            " nothing to compare: check gap, focal lengths and f-number"
        )
    near, far = distances
    return (
        f"range: no distance from {near:g} to {far:g} mm is seen sharply enough by two"
        " microlenses of this camera; `flflab model` says which are"
    )


def sweep(views: Views, disparities: Array, progress: Callable[[float], None]) -> Swept:
    """Try every disparity and keep the best at every place.

    The cost is the misfit of the views over their number less one, each averaged over a window.
    Only running minima are kept: a volume of costs would need a gigabyte. The sweep sees every
    second place of the map, which refinement does not notice.

    Args:
        views: the picture.
        disparities: hypotheses, rising or falling.
        progress: called with the share done.
    """
    whole = views.grid.shape
    views = views.coarse(EVERY)
    shape = views.grid.shape
    first = np.full(shape, np.inf, dtype=np.float32)
    second = np.full(shape, np.inf, dtype=np.float32)
    best = np.full(shape, np.nan)
    before = np.full(shape, np.inf, dtype=np.float32)
    here = np.full(shape, np.inf, dtype=np.float32)
    inside = np.zeros(shape, dtype=np.bool_)
    for index in range(len(disparities) + 1):
        after = (
            cost_of(views.costs(float(disparities[index])))
            if index < len(disparities)
            else np.full(shape, np.inf, dtype=np.float32)
        )
        lowest = (here < before) & (here <= after) & np.isfinite(here)
        better = lowest & (here < first)
        second = np.where(better, first, np.where(lowest & (here < second), here, second))
        first = np.where(better, here, first)
        if index:
            best[better] = disparities[index - 1]
            inside[better] = 1 < index < len(disparities)
        before, here = here, after
        progress(min(index + 1, len(disparities)) / len(disparities))
    best[~inside] = np.nan
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.asarray(second / first, dtype=np.float64)
    return Swept(_to_places(best, whole), _to_places(ratio, whole))


def _to_places(values: Array, shape: tuple[int, int]) -> Array:
    """Values of the sweep's grid at the places of the map."""
    return values.repeat(EVERY, axis=0).repeat(EVERY, axis=1)[: shape[0], : shape[1]]


def cost_of(sums: Array) -> npt.NDArray[np.float32]:
    """Misfit over number of views less one, in windows; infinite where no two views meet."""
    weight, value, square, number = sums
    with np.errstate(invalid="ignore", divide="ignore"):
        misfit = np.where(number > 1, square - value**2 / weight, 0.0)
    free = np.maximum(number - 1, 0)
    side = WINDOW // EVERY + 1
    misfit = uniform_filter(np.maximum(misfit, 0.0), side, mode="constant")
    free = uniform_filter(free, side, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(free > 0.3, misfit / free, np.inf).astype(np.float32)
