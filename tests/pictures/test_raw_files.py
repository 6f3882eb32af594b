"""Raw files: levels, mosaic and notes come from the file; what holds no picture of two by two
filters is refused by its name.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from flflab.errors import InputError
from flflab.files.image import read_sensor_picture
from flflab.files.raw import read_raw

PIXELS = np.random.default_rng(1).integers(300, 4000, (400, 600)).astype(np.uint16)
IDENTITY = [1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1]
QUAD = bytes([0, 0, 1, 1, 0, 0, 1, 1, 1, 1, 2, 2, 1, 1, 2, 2])
X_TRANS = bytes(
    [
        *(1, 1, 0, 1, 1, 2, 1, 1, 2, 1, 1, 0, 2, 0, 1, 0, 2, 1),
        *(1, 1, 2, 1, 1, 0, 1, 1, 0, 1, 1, 2, 0, 2, 1, 2, 0, 1),
    ]
)


def dng(
    file: Path, filters: bytes, repeat: tuple[int, int] = (2, 2), *more: Any, pixels: Any = PIXELS
) -> Path:
    """A DNG of any mosaic, by tifffile."""
    tags = [
        (50706, 1, 4, bytes([1, 4, 0, 0]), True),
        (33421, 3, 2, repeat, True),
        (33422, 1, len(filters), filters, True),
        (50721, 10, 9, IDENTITY, True),
        (50717, 4, 1, 4095, True),
        (50708, 2, None, "camera", True),
        *more,
    ]
    tifffile.imwrite(file, pixels, photometric=32803, extratags=tags, metadata=None)
    return file


BLACK = (50713, 3, 2, (2, 2), True), (50714, 3, 4, (64, 60, 61, 70), True)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "frame.dng"


def test_black_of_each_filter_and_white_come_from_the_file(file: Path) -> None:
    picture = read_sensor_picture(dng(file, bytes([1, 0, 2, 1]), (2, 2), *BLACK))
    assert np.array_equal(picture.values, PIXELS)
    assert picture.pattern == "grbg"
    assert picture.black_level == (64, 60, 61, 70)
    assert picture.full_scale == 4095
    assert picture.remarks == ()


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_an_orientation_turns_no_raw_numbers_and_is_remarked(file: Path, orientation: int) -> None:
    picture = read_sensor_picture(
        dng(file, bytes([0, 1, 1, 2]), (2, 2), (274, 3, 1, orientation, True))
    )
    assert np.array_equal(picture.values, PIXELS)
    assert picture.pattern == "rggb"
    (remark,) = picture.remarks
    assert remark.code == "orientation"
    assert f"({orientation})" in remark.sentence


def only_the_header(file: Path) -> None:
    content = dng(file, bytes([0, 1, 1, 2])).read_bytes()
    file.write_bytes(content[: len(content) - PIXELS.nbytes])


def cut_short(file: Path) -> None:
    file.write_bytes(dng(file, bytes([0, 1, 1, 2])).read_bytes()[:-1000])


def zeros(file: Path) -> None:
    dng(file, bytes([0, 1, 1, 2]), (2, 2), *BLACK, pixels=np.zeros_like(PIXELS))


def zeros_below(file: Path) -> None:
    half = np.where(np.arange(400)[:, None] < 200, PIXELS, 0).astype(np.uint16)
    dng(file, bytes([0, 1, 1, 2]), (2, 2), *BLACK, pixels=half)


@pytest.mark.parametrize(
    ("write", "says"),
    [
        (only_the_header, "bytes, its pixels would end at byte"),
        (cut_short, "bytes, its pixels would end at byte"),
        (zeros, "it holds no picture: all of its 600 x 400 pixels are 0"),
        (zeros_below, "all its pixels below row 199 are 0, where darkness reads 70 DN"),
        (lambda file: dng(file, QUAD, (4, 4)), "its mosaic is quad-Bayer, 4 x 4 filters"),
        (lambda file: dng(file, X_TRANS, (6, 6)), "its mosaic is X-Trans, 6 x 6 filters"),
        (lambda file: dng(file, bytes([0, 1, 2, 3])), "its mosaic is of the filters gmcy"),
    ],
)
def test_what_holds_no_picture_of_two_by_two_filters_is_refused_by_its_name(
    file: Path, capfd: pytest.CaptureFixture[str], write: Callable[[Path], None], says: str
) -> None:
    write(file)
    with pytest.raises(InputError, match=says) as refused:
        read_raw(file)
    assert str(file) in str(refused.value)
    assert "\n" not in str(refused.value)
    assert capfd.readouterr() == ("", "")


def test_a_channel_of_a_raw_file_is_refused(file: Path) -> None:
    with pytest.raises(InputError, match="leave --channel out"):
        read_sensor_picture(dng(file, bytes([0, 1, 1, 2])), channel="red")


def test_without_the_library_a_sentence_says_what_to_do(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dng(file, bytes([0, 1, 1, 2]))
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(InputError, match=r"pip install rawpy.*--mosaic"):
        read_raw(file)
