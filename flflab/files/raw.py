"""Raw files: the sensor's own numbers with the facts that go with them; many makers' in, .dng in
and out.
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.files.stored_picture import MOSAICS, orientation_remarks
from flflab.files.tiff import filter_repeat, require_whole_strips
from flflab.remark import Remark
from flflab.whole_file import write_whole

RAW = (".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2", ".pef")
FULL_DN = 65535
PLACES = (b"strip", b"notes")  # in place of what is known only when everything has its place
FLIPS = {3: 3, 5: 8, 6: 6}  # LibRaw's, as orientations of TIFF
LEFT_EMPTY = 0.01  # of the rows: a file that ends early leaves more
PERIODS = 12  # rows and columns in which mosaics of 2, 4 and 6 repeat
SMALLEST = 22  # rows and columns; LibRaw takes nothing smaller for a raw file


@dataclass(frozen=True)
class RawPicture:
    """The sensor's own numbers, and what a raw file says of them.

    Attributes:
        values: shape (rows, columns), uint16, black level not subtracted, every filter's pixels at
            their places.
        pattern: the filters of the pixels [0, 0], [0, 1], [1, 0], [1, 1], a letter each; None for a
            sensor without filters.
        black_level: what these four read in the dark, DN.
        white_level: what a saturated pixel reads, DN.
        neutral: what a white target gives in red, green and blue, of the largest of the three.
        exposure_s: exposure time, s; 0 where the file does not say.
        iso: speed it was taken at; 0 where the file does not say.
        remarks: what else the file says that a reader of its numbers should know.
        note: what is written into the file beside, ASCII; not read back.
    """

    values: npt.NDArray[np.uint16]
    pattern: str | None = None
    black_level: tuple[int, int, int, int] = (0, 0, 0, 0)
    white_level: int = FULL_DN
    neutral: tuple[float, float, float] = (1.0, 1.0, 1.0)
    exposure_s: float = 0.0
    iso: float = 0.0
    remarks: tuple[Remark, ...] = ()
    note: str = ""


def read_raw(file: Path) -> RawPicture:
    """Read a raw file with its facts, without demosaicing.

    Args:
        file: a raw file of one number a pixel, with a mosaic of two by two filters or none.

    Raises:
        InputError: no such file, not a raw file, damaged, without pixels, or of another kind; or
            the library that reads raw files is not installed.
    """
    file = Path(file)
    if file.suffix.lower() not in RAW:
        raise InputError(f"{file}: raw pictures are read from files ending in {', '.join(RAW)}")
    require_file(file)
    try:
        import rawpy  # only raw files pay for its start-up
    except ImportError as error:
        raise InputError(
            f"{file}: raw files are read through rawpy, which cannot be loaded here ({error});"
            " install it (pip install rawpy), or convert the file to .tiff without demosaicing"
            " and name its mosaic (--mosaic)"
        ) from error
    try:
        if file.suffix.lower() == ".dng":
            require_whole_strips(file)  # LibRaw prints a line of its own where they are not
        with rawpy.imread(str(file)) as raw:
            return _facts(file, raw, rawpy.RawType.Flat)
    except (OSError, ValueError, rawpy.LibRawError) as error:
        said = error.args[0] if error.args else ""
        why = said.decode() if isinstance(said, bytes) else str(error)
        raise InputError(
            f"{file}: cannot be read as a raw picture ({why}); is it whole?"
        ) from error


def _facts(file: Path, raw: Any, flat: Any) -> RawPicture:
    """Numbers and facts of an opened raw file."""
    if raw.raw_type != flat:
        raise InputError(
            f"{file}: it holds several numbers a pixel, as after demosaicing; one number a pixel"
            " is due, save the raw file as the camera wrote it"
        )
    values, levels = np.array(raw.raw_image_visible), raw.black_level_per_channel
    _require_pixels(file, values, max(int(level) for level in levels))
    # single precision
    exposure_s, iso = (
        float(f"{noted:.7g}") for noted in (raw.other.shutter_speed, raw.other.iso_speed)
    )
    pattern, balance = None, (1.0, 1.0, 1.0)
    places = [0, 0, 0, 0]
    if raw.num_colors > 1:
        pattern, places = _mosaic(file, raw), raw.raw_colors_visible[:2, :2].ravel()
        balance = _neutral(raw.camera_whitebalance)
    a, b, c, d = (int(levels[int(place)]) for place in places)
    return RawPicture(
        values,
        pattern,
        (a, b, c, d),
        int(raw.white_level),
        balance,
        exposure_s,
        iso,
        orientation_remarks(FLIPS.get(int(raw.sizes.flip), 1)),
    )


def _require_pixels(file: Path, values: npt.NDArray[np.uint16], black: int) -> None:
    """Refuse a header that LibRaw fills with zeros: no pixel takes less than a bit, and a sensor
    in the dark reads its black level.

    Raises:
        InputError: there are no pixels, or none below some row.
    """
    size = file.stat().st_size
    dark = values == 0
    if dark.all() and (black > 0 or 8 * size < values.size):
        raise InputError(
            f"{file}: it holds no picture: all of its {values.shape[1]} x {values.shape[0]} pixels"
            f" are 0, in a file of {size} bytes; a copy or a download that ended after the header?"
        )
    last = len(values) - int(np.argmin(dark[::-1].all(axis=1)))
    if black > 0 and len(values) - last > LEFT_EMPTY * len(values):
        raise InputError(
            f"{file}: all its pixels below row {last - 1} are 0, where darkness reads {black} DN; a"
            " copy or a download that ended before the picture did?"
        )


def _mosaic(file: Path, raw: Any) -> str:
    """The mosaic of two by two filters, a letter a filter.

    Raises:
        InputError: it is of another size, or of other filters.
    """
    repeat = filter_repeat(file) if file.suffix.lower() == ".dng" else None
    colours = np.asarray(raw.raw_colors_visible[:PERIODS, :PERIODS])
    if repeat is None:
        repeat = next(
            (
                (side, side)
                for side in (2, 4, 6)
                if (colours[side:] == colours[:-side]).all()
                and (colours[:, side:] == colours[:, :-side]).all()
            ),
            (PERIODS, PERIODS),
        )
    letters = "".join(chr(raw.color_desc[int(place)]) for place in colours[:2, :2].ravel()).lower()
    if repeat == (2, 2) and letters in MOSAICS:
        return letters
    if repeat == (2, 2):
        name = f"of the filters {letters}"
    else:
        known = {4: "quad-Bayer, ", 6: "X-Trans, "}.get(repeat[0], "")
        name = f"{known}{repeat[0]} x {repeat[1]} filters"
    raise InputError(
        f"{file}: its mosaic is {name}; two by two filters of red, green and blue are due"
        f" ({', '.join(MOSAICS)}), or none. Let the camera write a Bayer or monochrome raw file, or"
        " measure one colour of a developed picture (--channel green)"
    )


def write_raw(file: Path, raw: RawPicture) -> None:
    """Write a .dng that LibRaw reads back bit for bit, with its facts.

    Args:
        file: ends in .dng.
        raw: numbers of any bits up to 16; each takes 16 in the file.

    Raises:
        InputError: another ending, too small a picture, an impossible fact, or it cannot be
            written.
    """
    file = Path(file)
    rows, columns = raw.values.shape
    if file.suffix.lower() != ".dng":
        raise InputError(f"{file}: raw pictures are written to files ending in .dng")
    if min(rows, columns) < SMALLEST:
        raise InputError(
            f"{file}: the picture has {columns} x {rows} pixels; a raw file takes {SMALLEST} x"
            f" {SMALLEST} or more"
        )
    if raw.pattern not in (None, *MOSAICS):
        raise InputError(
            f"{file}: there is no pattern {raw.pattern!r}; allowed: {', '.join(MOSAICS)}, or None"
        )
    if not 0 <= min(raw.black_level) <= max(raw.black_level) < raw.white_level <= FULL_DN:
        raise InputError(
            f"{file}: black {raw.black_level} and white {raw.white_level} DN; 0 <= black < white <="
            f" {FULL_DN} is due"
        )
    if raw.pattern is None and len(set(raw.black_level)) > 1:
        raise InputError(
            f"{file}: black levels are {raw.black_level} DN; without filters they are all the same"
        )
    if not all(0 < share <= 1 for share in raw.neutral):
        raise InputError(f"{file}: neutral is {raw.neutral}; numbers above 0 up to 1 are due")
    write_whole(file, _dng(raw))


def require_file(file: Path) -> None:
    """Check that there is such a file.

    Raises:
        InputError: there is none.
    """
    if not file.is_file():
        raise InputError(f"{file}: there is no such file")


def _neutral(balance: list[float]) -> tuple[float, float, float]:
    """What white gives in red, green and blue, from the factors that even them out; all alike where
    a file has none.
    """
    if not all(factor > 0 for factor in balance[:3]):
        return 1.0, 1.0, 1.0
    red, green, blue = (min(balance[:3]) / factor for factor in balance[:3])
    return red, green, blue


def _dng(raw: RawPicture) -> bytes:
    """A little-endian DNG 1.4 of one uncompressed strip: a colour filter array, or linear raw of
    one sample.
    """
    rows, columns = raw.values.shape
    short, long, byte, ascii_, rational, srational = 3, 4, 1, 2, 5, 10
    tags: list[tuple[int, int, int, bytes]] = [
        (254, long, 1, struct.pack("<I", 0)),  # a full picture
        (256, long, 1, struct.pack("<I", columns)),
        (257, long, 1, struct.pack("<I", rows)),
        (258, short, 1, struct.pack("<H", 16)),
        (259, short, 1, struct.pack("<H", 1)),  # uncompressed
        (
            262,
            short,
            1,
            struct.pack("<H", 32803 if raw.pattern else 34892),
        ),  # colour filter array, or linear raw
        *_note(raw.note),
        (271, ascii_, 7, b"flflab\0"),
        (272, ascii_, 7, b"flflab\0"),
        (273, long, 1, b"strip"),  # where the pixels begin, set below
        (274, short, 1, struct.pack("<H", 1)),
        (277, short, 1, struct.pack("<H", 1)),
        (278, long, 1, struct.pack("<I", rows)),
        (279, long, 1, struct.pack("<I", raw.values.nbytes)),
        (284, short, 1, struct.pack("<H", 1)),
    ]
    if raw.pattern:
        tags += [
            (33421, short, 2, struct.pack("<HH", 2, 2)),
            (33422, byte, 4, bytes("rgb".index(letter) for letter in raw.pattern)),
        ]
    noted = _exif(raw)
    if noted:
        tags.append((34665, long, 1, b"notes"))  # where the exposure is told, set below
    tags += [
        (50706, byte, 4, bytes([1, 4, 0, 0])),
        (50707, byte, 4, bytes([1, 1, 0, 0])),
        (50708, ascii_, 7, b"flflab\0"),
    ]
    if raw.pattern:
        tags += [
            (50713, short, 2, struct.pack("<HH", 2, 2)),
            (50714, short, 4, struct.pack("<4H", *raw.black_level)),
        ]
    else:
        tags += [(50714, short, 1, struct.pack("<H", raw.black_level[0]))]
    planes = 3 if raw.pattern else 1
    identity = [number for at in range(planes**2) for number in (int(at % (planes + 1) == 0), 1)]
    neutral = [number for share in raw.neutral[:planes] for number in (round(share * 1e6), 10**6)]
    tags += [
        (50717, long, 1, struct.pack("<I", raw.white_level)),
        (
            50721,
            srational,
            planes**2,
            struct.pack(f"<{len(identity)}i", *identity),
        ),  # no colours are claimed
        (50728, rational, planes, struct.pack(f"<{len(neutral)}I", *neutral)),
        (50778, short, 1, struct.pack("<H", 21)),  # D65
    ]
    values_at = 8 + 2 + 12 * len(tags) + 4
    values = b"".join(
        value + b"\0" * (len(value) % 2)
        for _, _, _, value in tags
        if len(value) > 4 and value not in PLACES
    )
    noted_at = values_at + len(values)
    pixels_at = (noted_at + len(noted) + 15) // 16 * 16
    entries, at = b"", values_at
    for tag, kind, count, value in tags:
        if value in PLACES:
            field = struct.pack("<I", pixels_at if value == b"strip" else noted_at)
        elif len(value) <= 4:
            field = value.ljust(4, b"\0")
        else:
            field = struct.pack("<I", at)
            at += len(value) + len(value) % 2
        entries += struct.pack("<HHI", tag, kind, count) + field
    head = (
        struct.pack("<2sHI", b"II", 42, 8)
        + struct.pack("<H", len(tags))
        + entries
        + struct.pack("<I", 0)
        + values
    )
    head += _exif(raw, noted_at)
    return head.ljust(pixels_at, b"\0") + raw.values.astype("<u2").tobytes()


def _note(note: str) -> list[tuple[int, int, int, bytes]]:
    """The tag of a description; none where there is none."""
    text = note.encode("ascii", "replace").ljust(4) + b"\0"  # four bytes stand in its entry
    return [(270, 2, len(text), text)] if note else []


def _exif(raw: RawPicture, at: int = 0) -> bytes:
    """The directory that tells exposure time and speed, to stand at a place in the file; empty
    where neither is known.
    """
    entries, values = [], b""
    if raw.exposure_s > 0:
        values = (
            struct.pack("<II", round(raw.exposure_s * 1e8), 10**8)
            if raw.exposure_s < 40
            else struct.pack("<II", round(raw.exposure_s), 1)
        )
        entries.append((33434, 5, values))
    if raw.iso > 0:
        entries.append((34855, 3, struct.pack("<HH", min(round(raw.iso), FULL_DN), 0)))
    if not entries:
        return b""
    values_at = at + 2 + 12 * len(entries) + 4
    fields = b"".join(
        struct.pack("<HHI", tag, kind, 1)
        + (value if len(value) == 4 else struct.pack("<I", values_at))
        for tag, kind, value in entries
    )
    return struct.pack("<H", len(entries)) + fields + struct.pack("<I", 0) + values
