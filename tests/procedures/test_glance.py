"""What is said of frames while a run goes on: the numbers of the camera that took them, and one
frame at a time.
"""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.base import CameraDevice, Frame
from flflab.bench import Bench, read_bench
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.study import Study, read_study
from flflab.targets import FourDot, Target, White
from procedures.devices import NO_CONFIGURATION, Picture, Shot
from procedures.glance import Glance

EXAMPLES = Path(__file__).parents[2] / "examples"
CAMERA = cast(
    CameraDevice,
    SimpleNamespace(dn_per_electron=0.3, read_noise_dn=1.0, offset_dn=64.0, full_scale=4095),
)


@pytest.fixture(scope="module")
def bench() -> Bench:
    found = read_bench(EXAMPLES / "benches" / "simulated.yaml")
    optics = replace(
        found.optics,
        sensor=replace(found.optics.sensor, resolution=(760, 560)),
        array=replace(found.optics.array, count=(7, 7)),
    )
    return replace(found, optics=optics)


@pytest.fixture(scope="module")
def study(bench: Bench) -> Study:
    return replace(
        read_study(EXAMPLES / "studies" / "first.yaml", bench.optics), dots=FourDot(1.0, 4.0)
    )


def taken(bench: Bench, study: Study, target: Target, key: str, index: int = 1) -> Picture:
    configuration = study.configurations[index]
    light = render(one_plane(configuration.camera(bench.optics), target, configuration.distance))
    electrons = np.random.default_rng(1).poisson(8000 * np.maximum(light, 0))
    frame = SimpleNamespace(
        picture=np.clip(np.rint(0.3 * electrons + 64), 0, 4095).astype(np.uint16)
    )
    return Picture(Shot(key, index, 0, 0.01), cast(Frame, frame), "", 0)


def said(glance: Glance, picture: Any) -> str:
    glance.look_at(picture)
    glance.wait()
    return glance.said


def test_a_white_frame_shows_pitch_and_bright_field_as_thin_lenses_have_them(
    bench: Bench, study: Study
) -> None:
    configuration = study.configurations[1]
    array, pixel = bench.optics.array, bench.optics.sensor.pixel
    b, L, f = (
        configuration.sensor - configuration.array,
        configuration.array,
        array.focal_lengths[0],
    )
    # A ray back from s through m of the microlens meets the main lens at m (1 + L/b - L/f) - s L/b:
    # full light where all m do within it.
    bright = 2 * (50 / 4 / 2 - abs(1 + L / b - L / f) * array.aperture / 2) * b / L / pixel
    words = said(Glance(study, bench, CAMERA), taken(bench, study, White(), "c1/white/0"))
    found = re.fullmatch(
        r"c1/white/0 shows micro-images ([\d.]+) px apart, bright fields ([\d.]+) px wide", words
    )
    assert found
    assert float(found[1]) == pytest.approx(0.4 * (1 + b / L) / pixel, abs=0.02)
    assert float(found[2]) == pytest.approx(bright, abs=0.2)


def test_frames_of_dots_show_views_and_what_shows_nothing_says_why(
    bench: Bench, study: Study
) -> None:
    glance = Glance(study, bench, CAMERA, every_s=0.0, share=1.0)
    assert (
        said(glance, taken(bench, study, study.dots, "c1/four-dot/0"))
        == "c1/four-dot/0 shows 4 4 4 4 views"
    )
    dark = taken(bench, study, study.dots, "c1/four-dot/1")
    dark = replace(
        dark, frame=cast(Frame, SimpleNamespace(picture=np.full((560, 760), 64, np.uint16)))
    )
    assert "c1/four-dot/1 shows" in said(glance, dark)
    assert "views" not in glance.said


def test_frames_too_soon_after_another_and_frames_of_no_configuration_are_passed_over(
    bench: Bench, study: Study
) -> None:
    glance = Glance(study, bench, CAMERA)
    white = taken(bench, study, White(), "c1/white/0")
    assert (
        said(
            glance,
            replace(
                white, shot=replace(white.shot, key="dark/0.01s/0", configuration=NO_CONFIGURATION)
            ),
        )
        == ""
    )
    assert said(glance, None) == ""
    first = said(glance, white)
    assert said(glance, replace(white, shot=replace(white.shot, key="c1/white/1"))) == first


def test_of_a_long_run_a_small_part_of_the_time_goes_to_measuring(
    bench: Bench, study: Study
) -> None:
    glance = Glance(study, bench, CAMERA, every_s=0.0, share=1e-4)
    white = taken(bench, study, White(), "c1/white/0")
    first = said(glance, white)
    assert said(glance, replace(white, shot=replace(white.shot, key="c1/white/1"))) == first
