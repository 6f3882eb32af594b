"""Everything the model says of a camera, gathered for people and programs: properties of the
camera, and of each distance.

An answer that does not exist is None with a reason, never nan.
"""

from dataclasses import dataclass

import numpy as np

from flflab.optics.camera import Camera
from flflab.optics.contrast import contrast_paper, mtf_pixel, transfer
from flflab.optics.focus import (
    blur,
    depth_of_field,
    image_distance,
    magnification,
    marginal_angle,
    merge_intervals,
    vergence_of,
    virtual_depth,
)
from flflab.optics.per_type import (
    TypeSolution,
    arrangement_of,
    as_distances,
    sharp_distance,
    solve_types,
    type_smms,
)
from flflab.optics.pixels import useful_pixels
from flflab.optics.resolution import (
    Stereo,
    central_smms,
    effective_resolution,
    mean_row_views,
    mean_sensor_views,
    stereo,
)
from flflab.optics.smms import Smms, image_offset
from flflab.optics.useful import RowFields, SensorFields, row_fields
from flflab.optics.views import Views, row_views, sensor_views

FREQUENCIES = 101


@dataclass(frozen=True)
class CameraSolution:
    """What the model says of the camera itself; lengths in mm, angles in rad."""

    arrangement: str
    sharp_distance: float | None
    image_pitch: float
    overlap: float
    in_exit_pupil: bool
    touching_f_number: float
    useful_pixels: tuple[int, int]
    depth_of_field: tuple[tuple[float, float], ...]
    stereo: Stereo
    row: RowFields
    marginal_angles: tuple[float, ...]
    types: tuple[TypeSolution, ...] = ()
    reference_planes: str = ""


@dataclass(frozen=True)
class DistanceSolution:
    """What the model says of a target at one distance; the MTF curves are on the target, cycles/mm.

    ``by_type`` holds (magnification, blur in mm) of every microlens type; the plain figures are
    those of the microlens nearest the axis.
    """

    distance: float
    image_distance: float
    arrangement: str
    virtual_depth: float
    magnification: float
    blur: float
    row_views: Views
    sensor_views: Views
    resolution: tuple[float, float]
    resolution_by_views: tuple[float | None, float | None]
    cycles_per_mm: tuple[float, ...]
    contrast_paper: tuple[float, ...]
    mtf_pixel: tuple[float, ...]
    mtf: tuple[float, ...]
    by_type: tuple[tuple[float, float], ...] = ()


def array_arrangement(camera: Camera) -> str:
    """keplerian where b > f, galilean where b < f, afocal where b = f; mixed where the microlens
    types differ in it.
    """
    kinds = {arrangement_of(camera.optical_gap, focal) for focal in camera.array.focal_lengths}
    return kinds.pop() if len(kinds) == 1 else "mixed"


def reference_planes(camera: Camera) -> str:
    """From which plane every distance of an answer is measured, in sentences."""
    thick, plate = camera.main_lens.principal_separation, camera.array.substrate
    before = "the main lens" if thick == 0 else "the main lens's front principal plane"
    behind = (
        "the main lens"
        if thick == 0
        else f"its rear principal plane, {thick:g} mm behind the front one"
    )
    text = (
        f"Target distances are measured from {before}, positive in front; image, array and sensor"
        f" distances from {behind}, positive behind; virtual depth from the microlenses; positions"
        " on the sensor from the axis."
    )
    if plate is not None and plate.thickness > 0:
        name = "array to sensor" if plate.side == "sensor" else "main lens to array"
        air, optical = (
            (camera.gap, camera.optical_gap)
            if plate.side == "sensor"
            else (camera.array.distance, camera.optical_distance)
        )
        text += (
            f" The glass plate adds its thickness over its index: {name} is {air:g} mm of air,"
            f" {optical:g} mm optically."
        )
    return text


def distance_arrangement(x: float) -> str:
    """How the target's image lies against the array."""
    if x < 0:
        return "keplerian"
    if x == 0:
        return "on the array"
    return "galilean" if x < 1 else "object in or inside the front focus"


def solve_camera(camera: Camera, fields: SensorFields | None = None) -> CameraSolution:
    """All properties of a camera that need no target distance.

    Args:
        camera: the camera.
        fields: its useful regions on the sensor, where they are known already.
    """
    central = central_smms(camera)
    row = row_fields(camera)
    pitch = camera.array.pitch[0] * float(central.image_scale)
    intervals = merge_intervals(
        [part for smms in type_smms(camera) for part in depth_of_field(smms, camera.sensor.pixel)]
    )
    return CameraSolution(
        arrangement=array_arrangement(camera),
        sharp_distance=sharp_distance(central),
        image_pitch=pitch,
        overlap=2 * float(central.outside_radius) - pitch,
        in_exit_pupil=bool(np.abs(central.microlens_width) <= camera.sensor.pixel),
        touching_f_number=camera.main_lens.focal_length
        * float(central.gap / central.distance)
        / pitch,
        useful_pixels=useful_pixels(camera, fields),
        depth_of_field=as_distances(intervals),
        stereo=stereo(camera),
        row=row,
        marginal_angles=tuple(float(angle) for angle in marginal_angle(row.smms)),
        types=solve_types(camera),
        reference_planes=reference_planes(camera),
    )


def solve_distance(
    camera: Camera, distance: float, useful: tuple[int, int], fields: SensorFields, row: RowFields
) -> DistanceSolution:
    """All properties of a target at one distance.

    Args:
        camera: the camera.
        distance: main lens to target, mm; infinity is allowed.
        useful: useful pixels along the row and on the sensor.
        fields: the camera's useful regions on the sensor.
        row: the camera's useful intervals along the row.
    """
    vergence = vergence_of(distance)
    central = central_smms(camera)
    enlarged = float(magnification(central, vergence))
    cycles_per_px = np.linspace(0.0, 1.0, FREQUENCIES)
    on_target = cycles_per_px * enlarged / camera.sensor.pixel
    resolution = effective_resolution(camera, vergence, useful)
    mean_row = mean_row_views(row, camera, vergence)
    mean_sensor = mean_sensor_views(fields, camera, vergence)
    return DistanceSolution(
        distance=distance,
        image_distance=float(image_distance(central, vergence)),
        arrangement=distance_arrangement(float(image_offset(central, vergence))),
        virtual_depth=float(virtual_depth(central, vergence)),
        magnification=enlarged,
        blur=float(blur(central, vergence)),
        row_views=row_views(row, vergence, 0.0),
        sensor_views=sensor_views(fields, vergence, np.zeros(2)),
        resolution=resolution,
        resolution_by_views=(
            useful[0] / mean_row if mean_row >= 1 else None,
            useful[1] / mean_sensor if mean_sensor >= 1 else None,
        ),
        cycles_per_mm=tuple(on_target.tolist()),
        contrast_paper=tuple(contrast_paper(cycles_per_px).tolist()),
        mtf_pixel=tuple(mtf_pixel(cycles_per_px).tolist()),
        mtf=tuple(np.abs(_mtf(central, vergence, camera.sensor.pixel, on_target)).tolist()),
        by_type=tuple(
            (float(magnification(smms, vergence)), float(blur(smms, vergence)))
            for smms in type_smms(camera)
        ),
    )


def _mtf(
    central: Smms,
    vergence: float,
    pixel: float,
    on_target: np.ndarray[tuple[int], np.dtype[np.float64]],
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    if not on_target[-1] > 0:
        return np.where(np.arange(on_target.size) == 0, 1.0, 0.0)
    return transfer(central, vergence, pixel, on_target)
