"""What choosing effects saves, over random scenes: ``python benchmarks/bench_choice.py [--scenes N] [--seconds S]``.

For each scene the processor time of a picture by ``auto``, its choice and its error estimate included, against that of the same
scene with every effect on at the same tolerance. Compiling is done before, on scenes of other seeds.
"""

import argparse
import math
import time

import numpy as np

from flflab.image.picture import take_picture
from flflab.image.random_scene import random_scene
from flflab.image.render import render

WARM = 5


def measure(seed: int) -> tuple[float, float, float, float]:
    """Tolerance, estimate, seconds by ``auto``, seconds with every effect."""
    rng = np.random.default_rng(seed)
    scene = random_scene(rng)
    tolerance = math.exp(rng.uniform(math.log(1e-3), math.log(1e-1)))
    marks = [time.process_time()]
    report = take_picture(scene, tolerance=tolerance)
    marks.append(time.process_time())
    render(scene, tolerance=tolerance)
    marks.append(time.process_time())
    return tolerance, report.error_estimate, marks[1] - marks[0], marks[2] - marks[1]


def main() -> None:
    """Print a line for each scene, and the medians."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=math.inf, help="stop after this long")
    asked = parser.parse_args()
    for seed in range(WARM):
        measure(10_000 + seed)
    end = time.monotonic() + asked.seconds
    ratios: list[float] = []
    for seed in range(asked.scenes):
        if time.monotonic() > end:
            break
        tolerance, estimate, chosen, every = measure(seed)
        ratios.append(every / chosen)
        told = f"{seed:4d}  tolerance {tolerance:.1e}  estimate {estimate:.1e}  auto {chosen:7.3f} s"
        print(f"{told}  every effect {every:7.3f} s  {every / chosen:6.1f}", flush=True)
    low, median, high = np.percentile(ratios, [10, 50, 90])
    print(f"{len(ratios)} scenes: every effect takes {median:.1f} times as long in the median ({low:.1f} to {high:.1f} in 80 % of them)")


if __name__ == "__main__":
    main()
