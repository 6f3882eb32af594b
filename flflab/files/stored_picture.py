"""What a picture file holds, before one of its channels is chosen."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

from flflab.errors import InputError
from flflab.remark import Remark

if TYPE_CHECKING:
    import numpy.typing as npt

Filters = Literal["rggb", "bggr", "grbg", "gbrg"]  # two by two, row by row
MOSAICS: tuple[str, ...] = get_args(Filters)
FEWEST_BITS = 8
ORIENTATIONS = {
    2: "mirrored left to right",
    3: "turned by 180 degrees",
    4: "mirrored top to bottom",
    5: "mirrored about its diagonal",
    6: "turned by 90 degrees",
    7: "mirrored about its other diagonal",
    8: "turned by 270 degrees",
}


@dataclass(frozen=True)
class StoredPicture:
    """Numbers as stored.

    Attributes:
        values: shape (rows, columns), or (rows, columns, channels) without alpha.
        full_scale: the largest number that the format can hold where that is not the largest of 8
            or 16 bits; None where it says nothing.
        pattern: the mosaic of filters that the file names, as in ``SensorPicture``.
        remarks: what the file says that a reader of its numbers should know.
    """

    values: "npt.NDArray[Any]"
    full_scale: float | None = None
    pattern: str | None = None
    remarks: tuple[Remark, ...] = ()


def orientation_remarks(orientation: int) -> tuple[Remark, ...]:
    """A remark where a tag asks for a picture to be turned, which a sensor's numbers never are."""
    if orientation not in ORIENTATIONS:
        return ()
    return (
        Remark(
            "orientation",
            f"the file's orientation tag ({orientation}) asks viewers to show it"
            f" {ORIENTATIONS[orientation]}; the numbers were taken as stored, columns along the"
            " sensor's",
        ),
    )


def lossy_remark(compression: str) -> Remark:
    """A remark on numbers that a compression changed."""
    return Remark(
        "lossy",
        f"{compression} compression changes numbers: noise and uncertainties are not the sensor's;"
        " save without losses",
    )


def gamma_remark(why: str) -> Remark:
    """A remark on numbers that are perhaps not linear in light."""
    return Remark(
        "gamma",
        f"{why}: light was taken as linear in the numbers; where it is not, radii, light and"
        " contrast are wrong",
    )


def alpha_remark() -> Remark:
    """A remark on a channel that holds no light."""
    return Remark("alpha", "the file has an alpha channel, which holds no light; it was left out")


def require_bits(who: object, bits: int) -> None:
    """Refuse a picture of next to no levels.

    Raises:
        InputError: fewer than 8 bits.
    """
    if bits < FEWEST_BITS:
        raise InputError(
            f"{who}: it holds {bits} bit{'s' * (bits > 1)} a pixel, {2**bits} levels of grey;"
            f" {FEWEST_BITS} or more are due; was it made for print or a screen? Save the sensor's"
            " own numbers"
        )


def require_no_palette(who: object) -> None:
    """Refuse the numbers of a palette.

    Raises:
        InputError: always.
    """
    raise InputError(
        f"{who}: its numbers are places in a palette of colours, not light; a viewer's colour map"
        " was saved with it? Save the sensor's own numbers in grey"
    )
