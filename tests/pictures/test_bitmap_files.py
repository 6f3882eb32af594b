"""PNG, BMP, PGM and JPEG files as machine cameras and editors write them: the numbers as stored, or
a sentence.
"""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from flflab.errors import InputError
from flflab.files.image import read_picture, read_sensor_picture

GREY = (np.arange(30 * 40).reshape(30, 40) * 50 + 7).astype(np.uint16)
BYTES = (np.arange(30 * 40).reshape(30, 40) % 251).astype(np.uint8)
COLOURS = np.stack([BYTES, BYTES // 2, BYTES // 3], axis=-1)


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(
    pixels: npt.NDArray[np.unsignedinteger], colour_type: int, notes: bytes = b"", bits: int = 0
) -> bytes:
    """A PNG (W3C) of one row filter: none."""
    bits = bits or 8 * pixels.dtype.itemsize
    rows = b"".join(b"\0" + row.astype(f">u{row.dtype.itemsize}").tobytes() for row in pixels)
    head = struct.pack(
        ">IIBBBBB", pixels.shape[1] * 8 // min(bits, 8), len(pixels), bits, colour_type, 0, 0, 0
    )
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + notes
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


def turned(tag: int = 274) -> bytes:
    """EXIF notes with an orientation of 6."""
    return struct.pack("<2sHIHHHIHHI", b"II", 42, 8, 1, tag, 3, 1, 6, 0, 0)


@pytest.mark.parametrize("behind", [0, 1, 200, 100_000])
def test_bytes_behind_the_end_of_a_png_do_not_count(tmp_path: Path, behind: int) -> None:
    file = tmp_path / "frame.png"
    file.write_bytes(png(GREY, 0) + bytes(behind))
    picture = read_sensor_picture(file)
    assert np.array_equal(picture.values, GREY)
    assert picture.remarks == ()


@pytest.mark.parametrize(
    ("notes", "codes"),
    [
        (chunk(b"gAMA", struct.pack(">I", 45455)), ["gamma"]),
        (chunk(b"gAMA", struct.pack(">I", 100_000)), []),
        (chunk(b"sRGB", b"\0"), ["gamma"]),
        (chunk(b"iCCP", b"x\0\0" + zlib.compress(b"no profile")), []),
        (chunk(b"tRNS", struct.pack(">H", 57)), []),
        (chunk(b"eXIf", turned()), ["orientation"]),
        (chunk(b"eXIf", turned(305)), []),
        (chunk(b"eXIf", b"II"), []),
    ],
)
def test_notes_of_a_png_change_no_numbers_and_are_remarked(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], notes: bytes, codes: list[str]
) -> None:
    file = tmp_path / "frame.png"
    file.write_bytes(png(GREY, 0, notes))
    picture = read_sensor_picture(file)
    assert np.array_equal(picture.values, GREY)
    assert [remark.code for remark in picture.remarks] == codes
    assert capfd.readouterr() == ("", "")


def test_grey_with_alpha_keeps_its_sixteen_bits(tmp_path: Path) -> None:
    file = tmp_path / "frame.png"
    file.write_bytes(png(np.stack([GREY, GREY[::-1]], axis=-1), 4))
    picture = read_sensor_picture(file)
    assert np.array_equal(picture.values, GREY)
    assert [remark.code for remark in picture.remarks] == ["alpha"]


@pytest.mark.parametrize("name", ["frame.png", "frame.bmp", "frame.ppm"])
def test_a_channel_of_colours_is_the_one_that_was_named(tmp_path: Path, name: str) -> None:
    Image.fromarray(COLOURS).save(tmp_path / name)
    for place, colour in enumerate(("red", "green", "blue")):
        picture = read_sensor_picture(tmp_path / name, channel=colour)
        assert np.array_equal(picture.values, COLOURS[..., place])
    with pytest.raises(InputError, match=r"3 colours.*--mosaic.*--channel red or green or blue"):
        read_picture(tmp_path / name)
    Image.fromarray(np.repeat(BYTES[..., None], 3, axis=-1)).save(tmp_path / name)
    assert np.array_equal(read_picture(tmp_path / name), BYTES)


def test_a_channel_of_what_has_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "frame.png").write_bytes(png(GREY, 0))
    with pytest.raises(InputError, match="one channel, in grey; leave --channel out"):
        read_sensor_picture(tmp_path / "frame.png", channel="red")


def test_a_grey_bmp_is_read_top_row_first(tmp_path: Path) -> None:
    for write in (
        lambda file: Image.fromarray(BYTES).save(file),
        lambda file: cv2.imwrite(str(file), BYTES),
    ):
        write(tmp_path / "frame.bmp")
        assert np.array_equal(read_picture(tmp_path / "frame.bmp"), BYTES)


@pytest.mark.parametrize("head", [b"P5\n40 30\n%d\n", b"P5 # a note\n# 7 8\n40\t30 # 9\n%d\n"])
@pytest.mark.parametrize(("most", "full"), [(255, None), (4095, 4095.0), (65535, None)])
def test_a_pgm_is_read_and_its_largest_number_is_its_full_scale(
    tmp_path: Path, head: bytes, most: int, full: float | None
) -> None:
    due = (GREY.astype(np.int64) % (most + 1)).astype(">u1" if most < 256 else ">u2")
    (tmp_path / "frame.pgm").write_bytes(head % most + due.tobytes())
    picture = read_sensor_picture(tmp_path / "frame.pgm")
    assert np.array_equal(picture.values, due)
    assert picture.values.dtype == (np.uint8 if most < 256 else np.uint16)
    assert picture.full_scale == full


def test_a_pgm_in_words_is_read(tmp_path: Path) -> None:
    words = "\n".join(" ".join(str(number) for number in row) for row in GREY)
    (tmp_path / "frame.pgm").write_text(f"P2\n40 30\n65535\n{words}\n")
    assert np.array_equal(read_picture(tmp_path / "frame.pgm"), GREY)


def test_a_jpeg_is_read_with_remarks_and_not_turned(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    even = np.full((32, 48), 77, dtype=np.uint8)
    exif = Image.Exif()
    exif[274] = 6
    Image.fromarray(even).save(tmp_path / "frame.jpg", exif=exif)
    picture = read_sensor_picture(tmp_path / "frame.jpg")
    assert np.array_equal(picture.values, even)
    assert [remark.code for remark in picture.remarks] == ["orientation", "lossy", "gamma"]
    assert capfd.readouterr() == ("", "")


def broken(content: bytes) -> bytes:
    return content[:60] + b"\xff\xff" + content[62:]


def palette(ending: str) -> Callable[[Path], None]:
    def write(file: Path) -> None:
        picture = Image.fromarray(BYTES).convert("P")
        picture.putpalette([n * 7 % 256 for n in range(768)])
        picture.save(file, ending)

    return write


@pytest.mark.parametrize(
    ("name", "write", "says"),
    [
        ("a.png", lambda f: f.write_bytes(png(BYTES, 0, bits=1)), "1 bit a pixel"),
        ("a.png", lambda f: f.write_bytes(png(BYTES, 0, bits=4)), "4 bits a pixel"),
        ("a.png", palette("PNG"), "palette"),
        ("a.png", lambda f: f.write_bytes(png(GREY, 0)[:-20]), "ends before"),
        ("a.png", lambda f: f.write_bytes(broken(png(GREY, 0))), "IDAT is damaged"),
        ("a.bmp", palette("BMP"), "palette"),
        ("a.bmp", lambda f: Image.fromarray(BYTES).convert("1").save(f), "1 bit a pixel"),
        ("a.bmp", lambda f: f.write_bytes(b"BM" + bytes(60)), "0 bit"),
        ("a.pgm", lambda f: f.write_bytes(b"P5 40 30 65535\n" + bytes(2398)), "1199 of its 1200"),
        ("a.pgm", lambda f: f.write_bytes(b"P5 40 30 0\n"), "none that a PGM can have"),
        ("a.pgm", lambda f: f.write_bytes(b"P4 40 30\n" + bytes(150)), "begin as a PGM"),
        ("a.jpg", lambda f: f.write_bytes(b"\xff\xd8\xff\xe0" + bytes(60)), "ends before"),
        ("a.fits", lambda f: f.write_bytes(b"SIMPLE"), r"16-bit \.tiff or \.png"),
        ("a.npy", lambda f: np.save(f, np.zeros((4, 4), dtype=np.complex64)), "complex64"),
        ("a.npy", lambda f: np.save(f, np.zeros((4, 4), dtype=bool)), "bool"),
    ],
)
def test_what_is_no_sensors_picture_is_refused_by_its_name(
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    name: str,
    write: Callable[[Path], None],
    says: str,
) -> None:
    write(tmp_path / name)
    with pytest.raises(InputError, match=says) as refused:
        read_picture(tmp_path / name)
    assert name in str(refused.value)
    assert "\n" not in str(refused.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("order", ["<", ">"])
def test_numbers_of_npy_come_out_in_this_machines_order(tmp_path: Path, order: str) -> None:
    np.save(tmp_path / "frame.npy", np.asfortranarray(GREY.astype(f"{order}u2")))
    read = read_picture(tmp_path / "frame.npy")
    assert read.dtype.isnative
    assert read.flags.c_contiguous
    assert np.array_equal(read, GREY)
