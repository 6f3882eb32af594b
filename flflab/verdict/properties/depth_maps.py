"""Depth maps of the frames of a run, with the uncertainty that the bench gives all their places,
and the mean distance of a flat texture against where the stage put it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench, Element
from flflab.depth_map.depth import depth
from flflab.depth_map.geometry import derivatives
from flflab.depth_map.result import DepthMap
from flflab.errors import InputError, MeasurementError
from flflab.files.sensor_picture import SensorPicture
from flflab.record import FrameRecord, Run
from flflab.study import Configuration, Study
from flflab.targets import Texture
from flflab.verdict.properties.depth import distance_of, offset_read
from flflab.verdict.properties.measured import Measured, PlaneSeen, as_placed, mean_picture
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Values, single

Array = npt.NDArray[np.float64]

WHITE = "white"
SHARED_PX = 0.008  # px a pitch: what interpolation and cut views move a whole map by
LEAST_BLOCKS = 4


@dataclass(frozen=True)
class PictureOfRun:
    """One target of one configuration."""

    configuration: Configuration
    target: str

    @property
    def name(self) -> str:
        """For a folder, as ``c0-bars``."""
        return f"c{self.configuration.index}-{self.target}"


def pictures_of(run: Run, study: Study) -> tuple[PictureOfRun, ...]:
    """What a run shows beside white targets, in the order of its study.

    Raises:
        MeasurementError: nothing, or no white picture with it.
    """
    have = {(frame.configuration, frame.target) for frame in run.frames}
    found = tuple(
        PictureOfRun(one, target)
        for one in study.configurations
        for target in study.shown
        if {(one.index, target), (one.index, WHITE)} <= have
    )
    if not found:
        raise MeasurementError(
            f"{run.folder}: holds no picture of a target with a white picture beside it; a depth"
            " map needs both"
        )
    return found


def depth_of_frames(
    run: Run,
    one: PictureOfRun,
    bench: Bench,
    distances: tuple[float, float] | None,
    progress: Callable[[str, float], None] | None = None,
) -> DepthMap:
    """The depth map of the mean of all frames of one target in one configuration.

    Args:
        run: the record.
        one: which frames.
        bench: whose axes placed the elements.
        distances: nearest and farthest to look at, mm; None: all that the camera sees.
        progress: called with the step's name and the share done.

    Raises:
        InputError: see ``depth``.
        MeasurementError: see ``depth``.
    """
    scene, white = (_as_read(run, one.configuration, target) for target in (one.target, WHITE))
    frame = scene[1]
    camera, _ = as_placed(one.configuration, bench.optics, frame.worlds)
    return depth(
        scene[0],
        camera,
        white[0],
        distances=distances,
        covariance=lengths_covariance(bench, frame.worlds),
        progress=progress,
    )


def _as_read(
    run: Run, configuration: Configuration, target: str
) -> tuple[SensorPicture, FrameRecord]:
    """A mean picture, DN, with its dark frame where one was taken, and its first frame."""
    picture, frames = mean_picture(run, configuration, target)
    first = frames[0]
    whole = picture.astype(np.uint16) if len(frames) == 1 else picture
    dark = run.dark(first.exposure_s)
    found = SensorPicture(whole, full_scale=run.sensor_noise["full_scale_dn"])
    if dark is not None:
        found = replace(found, dark=run.picture(dark).astype(whole.dtype))
    return found, first


def lengths_covariance(bench: Bench, worlds: dict[Element, float]) -> Array:
    """Covariance of the main lens's focal length, its distance to the array, and the gap, mm^2, as
    the bench file states focal length and axes.

    An array that stands further back makes the one longer and the other shorter.
    """
    lens, array, sensor = (
        _place_uncertainty(bench, element, worlds)
        for element in ("main_lens.z", "array.z", "sensor.z")
    )
    focal = (
        bench.description.optics_uncertainty.main_lens_focal_length
        * bench.optics.main_lens.focal_length
    )
    return np.array(
        [
            [focal**2, 0.0, 0.0],
            [0.0, lens**2 + array**2, -(array**2)],
            [0.0, -(array**2), array**2 + sensor**2],
        ]
    )


def _place_uncertainty(bench: Bench, element: Element, worlds: dict[Element, float]) -> float:
    axis = bench.description.axis_of(element)
    if axis is not None:
        return axis[1].uncertainty(axis[1].reading(worlds[element]))
    fixed = bench.description.fixed.stated()
    return fixed[element].uncertainty if element in fixed else 0.0


def with_map(measured: Measured, run: Run, study: Study, bench: Bench) -> Measured:
    """The same with the depth map of its texture, where the study shows one; where none can be
    made, with the reason among its failures.
    """
    if Texture.kind not in study.shown:
        return measured
    try:
        asked = PictureOfRun(measured.configuration, Texture.kind)
        found = depth_of_frames(run, asked, bench, None)
        return replace(measured, plane=plane_seen(found))
    except (InputError, MeasurementError) as error:
        failure = MeasurementError(f"depth map: {error}")
        return replace(measured, failures=(*measured.failures, failure))


def plane_seen(found: DepthMap) -> PlaneSeen:
    """A flat target in a depth map.

    The mean's uncertainty is the scatter of blocks as large as a microlens's view, which share
    neither pixels nor most of their microlenses, and what all of them share.

    Raises:
        MeasurementError: too few places have a value.
    """
    away, camera = found.distance, found.camera
    side = round(min(camera.array.pitch) / camera.sensor.pixel / abs(found.grid.step))
    rows, columns = (size // side for size in away.shape)
    blocks = away[: rows * side, : columns * side].reshape(rows, side, columns, side)
    seen = np.isfinite(blocks).mean(axis=(1, 3)) > 0.5
    count = int(seen.sum())
    if count < LEAST_BLOCKS:
        raise MeasurementError(
            f"the texture has values in {count} views of a microlens, at least {LEAST_BLOCKS} are"
            " due: does it fill the frame, and is it in focus?"
        )
    means = np.nanmean(blocks.transpose(0, 2, 1, 3)[seen], axis=(1, 2))
    mean = float(means.mean())
    middle = float(np.nanmedian(found.disparity))
    slope = abs(float(derivatives(np.array(middle), camera).by_disparity))
    by_views = SHARED_PX * camera.sensor.pixel / min(camera.array.pitch)
    shared = slope * float(np.hypot(by_views, found.shared * middle))
    own = away[np.isfinite(away)]
    sigmas = np.abs(own - mean) / found.sigma[np.isfinite(away)]
    return PlaneSeen(
        mean,
        float(np.hypot(means.std(ddof=1) / np.sqrt(count), shared)),
        float(own.std()),
        float(np.mean(sigmas < 1)),
        float(np.mean(sigmas < 2)),
        found.density,
    )


def map_distance(one: Measured, model: Predicted) -> list[Values]:
    """Mean distance of the texture's depth map, mm, against what the same parallax would read with
    the stages' and optics' errors of each draw; nothing where there is no map.
    """
    if one.plane is None:
        return []
    read = distance_of(offset_read(model), model.camera) * model.stretches
    index, seen = one.configuration.index, one.plane
    return [single(index, "map_distance_mm", Texture.kind, seen.distance, seen.uncertainty, read)]
