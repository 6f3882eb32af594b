"""Time for equal error: ``render`` against Mitsuba 3's best sampler, multijitter, in one run.

    python benchmarks/bench_mitsuba.py

Needs mitsuba 3 and LLVM 16 or newer ($DRJIT_LIBLLVM_PATH). Mitsuba's error is measured on a crop, at as many samples as a minute
allows, against ``render`` at its least tolerance; its slope in the last two steps extrapolates to the error asked for, and its time a
sample to 10 megapixels. ``render`` forms the whole 10 megapixels, at the loosest tolerance whose error on the crop is not above it.
"""

import importlib
import math
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from flflab.image.render import LEAST_TOLERANCE, render
from flflab.image.scene import one_plane
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars

FOCUS_DEPTH = 1 / (1 / 50 - 1 / 1000)  # mm behind the main lens; the array lies 3.6 mm further
CYCLES, WIDTH = 1.0, 400.0  # of the bars, cycles/mm and mm
TOLERANCES = tuple(0.064 * 2 ** (-step / 2) for step in range(13))
SAMPLES = (64, 256, 1024, 4096)


def plenoptic() -> Any:
    """The sensor plugin, which the tests use as well."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "image"))
    return importlib.import_module("plenoptic_sensor")


def camera(columns: int, rows: int) -> Camera:
    """The bench model: chart sharp at 1000 mm, F/4, microlenses of f 0.9 mm that touch."""
    distance = FOCUS_DEPTH + 3.6
    array = MicrolensArray("square", (25, 25), (0.4, 0.4), 0.4, (0.9,), distance)
    return Camera(MainLens(50.0, 4.0), array, Sensor((columns, rows), 0.00166, distance + 0.72))


def ours(distance: float, allowed: float) -> tuple[float, float, float]:
    """Tolerance, error on the crop and seconds for 10 megapixels, warm, best of three."""
    bars = Bars((CYCLES, CYCLES), WIDTH, WIDTH)
    crop = one_plane(camera(116, 86), bars, distance)
    finest = render(crop, tolerance=LEAST_TOLERANCE)
    errors = [float(np.sqrt(np.mean((render(crop, tolerance=tolerance) - finest) ** 2))) for tolerance in TOLERANCES]
    tolerance, error = next((tolerance, error) for tolerance, error in zip(TOLERANCES, errors, strict=True) if error <= allowed)
    whole = replace(crop, camera=camera(3664, 2748))
    times: list[float] = []
    for _ in range(4):
        started = time.perf_counter()
        render(whole, tolerance=tolerance)
        times.append(time.perf_counter() - started)
    return tolerance, error, min(times[1:])


def theirs(distance: float, allowed: float) -> tuple[float, float, float]:
    """Samples a pixel for the error allowed, slope of the convergence, seconds for 10 megapixels."""
    plugin = plenoptic()
    mi = plugin.mitsuba()
    small = camera(116, 86)
    plugin.register(mi, small)
    stripes = np.tile(np.arange(2 * CYCLES * WIDTH) % 2 == 0, (800, 1)).astype(np.float64)
    finest = render(one_plane(small, Bars((CYCLES, CYCLES), WIDTH, WIDTH), distance), tolerance=LEAST_TOLERANCE)
    errors: list[float] = []
    seconds = 0.0
    for samples in SAMPLES:
        scene = plugin.picture_scene(mi, small, stripes, WIDTH, distance, "multijitter", samples)
        plugin.pictured(mi, scene, samples, 0)  # compiles
        started = time.perf_counter()
        pictures = [plugin.pictured(mi, scene, samples, seed) for seed in (1, 2)]
        seconds = (time.perf_counter() - started) / 2 / samples / finest.size
        errors.append(float(np.sqrt(np.mean([(picture - finest) ** 2 for picture in pictures]))))
        print(f"  multijitter {samples:5} samples: rms {errors[-1]:.5f}, {1e-6 / seconds:.1f} Msamples/s", flush=True)
    slope = math.log(errors[-2] / errors[-1]) / math.log(SAMPLES[-1] / SAMPLES[-2])
    needed = SAMPLES[-1] * (errors[-1] / allowed) ** (1 / slope)
    return needed, slope, needed * seconds * 3664 * 2748


def main() -> None:
    """Print the two comparisons."""
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    for name, distance, allowed in (("in focus", 1000.0, 2e-3), ("defocused", 900.0, 1e-3)):
        tolerance, error, seconds = ours(distance, allowed)
        print(f"{name}: rms {allowed:g} allowed; render at tolerance {tolerance:g}: rms {error:.5f}, {seconds:.3f} s", flush=True)
        samples, slope, mitsuba_seconds = theirs(distance, allowed)
        print(f"  extrapolated with slope -{slope:.2f}: {samples:.0f} samples, {mitsuba_seconds:.0f} s")
        print(f"  {mitsuba_seconds / seconds:,.0f} times the time of render", flush=True)


if __name__ == "__main__":
    main()
