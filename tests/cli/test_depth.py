"""``flflab depth`` and ``flflab refocus`` on pictures that ``flflab image`` makes: files, numbers
and refusals.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

Run = Callable[..., Any]
FILES = {"depth.tif", "focus.png", "cloud.ply", "depth.json", "depth.html"}
PAGES = ["distance_mm", "sigma_mm", "disparity", "disparity_sigma", "views"]
POINT = np.dtype([(name, "<f4") for name in ("x", "y", "z", "sigma_z", "intensity")])
TRUTH = 500.0
OSINSKI = Path(__file__).parents[2] / "examples" / "cameras" / "osinski.yaml"
COLUMNS, ROWS = 540, 460


@pytest.fixture
def small_camera(tmp_path: Path) -> Path:
    """The built-in camera with pixels three times as large and 6 x 5 micro-images."""
    text = OSINSKI.read_text(encoding="utf-8")
    file = tmp_path / "small.yaml"
    file.write_text(
        text.replace("[3664, 2748]", f"[{COLUMNS}, {ROWS}]")
        .replace("pixel: 1.66 um", "pixel: 5 um")
        .replace("count: [25, 25]", "count: [11, 11]"),
        encoding="utf-8",
    )
    return file


@pytest.fixture
def pictures(flflab: Run, small_camera: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A texture at ``TRUTH`` and a white picture, each with noise of its own."""
    found: list[Path] = []
    for target, seed in (("texture", 1), ("white", 2)):
        found.append(tmp_path / f"{target}.png")
        there = ("--target", target, "--distance", f"{TRUTH} mm", "--seed", seed)
        ended = flflab("image", small_camera, *there, "--tolerance", 0.004, "-o", found[-1])
        assert ended.code == 0, ended.err
    return found[0], found[1]


def read_png(file: Path) -> Any:
    return np.asarray(cv2.imread(str(file), cv2.IMREAD_UNCHANGED))


def read_cloud(file: Path) -> Any:
    head, _, body = file.read_bytes().partition(b"end_header\n")
    assert head.startswith(b"ply\nformat binary_little_endian 1.0\n")
    points = np.frombuffer(body, POINT)
    assert f"element vertex {len(points)}\n".encode() in head
    return points


def test_a_picture_becomes_files_that_hold_its_distance(
    flflab: Run, small_camera: Path, pictures: tuple[Path, Path], tmp_path: Path
) -> None:
    raw, white = pictures
    made_by = ("--camera", small_camera, "--white", white)
    ended = flflab("depth", raw, *made_by, "--range", "440 mm", "580 mm", "--json")
    assert ended.code == 0, ended.err
    folder = tmp_path / "texture-depth"
    assert {file.name for file in folder.iterdir()} == FILES
    told = json.loads((folder / "depth.json").read_text(encoding="utf-8"))
    assert ended.json == {**told, "files": ended.json["files"]}
    assert told["schema"] == 1
    assert told["density"] > 0.95
    assert told["distance_mm"]["median"] == pytest.approx(TRUTH, abs=0.3)
    assert told["derivatives_at_median"]["gap"] == pytest.approx(290, rel=0.05)
    with tifffile.TiffFile(folder / "depth.tif") as tiff:
        stored: list[Any] = list(tiff.pages)
        assert [page.tags[285].value for page in stored] == PAGES
        pages = {name: page.asarray() for name, page in zip(PAGES, stored, strict=True)}
    assert all(page.dtype == np.float32 for page in pages.values())
    error = (pages["distance_mm"] - TRUTH) / pages["sigma_mm"]
    assert np.nanmean(np.abs(error) < 3) > 0.9
    points = read_cloud(folder / "cloud.ply")
    assert len(points) == told["values"] == np.isfinite(pages["distance_mm"]).sum()
    assert np.median(points["z"]) == pytest.approx(TRUTH, abs=0.3)
    # the camera sees (sensor size)/L of the distance, less what the outer micro-images lack
    assert np.ptp(points["x"]) == pytest.approx(COLUMNS * 5e-3 / 60 * TRUTH, rel=0.15)
    focus = read_png(folder / "focus.png")
    assert focus.dtype == np.uint16
    assert focus.shape == pages["distance_mm"].shape
    assert np.std(focus[focus > 0]) > 0.05 * 65535
    page = (folder / "depth.html").read_text(encoding="utf-8")
    assert "Depth map" in page
    assert "http" not in page


@pytest.mark.ci
def test_a_picture_is_focused_anew_where_it_was_blurred(
    flflab: Run, small_camera: Path, pictures: tuple[Path, Path], tmp_path: Path
) -> None:
    raw, white = pictures
    made_by = ("--camera", small_camera, "--white", white)
    stack = tmp_path / "stack.tiff"
    at = ("--distance", f"{TRUTH} mm", "--distance", "420 mm")
    assert flflab("refocus", raw, *made_by, *at, "-o", stack).code == 0
    with tifffile.TiffFile(stack) as tiff:
        sharp, blurred = (page.asarray() for page in tiff.pages)
    detail = [np.nanmean(np.abs(np.diff(one, axis=1))) for one in (sharp, blurred)]
    assert detail[0] > 2 * detail[1]
    ended = flflab("refocus", raw, *made_by, "--total", "-o", tmp_path / "total.png")
    assert ended.code == 0, ended.err
    assert read_png(tmp_path / "total.png").dtype == np.uint16


def test_what_cannot_become_a_depth_map_is_said_in_one_sentence_and_leaves_no_files(
    flflab: Run, small_camera: Path, tmp_path: Path
) -> None:
    flat = tmp_path / "flat.npy"
    np.save(flat, np.full((ROWS, COLUMNS), 500, dtype=np.uint16))
    other = tmp_path / "other.npy"
    np.save(other, np.full((76, 100), 500, dtype=np.uint16))
    text = small_camera.read_text(encoding="utf-8")
    tiny = tmp_path / "tiny.yaml"
    tiny.write_text(text.replace(f"[{COLUMNS}, {ROWS}]", "[100, 76]"), encoding="utf-8")
    unfocused = tmp_path / "unfocused.yaml"
    unfocused.write_text(text.replace("focal_length: 0.917 mm", "focal_length: 1.15 mm"))
    with_white = ("--white", flat)
    cases = (
        ((flat,), "--camera and --white missing"),
        ((flat, "--camera", small_camera), "--white missing"),
        ((flat, "--camera", small_camera, *with_white), "nothing in it repeats"),
        ((flat, "--camera", small_camera, *with_white, "--range", "9 m", "8 m"), "rising"),
        ((flat, "--camera", small_camera, *with_white, "--range", "9 mm", "12 mm"), "no distance"),
        ((other, "--camera", tiny, "--white", other), "at least 5 x 5"),
        ((flat, "--camera", unfocused, *with_white), "plenoptic 1.0"),
        ((other, "--camera", small_camera, *with_white), "76"),
        ((tmp_path, *with_white), "leave"),
        ((tmp_path,), "nothing was recorded"),
    )
    for given, says in cases:
        ended = flflab("depth", *given, "--out", tmp_path / "made")
        assert ended.code == 1, (given, ended)
        assert says in " ".join(ended.err.split()), (given, ended.err)
        assert ended.err.count("\n") == 1, ended.err
        assert not list((tmp_path / "made").glob("*"))


def test_one_picture_or_several_need_a_file_that_holds_them(flflab: Run, tmp_path: Path) -> None:
    given = ("refocus", "raw.npy", "--camera", "c.yaml", "--white", "w.npy", "-o")
    for more, says in (
        ((tmp_path / "a.png",), "give --distance"),
        ((tmp_path / "a.png", "--total", "--distance", "5 mm"), "not both"),
        ((tmp_path / "a.png", "--distance", "5 mm", "--distance", "6 mm"), "holds one picture"),
        ((tmp_path / "a.gif", "--total"), ".png, .tif, .tiff"),
    ):
        ended = flflab(*given, *more)
        assert ended.code == 1
        assert says in ended.err
