"""One frame measured without a white picture, in JSON's own types, and noise estimated from a
picture.
"""

import json
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flflab.errors import InputError
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.lattice.white_picture import measure_white
from flflab.measurement.measure import measure
from flflab.measurement.sensor.noise import SensorNoise, estimate_noise
from flflab.targets import Bars, Edge, FourDot, Picture, White

NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
RESOLUTION = (760, 520)
LATTICE = "square", 245.5825, 0.0, (379.5, 259.5), 72.168, 23.777


def test_a_white_frame_gives_the_lattice_alone(brute: Any) -> None:
    camera = brute.camera(4.0, RESOLUTION)
    white = brute.white_picture(RESOLUTION[::-1], *LATTICE)
    said = measure(brute.expose(white, NOISE, 3000, np.random.default_rng(1)), camera, White())
    json.dumps(said, allow_nan=False)
    lattice = said["lattice"]
    assert lattice["layout"] == "square"
    assert lattice["pitch_px"] == pytest.approx(245.5825, rel=1e-5)
    assert lattice["origin_px"] == pytest.approx([379.5, 259.5], abs=0.01)
    assert len(lattice["centres_px"]) == 9
    assert said["dots"] == []
    assert said["mtf"] == []
    assert not any("radius" in remark or "cut" in remark for remark in said["remarks"])


def test_without_a_camera_a_white_frame_gives_the_lattice_and_others_are_refused(
    brute: Any,
) -> None:
    picture = 64 + 3000 * brute.white_picture((200, 220), "square", 24.0, 0.03, (97.3, 96.6), 8, 2)
    assert abs(measure(picture)["lattice"]["pitch_px"] - 24.0) < 1e-3
    with pytest.raises(InputError, match="a four-dot target without a camera"):
        measure(picture, target=FourDot())


def test_darkness_cut_at_zero_draws_no_rim_inwards_and_it_is_said(brute: Any) -> None:
    white = brute.white_picture(RESOLUTION[::-1], *LATTICE)
    cut = replace(NOISE, offset_dn=0.0)
    said = measure(
        brute.expose(white, cut, 3000, np.random.default_rng(1)), brute.camera(4.0, RESOLUTION)
    )
    assert said["lattice"]["outside_radius_px"] == pytest.approx(95.945, abs=0.01)
    assert said["lattice"]["inside_radius_px"] == pytest.approx(48.391, abs=0.02)
    assert any("below 0 DN was clipped" in remark for remark in said["remarks"])


def test_a_radius_or_pitch_that_is_not_the_cameras_is_remarked_on(brute: Any) -> None:
    camera = brute.camera(5.6, RESOLUTION)
    camera = replace(camera, array=replace(camera.array, pitch=(0.41, 0.41)))
    white = brute.white_picture(RESOLUTION[::-1], *LATTICE)
    said = measure(white, camera)
    assert any("outside radius" in remark for remark in said["remarks"])
    assert any(
        "pitch is 245.58 px, the camera's description makes it 251.72 px" in remark
        for remark in said["remarks"]
    )


@pytest.mark.ci
def test_bars_are_measured_on_the_nominal_lattice_and_it_is_said(brute: Any) -> None:
    camera = brute.camera(4.0, RESOLUTION)
    _, bars = brute.bars_picture(camera, 506.7016, (0.5, 10.0), 20.0)
    said = measure(bars, camera, Bars())
    json.dumps(said, allow_nan=False)
    assert any("nominal" in remark for remark in said["remarks"])
    for point in said["mtf"]:
        assert point["contrast"] == pytest.approx(np.sinc(point["cycles_per_px"]), abs=2e-3)


@pytest.mark.ci
def test_dots_and_other_targets(brute: Any) -> None:
    camera = brute.camera(4.0, (1240, 1240))
    target = FourDot(spacing=4.0)
    said = measure(
        brute.dots_picture(camera, 506.7016, target.centres, 1.0), camera, target, 506.7016
    )
    json.dumps(said, allow_nan=False)
    assert [dot["dot"] for dot in said["dots"]] == [0, 1, 2, 3]
    assert len({dot["views"] for dot in said["dots"]}) == 1
    with pytest.raises(InputError, match="picture"):
        measure(np.zeros((1240, 1240)), camera, Picture(np.ones((2, 2)), 10.0))


@pytest.mark.ci
@pytest.mark.parametrize(
    ("gap", "distance"), [(1.17, 506.7016), pytest.param(1.15, 515.0, marks=pytest.mark.full)]
)
def test_dots_before_a_camera_of_another_gap_or_at_another_distance_tell_which(
    brute: Any, gap: float, distance: float
) -> None:
    remarks = " ".join(dots_remarked_on(brute, gap, distance, 0.0))
    number = r"(\d+\.?\d*)"
    found = re.search(
        f"a target about {number} mm away and a gap of about {number} mm .*described: 1.15 mm",
        remarks,
    )
    assert found is not None, remarks
    assert float(found[1]) == pytest.approx(distance, abs=1.0)
    assert float(found[2]) == pytest.approx(gap, abs=0.005)


@pytest.mark.full
def test_turned_dots_are_remarked_on_and_half_a_per_cent_is_not(brute: Any) -> None:
    assert any(
        "turned by 1.15 deg" in remark for remark in dots_remarked_on(brute, 1.15, 506.7016, 0.02)
    )
    assert not any(
        "description" in remark or "turned" in remark
        for remark in dots_remarked_on(brute, 1.155, 506.7016, 0.0)
    )


def dots_remarked_on(brute: Any, gap: float, distance: float, turn: float) -> list[str]:
    """What is said of a picture of dots as another camera takes it, by a description of a gap of
    1.15 mm, at 506.7016 mm.
    """
    camera, target = brute.camera(4.0, (1240, 1240)), FourDot(spacing=4.0)
    real = replace(camera, sensor=replace(camera.sensor, distance=camera.array.distance + gap))
    turned = target.centres @ np.array(
        [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
    )
    picture = brute.dots_picture(real, distance, turned, 1.0)
    white = 4000 * render(one_plane(real, White(), distance), tolerance=1e-3)
    said: list[str] = measure(picture, camera, target, 506.7016, white=white)["remarks"]
    return said


def test_edges_in_all_bright_fields_are_pooled(brute: Any) -> None:
    camera = brute.camera(4.0, (740, 740))
    angle = math.radians(5)
    noisy = brute.expose(brute.edges_picture(740, angle), NOISE, 3000, np.random.default_rng(4))
    said = measure(noisy, camera, Edge(angle), 506.7016, NOISE)
    json.dumps(said, allow_nan=False)
    assert any("9 edges" in remark for remark in said["remarks"])
    for point in said["mtf"]:
        truth = np.sinc(point["cycles_per_px"] * math.cos(angle)) * np.sinc(
            point["cycles_per_px"] * math.sin(angle)
        )
        assert abs(point["contrast"] - truth) < 4 * point["uncertainty"] + 1e-4
    assert said["mtf"][-1]["uncertainty"] < 0.01


def test_noise_is_estimated_from_a_picture(brute: Any) -> None:
    white = brute.white_picture(RESOLUTION[::-1], "square", 120.0, 0.0, (379.5, 259.5), 40.0, 10.0)
    found = estimate_noise(brute.expose(white, NOISE, 3000, np.random.default_rng(4)))
    assert found.dn_per_electron == pytest.approx(0.3, rel=0.15)
    assert found.read_noise_dn == pytest.approx(2.0, abs=0.7)
    assert found.offset_dn == pytest.approx(64.0, abs=1.0)


def test_edges_of_dots_are_not_taken_for_noise(brute: Any) -> None:
    """Few of the squares that see a dot see no edge: with all of them the noise's variance came out
    twice what it is.
    """
    camera, dots = brute.camera(4.0, (800, 800)), FourDot(diameter=1.0, spacing=4.0)
    picture = brute.dots_picture(camera, 506.7016, dots.centres, dots.diameter)
    for gain in (0.3, 3.0):
        noise = SensorNoise(
            dn_per_electron=gain, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0
        )
        found = [
            estimate_noise(brute.expose(picture, noise, 3000, np.random.default_rng(seed)))
            for seed in range(8)
        ]
        assert np.mean([one.dn_per_electron for one in found]) == pytest.approx(gain, rel=0.12)


def test_where_dots_are_blurred_all_over_their_noise_is_rather_taken_for_too_large(
    brute: Any,
) -> None:
    camera, dots = brute.camera(4.0, (800, 800)), FourDot(diameter=1.0, spacing=4.0)
    picture = brute.dots_picture(camera, 590.0, dots.centres, dots.diameter)
    for seed in range(8):
        assert (
            estimate_noise(
                brute.expose(picture, NOISE, 3000, np.random.default_rng(seed))
            ).dn_per_electron
            > 0.8 * 0.3
        )


def test_darkness_cut_at_zero_and_coarse_steps_are_not_taken_for_a_picture_without_noise(
    brute: Any,
) -> None:
    white = brute.white_picture(RESOLUTION[::-1], "square", 120.0, 0.0, (379.5, 259.5), 40.0, 10.0)
    cut = SensorNoise(dn_per_electron=0.4, read_noise_dn=0.8, offset_dn=0.0, full_scale_dn=4095.0)
    coarse = 6 * brute.expose(white, cut, 3000, np.random.default_rng(4))
    found = estimate_noise(coarse)
    assert 3.0 < found.read_noise_dn < 7.0  # 4.8, half of it cut off
    assert found.dn_per_electron == pytest.approx(2.4, rel=0.15)
    seen = measure_white(np.asarray(coarse, dtype=np.float32), found)
    assert seen.rough.pitch == pytest.approx(120.0, rel=1e-3)
    assert seen.misfit < 0.01


def test_variance_is_shot_read_and_rounding() -> None:
    assert NOISE.variance(64.0) == pytest.approx(4 + 1 / 12)
    assert NOISE.variance(1064.0) == pytest.approx(4 + 1 / 12 + 300)
    with pytest.raises(InputError):
        SensorNoise(0.0, 1.0, 0.0, 100.0)


@pytest.mark.parametrize("off_px", [0.0, 2.0])
def test_dots_without_a_white_picture_are_as_sure_as_the_camera_is_described(
    brute: Any, off_px: float
) -> None:
    camera, target, aside = brute.camera(4.0, (1000, 1000)), FourDot(0.8, 3.0), (0.1, 0.2)
    image = np.maximum(render(one_plane(camera, target, 507.0, aside), tolerance=1e-3), 0.0)
    picture = brute.expose(image, NOISE, 3000, np.random.default_rng(1))
    moved = off_px * camera.sensor.pixel
    pitch = 0.4 * (1 + 4e-4 * off_px)
    array = replace(camera.array, offset=(moved, -moved), pitch=(pitch, pitch))
    said = measure(picture, replace(camera, array=array), target, 507.0, NOISE)
    assert "no-white" in said["remark_codes"]
    for dot in said["dots"]:
        off = np.array(dot["position_mm"]) - [*(target.centres[dot["dot"]] + aside), -507.0]
        assert np.all(np.abs(off) < 2 * np.array(dot["uncertainty_mm"]))
        assert dot["uncertainty_mm"][2] < 3.0
        assert abs(off[2]) < 0.2 or off_px > 0
