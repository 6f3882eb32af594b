"""A camera file begun from a white picture: what the picture shows of the array that was drawn, and
the lines that are left to be filled in.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flflab.files.image import write_picture

PITCH_PX, ANGLE, RADIUS = 24.6, math.radians(0.3), 9.0
SIZE = (300, 400)  # rows, columns
Run = Callable[..., Any]
OPEN = "to be filled in"


@pytest.fixture(scope="module")
def white(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Discs on a square lattice, one of them 3 px right of and 2 px below the middle."""
    fine = 4
    y, x = (np.indices((SIZE[0] * fine, SIZE[1] * fine)) + 0.5) / fine - 0.5
    x, y = x - (199.5 + 3.0), y - (149.5 + 2.0)
    along, across = (
        x * math.cos(ANGLE) + y * math.sin(ANGLE),
        y * math.cos(ANGLE) - x * math.sin(ANGLE),
    )
    aside = [one - PITCH_PX * np.rint(one / PITCH_PX) for one in (along, across)]
    light = (np.hypot(*aside) < RADIUS).reshape(SIZE[0], fine, SIZE[1], fine).mean(axis=(1, 3))
    rng = np.random.default_rng(1)
    picture = rng.poisson(100 + 8000 * light) + rng.normal(0, 3, SIZE)
    file = tmp_path_factory.mktemp("white") / "white.png"
    write_picture(file, np.clip(picture, 0, 65535).astype(np.uint16))
    return file


def line(text: str, name: str) -> str:
    return next(one for one in text.splitlines() if one.strip().startswith(f"{name}:"))


def test_a_camera_file_begins_with_what_its_white_picture_shows(
    flflab: Run, white: Path, tmp_path: Path
) -> None:
    file = tmp_path / "camera.yaml"
    ended = flflab("new", "camera", file, "--white", white, "--pixel", "5um", "--pitch", "120um")
    assert (ended.code, ended.err) == (0, "")
    text = file.read_text(encoding="utf-8")
    assert line(text, "layout").split()[1] == "square"
    assert line(text, "resolution").endswith("[400, 300]  # columns, rows")
    assert float(line(text, "roll").split()[1]) == pytest.approx(0.3, abs=0.01)
    x, y = (float(one.split()[0]) for one in line(text, "offset").split("[")[1].split(",")[:2])
    assert (x, y) == pytest.approx((3 * 120 / PITCH_PX, 2 * 120 / PITCH_PX), abs=0.05)
    assert line(text, "pitch").endswith("pitch: 120 um")
    ratio = float(next(one for one in text.splitlines() if "times the distance" in one).split()[1])
    assert ratio == pytest.approx(PITCH_PX * 5 / 120, rel=1e-4)


def test_the_lines_that_are_left_open_are_named_by_the_model_and_no_others_once_filled(
    flflab: Run, white: Path, tmp_path: Path
) -> None:
    file = tmp_path / "camera.yaml"
    flflab("new", "camera", file, "--white", white)
    text = file.read_text(encoding="utf-8")
    ended = flflab("model", file)
    assert ended.code == 1
    open_lines = [n for n, one in enumerate(text.splitlines(), 1) if f": {OPEN}" in one]
    assert len(open_lines) == 8
    assert all(f"{file}:{n}: " in ended.err for n in open_lines)
    values = iter(["50 mm", "4", "120 um", "100 um", "0.5 mm", "60 mm", "5 um", "61.5 mm"])
    while f": {OPEN}" in text:
        text = text.replace(f": {OPEN}", f": {next(values)}", 1)
    file.write_text(text, encoding="utf-8")
    assert flflab("model", file).code == 0


def test_sizes_without_a_white_picture_are_refused(flflab: Run, tmp_path: Path) -> None:
    ended = flflab("new", "camera", tmp_path / "camera.yaml", "--pixel", "5um")
    assert ended.code != 0
    assert "--white PICTURE" in ended.err
    assert not list(tmp_path.iterdir())
