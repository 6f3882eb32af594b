"""Pictures in files: .npy, .png, .tiff, .bmp, .pgm, .jpg, .h5, raw and .dng in; .npy, .png, .tiff,
.dng out. Always one plane, [row, col].
"""

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from flflab.errors import InputError, reason
from flflab.files.bitmap import (
    by_content,
    png_with,
    read_bmp,
    read_jpeg,
    read_pgm,
    read_png,
)
from flflab.files.raw import FULL_DN, RAW, RawPicture, read_raw, require_file, write_raw
from flflab.files.sensor_picture import SensorPicture, declare, from_raw, with_dark
from flflab.files.stored_picture import StoredPicture
from flflab.files.tiff import read_tiff, tiff_of
from flflab.remark import Remark
from flflab.whole_file import require_writable, write_whole

Picture = npt.NDArray[Any]

WRITABLE = (".npy", ".png", ".tif", ".tiff", ".dng")
TIFF = (".tif", ".tiff")
HDF5 = (".h5", ".hdf5")
JPEG = (".jpg", ".jpeg")
PGM = (".pgm", ".ppm", ".pnm")
READABLE = (".npy", ".png", *TIFF, ".bmp", *PGM, *JPEG, *HDF5, *RAW)
COLOURS = ("red", "green", "blue")
WHITE_DN = (
    16384  # what 1.0 becomes in 16 bits: room for four times the white level where light overlaps
)


@dataclass(frozen=True)
class Declared:
    """What an operator says of a picture; None says nothing.

    Attributes:
        mosaic: the filters of a two by two mosaic, row by row, as ``rggb``.
        channel: which one of a colour picture, as of ``read_sensor_picture``.
        full_scale: what a saturated pixel reads, DN as stored.
        dark: a picture taken in the dark with the same settings.
    """

    mosaic: str | None = None
    channel: str | None = None
    full_scale: float | None = None
    dark: Path | None = None


def read_picture(file: Path, number: int | None = None) -> Picture:
    """Read one grey or raw picture.

    Raw files give the sensor's own numbers, black level not subtracted, no demosaicing.

    Args:
        file: its ending says what it is.
        number: which one of a file of several pictures, from 0; None where there is only one.

    Returns:
        The numbers as stored, shape (rows, columns): whole or floating point.

    Raises:
        InputError: as ``read_sensor_picture``.
    """
    return read_sensor_picture(file, number).values


def read_sensor_picture(
    file: Path, number: int | None = None, channel: str | None = None
) -> SensorPicture:
    """Read one picture with what its file says of it.

    Args:
        file: its ending says what it is.
        number: which one of a file of several pictures, from 0; None where there is only one.
        channel: which one of a colour picture: red, green, blue, or its number from 0; None for a
            grey picture or one whose channels are all equal.

    Raises:
        InputError: no such file, unknown ending, damaged or cut short, a colour picture without a
            channel, one of several without its number, 8 bits stretched to 16, or numbers that are
            not a sensor's.
    """
    file = Path(file)
    ending = file.suffix.lower()
    if ending not in READABLE:
        raise InputError(
            f"{file}: pictures are read from files ending in {', '.join(READABLE)}; save it as"
            " 16-bit .tiff or .png, or numbers without a header as .npy"
        )
    if ending in RAW:
        if channel is not None:
            raise InputError(
                f"{file}: a raw file holds one number a pixel, of whatever filter lies there; leave"
                " --channel out"
            )
        _choose(file, 1, number)
        return from_raw(read_raw(file))
    require_file(file)
    try:
        stored = _read(file, ending, number)
    except (OSError, ValueError, EOFError, KeyError, RuntimeError) as error:
        raise InputError(
            f"{file}: cannot be read as a {ending} picture ({_why(file, ending, error)}); is it"
            " whole?"
        ) from error
    values, remarks = _plane(file, stored, channel)
    if values.ndim != 2 or values.size == 0 or values.dtype.kind not in "uif":
        raise InputError(
            f"{file}: a grey picture of rows and columns is due, not shape {values.shape} of"
            f" {values.dtype}"
        )
    if _stretched(values):
        raise InputError(
            f"{file}: its 16 bits hold numbers of 8 bits, stretched; the sensor's own numbers are"
            " due, linear in light, as they were read"
        )
    return SensorPicture(
        np.ascontiguousarray(values, values.dtype.newbyteorder("=")),
        stored.pattern,
        full_scale=stored.full_scale,
        remarks=(*stored.remarks, *remarks),
    )


def read_declared(file: Path, number: int | None, said: Declared) -> SensorPicture:
    """Read one picture with what its file and its operator say of it.

    Raises:
        InputError: as ``read_sensor_picture``, or what was said cannot be true of the file.
    """
    if said.mosaic is not None and said.channel is not None:
        raise InputError(
            f"{file}: --mosaic is of a file with one number a pixel, --channel of one with a colour"
            " in each; give the one that is true of it"
        )
    picture = read_sensor_picture(file, number, said.channel)
    picture = declare(picture, str(file), said.mosaic, said.full_scale)
    if said.dark is None:
        return picture
    dark = read_sensor_picture(said.dark, None, said.channel)
    return with_dark(picture, str(file), dark, str(said.dark))


def write_picture(
    file: Path,
    picture: Picture,
    white_dn: int = WHITE_DN,
    *,
    pattern: str | None = None,
    neutral: tuple[float, float, float] = (1.0, 1.0, 1.0),
    note: str = "",
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
        note: written beside the numbers, ASCII: the description of a .tiff or .dng, a text of a
            .png; a .npy takes none.

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
            file,
            RawPicture(_sixteen_bits(file, picture, white_dn), pattern, neutral=neutral, note=note),
        )
    if ending == ".npy":
        stream = io.BytesIO()
        np.save(stream, picture, allow_pickle=False)
        return write_whole(file, stream.getbuffer())
    numbers = _sixteen_bits(file, picture, white_dn)
    if ending in TIFF:
        return write_whole(file, tiff_of(numbers, note))
    done, encoded = cv2.imencode(ending, numbers)
    if not done:
        raise InputError(f"{file}: this picture cannot be written as {ending}")
    write_whole(file, png_with(encoded.tobytes(), note) if note else encoded.tobytes())


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


def _plane(
    file: Path, stored: StoredPicture, channel: str | None
) -> tuple[Picture, tuple[Remark, ...]]:
    """One channel of what was stored, and a remark on the others."""
    values = stored.values
    if values.ndim != 3:
        if channel is not None:
            raise InputError(f"{file}: it holds one channel, in grey; leave --channel out")
        return values, ()
    count = values.shape[2]
    names = dict(zip(COLOURS, range(3), strict=True)) if count == 3 else {}
    names |= {str(place): place for place in range(count)}
    if channel is None:
        if (values == values[..., :1]).all():
            return values[..., 0], ()
        raise InputError(
            f"{file}: it holds a picture of {count} colours; the sensor's own numbers are due: save"
            " the camera's raw file or its mosaic in grey (--mosaic), or name the channel to"
            f" measure (--channel {' or '.join(names)})"
        )
    if channel not in names:
        raise InputError(f"{file}: it has no channel {channel!r}; allowed are {', '.join(names)}")
    return values[..., names[channel]], (
        Remark(
            "one-channel",
            f"channel {channel} of {count} was measured; colours are as a rule interpolated from a"
            " mosaic, so that the noise of neighbouring pixels is alike and uncertainties are too"
            " small",
        ),
    )


def _why(file: Path, ending: str, error: Exception) -> str:
    """What is wrong with a file, its name first where that is what is wrong."""
    with contextlib.suppress(OSError), file.open("rb") as stream:
        found = by_content(stream.read(16))
        kinds = {".tiff": ".tif", ".jpeg": ".jpg", ".ppm": ".pgm", ".pnm": ".pgm", ".hdf5": ".h5"}
        if found and found != kinds.get(ending, ending):
            return f"its content is that of a {found} file: rename it"
    return reason(error)


def _read(file: Path, ending: str, number: int | None) -> StoredPicture:
    if ending in TIFF:
        return _numbered(read_tiff, file, number)
    if ending in HDF5:
        return _numbered(_read_hdf5, file, number)
    _choose(file, 1, number)
    if ending == ".npy":
        return StoredPicture(np.asarray(np.load(file, allow_pickle=False)))
    content = file.read_bytes()
    if ending == ".png":
        return read_png(file, content)
    if ending == ".bmp":
        return read_bmp(file, content)
    return read_jpeg(content) if ending in JPEG else read_pgm(content)


def _numbered(
    read: Callable[[Path, Callable[[int], int]], StoredPicture], file: Path, number: int | None
) -> StoredPicture:
    """One picture of a file that may hold several, and a remark that says which."""
    counted = list[int]()

    def choose(count: int) -> int:
        counted.append(count)
        return _choose(file, count, number)

    stored = read(file, choose)
    if counted[-1] == 1:
        return stored
    which = Remark("one-of-several", f"picture {number} of {counted[-1]} was read, counted from 0")
    return replace(stored, remarks=(*stored.remarks, which))


def _read_hdf5(file: Path, choose: Callable[[int], int]) -> StoredPicture:
    """A picture of the file's only set of pictures, as in a run's frames.h5."""
    import h5py  # only those who read such files pay for its start-up

    from flflab.files.hdf5 import opened_hdf5, require_own_numbers

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
            choose(1)
            return StoredPicture(np.asarray(found[0]))
        return StoredPicture(np.asarray(found[0][choose(len(found[0]))]))


def _choose(file: Path, count: int, number: int | None) -> int:
    """Which of ``count`` pictures."""
    if number is None and count == 1:
        return 0
    if number is None:
        raise InputError(
            f"{file}: it holds {count} pictures; say which, from 0 to {count - 1} (--number), or"
            " save that one to a file of its own"
        )
    if not 0 <= number < count:
        raise InputError(f"{file}: there is no picture {number}; it holds {count}, counted from 0")
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
