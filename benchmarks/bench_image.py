"""Times and errors of ``render`` on 10-megapixel frames: ``python benchmarks/bench_image.py
[--quick | --waves]``.

The first table holds the three scenes with a goal. Their error is that of the middle of the frame
against a rendering at a fiftieth of the tolerance: root of the mean square, and largest. Cold is
the first call of its kind in this process (compiled kernels come from numba's cache if it holds
them), warm the median and the best of some; processor seconds are those of all cores for the best.
The second table holds other targets at one tolerance, the third (``--waves`` shows it alone) lines
in light that bends, each formed once after one at another tolerance.
"""

import argparse
import os
import statistics
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from flflab.image.effects.diffraction import Diffraction
from flflab.image.render import render
from flflab.image.scene import Scene, one_plane
from flflab.image.sensor.random_numbers import noise_key
from flflab.image.sensor.response import SensorResponse, digitise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars, Chirp, Edge, FourDot, Picture, Target, White

CHART = Chirp((0.125, 3.875), width=160.0, height=120.0)
GOALS = (  # name, f-number, distance mm, seconds, rms
    ("in focus, F/4", 4.0, 1000.0, 0.030, 0.002),
    ("defocused, F/4", 4.0, 900.0, 0.080, 0.001),
    ("every lens overlaps, F/1.6", 1.6, 900.0, 0.300, 0.001),
)
TOLERANCES = (0.01, 0.002, 0.0005)
MIDDLE = (490, 490)
TARGETS: tuple[Target, ...] = (
    White(),
    FourDot(),
    Bars(),
    Edge(),
    Picture(np.random.default_rng(0).random((300, 400)), 160.0),
)
FINER = 50


def bench_camera(f_number: float) -> Camera:
    """The camera of the speed trials: the main image 3.6 mm behind the array, the sensor 0.72 mm
    behind it.
    """
    distance = 1 / (1 / 50.0 - 1 / 1000.0) - 3.6
    array = MicrolensArray(
        layout="square",
        count=(27, 21),
        pitch=(0.4, 0.4),
        aperture=0.4,
        focal_lengths=(0.9,),
        distance=distance,
    )
    return Camera(MainLens(50.0, f_number), array, Sensor((3664, 2748), 0.00166, distance + 0.72))


def timed(scene: Scene, tolerance: float) -> tuple[float, float]:
    """Seconds on the wall and of all cores."""
    started, used = time.perf_counter(), time.process_time()
    render(scene, tolerance=tolerance)
    return time.perf_counter() - started, time.process_time() - used


def errors(scene: Scene, tolerance: float) -> tuple[float, float]:
    """Root of the mean square of the error over the lit pixels in the middle, and the largest."""
    middle = replace(
        scene, camera=replace(scene.camera, sensor=replace(scene.camera.sensor, resolution=MIDDLE))
    )
    fine = render(middle, tolerance=max(tolerance / FINER, 1e-5))
    difference = (render(middle, tolerance=tolerance) - fine)[fine > 0]
    return float(np.sqrt(np.mean(difference**2))), float(np.abs(difference).max())


def row(name: str, scene: Scene, tolerance: float, repeats: int) -> None:
    """One line of a table."""
    cold = timed(scene, tolerance)[0]
    warm = [timed(scene, tolerance) for _ in range(repeats)]
    median, (best, used) = statistics.median(wall for wall, _ in warm), min(warm)
    lit = np.count_nonzero(render(scene, tolerance=tolerance)) / 1e6
    rms, largest = errors(scene, tolerance)
    times = f"{cold:7.3f} {median:7.3f} {best:7.3f} {used:7.3f}"
    print(
        f"{name:34} {tolerance:<7g} {times}  {lit / best:7.1f}  {rms:.6f} {largest:.5f}", flush=True
    )


def peak(scene: Scene) -> int:
    """Most bytes held while a scene is formed, beyond what was held before; the kernels are loaded
    by a small picture first.
    """
    sensor = scene.camera.sensor
    render(
        replace(scene, camera=replace(scene.camera, sensor=replace(sensor, resolution=(64, 64)))),
        tolerance=TOLERANCES[0],
    )
    held = _status("VmRSS")
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak counts from here
    render(scene, tolerance=TOLERANCES[0])
    return _status("VmHWM") - held


def _status(name: str) -> int:
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))


def memory(scene: Scene) -> float:
    """Bytes a pixel beyond the 8 of the picture, at the most, in a fresh process; below 0 where
    dark parts are never touched.
    """
    columns, rows = scene.camera.sensor.resolution
    with ProcessPoolExecutor(1, get_context("spawn")) as fresh:
        return fresh.submit(peak, scene).result() / (columns * rows) - 8


def waves() -> None:
    """Print what lines in light of 550 nm take."""
    for target in (Bars(), Edge()):
        scene = replace(
            one_plane(bench_camera(4.0), target, 900.0), diffraction=Diffraction(550e-6)
        )
        timed(scene, 0.005)
        for tolerance in (0.002, 0.001):
            wall, used = timed(scene, tolerance)
            print(
                f"{target.kind} in waves, F/4, 900 mm, tolerance {tolerance:g}: {wall:.2f} s, of"
                f" the processor {used:.2f} s",
                flush=True,
            )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--waves", action="store_true", help="lines in light that bends only")
    parser.add_argument(
        "--quick", action="store_true", help="the scenes with a goal only, at the loosest tolerance"
    )
    parser.add_argument("--repeats", type=int, default=9)
    asked = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    if asked.waves:
        waves()
        return
    scenes = [
        one_plane(bench_camera(f_number), CHART, distance) for _, f_number, distance, _, _ in GOALS
    ]
    small = replace(
        scenes[1],
        camera=replace(
            scenes[1].camera, sensor=Sensor((64, 64), 0.00166, scenes[1].camera.sensor.distance)
        ),
    )
    started = time.perf_counter()
    render(small)
    print(f"first picture of this process, 64 x 64 pixels: {time.perf_counter() - started:.2f} s")
    beyond = ", ".join(
        f"{name}: {memory(scene):.2f}" for (name, *_), scene in zip(GOALS, scenes, strict=True)
    )
    print(f"bytes a pixel beyond the picture, at the most, each in a fresh process: {beyond}")
    head = "tolerance cold s  median s  best s  cpu s  lit Mpx/s  rms      largest error"
    print(f"{'scene':34} {head}")
    for (name, _, _, seconds, rms), scene in zip(GOALS, scenes, strict=True):
        print(f"{name + ':':34} goal {seconds:g} s at rms {rms:g}")
        for tolerance in TOLERANCES[: 1 if asked.quick else None]:
            row("", scene, tolerance, asked.repeats)
    if asked.quick:
        return
    for target in TARGETS:
        for distance in (1000.0, 900.0):
            row(
                f"{target.kind}, F/4, {distance:g} mm",
                one_plane(bench_camera(4.0), target, distance),
                0.002,
                3,
            )
    waves()
    image = render(scenes[0])
    started = time.perf_counter()
    digitise(image, 8000.0, SensorResponse(), noise_key("bench"))
    print(f"digitise: {time.perf_counter() - started:.3f} s")


if __name__ == "__main__":
    main()
