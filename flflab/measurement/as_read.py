"""A picture of any origin as the fits take it: DN above black, the noise of its pixels, and in
sentences what was guessed on the way.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.lattice.registration import require_picture, require_shape
from flflab.measurement.sensor.cut_darkness import mend_darkness, remark_on
from flflab.measurement.sensor.mosaic import Mosaic, from_raw
from flflab.measurement.sensor.noise import SensorNoise, estimate_noise
from flflab.optics.camera import Camera
from flflab.raw_file import RawPicture

Array = npt.NDArray[np.float64]

SCALED_WHITE_DN = 4000.0
NEXT_TO_NONE = 5e-4  # of the brightest light: no sensor has less noise in a single picture


def as_read(
    picture: npt.NDArray[np.generic] | RawPicture,
    camera: Camera,
    kind: str,
    noise: SensorNoise | None,
) -> tuple[Mosaic, list[str]]:
    """The picture above its black level, and remarks.

    Args:
        picture: [row, col]; DN, or any other unit where ``noise`` is None.
        camera: nominal.
        kind: of the target that stood there.
        noise: of the sensor; None estimates it from the picture.

    Raises:
        MeasurementError: of another shape than the camera's, or no numbers of light.
    """
    remarks = list[str]()
    if isinstance(picture, RawPicture):
        require_shape(picture.values, camera, kind)
        mosaic = from_raw(picture, noise)
        if mosaic.gains is not None:
            share = ", ".join(f"{gain:.4f}" for gain in mosaic.gains.ravel())
            remarks.append(
                f"the mosaic {picture.pattern} was measured as four sub-lattices of gains {share}"
            )
    else:
        mosaic = _grey(require_picture(picture, camera, kind), np.asarray(picture), noise, remarks)
    if noise is None:
        if (mended := mend_darkness(mosaic)) is not None:
            mosaic = mended
            remarks.append(remark_on(mosaic))
        remarks.append(_remark_on_noise(mosaic))
    return mosaic, remarks


def _remark_on_noise(mosaic: Mosaic) -> str:
    """Where the noise comes from that uncertainties count, and when that is next to nothing."""
    light = float(mosaic.values.max()) - mosaic.noise.offset_dn
    share = math.sqrt(float(mosaic.noise.variance(light + mosaic.noise.offset_dn))) / max(
        light, 1e-300
    )
    if share >= NEXT_TO_NONE:
        return "the sensor's noise was estimated from the picture itself"
    return (
        f"there is next to no noise in the picture, {share:.1g} of its light: uncertainties count"
        " that and nothing else that may be wrong with it; a simulated picture has noise with"
        " --seed"
    )


def _grey(
    values: Array, picture: npt.NDArray[np.generic], noise: SensorNoise | None, remarks: list[str]
) -> Mosaic:
    """A picture without filters, in steps of one."""
    if noise is None and picture.dtype.kind == "f":
        top = float(values.max())
        if top < 0:
            raise MeasurementError(
                f"picture: all its numbers are below 0, from {values.min():.4g}; light from 0 up"
                " is due"
            )
        # in units of the white level the rounding of whole numbers would count as noise; dots may
        # cover less than a thousandth
        values = values * (SCALED_WHITE_DN / top if top > 0 else 1.0)
    if noise is None and picture.dtype.kind == "u":
        step = int(np.gcd.reduce(picture.ravel().astype(np.int64))) or 1
        if step > 1 and step & (step - 1) == 0:
            values = values / step
            picture = values.astype(np.uint16)
            remarks.append(
                f"every number of the picture is a multiple of {step}: fewer bits, shifted up; they"
                " were shifted back"
            )
    return Mosaic(
        values,
        (
            estimate_noise(picture if picture.dtype.kind == "u" else values)
            if noise is None
            else noise
        ),
        None,
    )
