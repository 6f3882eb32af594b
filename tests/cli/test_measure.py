"""``flflab measure``: one picture of several, a mosaic, and what is refused, as the operator sees
it.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.special import erf

from flflab.files.image import read_picture, write_picture

Run = Callable[..., Any]
SHAPE = (560, 760)


@pytest.fixture
def frames(flflab: Run, small_camera: Path, tmp_path: Path) -> Path:
    """Two pictures in one file, as a run leaves them: darkness, then bars."""
    picture = tmp_path / "bars.png"
    assert (
        flflab(
            "image",
            small_camera,
            "--target",
            "bars",
            "--distance",
            "506.7 mm",
            "--seed",
            1,
            "-o",
            picture,
        ).code
        == 0
    )
    with h5py.File(tmp_path / "frames.h5", "w") as content:
        content["frames"] = np.stack([np.zeros(SHAPE, dtype=np.uint16), read_picture(picture)])
    return tmp_path / "frames.h5"


@pytest.mark.full
def test_a_picture_of_a_runs_frames_is_measured_by_its_number(
    flflab: Run, small_camera: Path, frames: Path
) -> None:
    command = (
        "measure",
        frames,
        "--camera",
        small_camera,
        "--target",
        "bars",
        "--distance",
        "506.7 mm",
    )
    said = flflab(*command, "--number", 1, "--json").json
    assert len(said["mtf"]) > 5
    assert set(said["mtf"][0]) >= {
        "cycles_per_px",
        "contrast",
        "uncertainty",
        "classic",
        "classic_bias",
        "views",
    }
    assert set(said["mtf_by_view"][0]) >= {"centre_px", "cycles_per_px", "contrast", "uncertainty"}
    shown = flflab(*command, "--number", 1)
    assert "its bias" in shown.out
    for more, says in (
        ((), "2 pictures; say which"),
        (("--number", 0), "it is dark"),
        (("--number", 2), "it holds 2"),
    ):
        refused = flflab(*command, *more)
        assert refused.code == 1
        assert says in " ".join(refused.err.split())
        assert "Traceback" not in refused.err


# every pair of target, noise and kind of file; all eight together are slow
WITHOUT, WITH = (), ("--seed", 1)


@pytest.mark.parametrize(
    ("target", "noise", "ending"),
    [
        ("four-dot", WITHOUT, ".npy"),
        ("four-dot", WITH, ".png"),
        ("bars", WITHOUT, ".png"),
        pytest.param("bars", WITH, ".npy", marks=pytest.mark.ci),
        pytest.param("four-dot", WITHOUT, ".png", marks=pytest.mark.ci),
        pytest.param("four-dot", WITH, ".npy", marks=pytest.mark.ci),
        pytest.param("bars", WITHOUT, ".npy", marks=pytest.mark.ci),
        pytest.param("bars", WITH, ".png", marks=pytest.mark.ci),
    ],
)
def test_a_picture_that_image_writes_is_measured_as_it_is(
    flflab: Run,
    small_camera: Path,
    tmp_path: Path,
    target: str,
    noise: tuple[Any, ...],
    ending: str,
) -> None:
    there = ("--target", target, "--distance", "507 mm")
    picture = tmp_path / f"picture{ending}"
    assert flflab("image", small_camera, *there, *noise, "-o", picture).code == 0
    measured = flflab("measure", picture, "--camera", small_camera, *there, "--json").json
    if target == "bars":
        assert len(measured["mtf"]) > 5
    else:
        aside = np.array([dot["position_mm"][:2] for dot in measured["dots"]])
        assert np.abs(np.abs(aside) - 4.0).max() < 0.1
    assert any("next to no noise" in remark for remark in measured["remarks"]) == (not noise)


@pytest.mark.ci
def test_a_white_picture_beside_dots_or_bars_is_where_their_lattice_comes_from(
    flflab: Run, small_camera: Path, tmp_path: Path
) -> None:
    white, camera = tmp_path / "white.png", ("--camera", small_camera)
    for target in ("white", "four-dot", "bars"):
        made = flflab(
            "image",
            small_camera,
            "--target",
            target,
            "--distance",
            "507 mm",
            "--seed",
            1,
            "-o",
            tmp_path / f"{target}.png",
        )
        assert made.code == 0
    lattice = flflab("measure", white, *camera, "--json").json["lattice"]
    for target in ("four-dot", "bars"):
        there = (
            tmp_path / f"{target}.png",
            *camera,
            "--target",
            target,
            "--distance",
            "507 mm",
            "--white",
        )
        said = flflab("measure", *there, white, "--json").json
        assert said["lattice"]["pitch_px"] == lattice["pitch_px"]
        assert not any("no white picture" in remark for remark in said["remarks"])
        if target == "four-dot":
            for dot, place in zip(
                said["dots"],
                [(-4, -4, -507), (4, -4, -507), (-4, 4, -507), (4, 4, -507)],
                strict=True,
            ):
                assert np.all(
                    np.abs(np.array(dot["position_mm"]) - place)
                    < 4 * np.array(dot["uncertainty_mm"])
                )
                assert dot["uncertainty_mm"][2] < 0.15
    beside_white = flflab("measure", white, *camera, "--white", white)
    assert beside_white.code == 1
    assert "a white picture beside a white one" in " ".join(beside_white.err.split())


@pytest.mark.parametrize(
    ("name", "picture", "says"),
    [
        ("small.npy", np.zeros((3, 3)), "does not fit"),
        ("nan.npy", np.full(SHAPE, np.nan), "finite"),
        ("full.png", np.full(SHAPE, 65535, dtype=np.uint16), "saturated"),
        ("dark.dng", np.zeros(SHAPE, dtype=np.uint16), "dark"),
    ],
)
def test_what_cannot_be_measured_ends_with_1_and_a_sentence(
    flflab: Run, small_camera: Path, tmp_path: Path, name: str, picture: Any, says: str
) -> None:
    write_picture(tmp_path / name, picture)
    refused = flflab("measure", tmp_path / name, "--camera", small_camera)
    assert refused.code == 1
    assert refused.out == ""
    assert refused.err.startswith("flflab: ")
    assert says in refused.err


def test_an_ordinary_picture_of_an_edge_is_measured_without_a_camera(
    flflab: Run, tmp_path: Path
) -> None:
    angle, blur = np.radians(5.0), 0.8
    y, x = np.mgrid[:420, :640] - np.array([209.5, 319.5])[:, None, None]
    edge = 0.5 * (1 + erf((x * np.cos(angle) + y * np.sin(angle)) / blur / np.sqrt(2)))
    rng = np.random.default_rng(1)
    picture = rng.poisson(2000 + 6000 * edge) + rng.normal(100, 3, edge.shape)
    np.save(tmp_path / "edge.npy", picture.astype(np.uint16))
    said = flflab("measure", tmp_path / "edge.npy", "--plain", "--json").json
    assert said["edge"]["angle_deg"] == pytest.approx(5.0, abs=0.05)
    u, contrast = (
        np.array([one[key] for one in said["mtf"]]) for key in ("cycles_per_px", "contrast")
    )
    # drawn at the pixels' middles: the blur alone
    assert np.abs(contrast - np.exp(-2 * (np.pi * blur * u) ** 2))[u < 0.4].max() < 0.02
    refused = flflab("measure", tmp_path / "edge.npy", "--plain", "--white", tmp_path / "edge.npy")
    assert refused.code == 2
