"""Processor time of ``digitise`` on 10-megapixel frames beside numpy's generators: ``python
benchmarks/bench_noise.py``.

Processor seconds of all threads, best of five: on two idle cores a frame takes half of them on the
wall. ``numpy`` is a Poisson and a single-precision normal number a pixel, in one thread and without
offset, rounding and limits.
"""

import os
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from flflab.image.effects.dark_current import DarkCurrent
from flflab.image.effects.dead_pixels import DeadPixels
from flflab.image.effects.fixed_pattern import FixedPattern
from flflab.image.sensor.random_numbers import noise_key
from flflab.image.sensor.response import SensorResponse, digitise

SHAPE = (2748, 3664)
ELECTRONS = 8000.0


def used(work: Callable[[], object]) -> float:
    """Least processor time of five calls, s; the first call before them may compile."""
    work()
    best = float("inf")
    for _ in range(5):
        started = time.process_time()
        work()
        best = min(best, time.process_time() - started)
    return best


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(0)
    images = {
        "white": np.ones(SHAPE),
        "from dark to white": rng.random(SHAPE),
        "2 electrons": np.full(SHAPE, 2 / ELECTRONS),
        "dark": np.zeros(SHAPE),
    }
    plain, key = SensorResponse(), noise_key("bench")
    faulty = replace(
        plain,
        dark_current=DarkCurrent(10.0, 0.1),
        fixed_pattern=FixedPattern(0.01, 2.0),
        dead_pixels=DeadPixels(1e-4),
    )
    responses = {
        "shot and read noise": plain,
        "no noise": replace(plain, shot_noise=None, read_noise=None),
        "every effect": faulty,
    }
    print(
        f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, {SHAPE[1]} x {SHAPE[0]} pixels,"
        f" white makes {ELECTRONS:g} electrons"
    )
    for name, image in images.items():
        for kind, response in responses.items():
            seconds = used(
                lambda image=image, response=response: digitise(image, ELECTRONS, response, key)
            )
            print(
                f"{name:20} {kind:20} {seconds:6.3f} s  {1e9 * seconds / image.size:5.1f} ns/px",
                flush=True,
            )
        means = ELECTRONS * image
        seconds = used(
            lambda means=means: (rng.poisson(means), rng.standard_normal(SHAPE, dtype=np.float32))
        )
        print(
            f"{name:20} {'numpy':20} {seconds:6.3f} s  {1e9 * seconds / image.size:5.1f} ns/px",
            flush=True,
        )


if __name__ == "__main__":
    main()
