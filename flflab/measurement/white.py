"""A white picture of any camera, measured with or without a camera file."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.files.raw import RawPicture
from flflab.files.sensor_picture import SensorPicture
from flflab.measurement.as_read import as_read
from flflab.measurement.in_json import result_json
from flflab.measurement.lattice.kernel import LIGHT, WIDER
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.plausible import require_white
from flflab.measurement.lattice.types import Types, types_of
from flflab.measurement.lattice.white_picture import WhitePicture, measure_white
from flflab.measurement.lattice.with_camera import CameraWhite, white_behind
from flflab.measurement.presence import require_light
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.unlike_camera import unlike_the_camera
from flflab.measurement.white_json import micro_images_json, white_lattice_json
from flflab.measurement.white_remarks import remarks_on_white
from flflab.optics.camera import Camera
from flflab.remark import Remark
from flflab.targets import White

Picture = npt.NDArray[np.generic] | RawPicture | SensorPicture
Found = TypeVar("Found")
MUCH_SATURATED = 0.05  # of the pixels: the likely cause of a failure


@dataclass(frozen=True)
class MeasuredWhite:
    """A white picture as measured.

    Attributes:
        picture: DN, [row, col].
        noise: of its pixels.
        white: every micro-image, and the lattice through them.
        types: kinds of microlens.
        remarks: on what was guessed and what departs from the model.
        camera: whose picture it is; None without a camera file.
        behind: what that camera's shape tells besides.
    """

    picture: npt.NDArray[np.float32]
    noise: SensorNoise
    white: WhitePicture
    types: Types
    remarks: tuple[Remark, ...]
    camera: Camera | None = None
    behind: CameraWhite | None = None

    @property
    def lattice(self) -> Lattice:
        """Of chief rays; of a picture measured with a camera file."""
        if self.behind is None:
            raise MeasurementError(
                "white picture: its chief rays are known with a camera file only"
            )
        return self.behind.lattice

    def lattice_json(self) -> dict[str, Any]:
        """As ``flflab measure --json`` says it, but for the single micro-images."""
        return white_lattice_json(self.white, self.types, self.picture.shape, self.behind)

    def json(self) -> dict[str, Any]:
        """As ``flflab measure --json`` says it."""
        white, shape = self.white, self.picture.shape
        each = micro_images_json(white, self.types, shape, self.camera, self.behind)
        seen = {
            "lattice": self.lattice_json() | {"micro_images": each},
            "dots": list[Any](),
            "mtf": list[Any](),
        }
        saturated = _saturated(self.picture, self.noise)
        return result_json(seen, self.remarks, saturated, white.misfit, self.noise.offset_dn)


def measure_blind(picture: Picture, noise: SensorNoise | None = None) -> MeasuredWhite:
    """Measure a white picture of which no camera file is known.

    Args:
        picture: [row, col]; DN, or any other unit where ``noise`` is None. Filters of a mosaic are
            evened out by their gains.
        noise: of the sensor; None estimates it from the picture.

    Raises:
        MeasurementError: no white picture of a microlens array, or one that shows too little.
    """
    numbers, evened, remarks = _evened(picture, None, noise)
    white = _measured(numbers, evened, lambda: measure_white(numbers, evened))
    require_white(white, _saturated(numbers, evened))
    return _remarked(numbers, evened, white, remarks)


def measure_described(
    picture: Picture, camera: Camera, noise: SensorNoise | None = None
) -> MeasuredWhite:
    """Measure a white picture of a camera whose file is known.

    Args:
        picture: as ``measure_blind``'s.
        camera: as described; what is unlike it is remarked.
        noise: of the sensor; None estimates it from the picture.

    Raises:
        MeasurementError: as ``measure_blind``; or not of this camera.
    """
    numbers, evened, remarks = _evened(picture, camera, noise)
    found = _measured(numbers, evened, lambda: white_behind(camera, numbers, evened))
    remarks += unlike_the_camera(found.lattice, camera)
    return replace(_remarked(numbers, evened, found.white, remarks), camera=camera, behind=found)


def _evened(
    picture: Picture, camera: Camera | None, noise: SensorNoise | None
) -> tuple[npt.NDArray[np.float32], SensorNoise, list[Remark]]:
    """The picture with filters evened out, its noise, and remarks on how it was read."""
    mosaic, remarks = as_read(picture, camera, White.kind, noise)
    values, evened = mosaic.even()
    require_light(values, evened, White())
    return np.ascontiguousarray(values, dtype=np.float32), evened, remarks


def _saturated(numbers: npt.NDArray[np.float32], noise: SensorNoise) -> float:
    return float(np.mean(numbers >= noise.saturated_dn))


def _measured(
    numbers: npt.NDArray[np.float32], noise: SensorNoise, measure: Callable[[], Found]
) -> Found:
    """What a measurement finds; where it fails for want of unsaturated pixels, that reason."""
    try:
        return measure()
    except MeasurementError as error:
        saturated = _saturated(numbers, noise)
        if saturated < MUCH_SATURATED:
            raise
        raise MeasurementError(
            f"white picture: {100 * saturated:.0f} % of its pixels are saturated, which is probably"
            f" why it could not be measured; expose it shorter ({error})"
        ) from error


def _remarked(
    numbers: npt.NDArray[np.float32],
    noise: SensorNoise,
    white: WhitePicture,
    remarks: list[Remark],
) -> MeasuredWhite:
    """Kinds of microlens and remarks beside what was measured."""
    radius = white.profile.radius + white.values[:, WIDER]
    light = np.log(np.maximum(white.values[:, LIGHT], 1e-9))
    types = types_of(white.grid.layout, white.indices, white.usual, [radius, light])
    every = remarks + remarks_on_white(numbers, noise, white)
    return MeasuredWhite(numbers, noise, white, types, tuple(every))
