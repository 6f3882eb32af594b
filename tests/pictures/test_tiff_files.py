"""TIFF files as cameras, scanners and editors write them: the sensor's numbers come out as stored,
or a sentence says why not.
"""

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from flflab.errors import InputError
from flflab.files.image import read_picture, read_sensor_picture

GREY = (np.arange(30 * 40).reshape(30, 40) * 50 + 7).astype(np.uint16)
COLOURS = np.stack([GREY, GREY // 2, GREY // 3], axis=-1)


def tiff(
    file: Path,
    pixels: bytes,
    bits: list[int],
    tags: dict[int, int | list[int] | bytes] | None = None,
    order: str = "<",
    shape: tuple[int, int] = (30, 40),
) -> Path:
    """Write one uncompressed strip with any tags (TIFF 6.0, section 2)."""
    rows, columns = shape
    all_tags: dict[int, int | list[int] | bytes] = {
        **{256: columns, 257: rows, 258: bits, 259: 1, 262: 1, 273: 0, 277: len(bits), 278: rows},
        **{279: len(pixels)},
        **(tags or {}),
    }
    values_at = 8 + 2 + 12 * len(all_tags) + 4
    entries, values = b"", b""
    for tag, given in sorted(all_tags.items()):
        if isinstance(given, bytes):
            kind, count, packed = 2 if tag == 270 else 1, len(given), given
        else:
            numbers = given if isinstance(given, list) else [given]
            kind, count = 4 if tag in (273, 279) else 3, len(numbers)
            packed = struct.pack(f"{order}{count}{'I' if kind == 4 else 'H'}", *numbers)
        if tag == 273:
            packed = b"place"[:4]
        if len(packed) > 4:
            at, values = values_at + len(values), values + packed + b"\0" * (len(packed) % 2)
            packed = struct.pack(f"{order}I", at)
        entries += struct.pack(f"{order}HHI", tag, kind, count) + packed.ljust(4, b"\0")
    pixels_at = values_at + len(values)
    entries = entries.replace(b"plac", struct.pack(f"{order}I", pixels_at))
    head = struct.pack(f"{order}2sHIH", b"II" if order == "<" else b"MM", 42, 8, len(all_tags))
    file.write_bytes(head + entries + struct.pack(f"{order}I", 0) + values + pixels)
    return file


def grey(file: Path, tags: dict[int, int | list[int] | bytes] | None = None) -> Path:
    return tiff(file, GREY.astype("<u2").tobytes(), [16], tags)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "frame.tif"


@pytest.mark.parametrize("orientation", range(1, 9))
def test_an_orientation_turns_no_numbers_and_is_remarked(file: Path, orientation: int) -> None:
    picture = read_sensor_picture(grey(file, {274: orientation}))
    assert np.array_equal(picture.values, GREY)
    assert [remark.code for remark in picture.remarks] == ["orientation"] * (orientation > 1)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("kind", "sample_format"),
    [("u1", 1), ("u2", 1), ("u4", 1), ("i2", 2), ("i4", 2), ("f2", 3), ("f4", 3), ("f8", 3)],
)
def test_every_kind_of_number_comes_out_in_this_machines_order(
    file: Path, order: str, kind: str, sample_format: int
) -> None:
    due = (GREY.astype(np.int64) % 200 - (50 if kind[0] == "i" else 0)).astype(kind)
    pixels = due.astype(order + kind).tobytes()
    read = read_picture(tiff(file, pixels, [8 * int(kind[1])], {339: sample_format}, order))
    assert read.dtype == np.dtype(kind)
    assert read.dtype.isnative
    assert np.array_equal(read, due)


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_packed_bits_are_unpacked_and_say_their_full_scale(file: Path, bits: int) -> None:
    due = GREY % (2**bits)
    ones = "".join(format(number, f"0{bits}b") for number in due.ravel())
    pixels = int(ones, 2).to_bytes(len(ones) // 8, "big")
    picture = read_sensor_picture(tiff(file, pixels, [bits]))
    assert np.array_equal(picture.values, due)
    assert picture.full_scale == 2**bits - 1


@pytest.mark.parametrize("associated", [1, 2])
def test_alpha_is_left_out_of_sixteen_bits(file: Path, associated: int) -> None:
    pixels = np.stack([GREY, np.full_like(GREY, 65535)], axis=-1).tobytes()
    picture = read_sensor_picture(tiff(file, pixels, [16, 16], {338: associated}))
    assert np.array_equal(picture.values, GREY)
    assert [remark.code for remark in picture.remarks] == ["alpha"]


def test_numbers_multiplied_by_alpha_are_refused(file: Path) -> None:
    pixels = np.stack([GREY, GREY], axis=-1).tobytes()
    with pytest.raises(InputError, match="multiplied by an alpha channel"):
        read_picture(tiff(file, pixels, [16, 16], {338: 1}))


@pytest.mark.parametrize("planar", [False, True])
def test_one_channel_of_colours_is_read_by_its_name_or_number(file: Path, planar: bool) -> None:
    planes = np.moveaxis(COLOURS, -1, 0) if planar else COLOURS
    if planar:
        tifffile.imwrite(file, planes, photometric="rgb", planarconfig="separate")
    else:
        tiff(file, planes.tobytes(), [16] * 3, {262: 2})
    for place, name in enumerate(("red", "green", "blue")):
        for channel in (name, str(place)):
            picture = read_sensor_picture(file, channel=channel)
            assert np.array_equal(picture.values, COLOURS[..., place])
            assert [remark.code for remark in picture.remarks] == ["one-channel"]
    with pytest.raises(InputError, match="--channel red or green or blue"):
        read_picture(file)
    with pytest.raises(InputError, match="no channel 'uv'; allowed are red, green, blue, 0, 1, 2"):
        read_sensor_picture(file, channel="uv")


def test_a_mosaic_that_a_tiff_names_is_its_pattern(file: Path) -> None:
    picture = read_sensor_picture(
        grey(file, {262: 32803, 33421: [2, 2], 33422: bytes([1, 0, 2, 1])})
    )
    assert np.array_equal(picture.values, GREY)
    assert picture.pattern == "grbg"


@pytest.mark.parametrize(
    ("bits", "tags", "says"),
    [
        ([1], {}, "1 bit a pixel"),
        ([4], {}, "4 bits a pixel"),
        ([8], {262: 3, 320: [0] * 768}, "palette"),
        ([16], {262: 0}, "fall with light"),
        ([8] * 4, {262: 5}, "CMYK"),
        ([8] * 3, {262: 8}, "CIELAB"),
        ([16], {259: 50000}, r"ZSTD \(50000\)"),
        ([16], {259: 34713}, r"\(34713\)"),
        ([16], {259: 9999}, r"9999"),
        ([16], {279: 0}, "hold no pixels"),
        ([16], {279: 10**6}, "its pixels would end at byte"),
        ([16, 16], {339: [6, 6]}, "."),
    ],
)
def test_what_is_no_sensors_grey_numbers_is_refused_by_its_name(
    file: Path, bits: list[int], tags: dict[int, Any], says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    pixels = bytes(30 * 40 * sum(bits) // 8)
    with pytest.raises(InputError, match=says) as refused:
        read_picture(tiff(file, pixels, bits, tags))
    assert str(file) in str(refused.value)
    assert "\n" not in str(refused.value)
    assert capfd.readouterr() == ("", "")


def virtual_stack(file: Path) -> None:
    """As ImageJ writes stacks that are too large for pages: one page, the pictures behind it."""
    note = b"ImageJ=1.54f\nimages=3\nslices=3\n\0"
    pixels = b"".join((GREY + n).astype(">u2").tobytes() for n in range(3))
    tiff(file, pixels, [16], {270: note, 279: GREY.nbytes}, ">")


def thumbnailed(file: Path) -> None:
    """Three pages, each with a small one that says so (NewSubfileType 1) behind it."""
    with tifffile.TiffWriter(file) as writer:
        for n in range(3):
            writer.write(GREY + np.uint16(n), metadata=None)
            writer.write(GREY[::4, ::4], subfiletype=1, metadata=None)


def stack(file: Path, **kind: Any) -> None:
    three = np.stack([GREY + np.uint16(n) for n in range(3)])
    tifffile.imwrite(file, three, photometric="minisblack", **kind)


@pytest.mark.parametrize(
    "write",
    [
        virtual_stack,
        thumbnailed,
        stack,
        lambda file: stack(file, imagej=True),
        lambda file: stack(file, ome=True),
        lambda file: stack(file, bigtiff=True, tile=(16, 16), compression="zstd"),
        lambda file: stack(file, truncate=True),
        lambda file: cv2.imwritemulti(str(file), [GREY + np.uint16(n) for n in range(3)]),
    ],
    ids=["virtual", "thumbnails", "pages", "ImageJ", "OME", "BigTIFF", "truncated", "OpenCV"],
)
def test_one_of_several_pictures_is_read_and_which_is_said(file: Path, write: Any) -> None:
    write(file)
    for n in range(3):
        picture = read_sensor_picture(file, n)
        assert np.array_equal(picture.values, GREY + n)
        assert picture.remarks[-1].sentence == f"picture {n} of 3 was read, counted from 0"
    with pytest.raises(InputError, match="it holds 3 pictures; say which, from 0 to 2"):
        read_picture(file)


@pytest.mark.parametrize("compression", ["tiff_lzw", "tiff_adobe_deflate", "packbits", "zstd"])
def test_what_another_library_compresses_is_read(file: Path, compression: str) -> None:
    Image.fromarray(GREY).save(file, compression=compression)
    assert file.stat().st_size != GREY.nbytes
    assert np.array_equal(read_picture(file), GREY)


def test_jpeg_within_a_tiff_is_remarked(file: Path) -> None:
    even = np.full((32, 48), 77, dtype=np.uint8)
    Image.fromarray(even).save(file, compression="jpeg")
    picture = read_sensor_picture(file)
    assert np.array_equal(picture.values, even)
    assert [remark.code for remark in picture.remarks] == ["lossy", "gamma"]


def test_a_calibration_function_scales_no_numbers_and_is_remarked(file: Path) -> None:
    note = b"ImageJ=1.54f\ncf=20\nc0=-32768\nc1=1\n\0"
    picture = read_sensor_picture(grey(file, {270: note}))
    assert np.array_equal(picture.values, GREY)
    assert [remark.code for remark in picture.remarks] == ["calibration-function"]


def test_a_file_of_another_kind_is_named(tmp_path: Path) -> None:
    wrong = tmp_path / "frame.tif"
    Image.fromarray(GREY).save(tmp_path / "frame.png")
    wrong.write_bytes((tmp_path / "frame.png").read_bytes())
    with pytest.raises(InputError, match=r"content is that of a \.png file: rename it"):
        read_picture(wrong)
