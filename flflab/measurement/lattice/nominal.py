"""The lattice of micro-images that a camera's description says."""

import math

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError, MeasurementError
from flflab.measurement.lattice.find import RoughLattice, pitch_and_angle
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import sensor_pixel
from flflab.measurement.lattice.tilting import axis_of
from flflab.optics.camera import Camera, microlens_centres
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

DESCRIBED = 0.12  # of the pitch: what differs more is another camera
UNITS = {
    25.4: "inches and millimetres",
    10.0: "centimetres and millimetres",
    1000.0: "millimetres and micrometres",
    2.54: "inches and centimetres",
}
NEAR = 0.08  # of a ratio of units
UNCERTAINTY_PX = 1.0  # of its radii and centres


def nominal_vectors_px(camera: Camera) -> Array:
    """Lattice vectors a, b as columns, px, shape (2, 2)."""
    pitch = np.asarray(camera.array.pitch) * float(central_smms(camera).image_scale)
    slant = (
        np.array([[1.0, 0.5], [0.0, math.sqrt(3) / 2]])
        if camera.array.layout == "hexagonal"
        else np.eye(2)
    )
    cos, sin = math.cos(camera.array.roll), math.sin(camera.array.roll)
    turned = np.array([[cos, -sin], [sin, cos]]) @ (pitch[:, None] * slant)
    return np.asarray(turned / camera.sensor.pixel, dtype=np.float64)


def nominal_centres_px(camera: Camera) -> Array:
    """Centres of all micro-images, px, in the order of the microlenses, shape (n, 2)."""
    centres = microlens_centres(camera.array) * float(central_smms(camera).image_scale)
    return sensor_pixel(camera.sensor, centres)


def require_described_pitch(pitch_px: float, camera: Camera) -> None:
    """Refuse micro-images that lie farther apart, or nearer, than a camera's.

    Raises:
        MeasurementError: they do.
    """
    due = pitch_and_angle(camera.array.layout, nominal_vectors_px(camera))[0]
    ratio = pitch_px / due
    if abs(ratio - 1) > DESCRIBED:
        units = mixed_up_units(ratio)
        raise MeasurementError(
            f"white picture: its micro-images lie about {pitch_px:.3g} px apart, {ratio:.3g}"
            f" times the {due:.3g} px of the camera's description:"
            f" {f'were {units} mixed up? Check' if units else 'is it a white picture? Else check'}"
            " pitch, pixel and distances"
        )


def require_described(rough: RoughLattice, camera: Camera) -> None:
    """Refuse the lattice of another camera.

    Raises:
        MeasurementError: its pitch or layout is not the description's.
    """
    require_described_pitch(rough.pitch, camera)
    if rough.layout != camera.array.layout:
        raise MeasurementError(
            f"white picture: its micro-images lie on a {rough.layout} lattice of"
            f" {rough.pitch:.4g} px, the camera's description says {camera.array.layout}; check"
            " the layout"
        )


def mixed_up_units(ratio: float) -> str | None:
    """The units whose sizes have this ratio or its inverse: one may have been written for the
    other.
    """
    return next(
        (
            names
            for size, names in UNITS.items()
            if min(abs(ratio / size - 1), abs(ratio * size - 1)) < NEAR
        ),
        None,
    )


def nominal_lattice(camera: Camera, light_dn: float) -> Lattice:
    """The lattice that the camera's description says; radii and centres good to a pixel, light the
    same everywhere.
    """
    smms = central_smms(camera)
    width, height = camera.sensor.resolution
    centres, vectors = nominal_centres_px(camera), nominal_vectors_px(camera)
    outside = float(smms.outside_radius) / camera.sensor.pixel
    off = np.hypot(*(centres - np.clip(centres, -0.5, [width - 0.5, height - 0.5])).T)
    centres = centres[off < outside]
    if len(centres) == 0:
        raise InputError(
            "camera: no micro-image falls on the sensor; check the offsets of array and sensor"
        )
    origin = centres[int(np.argmin(np.hypot(*(centres - [(width - 1) / 2, (height - 1) / 2]).T)))]
    length, angle = pitch_and_angle(camera.array.layout, vectors)
    return Lattice(
        layout=camera.array.layout,
        pitch_px=length,
        angle=angle,
        origin_px=origin,
        vectors_px=vectors,
        indices=np.rint((centres - origin) @ np.linalg.inv(vectors).T).astype(np.int64),
        centres_px=centres,
        inside_radius_px=float(smms.inside_radius) / camera.sensor.pixel,
        outside_radius_px=outside,
        pitch_uncertainty_px=math.nan,
        angle_uncertainty=math.nan,
        origin_uncertainty_px=np.full(2, UNCERTAINTY_PX),
        inside_uncertainty_px=UNCERTAINTY_PX,
        outside_uncertainty_px=UNCERTAINTY_PX,
        covariance_px=np.full((6, 6), math.nan),
        sizes_covariance_px=np.full((3, 3), math.nan),
        light=np.array([light_dn, 0, 0, 0, 0, 0.0]),
        axis=axis_of(camera) if any(camera.array.tilt) else None,
        tilt=np.array(camera.array.tilt),
    )
