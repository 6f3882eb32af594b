"""A picture and its white picture as numbers above black in one unit, with the noise of both."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.files.raw import RawPicture
from flflab.files.sensor_picture import SensorPicture, from_raw
from flflab.measurement.as_read import SCALED_WHITE_DN, as_read
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.remark import Remark

Array = npt.NDArray[np.float64]
Given = npt.NDArray[Any] | RawPicture | SensorPicture

SAID_ONCE = "noise-estimated"


@dataclass(frozen=True)
class Readings:
    """Both pictures, [row, col] in DN; filters' gains divided out.

    Attributes:
        raw: of the scene.
        raw_noise: of its pixels; its gain is that found in the white picture.
        white: of a white target, taken with the same camera.
        white_noise: of its pixels.
        remarks: what was guessed.
    """

    raw: Array
    raw_noise: SensorNoise
    white: Array
    white_noise: SensorNoise
    remarks: tuple[Remark, ...]


def readings(picture: Given, white: Given, camera: Camera) -> Readings:
    """Read both pictures.

    The sensor's noise is estimated from the white picture, which has light and no texture. Pictures
    of floating point share a unit.

    Raises:
        MeasurementError: of another shape than the camera's, or no numbers of light.
    """
    beside, remarks = as_read(white, camera, "white", None)
    scene = _sensor_picture(picture)
    if scene.values.dtype.kind == "f":
        top = float(_sensor_picture(white).values.max())
        factor = SCALED_WHITE_DN / top if top > 0 else 1.0
        scene = replace(
            scene,
            values=scene.values * factor,
            dark=None if scene.dark is None else scene.dark * factor,
        )
    mosaic, notes = as_read(scene, camera, "scene", beside.noise)
    raw, raw_noise = mosaic.even()
    flat, flat_noise = beside.even()
    said = [replaced for note in remarks if (replaced := _of("white picture", note))]
    said += [note for note in notes if note.code != SAID_ONCE]
    return Readings(
        np.asarray(raw, dtype=np.float64),
        raw_noise,
        np.asarray(flat, dtype=np.float64),
        flat_noise,
        tuple(said),
    )


def _sensor_picture(picture: Given) -> SensorPicture:
    if isinstance(picture, RawPicture):
        return from_raw(picture)
    return picture if isinstance(picture, SensorPicture) else SensorPicture(np.asarray(picture))


def _of(what: str, note: Remark) -> Remark | None:
    return None if note.code == SAID_ONCE else Remark(note.code, f"{what}: {note.sentence}")
