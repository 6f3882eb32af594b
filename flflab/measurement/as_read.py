"""A picture of any origin as the fits take it: DN above black, the noise of its pixels, and remarks
on what was guessed on the way.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.files.raw import RawPicture
from flflab.files.sensor_picture import SensorPicture, from_raw
from flflab.measurement.lattice.registration import require_shape
from flflab.measurement.sensor.cut_darkness import find_cut, mend
from flflab.measurement.sensor.mosaic import (
    Mosaic,
    brightest_filter,
    measure_gains,
    require_no_filters,
)
from flflab.measurement.sensor.noise import SensorNoise, estimate_noise
from flflab.measurement.sensor.saturation import common_step, saturation_level
from flflab.optics.camera import Camera
from flflab.remark import Remark

FULL_SCALES = tuple(2**bits - 1 for bits in (8, 10, 12, 14, 16))
SCALED_WHITE_DN = 4000.0
NEXT_TO_NONE = 5e-4  # of the brightest light: no sensor has less noise in a single picture
BELOW_BLACK = 0.01  # of the light: gaps that read less than that below black


def as_read(
    picture: npt.NDArray[Any] | RawPicture | SensorPicture,
    camera: Camera | None,
    kind: str,
    noise: SensorNoise | None,
) -> tuple[Mosaic, list[Remark]]:
    """The picture above its black level, and remarks.

    Args:
        picture: [row, col]; DN, or any other unit where ``noise`` is None.
        camera: whose picture it is; None where nothing is known of it.
        kind: of the target that stood there.
        noise: of the sensor; None estimates it from the picture.

    Raises:
        MeasurementError: of another shape than the camera's, no numbers of light, or a mosaic of
            filters that nothing names.
    """
    given = _sensor_picture(picture)
    if camera is not None:
        require_shape(given.values, camera, kind)
    _require_finite(given.values, kind)
    remarks = list(given.remarks)
    if noise is None:
        given = _in_steps_of_one(given, remarks)
    if given.pattern is None:
        require_no_filters(given.values)
    full = _full_scale(given, noise, remarks)
    numbers, full = _above_black(given, full)
    known_black = given.dark is not None or given.black_level is not None
    if noise is None:
        plane = numbers if given.pattern is None else brightest_filter(numbers)
        found = estimate_noise(plane, full)
        remarks += _remarks_on_black(found, plane) if known_black else []
    else:
        found = noise
    found = replace(
        found,
        offset_dn=0.0 if known_black else found.offset_dn,
        full_scale_dn=found.full_scale_dn if full is None else full,
    )
    mosaic = _through_filters(numbers, given.pattern, found, remarks)
    if noise is None:
        mosaic = _with_mended_darkness(mosaic, given, remarks)
        remarks.append(_remark_on_noise(mosaic))
    return mosaic, remarks


def _sensor_picture(picture: npt.NDArray[Any] | RawPicture | SensorPicture) -> SensorPicture:
    if isinstance(picture, RawPicture):
        return from_raw(picture)
    return picture if isinstance(picture, SensorPicture) else SensorPicture(np.asarray(picture))


def _require_finite(values: npt.NDArray[Any], kind: str) -> None:
    if strange := values.size - np.count_nonzero(np.isfinite(values)):
        raise MeasurementError(
            f"{kind} picture: {strange} of its {values.size} pixels are not finite numbers, as"
            " programs mark missing or masked ones; save the numbers as the sensor read them"
        )


def _in_steps_of_one(given: SensorPicture, remarks: list[Remark]) -> SensorPicture:
    """Bits that were shifted up shifted back, and floating point of any unit brought to numbers of
    which the rounding of whole ones is a small part.

    Raises:
        MeasurementError: all numbers are below 0.
    """
    if given.black_level is not None:
        return given
    values, dark, factor = given.values, given.dark, 1.0
    if values.dtype.kind == "f":
        top = float(values.max())
        if top < 0:
            raise MeasurementError(
                f"picture: all its numbers are below 0, from {values.min():.4g}; light from 0 up"
                " is due"
            )
        # dots may cover less than a thousandth
        factor = SCALED_WHITE_DN / top if top > 0 else 1.0
    elif values.dtype.kind == "u":
        step = common_step(values) if dark is None else math.gcd(*map(common_step, (values, dark)))
        if step > 1 and step & (step - 1) == 0:
            factor = 1 / step
            remarks.append(
                Remark(
                    "bits-shifted",
                    f"every number of the picture is a multiple of {step}: fewer bits, shifted up;"
                    " they were shifted back",
                )
            )
    if factor == 1:
        return given
    return replace(
        given,
        values=_scaled(values, factor),
        dark=None if dark is None else _scaled(dark, factor),
        full_scale=None if given.full_scale is None else given.full_scale * factor,
    )


def _scaled(values: npt.NDArray[Any], factor: float) -> npt.NDArray[Any]:
    return (values * factor).astype(np.float64 if values.dtype.kind == "f" else values.dtype)


def _full_scale(
    given: SensorPicture, noise: SensorNoise | None, remarks: list[Remark]
) -> float | None:
    """What a saturated pixel reads, as stored: where pixels pile up, else what is said, else the
    largest number of some bits; None where nothing tells.
    """
    if noise is not None:
        return noise.full_scale_dn if given.full_scale is None else given.full_scale
    values, stated = given.values, given.full_scale
    if stated is None and values.dtype.kind in "ui" and (top := int(values.max())) in FULL_SCALES:
        stated = top
    level = saturation_level(values if given.pattern is None else brightest_filter(values))
    if level is None or level >= (stated or math.inf):
        return stated
    below = f", below the full scale of {stated:g}" if stated else ""
    remarks.append(
        Remark(
            "saturation-found",
            f"{100 * float(np.mean(values >= level)):.2g} % of the pixels pile up at {level:g} DN"
            f"{below}: taken for saturated; expose shorter, or give what a saturated pixel reads"
            " (--full-scale)",
        )
    )
    return level


def _above_black(
    given: SensorPicture, full: float | None
) -> tuple[npt.NDArray[np.floating], float | None]:
    """Numbers above black, and what a saturated pixel reads there, which all of them do."""
    plain = given.pattern is None and given.black_level is None
    numbers = given.values.astype(np.float64 if plain else np.float32)
    black = 0.0
    if given.dark is not None:
        numbers -= given.dark
        black = float(np.median(given.dark))
    elif given.black_level is not None:
        levels = np.array(given.black_level, dtype=numbers.dtype).reshape(2, 2)
        for row, column in np.ndindex(2, 2):
            numbers[row::2, column::2] -= levels[row, column]
        black = float(levels.max())
    if full is None:
        return numbers, None
    numbers[given.values >= full] = full - black
    return numbers, full - black


def _remarks_on_black(found: SensorNoise, numbers: npt.NDArray[np.floating]) -> list[Remark]:
    """A remark where the gaps are darker than black."""
    light = float(numbers.max()) - found.offset_dn
    if -found.offset_dn < max(BELOW_BLACK * light, 3 * found.dark_variance**0.5):
        return []
    return [
        Remark(
            "black-level",
            f"the gaps between micro-images read {-found.offset_dn:.4g} DN less than black: the"
            " black level of the file or the dark frame is too high; was the dark frame exposed"
            " longer, or did light fall on it?",
        )
    ]


def _through_filters(
    numbers: npt.NDArray[np.floating],
    pattern: str | None,
    noise: SensorNoise,
    remarks: list[Remark],
) -> Mosaic:
    """The picture with its filters' gains, which are of light alone."""
    if pattern is None:
        return Mosaic(numbers, noise, None)
    offset = noise.offset_dn
    noise = replace(noise, offset_dn=0.0, full_scale_dn=noise.full_scale_dn - offset)
    numbers = numbers - numbers.dtype.type(offset)
    gains = measure_gains(numbers, pattern, noise)
    share = ", ".join(f"{gain:.4f}" for gain in gains.ravel())
    remarks.append(
        Remark("mosaic", f"the mosaic {pattern} was measured as four sub-lattices of gains {share}")
    )
    return Mosaic(numbers, noise, gains)


def _with_mended_darkness(mosaic: Mosaic, given: SensorPicture, remarks: list[Remark]) -> Mosaic:
    """The picture with dark pixels right on average where noise below 0 was cut."""
    if given.values.min() != 0:
        return mosaic
    if given.dark is not None:
        if find_cut(given.values.astype(np.float64)) is not None:
            remarks.append(
                Remark(
                    "darkness-cut",
                    "noise below 0 DN was clipped in this picture, perhaps in the dark frame too:"
                    " dim light reads too high. Save pictures with a black level above 0",
                )
            )
        return mosaic
    cut = find_cut(mosaic.values)
    if cut is None:
        return mosaic
    remarks.append(
        Remark(
            "darkness-cut",
            f"noise below 0 DN was clipped in this picture; its mean ({cut.below_dn:.3g} DN) was"
            " estimated. Save pictures with a black level above 0",
        )
    )
    return mend(mosaic, cut)


def _remark_on_noise(mosaic: Mosaic) -> Remark:
    """Where the noise comes from that uncertainties count, and when that is next to nothing."""
    light = float(mosaic.values.max()) - mosaic.noise.offset_dn
    share = math.sqrt(float(mosaic.noise.variance(light + mosaic.noise.offset_dn))) / max(
        light, 1e-300
    )
    if share >= NEXT_TO_NONE:
        return Remark("noise-estimated", "the sensor's noise was estimated from the picture itself")
    return Remark(
        "next-to-no-noise",
        f"there is next to no noise in the picture, {share:.1g} of its light: uncertainties count"
        " that noise alone; a simulated picture has noise with --seed",
    )
