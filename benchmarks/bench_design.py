"""What a design search costs: seconds and memory from 10^4 to 10^8 configurations, and the front's
size.

Run by hand: ``python benchmarks/bench_design.py [LARGEST]``. Page and refinement are left out;
processor time stands beside the wall clock.
"""

import os
import resource
import sys
import time
from pathlib import Path

from flflab.design.requirements import read_requirements
from flflab.design.search import search

ROOT = Path(__file__).resolve().parent.parent


def main() -> None:
    """Print the table."""
    largest = int(float(sys.argv[1])) if len(sys.argv) > 1 else 10**8
    wanted = read_requirements(ROOT / "examples" / "requirements" / "osinski.yaml")
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print("configurations    wall s  processor s  us each  meet all  front  most memory MiB")
    search(
        wanted.model_copy(
            update={"search": wanted.search.model_copy(update={"configurations": 10_000})}
        )
    )  # compiles
    count = 10_000
    while count <= largest:
        asked = wanted.model_copy(
            update={"search": wanted.search.model_copy(update={"configurations": count})}
        )
        start, before = time.perf_counter(), os.times()
        found = search(asked)
        wall, after = time.perf_counter() - start, os.times()
        spent = sum(after[:2]) - sum(before[:2])
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        figures = f"{found.met:9,} {len(found.front.numbers):6,} {memory:16.0f}"
        print(
            f"{found.tried:14,} {wall:9.3f} {spent:12.3f} {1e6 * wall / found.tried:8.3f}"
            f" {figures}",
            flush=True,
        )
        count *= 10


if __name__ == "__main__":
    main()
