"""PNG, JPEG, BMP and PGM files as numbers.

A note in a file never turns, scales or inverts numbers here: it becomes a remark.
"""

import re
import struct
import zlib
from collections.abc import Callable, Iterator

import numpy as np

from flflab.files.stored_picture import (
    StoredPicture,
    alpha_remark,
    gamma_remark,
    lossy_remark,
    orientation_remarks,
    require_bits,
    require_no_palette,
)
from flflab.remark import Remark

PNG_BEGIN, JPEG_BEGIN, JPEG_END = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"\xff\xd9"
PNG_PALETTE, PNG_ALPHA = 3, (4, 6)  # colour types
ORIENTATION = 274  # tag
LINEAR = 100_000  # gAMA, in 1e-5
SCREEN = "the file says that its numbers are for a screen"


def read_png(file: object, content: bytes) -> StoredPicture:
    """Read a PNG; what stands behind its end does not count.

    Args:
        file: its name, for messages.
        content: its bytes.

    Raises:
        InputError: a palette, or fewer than 8 bits.
        ValueError: not a PNG, damaged or cut short.
    """
    import imagecodecs  # only those who read such files pay for its start-up

    if not content.startswith(PNG_BEGIN):
        raise ValueError("it does not begin as a PNG file does")
    # notes are left out of what is decoded: the library prints what it thinks of them
    critical, notes, head = [PNG_BEGIN], dict[bytes, bytes](), b""
    for kind, body, chunk in _png_chunks(content):
        head = body if kind == b"IHDR" else head
        if kind in (b"IHDR", b"PLTE", b"IDAT", b"IEND"):
            critical.append(chunk)
        else:
            notes[kind] = body
    _, _, bits, colour_type = struct.unpack_from(">IIBB", head)
    if colour_type == PNG_PALETTE:
        require_no_palette(file)
    require_bits(file, bits)
    try:
        values = np.asarray(imagecodecs.png_decode(b"".join(critical)))
    except Exception as error:
        raise ValueError(str(error)) from error
    remarks = [*_exif_remarks(notes.get(b"eXIf", b""))]
    if b"sRGB" in notes or notes.get(b"gAMA", struct.pack(">I", LINEAR)) != struct.pack(
        ">I", LINEAR
    ):
        remarks.append(gamma_remark(f"{SCREEN} (gAMA or sRGB)"))
    if colour_type in PNG_ALPHA:
        values = values[..., 0] if values.shape[-1] == 2 else values[..., :-1]
        remarks.append(alpha_remark())
    return StoredPicture(values, remarks=tuple(remarks))


def read_jpeg(content: bytes) -> StoredPicture:
    """Read a JPEG, with remarks on what it does to numbers.

    Raises:
        ValueError: not a JPEG, damaged or cut short.
    """
    import imagecodecs

    if not content.startswith(JPEG_BEGIN):
        raise ValueError("it does not begin as a JPEG file does")
    if JPEG_END not in content[-4096:]:
        raise ValueError("it ends before the picture does")
    try:
        values = np.asarray(imagecodecs.jpeg8_decode(content))
    except Exception as error:
        raise ValueError(str(error)) from error
    remarks = (
        *_exif_remarks(_jpeg_exif(content)),
        lossy_remark("JPEG"),
        gamma_remark("a JPEG is as a rule made for a screen"),
    )
    return StoredPicture(values, remarks=remarks)


def read_bmp(file: object, content: bytes) -> StoredPicture:
    """Read a BMP of 8 bits a channel.

    Raises:
        InputError: a palette other than grey from 0 to 255, or fewer than 8 bits.
        ValueError: not a BMP, damaged or cut short.
    """
    import imagecodecs

    if len(content) < 54 or not content.startswith(b"BM"):
        raise ValueError("it does not begin as a BMP file does")
    (header,) = struct.unpack_from("<I", content, 14)
    (bits,) = struct.unpack_from("<H", content, 28)
    require_bits(file, bits)
    if bits == 8:
        count = struct.unpack_from("<I", content, 46)[0] or 256
        palette = np.frombuffer(content[14 + header :][: 4 * count], np.uint8).reshape(-1, 4)
        if (palette[:, :3] != np.arange(len(palette))[:, None]).any():
            require_no_palette(file)
    try:
        return StoredPicture(np.asarray(imagecodecs.bmp_decode(content)))
    except Exception as error:
        raise ValueError(str(error)) from error


def read_pgm(content: bytes) -> StoredPicture:
    """Read a PGM or PPM (netpbm), of bytes or in words; its largest number is its full scale.

    Raises:
        ValueError: not such a file, damaged or cut short.
    """
    found = re.match(rb"P([2356])((?:\s+|\s*#[^\n]*\n)+(\d+)){3}\s", content)
    if not found:
        raise ValueError("it does not begin as a PGM file does")
    words = re.sub(rb"#[^\n]*", b"", found.group(0)).split()
    columns, rows, most = (int(word) for word in words[1:])
    shape = (rows, columns, 3) if words[0] in (b"P3", b"P6") else (rows, columns)
    count, wide = int(np.prod(shape)), most > 255
    if not 0 < most < 65536 or count == 0:
        raise ValueError(f"{columns} x {rows} pixels up to {most} are none that a PGM can have")
    if words[0] in (b"P2", b"P3"):
        numbers = content[found.end() :].split()[:count]
        values = np.array([int(number) for number in numbers], np.int64)
    else:
        values = np.frombuffer(
            content[found.end() :][: count * (1 + wide)], ">u2" if wide else "u1"
        )
    if len(values) < count:
        raise ValueError(f"it ends after {len(values)} of its {count} numbers")
    values = values.reshape(shape).astype(np.uint16 if wide else np.uint8)
    return StoredPicture(values, None if most in (255, 65535) else float(most))


def by_content(content: bytes) -> str | None:
    """The ending that belongs to what the bytes are; None where that is none of these."""
    kinds: dict[str, Callable[[], bool]] = {
        ".png": lambda: content.startswith(PNG_BEGIN),
        ".jpg": lambda: content.startswith(JPEG_BEGIN),
        ".bmp": lambda: content.startswith(b"BM"),
        ".pgm": lambda: re.match(rb"P[2356]\s", content) is not None,
        ".tif": lambda: content[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
        ".npy": lambda: content.startswith(b"\x93NUMPY"),
        ".h5": lambda: content.startswith(b"\x89HDF"),
    }
    return next((ending for ending, fits in kinds.items() if fits()), None)


def _png_chunks(content: bytes) -> Iterator[tuple[bytes, bytes, bytes]]:
    """Kind, body and bytes of each part of a PNG, up to its end."""
    at = len(PNG_BEGIN)
    while at + 12 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        chunk = content[at : at + 12 + length]
        if len(chunk) < 12 + length:
            break
        if zlib.crc32(chunk[4:-4]) != struct.unpack(">I", chunk[-4:])[0]:
            raise ValueError(f"its part {kind.decode('latin-1')} is damaged (checksum)")
        yield kind, chunk[8:-4], chunk
        if kind == b"IEND":
            return
        at += 12 + length
    raise ValueError("it ends before the picture does")


def _exif_remarks(exif: bytes) -> tuple[Remark, ...]:
    """Remarks on EXIF notes, which are a TIFF's first directory; one cut short says nothing."""
    order = "<" if exif.startswith(b"II") else ">"
    try:
        (at,) = struct.unpack_from(f"{order}I", exif, 4)
        (count,) = struct.unpack_from(f"{order}H", exif, at)
        for place in range(at + 2, at + 2 + 12 * count, 12):
            tag, _, _, value = struct.unpack_from(f"{order}HHIH", exif, place)
            if tag == ORIENTATION:
                return orientation_remarks(value)
    except struct.error:
        pass
    return ()


def _jpeg_exif(content: bytes) -> bytes:
    """The EXIF notes of a JPEG, which stand before its pixels; empty where it has none."""
    _, found, rest = content.partition(b"Exif\0\0")
    return rest if found else b""


def png_with(content: bytes, note: str) -> bytes:
    """A PNG with a text beside its picture, keyword Description.

    Args:
        content: of a PNG.
        note: the text; what is no Latin-1 is replaced.
    """
    body = b"tEXtDescription\0" + note.encode("latin-1", "replace")
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    header = 8 + 25  # the signature, and IHDR
    return content[:header] + chunk + content[header:]
