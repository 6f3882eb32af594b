"""Speed of the model: one configuration and a million, the command from the shell, beside
PlenoptiSign where it is installed.

Run by hand: ``python benchmarks/bench_model.py``. Every figure is the least of several runs;
processor time beside the wall clock, because on a busy machine only the former says something.
"""

import importlib
import importlib.util
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from flflab.optics.configurations import Configurations, solve_configurations

ROOT = Path(__file__).resolve().parent.parent
CAMERA = ROOT / "examples" / "cameras" / "osinski.yaml"


def least(job: Callable[[], object], runs: int = 5) -> tuple[float, float]:
    """Least wall time and least processor time of several runs, s; children included."""
    walls: list[float] = []
    spent: list[float] = []
    for _ in range(runs):
        before, start = os.times(), time.perf_counter()
        job()
        after = os.times()
        walls.append(time.perf_counter() - start)
        spent.append(sum(after[:4]) - sum(before[:4]))
    return min(walls), min(spent)


def line(name: str, wall: float, spent: float) -> None:
    """One line of the table."""
    sys.stdout.write(f"{name:66s} {wall:11.6f} {spent:11.6f}\n")


def plenoptisign() -> Callable[[], object] | None:
    """PlenoptiSign solving the configuration it comes with; None where it is not installed."""
    if importlib.util.find_spec("plenoptisign") is None:
        return None
    module: Any = importlib.import_module("plenoptisign")
    system: Any = module.MainClass()

    def solve() -> object:
        system.refo()
        return system.tria()

    return solve


def main() -> None:
    """Print the table."""
    sys.stdout.write(f"{'':66s} {'wall s':>11s} {'processor s':>11s}\n")
    rng = np.random.Generator(np.random.Philox(key=1))
    million = Configurations(
        50.0, rng.uniform(1.6, 16, 10**6), rng.uniform(54, 62, 10**6), rng.uniform(0.6, 1.4, 10**6),
        0.917, 0.4, 0.336,
        rng.uniform(250, 900, 10**6), cycles_per_mm=2.0,
    )  # fmt: skip
    one = Configurations(50.0, 4.0, 60.0, 1.15, 0.917, 0.4, 0.336, 506.7)
    line("a million configurations, two threads", *least(lambda: solve_configurations(million, 2)))
    line("a million configurations, one thread", *least(lambda: solve_configurations(million, 1)))
    line(
        "one configuration",
        *(
            value / 200
            for value in least(lambda: [solve_configurations(one, 1) for _ in range(200)])
        ),
    )
    sys.stdout.write(
        f"most memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB\n"
    )
    other = plenoptisign()
    if other is None:
        sys.stdout.write("PlenoptiSign is not installed; pip install plenoptisign to see it here\n")
    else:
        line(
            "PlenoptiSign, one configuration (refocusing and triangulation)",
            *(value / 200 for value in least(lambda: [other() for _ in range(200)])),
        )
    run = [sys.executable, "-c"]
    line(
        "bare start: numpy, pydantic, yaml",
        *least(lambda: subprocess.run([*run, "import numpy, pydantic, yaml"], check=True)),
    )
    line(
        "import flflab.optics",
        *least(lambda: subprocess.run([*run, "import flflab.optics"], check=True)),
    )
    command = [sys.executable, "-m", "flflab", "model", str(CAMERA), "--json"]
    line(
        "flflab model --json from the shell",
        *least(lambda: subprocess.run(command, check=True, capture_output=True)),
    )


if __name__ == "__main__":
    main()
