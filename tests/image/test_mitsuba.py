"""The picture against Mitsuba 3 with a sensor of our own, which shares nothing with ``render``."""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Picture, White

DEPTH = (
    1 / (1 / 50 - 1 / 1000) - 3.6
)  # the array 3.6 mm before the image of 1000 mm, which it throws on the sensor
BATCHES, SAMPLES = 40, 1024
pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def plugin() -> Any:
    if importlib.util.find_spec("mitsuba") is None:
        pytest.fail(
            "mitsuba is not installed: pip install mitsuba, and name LLVM 16 or newer in"
            " DRJIT_LIBLLVM_PATH"
        )
    spec = importlib.util.spec_from_file_location(
        "plenoptic_sensor", Path(__file__).with_name("plenoptic_sensor.py")
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.timeout(1800)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["white", "squares"])
@pytest.mark.parametrize(("f_number", "distance"), [(4.0, 1000.0), (4.0, 900.0), (1.6, 900.0)])
def test_chi_squared_of_a_pixel_is_one(
    plugin: Any, kind: str, f_number: float, distance: float
) -> None:
    array = MicrolensArray("square", (25, 25), (0.4, 0.4), 0.4, (0.9,), DEPTH)
    camera = Camera(
        MainLens(50.0, f_number), array, Sensor((232, 172), 0.00166, DEPTH + 0.72, (0.03, 0.02))
    )
    values, width = (
        (np.ones((2, 2)), 4000.0)
        if kind == "white"
        else (np.random.default_rng(0).random((60, 80)), 80.0)
    )
    picture = render(
        one_plane(camera, White() if kind == "white" else Picture(values, width), distance),
        tolerance=1e-4,
    )
    mi = plugin.mitsuba()
    plugin.register(mi, camera)
    scene = plugin.picture_scene(mi, camera, values, width, distance, "independent", SAMPLES)
    batches = np.array([plugin.pictured(mi, scene, SAMPLES, seed) for seed in range(BATCHES)])
    scatter = batches.std(axis=0, ddof=1)
    bright = (picture > 0.05) & (
        scatter > 1e-4
    )  # enough hits a batch for its scatter to be known; some pixels have none
    assert np.abs(batches.mean(axis=0) - picture)[scatter <= 1e-4].max(initial=0.0) < 1e-3
    error = scatter[bright] / BATCHES**0.5
    ratio = (batches.mean(axis=0)[bright] - picture[bright]) / error
    chi_squared = (
        float(np.mean(ratio**2)) * (BATCHES - 3) / (BATCHES - 1)
    )  # Student's t is wider than the normal
    print(
        f"{kind}, F/{f_number:g}, {distance:g} mm: chi squared {chi_squared:.4f} of {bright.sum()}"
        f" pixels, rms error {error.mean():.4f}"
    )
    assert abs(chi_squared - 1) < 0.02 + 3 * (2 / bright.sum()) ** 0.5
