"""Times and errors of ``render`` on 10-megapixel frames: ``python benchmarks/bench_image.py``.

Cold is the first call of a kind in this process (compiled kernels come from numba's cache if it holds them), warm the best of three.
The error is the largest difference from the image at a tenth of the tolerance, over the middle of the sensor.
"""

import argparse
import os
import time
from dataclasses import replace

import numpy as np

from flflab.image.random_numbers import noise_key
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.image.sensor_response import SensorResponse, digitise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars, Edge, FourDot, Target, White

TARGETS: tuple[Target, ...] = (White(), FourDot(), Bars(), Edge())
FOCUS = 506.7016


def laboratory(f_number: float) -> Camera:
    """The worked example at this f-number."""
    array = MicrolensArray(layout="square", count=(25, 25), pitch=(0.4, 0.4), aperture=0.336, focal_lengths=(0.917,), distance=60.0)
    return Camera(MainLens(50.0, f_number), array, Sensor((3664, 2748), 0.00166, 61.15))


def timed(camera: Camera, target: Target, distance: float, tolerance: float) -> tuple[float, float]:
    """Seconds on the wall and of all cores."""
    started, used = time.perf_counter(), time.process_time()
    render(one_plane(camera, target, distance), tolerance=tolerance)
    return time.perf_counter() - started, time.process_time() - used


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--tolerance", type=float, default=0.002)
    tolerance = parser.parse_args().tolerance
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, tolerance {tolerance:g}")
    print("F/    target    distance mm  cold s  warm s  cpu s  lit Mpx  largest error")
    for f_number in (4.0, 1.6, 16.0):
        camera = laboratory(f_number)
        middle = replace(camera, sensor=replace(camera.sensor, resolution=(400, 400)))
        for target in TARGETS:
            for distance in (FOCUS, 500.0, 490.0):
                cold = timed(camera, target, distance, tolerance)
                warm = min(timed(camera, target, distance, tolerance) for _ in range(3))
                lit = np.count_nonzero(render(one_plane(camera, target, distance), tolerance=tolerance)) / 1e6
                fine = render(one_plane(middle, target, distance), tolerance=tolerance / 10)
                error = np.abs(render(one_plane(middle, target, distance), tolerance=tolerance) - fine).max()
                times = f"{cold[0]:7.3f} {warm[0]:7.3f} {warm[1]:6.3f}"
                print(f"{f_number:<5g} {target.kind:9} {distance:11.4f} {times} {lit:8.2f}  {error:.5f}", flush=True)
    image = render(one_plane(laboratory(4.0), White(), FOCUS))
    started = time.perf_counter()
    digitise(image, 8000.0, SensorResponse(), noise_key("bench"))
    print(f"digitise, F/4 white: {time.perf_counter() - started:.3f} s")


if __name__ == "__main__":
    main()
