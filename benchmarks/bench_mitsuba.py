"""Processor time for equal error: ``render`` against Mitsuba 3's best sampler, multijitter, in one
run.

    python benchmarks/bench_mitsuba.py

Needs mitsuba 3 and LLVM 16 or newer ($DRJIT_LIBLLVM_PATH). Mitsuba's error is measured on a crop
against ``render`` at its least tolerance, at more and more samples until it is no larger than the
error asked for: nothing is extrapolated but the time, from the crop to 10 megapixels. Between the
last two numbers of samples the error counts as a power of them. ``render`` forms the whole 10
megapixels, at the loosest tolerance whose error on the crop is not above the one asked for. Times
are processor seconds of all threads, the least of some: what else runs on the machine matters
little.
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
import numpy.typing as npt

from flflab.image.accuracy import LEAST_TOLERANCE
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars

Array = npt.NDArray[np.float64]

FOCUS_DEPTH = 1 / (1 / 50 - 1 / 1000)  # mm behind the main lens; the array lies 3.6 mm nearer to it
CYCLES, WIDTH = 1.0, 400.0  # of the bars, cycles/mm and mm
CROP = (116, 86)  # pixels
TOLERANCES = tuple(0.3 * 2 ** (-step / 4) for step in range(40))
SAMPLES = (256, 1024, 4096, 16384, 65536)
MOST_RAYS = 2**25  # in one go; a crop is rendered in rows of tiles


def plenoptic() -> Any:
    """The sensor plugin, which the tests use as well."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "image"))
    return importlib.import_module("plenoptic_sensor")


def camera(columns: int, rows: int) -> Camera:
    """The bench model: chart sharp at 1000 mm, F/4, microlenses of f 0.9 mm that touch."""
    distance = FOCUS_DEPTH - 3.6
    array = MicrolensArray("square", (25, 25), (0.4, 0.4), 0.4, (0.9,), distance)
    return Camera(MainLens(50.0, 4.0), array, Sensor((columns, rows), 0.00166, distance + 0.72))


def ours(distance: float, allowed: float) -> tuple[float, float, float]:
    """Tolerance, error on the crop and processor seconds for 10 megapixels, warm, best of nine."""
    bars = Bars((CYCLES, CYCLES), WIDTH, WIDTH)
    crop = one_plane(camera(*CROP), bars, distance)
    finest = render(crop, tolerance=LEAST_TOLERANCE)
    errors = [
        float(np.sqrt(np.mean((render(crop, tolerance=tolerance) - finest) ** 2)))
        for tolerance in TOLERANCES
    ]
    tolerance, error = next(
        (tolerance, error)
        for tolerance, error in zip(TOLERANCES, errors, strict=True)
        if error <= allowed
    )
    whole = replace(crop, camera=camera(3664, 2748))
    times: list[float] = []
    for _ in range(10):
        started = time.process_time()
        render(whole, tolerance=tolerance)
        times.append(time.process_time() - started)
    return tolerance, error, min(times[1:])


def crop_of(plugin: Any, mi: Any, distance: float, samples: int, seed: int) -> tuple[Array, float]:
    """Mitsuba's picture of the crop, and processor seconds; rows of pixels that it takes in one go
    are rendered one after the other.
    """
    columns, rows = CROP
    tall = max(1, min(rows, MOST_RAYS // (samples * columns)))
    stripes = np.tile(np.arange(2 * CYCLES * WIDTH) % 2 == 0, (800, 1)).astype(np.float64)
    parts: list[Array] = []
    seconds = 0.0
    for first in range(0, rows, tall):
        height = min(tall, rows - first)
        part = camera(columns, height)
        middle = (first + (height - rows) / 2) * part.sensor.pixel
        part = replace(part, sensor=replace(part.sensor, offset=(0.0, middle)))
        plugin.register(mi, part)
        scene = plugin.picture_scene(mi, part, stripes, WIDTH, distance, "multijitter", samples)
        if first == 0:
            plugin.pictured(mi, scene, samples, 0)  # compiles
        started = time.process_time()
        parts.append(plugin.pictured(mi, scene, samples, seed + first))
        seconds += time.process_time() - started
    return np.concatenate(parts), seconds


def theirs(distance: float, allowed: float) -> tuple[float, float]:
    """Samples a pixel for the error allowed, processor seconds for 10 megapixels."""
    plugin = plenoptic()
    mi = plugin.mitsuba()
    finest = render(
        one_plane(camera(*CROP), Bars((CYCLES, CYCLES), WIDTH, WIDTH), distance),
        tolerance=LEAST_TOLERANCE,
    )
    errors: list[float] = []
    for samples in SAMPLES:
        pictures = [crop_of(plugin, mi, distance, samples, seed) for seed in (1000, 2000)]
        errors.append(float(np.sqrt(np.mean([(picture - finest) ** 2 for picture, _ in pictures]))))
        seconds = min(used for _, used in pictures) / samples / finest.size
        print(
            f"  multijitter {samples:5} samples: rms {errors[-1]:.5f}, {1e-6 / seconds:.1f}"
            " Msamples a processor second",
            flush=True,
        )
        if errors[-1] <= allowed:
            slope = math.log(errors[-2] / errors[-1]) / math.log(4)
            needed = samples * (errors[-1] / allowed) ** (1 / slope)
            return needed, needed * seconds * 3664 * 2748
    raise RuntimeError(
        f"{SAMPLES[-1]} samples leave an rms of {errors[-1]:g}; {allowed:g} was asked for"
    )


def main() -> None:
    """Print the two comparisons."""
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    for name, distance, allowed in (("in focus", 1000.0, 2e-3), ("defocused", 900.0, 1e-3)):
        tolerance, error, seconds = ours(distance, allowed)
        print(
            f"{name}: rms {allowed:g} allowed; render at tolerance {tolerance:g}: rms {error:.5f},"
            f" {seconds:.3f} s",
            flush=True,
        )
        samples, mitsuba_seconds = theirs(distance, allowed)
        print(f"  {samples:.0f} samples, {mitsuba_seconds:.0f} s")
        print(f"  {mitsuba_seconds / seconds:,.0f} times the processor time of render", flush=True)


if __name__ == "__main__":
    main()
