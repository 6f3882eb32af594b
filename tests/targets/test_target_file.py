import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from flflab.errors import InputError
from flflab.files.target import load_target, target_from
from flflab.targets import Bars, Black, Chirp, Edge, FourDot, Picture, Target, White


@pytest.mark.parametrize(
    ("data", "target"),
    [
        ("four-dot", FourDot()),
        ("bars", Bars()),
        ("chirp", Chirp()),
        ("edge", Edge()),
        ("white", White()),
        ("black", Black()),
        ({"kind": "four-dot", "diameter": "500 um", "spacing": "1 cm"}, FourDot(0.5, 10.0)),
        ({"kind": "bars", "cycles_per_mm": [0.5, 10], "width": "20 mm", "height": "20 mm"}, Bars()),
        ({"kind": "chirp", "cycles_per_mm": ["1 lp/mm", 2]}, Chirp((1.0, 2.0))),
        ({"kind": "edge", "angle": "5 deg"}, Edge(math.radians(5))),
    ],
)
def test_a_bare_kind_means_its_defaults_and_fields_have_units(data: Any, target: Target) -> None:
    assert target_from(data) == target


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("dots", "'dots' is not a target; allowed: four-dot"),
        ({}, "kind: this field is missing"),
        ({"kind": "four-dot", "diameter": 1}, "diameter: 1 has no unit"),
        ({"kind": "four-dot", "diametr": "1 mm"}, "diametr: there is no such"),
        ({"kind": "bars", "cycles_per_mm": [0, 1]}, "cycles_per_mm"),
        ({"kind": "bars", "cycles_per_mm": ["1 mm", 1]}, "length"),
        ({"kind": "four-dot", "spacing": "0.1 mm"}, "spacing"),
        ({"kind": "edge", "angle": "5 mm"}, "angle"),
        ({"kind": "picture"}, "file"),
        ({"kind": "picture", "file": "none.png", "width": "1 mm"}, "cannot be read"),
    ],
)
def test_bad_descriptions_are_refused_with_field_and_reason(data: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        target_from(data)


def test_a_file_is_refused_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "bars.yaml"
    file.write_text("kind: bars\nwidth: 20 mm\nheight: 20\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"bars.yaml:3: height: 20 has no unit"):
        load_target(file)


@pytest.mark.parametrize("name", ["picture.png", "picture.tiff", "picture.npy"])
def test_a_picture_is_read_beside_its_file(tmp_path: Path, name: str) -> None:
    grey = np.array([[0, 51], [102, 255]], dtype=np.uint8)
    if name.endswith(".npy"):
        np.save(tmp_path / name, grey / 255)
    else:
        cv2.imwrite(str(tmp_path / name), grey)
    file = tmp_path / "target.yaml"
    file.write_text(f"kind: picture\nfile: {name}\nwidth: 4 mm\n", encoding="utf-8")
    target = load_target(file)
    assert isinstance(target, Picture)
    assert target.width == 4.0
    assert np.allclose(target.values, grey / 255)


def test_a_file_that_is_no_picture_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("no picture", encoding="utf-8")
    with pytest.raises(InputError, match="no kind that can be read"):
        target_from({"kind": "picture", "file": "text.png", "width": "1 mm"}, folder=tmp_path)
