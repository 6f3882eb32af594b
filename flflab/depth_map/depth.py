"""From a picture and a white picture to a depth map, and to refocused pictures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.depth_map.geometry import by_kappa, disparity_of, distance_of, kinds_of_microlens
from flflab.depth_map.lenses import lenses_of_white, lenses_on_array
from flflab.depth_map.normalise import normalise
from flflab.depth_map.readings import Given, readings
from flflab.depth_map.refine import refine
from flflab.depth_map.render import filled, refocus, total_focus
from flflab.depth_map.result import LENGTHS, DepthMap
from flflab.depth_map.sweep import hypotheses, sweep
from flflab.depth_map.views import Views, grid_behind, views_of
from flflab.errors import InputError, MeasurementError
from flflab.optics.camera import Camera
from flflab.remark import Remark

Array = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]

LEAST_ILLUMINATION = 0.3  # of a micro-image's centre: pixels with less are not used
# px at a baseline of one pitch: what is left of interpolation and of light within a pixel
FLOOR_PX, FLOOR_OF_FEW_PIXELS = 0.008, 0.02
FEW_PIXELS = 60  # pitches below this many pixels have the second floor


@dataclass(frozen=True)
class Prepared:
    """A picture ready for the sweep, the disparities to try, and how uncertain, relative, kappa is
    for all microlenses together.
    """

    views: Views
    disparities: Array
    kappa_doubt: float
    remarks: tuple[Remark, ...]


def depth(
    picture: Given,
    camera: Camera,
    white: Given,
    *,
    distances: tuple[float, float] | None = None,
    covariance: Array | None = None,
    progress: Progress | None = None,
) -> DepthMap:
    """Make a depth map of one picture.

    Args:
        picture: of the scene, [row, col], as the sensor read it; a dark frame goes into a
            ``SensorPicture``.
        camera: the camera that took it.
        white: a picture of a white target through the same camera with the same settings.
        distances: nearest and farthest distance to look at, mm; None: all that this camera sees
            sharply enough in two microlenses.
        covariance: of the main lens's focal length, its distance to the array and the gap, mm^2,
            shape (3, 3); None where it is not known. It moves the whole map.
        progress: called with the step's name and the share done.

    Returns:
        The depth map; places that cannot be trusted are NaN.

    Raises:
        InputError: the camera is not focused, or the range holds no distance it sees.
        MeasurementError: a picture of another camera, too small, or without a lattice.

    Example:
        >>> import flflab as ff
        >>> camera = ff.read_camera("camera.yaml")  # doctest: +SKIP
        >>> found = ff.depth(raw, camera, white)  # doctest: +SKIP
        >>> found.save("depth")  # doctest: +SKIP
    """
    if covariance is not None and covariance.shape != (len(LENGTHS), len(LENGTHS)):
        raise InputError(
            f"covariance: of shape {covariance.shape}; mm^2 of {', '.join(LENGTHS)} are due, shape"
            " (3, 3)"
        )
    tell = progress or _silent
    ready = prepare(picture, camera, white, distances, tell)
    return map_of(ready, camera, covariance, tell)


def prepare(
    picture: Given,
    camera: Camera,
    white: Given,
    distances: tuple[float, float] | None = None,
    progress: Progress | None = None,
    *,
    cut_aperture: bool = True,
) -> Prepared:
    """Read the pictures, find the microlenses, divide by white.

    Args:
        picture: of the scene.
        camera: the camera.
        white: of a white target.
        distances: nearest and farthest, mm.
        progress: called with the step's name and the share done.
        cut_aperture: see ``kinds_of_microlens``; only to show what leaving it out does.

    Raises:
        InputError: see ``depth``.
        MeasurementError: see ``depth``.
    """
    tell = progress or _silent
    _require_range(distances)
    kinds = kinds_of_microlens(camera, LEAST_ILLUMINATION, cut_aperture)
    tries = hypotheses(camera, kinds, distances)
    sharp = float(np.mean([abs(kind.kappa) for kind in kinds]))
    ends = np.sort(np.abs(tries[[0, -1]]))
    grid = grid_behind(camera.sensor, camera, float(np.clip(sharp, *ends)))
    tell("reading", 0.0)
    read = readings(picture, white, camera)
    tell("microlenses", 0.0)
    lenses = lenses_on_array(lenses_of_white(read.white, read.white_noise, camera), camera)
    ratio = normalise(read.raw, read.raw_noise, read.white, read.white_noise)
    if not ratio.weight.any():
        raise MeasurementError(
            "picture: no pixel is lit and unsaturated in both pictures; check exposure and dark"
            " frame"
        )
    remarks = list(read.remarks)
    if camera.aperture_shape != "round":
        remarks.append(
            Remark(
                "square-aperture",
                "apertures are square: the shift of cut apertures is taken from round ones, so"
                " distances out of focus are less certain than stated",
            )
        )
    views = views_of(ratio, lenses, kinds, grid, camera)
    return Prepared(views, tries, lenses.kappa_doubt, tuple(remarks))


def map_of(
    ready: Prepared,
    camera: Camera,
    covariance: Array | None,
    progress: Progress,
) -> DepthMap:
    """Sweep, refine and render what ``prepare`` made ready."""
    views = ready.views
    pitch = min(camera.array.pitch) / camera.sensor.pixel
    swept = sweep(views, ready.disparities, lambda share: progress("sweep", share))
    floor = FLOOR_PX if pitch >= FEW_PIXELS else FLOOR_OF_FEW_PIXELS
    found = refine(views, swept, pitch, floor, lambda share: progress("refine", share))
    middle = float(ready.disparities[len(ready.disparities) // 2])
    whole = filled(found.disparity, middle)
    focus, seen = total_focus(views, whole)
    ends = distance_of(ready.disparities[[0, -1]], camera)
    ends = np.where(ends > 0, ends, np.inf)
    return DepthMap(
        disparity=found.disparity,
        disparity_sigma=np.hypot(
            found.sigma, by_kappa(found.disparity, views.kinds, ready.kappa_doubt)
        ),
        shared=float(by_kappa(np.array(1.0), views.kinds, ready.kappa_doubt)),
        views=found.views.astype(np.int16),
        focus=focus,
        seen=seen | np.isfinite(found.disparity),
        grid=views.grid,
        camera=camera,
        searched=(float(ends.min()), float(ends.max())),
        covariance=covariance,
        remarks=(*ready.remarks, *_remarks(found.disparity, covariance)),
    )


def refocused(
    picture: Given,
    camera: Camera,
    white: Given,
    distances: Sequence[float] | None,
    progress: Progress | None = None,
) -> list[Array]:
    """The scene focused anew, [row, col] as in the depth map, in units of the white target's
    radiance; NaN where no microlens looks.

    Args:
        picture: as for ``depth``.
        camera: as for ``depth``.
        white: as for ``depth``.
        distances: to be sharp at, mm, a picture each; None makes one that is sharp everywhere.
        progress: called with the step's name and the share done.

    Raises:
        InputError: a distance is not above 0; and as ``depth``.
        MeasurementError: as ``depth``.
    """
    for away in distances or ():
        if not away > 0:
            raise InputError(f"distance {away:g} mm: one above 0 mm, or infinity, is due")
    tell = progress or _silent
    ready = prepare(picture, camera, white, None, tell)
    found = map_of(ready, camera, None, tell)
    if distances is None:
        return [found.focus]
    whole = filled(found.disparity, float(ready.disparities[len(ready.disparities) // 2]))
    return [
        refocus(ready.views, found.focus, whole, float(disparity_of(away, camera)))
        for away in distances
    ]


def _silent(step: str, share: float) -> None:
    """No progress is wanted."""


def _require_range(distances: tuple[float, float] | None) -> None:
    if distances is not None and not 0 < distances[0] < distances[1]:
        raise InputError(
            f"range: {distances[0]:g} mm to {distances[1]:g} mm; two rising distances above 0 mm"
            " are due"
        )


def _remarks(disparity: Array, covariance: Array | None) -> list[Remark]:
    remarks: list[Remark] = []
    if not np.isfinite(disparity).any():
        remarks.append(
            Remark(
                "no-value",
                "no place has a value: nothing in the picture has enough texture, or the scene lies"
                " outside the range, or camera file and picture do not belong together",
            )
        )
    if covariance is None:
        remarks.append(
            Remark(
                "common-unknown",
                "sigma counts noise, misfit and the microlenses' places; the camera's focal length,"
                " array distance and gap are taken as exact: they move the whole map by the"
                " derivatives stated",
            )
        )
    return remarks
