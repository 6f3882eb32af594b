"""Bars and dots in light as real cameras have it, one imperfection at a time and all together: what
is measured is within what is stated, or remarked.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.built_in import Kind, built_in
from flflab.files.camera import read_camera
from flflab.image.effects.columns import Columns
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.halo import Halo
from flflab.image.effects.scatter import Scatter
from flflab.image.effects.second_stop import SecondStop
from flflab.image.effects.shading import Shading
from flflab.image.effects.soft_rims import SoftRims
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.measure import measure
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.targets import Bars, FourDot, Target, White

NOISE = SensorNoise(
    dn_per_electron=0.34125, read_noise_dn=1.02375, offset_dn=64.0, full_scale_dn=4095.0
)
FOCUS = 506.7016
PIXEL = 0.00166
KEPT: dict[str, dict[str, Any]] = {  # bars keep their contrast in these
    "shading": {"shading": Shading(0.3)},
    "soft rims": {"soft_rims": SoftRims(2 * PIXEL)},
    "second stop": {"second_stop": SecondStop(30.0, 10.5)},
    "columns and taps": {"columns": Columns(0.003, 0.005)},
    "fall-off": {"falloff": Falloff()},
    "brightness": {"scatter": Scatter(0.0, 1e-4, 1, 0.018)},
}
HALO = {"halo": Halo(0.02, 40 * PIXEL)}
TOGETHER = {name: one for effects in (*KEPT.values(), HALO) for name, one in effects.items()}


def exposed(
    camera: Camera, target: Target, effects: dict[str, Any], rng: np.random.Generator
) -> npt.NDArray[np.uint16]:
    scene = replace(one_plane(camera, target, FOCUS, (0.1, 0.2)), **effects)
    electrons = rng.poisson(np.maximum(render(scene, tolerance=5e-4), 0) * 7000.0)
    dn = electrons * NOISE.dn_per_electron + NOISE.offset_dn
    dn = dn + rng.normal(0, NOISE.read_noise_dn, dn.shape)
    return np.clip(np.rint(dn), 0, NOISE.full_scale_dn).astype(np.uint16)


def measured(target: Target, effects: dict[str, Any], seed: int) -> dict[str, Any]:
    camera = read_camera(built_in(Kind.CAMERA))
    camera = replace(camera, sensor=replace(camera.sensor, resolution=(1400, 1100)))
    rng = np.random.default_rng(seed)
    white, picture = (exposed(camera, one, effects, rng) for one in (White(), target))
    return measure(picture, camera, target, FOCUS, NOISE, white)


@pytest.mark.full
@pytest.mark.parametrize("name", list(KEPT))
def test_bars_keep_their_contrast_in_uneven_light(name: str) -> None:
    for point in measured(Bars(), KEPT[name], 1)["mtf"]:
        off = abs(point["contrast"] - np.sinc(point["cycles_per_px"]))
        assert off < max(3 * point["uncertainty"], 0.005)


@pytest.mark.full
@pytest.mark.parametrize("effects", [*KEPT.values(), HALO], ids=[*KEPT, "halo"])
def test_depth_in_real_light_is_as_sure_as_stated(effects: dict[str, Any]) -> None:
    found = measured(FourDot(0.8, 3.0), effects, 2)
    for dot in found["dots"]:
        assert abs(dot["position_mm"][2] + FOCUS) < 3 * dot["uncertainty_mm"][2]


@pytest.mark.ci
def test_all_of_it_together_is_stated_and_remarked() -> None:
    found = measured(FourDot(0.8, 3.0), TOGETHER, 3)
    assert {"fixed-pattern", "misfit"} <= set(found["remark_codes"])
    for dot in found["dots"]:
        off = abs(dot["position_mm"][2] + FOCUS)
        assert off < min(3 * dot["uncertainty_mm"][2], 1.0)
