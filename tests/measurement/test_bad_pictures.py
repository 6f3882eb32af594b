"""Pictures that cannot be measured: each refused in one sentence that says what was found and what
is due, never a number.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import FlflabError
from flflab.files.image import read_picture, write_picture
from flflab.measurement.measure import measure
from flflab.targets import Bars, Chirp, Edge, FourDot, Target, White

SHAPE = (520, 760)
TARGETS = (White(), FourDot(spacing=2.0), Bars(), Chirp(), Edge())


def landscape() -> npt.NDArray[np.uint16]:
    """Something else: clouds of every size, as photographs have them."""
    rng = np.random.default_rng(7)
    spectrum = np.fft.rfft2(rng.standard_normal(SHAPE))
    frequency = np.hypot(np.fft.fftfreq(SHAPE[0])[:, None], np.fft.rfftfreq(SHAPE[1])[None, :])
    clouds = np.fft.irfft2(spectrum / np.maximum(frequency, 1e-3) ** 1.2, SHAPE)
    clouds = (clouds - clouds.min()) / np.ptp(clouds)
    return np.rint(clouds * 3000 + 64 + rng.normal(0, 10, SHAPE)).astype(np.uint16)


def hills() -> npt.NDArray[np.uint16]:
    """A photograph out of focus: in a micro-image it rises or falls evenly, as an edge blurred
    beyond all measure does.
    """
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    smooth = 120 + 60 * np.sin(x / 90) + 50 * np.cos(y / 70 + x / 200)
    return np.rint(
        10 * (smooth + np.random.default_rng(0).normal(0, 3, SHAPE)).clip(0, 255)
    ).astype(np.uint16)


PICTURES: dict[str, tuple[Any, str]] = {
    "all black": (np.zeros(SHAPE, dtype=np.uint16), "dark"),
    "black with noise": (np.random.default_rng(1).poisson(60, SHAPE).astype(np.uint16), "."),
    "black in floating point": (np.zeros(SHAPE), "dark"),
    "saturated": (np.full(SHAPE, 4095, dtype=np.uint16), "saturated|equally|dark"),
    "saturated in 8 bits": (np.full(SHAPE, 255, dtype=np.uint8), "saturated"),
    "evenly grey": (np.full(SHAPE, 1500, dtype=np.uint16), "."),
    "one pixel": (np.full((1, 1), 7, dtype=np.uint16), r"\(1, 1\)"),
    "of another size": (np.full((100, 100), 7, dtype=np.uint16), r"\(100, 100\)"),
    "turned on its side": (np.full(SHAPE[::-1], 7, dtype=np.uint16), r"\(760, 520\)"),
    "not numbers": (np.full(SHAPE, np.nan), "finite"),
    "one of them not a number": (
        np.where(np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE) == 9, np.inf, 0.5),
        "finite",
    ),
    "below 0": (-1.0 - landscape(), "below 0"),
    "of something else": (landscape(), "."),
    "of something smooth": (hills(), "."),
}
SLOW = "black with noise", "of something smooth"


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.kind)
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.full] if name in SLOW else []) for name in PICTURES],
)
def test_a_picture_that_shows_no_such_thing_gives_a_sentence_and_no_number(
    brute: Any, name: str, target: Target
) -> None:
    picture, says = PICTURES[name]
    with pytest.raises(FlflabError, match=says) as refused:
        measure(picture, brute.camera(4.0, SHAPE[::-1]), target, 506.7016)
    assert "\n" not in str(refused.value)


def png(file: Path) -> bytes:
    write_picture(file.with_suffix(".png"), landscape())
    return file.with_suffix(".png").read_bytes()


def truncated_png(file: Path) -> None:
    file.write_bytes(png(file)[:-1000])


def truncated_tiff(file: Path) -> None:
    write_picture(file, landscape())
    file.write_bytes(file.read_bytes()[:-1000])


def truncated_raw(file: Path) -> None:
    write_picture(file, landscape())
    file.write_bytes(file.read_bytes()[: 400 * 1000])


def truncated_numpy(file: Path) -> None:
    np.save(file, landscape())
    file.write_bytes(file.read_bytes()[:-1000])


def truncated_hdf5(file: Path) -> None:
    frames(file)
    file.write_bytes(file.read_bytes()[:1000])


def stretched(file: Path) -> None:
    write_picture(file, ((landscape() >> 4).astype(np.uint8) * np.uint16(257)).astype(np.uint16))


def shifted(file: Path) -> None:
    write_picture(file, (landscape() >> 4 << 8).astype(np.uint16))


def pages(file: Path) -> None:
    assert cv2.imwritemulti(str(file), [landscape(), landscape() + np.uint16(1)])


def printed(file: Path) -> None:
    """A TIFF whose PhotometricInterpretation is 5, separated inks."""
    assert cv2.imwrite(
        str(file), np.zeros((20, 30, 4), dtype=np.uint8), [cv2.IMWRITE_TIFF_COMPRESSION, 1]
    )
    content = bytearray(file.read_bytes())
    at = content.index(b"\x06\x01\x03\x00\x01\x00\x00\x00") + 8  # tag 262, a short
    content[at] = 5
    file.write_bytes(content)


def coloured(file: Path) -> None:
    picture = np.zeros((20, 30, 3), dtype=np.uint8)
    picture[..., 1] = 9
    assert cv2.imwrite(str(file), picture)


def frames(file: Path) -> None:
    with h5py.File(file, "w") as content:
        content["frames"] = np.stack([landscape(), landscape() + np.uint16(1)])


def two_sets(file: Path) -> None:
    with h5py.File(file, "w") as content:
        content["light"] = content["dark"] = landscape()


@pytest.mark.parametrize(
    ("make", "ending", "says"),
    [
        (truncated_png, ".png", "ends before"),
        (truncated_tiff, ".tiff", "cannot be read"),
        (truncated_raw, ".dng", "cannot be read"),
        (truncated_numpy, ".npy", "cannot be read"),
        (truncated_hdf5, ".h5", "cannot be read"),
        (stretched, ".png", "8 bits"),
        (shifted, ".tiff", "8 bits"),
        (pages, ".tiff", "2 pictures; say which"),
        (printed, ".tiff", "CMYK"),
        (coloured, ".png", "3 colours"),
        (frames, ".h5", "2 pictures; say which"),
        (two_sets, ".h5", "/dark, /light"),
        (lambda file: file.write_bytes(b""), ".tif", "cannot be read"),
        (lambda file: file.write_bytes(b"no picture at all, but words"), ".png", "cannot be read"),
    ],
)
def test_a_file_that_is_no_picture_of_a_sensor_is_refused_by_name(
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    make: Callable[[Path], None],
    ending: str,
    says: str,
) -> None:
    file = tmp_path / f"frame{ending}"
    make(file)
    with pytest.raises(FlflabError, match=says) as refused:
        read_picture(file)
    assert str(file) in str(refused.value)
    assert "\n" not in str(refused.value)
    assert not re.search("WARN|ERROR", capfd.readouterr().err)


@pytest.mark.parametrize(("make", "ending"), [(pages, ".tiff"), (frames, ".h5")])
def test_one_of_several_pictures_is_read_by_its_number(
    tmp_path: Path, make: Callable[[Path], None], ending: str
) -> None:
    file = tmp_path / f"frames{ending}"
    make(file)
    assert np.array_equal(read_picture(file, 0), landscape())
    assert np.array_equal(read_picture(file, 1), landscape() + 1)
    with pytest.raises(FlflabError, match="there is no picture 2; it holds 2"):
        read_picture(file, 2)


@pytest.mark.ci
def test_bits_shifted_up_are_shifted_back_and_it_is_said(brute: Any) -> None:
    camera = brute.camera(4.0, (760, 520))
    white = brute.white_picture((520, 760), "square", 245.5825, 0.0, (379.5, 259.5), 72.168, 23.777)
    twelve = (
        np.rint(white * 3000 + np.random.default_rng(1).normal(64, 3, white.shape))
        .clip(0, 4095)
        .astype(np.uint16)
    )
    plain, up = measure(twelve, camera), measure(twelve * np.uint16(16), camera)
    assert up["lattice"] == plain["lattice"]
    assert any("multiple of 16" in remark for remark in up["remarks"])
