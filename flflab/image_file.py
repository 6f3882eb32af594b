"""Pictures in files: .npy, .png, .tiff (LZW too), raw and .dng in; .npy, .png, .tiff, .dng out. Always one plane, [row, col]."""

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from flflab.errors import InputError

Picture = npt.NDArray[Any]

READABLE = (".npy", ".png", ".tif", ".tiff", ".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2", ".pef")
WRITABLE = (".npy", ".png", ".tif", ".tiff", ".dng")


def read_picture(file: Path) -> Picture:
    """Read one grey or raw picture.

    Raw files give the sensor's own numbers, black level not subtracted, no demosaicing.

    Args:
        file: its ending says what it is.

    Returns:
        The numbers as stored, shape (rows, columns): uint8, uint16 or floating point.

    Raises:
        InputError: no such file, unknown ending, damaged, or a colour picture.
    """
    file = Path(file)
    ending = file.suffix.lower()
    if ending not in READABLE:
        raise InputError(f"{file}: pictures are read from files ending in {', '.join(READABLE)}")
    if not file.is_file():
        raise InputError(f"{file}: there is no such file")
    try:
        picture = _read(file, ending)
    except (OSError, ValueError, EOFError, cv2.error) as error:
        raise InputError(f"{file}: cannot be read as a {ending} picture ({error})") from error
    if (
        picture.ndim == 3
        and picture.shape[2] >= 3
        and np.array_equal(picture[..., 0], picture[..., 1])
        and np.array_equal(picture[..., 0], picture[..., 2])
    ):
        picture = picture[..., 0]
    if picture.ndim != 2 or picture.size == 0 or picture.dtype.kind not in "uif":
        raise InputError(f"{file}: a grey picture of rows and columns is due, not shape {picture.shape} of {picture.dtype}")
    return picture


def _read(file: Path, ending: str) -> Picture:
    if ending == ".npy":
        return np.asarray(np.load(file, allow_pickle=False))
    if ending in (".png", ".tif", ".tiff"):
        # cv2.imread takes no path outside the locale's encoding; the bytes always work
        picture = cv2.imdecode(np.fromfile(file, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        if picture is None:
            raise ValueError("not decodable")
        return np.asarray(picture)
    import rawpy  # only raw files pay for its start-up

    try:
        with rawpy.imread(str(file)) as raw:
            return np.array(raw.raw_image_visible)
    except rawpy.LibRawError as error:
        raise ValueError(str(error)) from error


def write_picture(file: Path, picture: Picture, white_dn: int = 16384) -> None:
    """Write one picture.

    .npy keeps numbers and kind as they are. .tiff keeps float32 and whole numbers; float64 becomes float32. .png and .dng hold
    16 bits: whole numbers as they are, floating point times ``white_dn`` rounded, what noise puts below 0 as 0.

    Args:
        file: its ending says what to write.
        picture: shape (rows, columns).
        white_dn: what 1.0 of a floating-point picture becomes in .png and .dng; the rest is room for overlapping light. A .dng of
            whole numbers notes it as its white level.

    Raises:
        InputError: unknown ending, not a plane of numbers, numbers that 16 bits cannot hold, or the folder cannot be written.
    """
    file = Path(file)
    ending = file.suffix.lower()
    if ending not in WRITABLE:
        raise InputError(f"{file}: pictures are written to files ending in {', '.join(WRITABLE)}")
    if picture.ndim != 2 or picture.size == 0 or picture.dtype.kind not in "uif":
        raise InputError(f"{file}: a plane of numbers is due, not shape {picture.shape} of {picture.dtype}")
    try:
        if ending == ".npy":
            with file.open("wb") as stream:
                np.save(stream, picture, allow_pickle=False)
        elif ending == ".dng":
            file.write_bytes(_dng(_sixteen_bits(file, picture, white_dn), 65535 if picture.dtype.kind == "f" else white_dn))
        else:
            plane = _sixteen_bits(file, picture, white_dn) if ending == ".png" else _tiff_numbers(file, picture)
            done, encoded = cv2.imencode(ending, plane)
            if not done:
                raise InputError(f"{file}: this picture cannot be written as {ending}")
            file.write_bytes(encoded.tobytes())
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror}); check the folder") from error


def _tiff_numbers(file: Path, picture: Picture) -> Picture:
    if picture.dtype.kind == "f":
        return picture.astype(np.float32)
    return picture if picture.dtype == np.uint8 else _sixteen_bits(file, picture, 65535)


def _sixteen_bits(file: Path, picture: Picture, white_dn: int) -> npt.NDArray[np.uint16]:
    numbers = np.maximum(np.rint(picture * float(white_dn)), 0) if picture.dtype.kind == "f" else picture
    if not np.isfinite(picture).all() or numbers.min() < 0 or numbers.max() > 65535:
        span = f"{picture.min():g} to {picture.max():g}"
        raise InputError(f"{file}: 16 bits hold 0 to 65535, the picture runs from {span}; write .npy or .tiff")
    return numbers.astype(np.uint16)


def _dng(picture: npt.NDArray[np.uint16], white_dn: int) -> bytes:
    """A little-endian DNG 1.4 of one uncompressed strip, an RGGB mosaic by name; the least tags LibRaw reads bit-exactly."""
    rows, columns = picture.shape
    short, long, byte, ascii_, rational, srational = 3, 4, 1, 2, 5, 10
    identity = struct.pack("<18i", *(number for at in range(9) for number in (int(at % 4 == 0), 1)))
    tags: list[tuple[int, int, int, bytes]] = [
        (254, long, 1, struct.pack("<I", 0)),  # a full picture
        (256, long, 1, struct.pack("<I", columns)),
        (257, long, 1, struct.pack("<I", rows)),
        (258, short, 1, struct.pack("<H", 16)),
        (259, short, 1, struct.pack("<H", 1)),  # uncompressed
        (262, short, 1, struct.pack("<H", 32803)),  # colour filter array
        (271, ascii_, 7, b"flflab\0"),
        (272, ascii_, 7, b"flflab\0"),
        (273, long, 1, b"strip"),  # where the pixels begin, set below
        (274, short, 1, struct.pack("<H", 1)),
        (277, short, 1, struct.pack("<H", 1)),
        (278, long, 1, struct.pack("<I", rows)),
        (279, long, 1, struct.pack("<I", picture.nbytes)),
        (284, short, 1, struct.pack("<H", 1)),
        (33421, short, 2, struct.pack("<HH", 2, 2)),
        (33422, byte, 4, bytes([0, 1, 1, 2])),
        (50706, byte, 4, bytes([1, 4, 0, 0])),
        (50707, byte, 4, bytes([1, 1, 0, 0])),
        (50708, ascii_, 7, b"flflab\0"),
        (50714, short, 1, struct.pack("<H", 0)),  # black level
        (50717, long, 1, struct.pack("<I", white_dn)),
        (50721, srational, 9, identity),
        (50728, rational, 3, struct.pack("<6I", 1, 1, 1, 1, 1, 1)),
        (50778, short, 1, struct.pack("<H", 21)),
    ]
    directory_at = 8
    values_at = directory_at + 2 + 12 * len(tags) + 4
    values = b"".join(value + b"\0" * (len(value) % 2) for _, _, _, value in tags if len(value) > 4 and value != b"strip")
    pixels_at = (values_at + len(values) + 15) // 16 * 16
    entries, at = b"", values_at
    for tag, kind, count, value in tags:
        if value == b"strip":
            field = struct.pack("<I", pixels_at)
        elif len(value) <= 4:
            field = value.ljust(4, b"\0")
        else:
            field = struct.pack("<I", at)
            at += len(value) + len(value) % 2
        entries += struct.pack("<HHI", tag, kind, count) + field
    head = struct.pack("<2sHI", b"II", 42, directory_at) + struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0) + values
    return head.ljust(pixels_at, b"\0") + picture.astype("<u2").tobytes()
