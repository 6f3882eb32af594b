"""A white picture of any camera, measured without a camera file."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.as_read import as_read
from flflab.measurement.lattice.kernel import LIGHT, WIDER
from flflab.measurement.lattice.types import Types, types_of
from flflab.measurement.lattice.white_picture import WhitePicture, measure_white
from flflab.measurement.presence import require_light
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.white_json import white_lattice_json
from flflab.measurement.white_remarks import remarks_on_white, require_white
from flflab.raw_file import RawPicture
from flflab.remark import Remark
from flflab.sensor_picture import SensorPicture
from flflab.targets import White


@dataclass(frozen=True)
class BlindWhite:
    """A white picture measured without a camera file.

    Attributes:
        picture: DN, [row, col].
        noise: of its pixels.
        white: every micro-image, and the lattice through them.
        types: kinds of microlens.
        remarks: on what was guessed and what departs from the model.
    """

    picture: npt.NDArray[np.float32]
    noise: SensorNoise
    white: WhitePicture
    types: Types
    remarks: tuple[Remark, ...]

    def json(self) -> dict[str, Any]:
        """As ``flflab measure --json`` says it."""
        saturated = float(np.mean(self.picture >= self.noise.saturated_dn))
        return {
            "lattice": white_lattice_json(self.white, self.types, self.picture.shape),
            "dots": [],
            "mtf": [],
            "picture": {
                "saturated_share": saturated,
                "misfit": self.white.misfit,
                "offset_dn": self.noise.offset_dn,
            },
            "remarks": [remark.sentence for remark in self.remarks],
            "remark_codes": [remark.code for remark in self.remarks],
        }


def measure_blind(
    picture: npt.NDArray[np.generic] | RawPicture | SensorPicture,
    noise: SensorNoise | None = None,
) -> BlindWhite:
    """Measure a white picture of which no camera file is known.

    Args:
        picture: [row, col]; DN, or any other unit where ``noise`` is None. Filters of a mosaic are
            evened out by their gains.
        noise: of the sensor; None estimates it from the picture.

    Raises:
        MeasurementError: no white picture of a microlens array, or one that shows too little.
    """
    mosaic, remarks = as_read(picture, None, White.kind, noise)
    values, evened = mosaic.even()
    require_light(values, evened, White())
    numbers = np.ascontiguousarray(values, dtype=np.float32)
    saturated = float(np.mean(numbers >= evened.saturated_dn))
    try:
        white = measure_white(numbers, evened)
    except MeasurementError as error:
        if saturated < 0.05:
            raise
        raise MeasurementError(
            f"white picture: {100 * saturated:.0f} % of its pixels are saturated, which is probably"
            f" why it could not be measured; expose it shorter ({error})"
        ) from error
    require_white(white, saturated)
    radius = white.profile.radius + white.values[:, WIDER]
    light = np.log(np.maximum(white.values[:, LIGHT], 1e-9))
    usual = white.whole.copy()
    usual[np.flatnonzero(white.whole)[white.grid.off]] = False
    types = types_of(white.grid.layout, white.indices, usual, [radius, light])
    remarks += remarks_on_white(numbers, evened, white)
    return BlindWhite(numbers, evened, white, types, tuple(remarks))
