"""Microlenses that differ: what each does to its micro-image, against closed forms."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flflab.image.effects.scatter import Scatter
from flflab.image.microlenses import camera_lenses, draws_of
from flflab.image.path import prepare
from flflab.image.picture import take_picture
from flflab.image.scene import one_plane
from flflab.image.scene_file import read_scene
from flflab.optics.camera import Camera, pixel_positions
from flflab.targets import Bars, White

SEED = 5


def centroid(camera: Camera, scatter: Scatter | None, lens: int) -> tuple[float, float, float]:
    """Where the light of one micro-image lies in a white picture, mm, and how much there is."""
    scene = replace(one_plane(camera, White(), 507.0), scatter=scatter)
    image = take_picture(scene, tolerance=1e-4, effects="reference").image
    plain = camera_lenses(camera, 1 / 507.0)[lens]
    xs, ys = pixel_positions(camera.sensor)
    half = 0.5 * camera.array.pitch[0]
    columns, rows = np.abs(xs - plain["x"]) < half, np.abs(ys - plain["y"]) < half
    part = image[np.ix_(rows, columns)]
    return (
        float((part.sum(axis=0) @ xs[columns]) / part.sum()),
        float((part.sum(axis=1) @ ys[rows]) / part.sum()),
        float(part.sum()),
    )


@pytest.fixture
def one_lens(camera: Camera) -> tuple[Camera, int]:
    """A sensor that sees one whole micro-image, and the number of its microlens."""
    small = replace(camera, sensor=replace(camera.sensor, resolution=(240, 240)))
    middle = int(np.argmin(np.hypot(*(camera_lenses(small, 0.0)[name] for name in "xy"))))
    return small, middle


def test_an_aperture_aside_of_its_lens_shows_the_place_less_what_the_lens_bends(
    one_lens: tuple[Camera, int],
) -> None:
    camera, lens = one_lens
    scatter = Scatter(aperture_decentre=1e-3, seed=SEED)
    aside = 1e-3 * draws_of(scatter, 625)[lens, 4:6]
    gap, far, focal = camera.optical_gap, camera.array.distance, camera.array.focal_lengths[0]
    x, y, _ = centroid(camera, scatter, lens)
    x0, y0, _ = centroid(camera, None, lens)
    kappa = 1 + gap / far - gap / focal
    assert (x - x0, y - y0) == pytest.approx(tuple(kappa * aside), abs=2e-6)


def test_a_lens_aside_shows_its_place_seen_from_the_main_lens(
    one_lens: tuple[Camera, int],
) -> None:
    camera, lens = one_lens
    scatter = Scatter(position=1e-3, seed=SEED)
    aside = 1e-3 * draws_of(scatter, 625)[lens, 1:3]
    x, y, _ = centroid(camera, scatter, lens)
    x0, y0, _ = centroid(camera, None, lens)
    scale = 1 + camera.optical_gap / camera.array.distance
    assert (x - x0, y - y0) == pytest.approx(tuple(scale * aside), abs=2e-6)


def test_a_brighter_lens_makes_a_brighter_micro_image(one_lens: tuple[Camera, int]) -> None:
    camera, lens = one_lens
    scatter = Scatter(brightness=0.05, seed=SEED)
    gain = centroid(camera, scatter, lens)[2] / centroid(camera, None, lens)[2]
    assert gain == pytest.approx(1 + 0.05 * draws_of(scatter, 625)[lens, 3], rel=1e-3)


def test_workmanship_stays_on_the_closed_forms(camera: Camera) -> None:
    every = Scatter(0.01, 3e-4, SEED, 0.01, 1e-4)
    scene = replace(one_plane(camera, Bars(), 507.0), scatter=every)
    assert prepare(scene, 5e-4).made is not None


def test_a_scene_file_states_workmanship(tmp_path: Path, root: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(
        "planes: [{target: white, distance: 507 mm}]\n"
        "scatter: {focal_length: 1 %, position: 0.3 um, brightness: 2 %,"
        " aperture_decentre: 0.1 um, seed: 3}\n",
        encoding="utf-8",
    )
    scatter = read_scene(file, root / "examples/cameras/osinski.yaml").scene.scatter
    assert scatter is not None
    assert (scatter.brightness, scatter.seed) == (0.02, 3)
    assert math.isclose(scatter.aperture_decentre, 1e-4)
