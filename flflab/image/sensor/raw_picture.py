"""A sensor's numbers with the facts that a raw file holds."""

import numpy as np
import numpy.typing as npt

from flflab.files.raw import RawPicture
from flflab.image.effects.colour_filter import ColourFilter
from flflab.image.sensor.response import SensorResponse


def raw_picture(
    numbers: npt.NDArray[np.uint16],
    response: SensorResponse,
    colour_filter: ColourFilter | None,
    exposure_s: float = 0.0,
    iso: float = 0.0,
) -> RawPicture:
    """What ``write_raw`` takes, of what ``digitise`` gives.

    Args:
        numbers: what the sensor reads.
        response: the sensor; its offset, rounded, is the black level, and its saturation or full
            scale the white level.
        colour_filter: of the scene.
        exposure_s: exposure time, s; 0 notes none.
        iso: speed; 0 notes none.
    """
    scale = response.quantisation
    black = round(scale.offset_dn)
    white = min(
        scale.full_scale, round(scale.offset_dn + scale.dn_per_electron * response.saturation_e)
    )
    pattern = None if colour_filter is None else colour_filter.pattern
    blacks = (black, black, black, black)
    return RawPicture(numbers, pattern, blacks, white, neutral(colour_filter), exposure_s, iso)


def neutral(colour_filter: ColourFilter | None) -> tuple[float, float, float]:
    """What a white target gives in red, green and blue, of the largest of the three; all alike
    without filters or through black ones.
    """
    some = colour_filter
    if some is None or min(some.red, some.green, some.blue) == 0:
        return 1.0, 1.0, 1.0
    most = max(some.red, some.green, some.blue)
    return some.red / most, some.green / most, some.blue / most
