"""What the simulated camera draws follows from the bench file: its noise says how finely, its
workmanship and effects say what.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from flflab.bench import Bench, read_bench
from flflab.errors import InputError
from flflab.simulated_light import (
    chosen,
    drawing_tolerance,
    drawings,
    is_simulated,
    light_scenes,
    require_affordable,
)
from flflab.study import read_study
from flflab.targets import Bars, White

BenchWith = Callable[[str, str], Bench]


@pytest.fixture
def bench_with(tmp_path: Path, root: Path) -> BenchWith:
    """The built-in simulated bench with further lines, of its own and within ``simulated``."""

    def made(simulated: str, besides: str) -> Bench:
        text = (root / "examples/benches/simulated.yaml").read_text(encoding="utf-8")
        text = text.replace("../cameras", str(root / "examples/cameras"))
        text = text.replace("\nsimulated:\n", f"\n{besides}\nsimulated:\n{simulated}\n")
        file = tmp_path / "bench.yaml"
        file.write_text(text, encoding="utf-8")
        return read_bench(file)

    return made


def test_a_noisier_sensor_is_drawn_more_coarsely(bench_with: BenchWith) -> None:
    plain = bench_with("", "")
    noise = math.sqrt(12000 + 9) / 12000
    assert drawing_tolerance(plain, Bars()) == pytest.approx(0.1 * noise / 2)
    light = plain.description.simulated.model_copy(update={"full_well_electrons": 1200.0})
    noisy = replace(plain, description=plain.description.model_copy(update={"simulated": light}))
    assert drawing_tolerance(noisy, Bars()) > 3 * drawing_tolerance(plain, Bars())


def test_white_frames_are_drawn_finest_because_edges_are_long(bench_with: BenchWith) -> None:
    bench = bench_with("", "")
    assert drawing_tolerance(bench, White()) < drawing_tolerance(bench, Bars()) / 10


def test_a_measurement_floor_lets_drawings_be_coarser(bench_with: BenchWith) -> None:
    floor = bench_with("", "measurement_floor: {contrast: 0.02, position: 0.02 px, radius: 1 px}")
    assert drawing_tolerance(floor, Bars()) == pytest.approx(0.002, rel=0.05)
    assert drawing_tolerance(floor, White()) == pytest.approx(0.1 / 120.5, rel=0.05)


def test_the_effects_that_a_bench_states_are_in_its_scenes(bench_with: BenchWith) -> None:
    bench = bench_with(
        "  effects: {falloff: true, distortion: 0.02, stray_light: 1 %}",
        "workmanship: {microlens_position: 0.3 um, aperture_decentre: 0.1 um,"
        " microlens_focal_length: 1 %, microlens_brightness: 2 %}",
    )
    scene, weight = next(light_scenes(bench, bench.optics, Bars(), 507.0))
    assert weight == 1.0
    assert scene.scatter is not None
    assert (scene.scatter.focal_length, scene.scatter.brightness) == (0.01, 0.02)
    assert scene.scatter.seed == bench.description.simulated.seed
    on = chosen(bench, scene).effects
    assert {"scatter", "stray-light", "falloff", "distortion"} <= on


def test_an_effect_too_small_to_matter_is_left_out_and_said_to_be(bench_with: BenchWith) -> None:
    bench = bench_with("", "workmanship: {microlens_position: 0.001 um}")
    scene, _ = next(light_scenes(bench, bench.optics, Bars(), 507.0))
    decision = next(one for one in chosen(bench, scene).decisions if one.name == "distortion")
    assert not decision.on
    assert decision.why == "the scene has none"


def test_effects_that_there_are_not_are_refused_with_the_line(bench_with: BenchWith) -> None:
    bench = bench_with("  effects: {choose: halos}", "")
    scene, _ = next(light_scenes(bench, bench.optics, Bars(), 507.0))
    with pytest.raises(InputError, match=r"bench.yaml:\d+: .*there is no 'halos'"):
        chosen(bench, scene)


def test_a_frame_too_dear_is_refused_before_it_is_drawn(bench_with: BenchWith) -> None:
    bench = bench_with("", "")
    sensor = replace(bench.optics.sensor, resolution=(150000, 150000), distance=65.0)
    camera = replace(bench.optics, sensor=sensor)
    scene, _ = next(light_scenes(bench, camera, Bars(), 507.0))
    with pytest.raises(InputError, match=r"would take about \d+ s, and frames of up to 20 s"):
        require_affordable([(scene, chosen(bench, scene))])


def test_what_is_decided_is_said_of_every_target_and_configuration(
    bench_with: BenchWith, root: Path
) -> None:
    bench = bench_with("  effects: {halo: 0.05}", "light: {wavelength: 550 nm}")
    study = read_study(root / "examples/studies/first.yaml", bench.optics)
    drawn = drawings(bench, study)
    for kind in ("white", "four-dot", "bars"):
        told = sorted(i for one in drawn if one.target == kind for i in one.configurations)
        assert told == [one.index for one in study.configurations]
    assert {one.target: one.path for one in drawn} == {
        "white": "closed forms", "four-dot": "waves", "bars": "waves",
    }  # fmt: skip
    for one in drawn:
        halo = next(effect for effect in one.effects if effect.name == "halo")
        assert (halo.on, halo.size, "gamma" in one.absent) == (True, 0.05, True)


def test_a_camera_in_the_laboratory_draws_nothing() -> None:
    assert [is_simulated(at) for at in ("simulated", "127.0.0.1:5", "192.168.1.5:9000")] == [
        True, True, False,
    ]  # fmt: skip
