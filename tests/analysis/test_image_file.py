"""Pictures to files and back, read by other programs too."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from flflab.errors import InputError
from flflab.image_file import read_picture, write_picture

WHOLE = np.random.default_rng(1).integers(0, 4096, (48, 64)).astype(np.uint16)


@pytest.mark.parametrize("ending", [".npy", ".png", ".tif", ".tiff", ".dng"])
def test_whole_numbers_come_back_to_the_bit(tmp_path: Path, ending: str) -> None:
    file = tmp_path / f"frame{ending}"
    write_picture(file, WHOLE, 4095)
    assert np.array_equal(read_picture(file), WHOLE)


def test_floating_point_survives_in_npy_and_tiff_and_is_scaled_for_sixteen_bits(tmp_path: Path) -> None:
    picture = np.random.default_rng(2).random((48, 64)) * 2
    for ending, factor, error in ((".npy", 1.0, 0.0), (".tiff", 1.0, 1e-7), (".png", 16384.0, 0.5 / 16384), (".dng", 16384.0, 0.5 / 16384)):
        write_picture(tmp_path / f"a{ending}", picture)
        assert np.abs(read_picture(tmp_path / f"a{ending}") / factor - picture).max() <= error * 1.01


def test_lzw_tiff_and_grey_in_three_channels_are_read(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "lzw.tif"), WHOLE, [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    assert np.array_equal(read_picture(tmp_path / "lzw.tif"), WHOLE)
    assert cv2.imwrite(str(tmp_path / "grey.png"), np.repeat(WHOLE[..., None], 3, axis=2))
    assert np.array_equal(read_picture(tmp_path / "grey.png"), WHOLE)


def test_what_cannot_be_read_or_written_is_refused_by_name(tmp_path: Path) -> None:
    colour = np.zeros((4, 4, 3), dtype=np.uint8)
    colour[..., 1] = 9
    assert cv2.imwrite(str(tmp_path / "colour.png"), colour)
    for name, content in (("broken.png", b"no"), ("broken.npy", b"no"), ("broken.dng", b"no"), ("frame.txt", b"1")):
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
