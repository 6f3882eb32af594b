"""Pictures in files: .npy, .png, .tiff (LZW too), .h5, raw and .dng in; .npy, .png, .tiff, .dng
out. Always one plane, [row, col].
"""

import io
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from flflab.errors import InputError, reason
from flflab.raw_file import FULL_DN, RAW, RawPicture, read_raw, require_file, write_raw
from flflab.tiff_pages import CMYK, read_pages
from flflab.whole_file import require_writable, write_whole

Picture = npt.NDArray[Any]

WRITABLE = (".npy", ".png", ".tif", ".tiff", ".dng")
HDF5 = (".h5", ".hdf5")
READABLE = WRITABLE[:-1] + HDF5 + RAW
WHITE_DN = (
    16384  # what 1.0 becomes in 16 bits: room for four times the white level where light overlaps
)
PNG_BEGIN = b"\x89PNG\r\n\x1a\n"
PNG_END = b"IEND\xaeB`\x82"


def read_picture(file: Path, number: int | None = None) -> Picture:
    """Read one grey or raw picture.

    Raw files give the sensor's own numbers, black level not subtracted, no demosaicing.

    Args:
        file: its ending says what it is.
        number: which one of a file of several pictures, from 0; None where there is only one.

    Returns:
        The numbers as stored, shape (rows, columns): uint8, uint16 or floating point.

    Raises:
        InputError: no such file, unknown ending, damaged or cut short, a colour picture, one of
            several without its number, or 8 bits stretched to 16.
    """
    file = Path(file)
    ending = file.suffix.lower()
    if ending not in READABLE:
        raise InputError(f"{file}: pictures are read from files ending in {', '.join(READABLE)}")
    if ending in RAW:
        _choose(file, 1, number)
        return read_raw(file).values
    require_file(file)
    try:
        picture = _read(file, ending, number)
    except (OSError, ValueError, EOFError, KeyError, cv2.error) as error:
        raise InputError(
            f"{file}: cannot be read as a {ending} picture ({reason(error)}); is it whole?"
        ) from error
    if picture.ndim == 3 and picture.shape[2] in (3, 4):
        if not (
            np.array_equal(picture[..., 0], picture[..., 1])
            and np.array_equal(picture[..., 0], picture[..., 2])
        ):
            raise InputError(
                f"{file}: it holds a picture of {picture.shape[2]} colours; the sensor's own"
                " numbers are due, as a grey picture or as a raw file with its mosaic"
            )
        picture = picture[..., 0]
    if picture.ndim != 2 or picture.size == 0 or picture.dtype.kind not in "uif":
        raise InputError(
            f"{file}: a grey picture of rows and columns is due, not shape {picture.shape} of"
            f" {picture.dtype}"
        )
    if _stretched(picture):
        raise InputError(
            f"{file}: its 16 bits hold numbers of 8 bits, stretched; the sensor's own numbers are"
            " due, linear in light, as they were read"
        )
    return picture


def write_picture(
    file: Path,
    picture: Picture,
    white_dn: int = WHITE_DN,
    *,
    pattern: str | None = None,
    neutral: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> None:
    """Write one picture.

    .npy keeps numbers and kind as they are. .tiff, .png and .dng hold 16 bits: whole numbers as
    they are, floating point times ``white_dn`` rounded, what noise puts below 0 as 0. A .dng has
    its black at 0; ``write_raw`` says more.

    Args:
        file: its ending says what to write.
        picture: shape (rows, columns).
        white_dn: what 1.0 of a floating-point picture becomes in 16 bits; the rest is room for
            overlapping light.
        pattern: mosaic of a .dng, see ``RawPicture``; the other kinds note none.
        neutral: what white gives in its colours.

    Raises:
        InputError: unknown ending, not a plane of numbers, numbers that 16 bits cannot hold, or it
            cannot be written.
    """
    file = Path(file)
    ending = _writable_ending(file)
    if picture.ndim != 2 or picture.size == 0 or picture.dtype.kind not in "uif":
        raise InputError(
            f"{file}: a plane of numbers is due, not shape {picture.shape} of {picture.dtype}"
        )
    if ending == ".dng":
        return write_raw(
            file, RawPicture(_sixteen_bits(file, picture, white_dn), pattern, neutral=neutral)
        )
    if ending == ".npy":
        stream = io.BytesIO()
        np.save(stream, picture, allow_pickle=False)
        return write_whole(file, stream.getbuffer())
    done, encoded = cv2.imencode(ending, _sixteen_bits(file, picture, white_dn))
    if not done:
        raise InputError(f"{file}: this picture cannot be written as {ending}")
    write_whole(file, encoded.tobytes())


def require_picture_file(file: Path) -> None:
    """Refuse, before a picture is formed, a file that could not take it.

    Raises:
        InputError: unknown ending, no such folder, or file or folder may not be written.
    """
    _writable_ending(file)
    require_writable(file)


def _writable_ending(file: Path) -> str:
    ending = file.suffix.lower()
    if ending not in WRITABLE:
        raise InputError(f"{file}: pictures are written to files ending in {', '.join(WRITABLE)}")
    return ending


def _stretched(picture: Picture) -> bool:
    """Whether 16 bits hold numbers of 8, times 256 or 257; dark and full alone say nothing of
    that.
    """
    if picture.dtype != np.uint16 or picture.max() < 256:
        return False
    return any(not (picture % step).any() for step in (256, 257)) and len(np.unique(picture)) > 2


def _read(file: Path, ending: str, number: int | None) -> Picture:
    if ending in HDF5:
        return _read_hdf5(file, number)
    if ending == ".npy":
        _choose(file, 1, number)
        return np.asarray(np.load(file, allow_pickle=False))
    # cv2.imread takes no path outside the locale's encoding; the bytes always work
    content = file.read_bytes()
    if ending == ".png":
        _choose(file, 1, number)
        if not content.startswith(PNG_BEGIN):
            raise ValueError("it does not begin as a PNG file does")
        if PNG_END not in content[-64:]:
            raise ValueError("it ends before the picture does")
        page = 0
    else:
        pages = read_pages(content)
        page = _choose(file, len(pages), number)
        if pages[page].photometric == CMYK:
            raise InputError(
                f"{file}: it holds a picture in printing colours (CMYK); the sensor's own numbers"
                " in grey are due"
            )
    done, pictures = cv2.imdecodemulti(
        np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED, range=(page, page + 1)
    )
    if not done:
        raise ValueError("not decodable")
    return np.asarray(pictures[0])


def _read_hdf5(file: Path, number: int | None) -> Picture:
    """A picture of the file's only set of pictures, as in a run's frames.h5."""
    import h5py  # only those who read such files pay for its start-up

    from flflab.hdf5_file import opened_hdf5, require_own_numbers

    with opened_hdf5(file) as content:
        found: list[Any] = []
        content.visititems(
            lambda _, item: (
                found.append(item)
                if isinstance(item, h5py.Dataset) and item.ndim in (2, 3)
                else None
            )
        )
        if len(found) != 1:
            names = ", ".join(str(item.name) for item in found) or "none"
            raise InputError(
                f"{file}: one set of pictures is due, of two or three dimensions; found: {names}"
            )
        require_own_numbers(found[0], file)
        if found[0].ndim == 2:
            _choose(file, 1, number)
            return np.asarray(found[0])
        return np.asarray(found[0][_choose(file, len(found[0]), number)])


def _choose(file: Path, count: int, number: int | None) -> int:
    """Which of ``count`` pictures."""
    if number is None and count == 1:
        return 0
    if number is None:
        raise InputError(f"{file}: it holds {count} pictures; say which, from 0 to {count - 1}")
    if not 0 <= number < count:
        raise InputError(
            f"{file}: picture {number} was asked for; it holds {count}, counted from 0"
        )
    return number


def _sixteen_bits(file: Path, picture: Picture, white_dn: int) -> npt.NDArray[np.uint16]:
    numbers = (
        np.maximum(np.rint(picture * float(white_dn)), 0) if picture.dtype.kind == "f" else picture
    )
    if not np.isfinite(picture).all() or numbers.min() < 0 or numbers.max() > FULL_DN:
        span = f"{picture.min():g} to {picture.max():g}"
        raise InputError(
            f"{file}: 16 bits hold 0 to {FULL_DN}, the picture runs from {span}; write .npy"
        )
    return numbers.astype(np.uint16)
