"""What a raw file says of itself, held against what was asked of the camera that wrote it."""

import math

import numpy as np

from drivers.camera_commands import Setup, Taken
from flflab.errors import CommunicationError
from flflab.files.raw import RawPicture

# of an exposure or gain as a file tells it: cameras note 1/60 s for the 0.0166 s they were set to
CLOSENESS = 0.03
MOSAICS = {"rggb": "BayerRG", "bggr": "BayerBG", "grbg": "BayerGR", "gbrg": "BayerGB", None: "Mono"}


def taken_from(
    raw: RawPicture, source: str, asked: Setup, iso_at_gain_1: float, timestamp: float
) -> Taken:
    """The frame that a raw file holds.

    Args:
        raw: the file as read.
        source: camera and name of the file, for messages.
        asked: what the camera was set to; where the file does not tell exposure or speed, the frame
            has these.
        iso_at_gain_1: the speed that counts as gain 1.
        timestamp: when it was taken, s since 1970.

    Raises:
        CommunicationError: white level, exposure or gain are not what was asked for.
    """
    exposure_s = raw.exposure_s or asked.exposure_s
    gain = raw.iso / iso_at_gain_1 or asked.gain
    wrong = [
        f"{what} {came:g} instead of {due:g}"
        for what, came, due, near in (
            ("white level", raw.white_level, asked.full_scale, 0.0),
            ("exposure", exposure_s, asked.exposure_s, CLOSENESS),
            ("gain", gain, asked.gain, CLOSENESS),
        )
        if not math.isclose(came, due, rel_tol=near)
    ]
    if wrong:
        raise CommunicationError(
            f"{source} was taken with {', '.join(wrong)}; correct the camera or the bench file,"
            " then take it again"
        )
    pixel_format = f"{MOSAICS[raw.pattern]}{asked.full_scale.bit_length()}"
    return Taken(raw.values.astype(np.uint16), exposure_s, gain, timestamp, pixel_format)
