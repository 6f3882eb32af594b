"""Pictures to files and back, read by other programs too."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rawpy
import tifffile

from flflab.errors import InputError
from flflab.files.image import read_picture, write_picture
from flflab.files.raw import RawPicture, read_raw, write_raw

WHOLE = np.random.default_rng(1).integers(0, 4096, (48, 64)).astype(np.uint16)


@pytest.mark.parametrize("ending", [".npy", ".png", ".tif", ".tiff", ".dng"])
def test_whole_numbers_come_back_to_the_bit(tmp_path: Path, ending: str) -> None:
    file = tmp_path / f"frame{ending}"
    write_picture(file, WHOLE)
    assert np.array_equal(read_picture(file), WHOLE)


def test_floating_point_survives_in_npy_and_is_scaled_for_sixteen_bits(tmp_path: Path) -> None:
    picture = np.random.default_rng(2).random((48, 64)) * 2
    for ending, factor, error in (
        (".npy", 1.0, 0.0),
        *((ending, 16384.0, 0.5 / 16384) for ending in (".tiff", ".png", ".dng")),
    ):
        write_picture(tmp_path / f"a{ending}", picture)
        assert (
            np.abs(read_picture(tmp_path / f"a{ending}") / factor - picture).max() <= error * 1.01
        )


def test_a_tiff_of_floating_point_is_read(tmp_path: Path) -> None:
    picture = np.random.default_rng(3).random((48, 64)).astype(np.float32)
    assert cv2.imwrite(str(tmp_path / "float.tiff"), picture)
    assert np.array_equal(read_picture(tmp_path / "float.tiff"), picture)


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "grbg", "gbrg", None])
def test_libraw_reads_numbers_mosaic_and_levels_of_a_dng(
    tmp_path: Path, pattern: str | None, bits: int
) -> None:
    white = 2**bits - 1
    values = np.random.default_rng(bits).integers(0, white + 1, (49, 67)).astype(np.uint16)
    black = (64, 60, 61, 70) if pattern else (64, 64, 64, 64)
    neutral = (0.6, 1.0, 0.5) if pattern else (1.0, 1.0, 1.0)
    file = tmp_path / "frame.dng"
    write_raw(file, RawPicture(values, pattern, black, white, neutral))
    with rawpy.imread(str(file)) as raw:
        assert np.array_equal(raw.raw_image, values)
        assert raw.white_level == white
        places = raw.raw_colors[:2, :2].ravel()
        if pattern:
            assert "".join("RGBG"[colour] for colour in places).lower() == pattern
            assert tuple(raw.black_level_per_channel[colour] for colour in places) == black
            assert 1 / np.array(raw.camera_whitebalance[:3]) == pytest.approx(neutral, rel=1e-5)
        else:
            assert raw.num_colors == 1
            assert raw.black_level_per_channel[0] == 64
    back = read_raw(file)
    assert np.array_equal(back.values, values)
    assert (back.pattern, back.black_level, back.white_level) == (pattern, black, white)
    assert back.neutral == pytest.approx(neutral, rel=1e-5)
    assert np.array_equal(read_picture(file), values)


@pytest.mark.parametrize("pattern", [None, "gbrg"])
def test_exposure_and_speed_are_told_as_others_read_them(
    tmp_path: Path, pattern: str | None
) -> None:
    values = np.arange(40 * 30, dtype=np.uint16).reshape(30, 40)
    write_raw(tmp_path / "a.dng", RawPicture(values, pattern, exposure_s=0.02, iso=400.0))
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        (page,) = file.series[0].pages
        assert isinstance(page, tifffile.TiffPage)
        assert page.tags[34665].value == {
            "ExposureTime": (2_000_000, 100_000_000),
            "ISOSpeedRatings": 400,
        }
    back = read_raw(tmp_path / "a.dng")
    assert (back.exposure_s, back.iso) == (0.02, 400.0)
    assert np.array_equal(back.values, values)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"values": WHOLE[:21]}, "22 x 22"),
        ({"pattern": "rgbw"}, "rggb"),
        ({"black_level": (0, 0, 0, 4095), "white_level": 4095}, "black"),
        ({"white_level": 65536}, "65535"),
        ({"black_level": (0, 0, 0, 1)}, "without filters"),
        ({"neutral": (0.0, 1.0, 1.0)}, "neutral"),
    ],
)
def test_facts_that_no_raw_file_can_hold_are_refused(
    tmp_path: Path, change: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        write_raw(tmp_path / "frame.dng", replace(RawPicture(WHOLE), **change))
    assert not (tmp_path / "frame.dng").exists()


def test_raw_facts_of_what_is_not_raw_are_refused(tmp_path: Path) -> None:
    write_picture(tmp_path / "frame.png", WHOLE)
    with pytest.raises(InputError, match="raw pictures are read from"):
        read_raw(tmp_path / "frame.png")
    with pytest.raises(InputError, match=r"ending in \.dng"):
        write_raw(tmp_path / "frame.nef", RawPicture(WHOLE))
    with pytest.raises(InputError, match="no such file"):
        read_raw(tmp_path / "missing.dng")


def test_lzw_tiff_and_grey_in_three_channels_are_read(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "lzw.tif"), WHOLE, [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    assert np.array_equal(read_picture(tmp_path / "lzw.tif"), WHOLE)
    assert cv2.imwrite(str(tmp_path / "grey.png"), np.repeat(WHOLE[..., None], 3, axis=2))
    assert np.array_equal(read_picture(tmp_path / "grey.png"), WHOLE)


def test_what_cannot_be_read_or_written_is_refused_by_name(tmp_path: Path) -> None:
    colour = np.zeros((4, 4, 3), dtype=np.uint8)
    colour[..., 1] = 9
    assert cv2.imwrite(str(tmp_path / "colour.png"), colour)
    for name, content in (
        ("broken.png", b"no"),
        ("broken.npy", b"no"),
        ("broken.dng", b"no"),
        ("frame.txt", b"1"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            read_picture(tmp_path / name)
    for name in ("missing.png", "colour.png"):
        with pytest.raises(InputError, match=name):
            read_picture(tmp_path / name)
    with pytest.raises(InputError, match=r"65535"):
        write_picture(tmp_path / "bright.png", np.full((4, 4), 10.0))
    with pytest.raises(InputError, match="cannot be written"):
        write_picture(tmp_path / "no" / "such.npy", WHOLE)
    with pytest.raises(InputError, match="ending"):
        write_picture(tmp_path / "frame.jpg", WHOLE)
