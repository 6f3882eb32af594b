"""Speed of the bench: four axes at once, what polling costs, what a reading of every axis and a
point of a plan cost beside motion.

Run by hand: ``python benchmarks/bench_bench.py``. The instruments are simulated in real time by
another process, so that processor time here is the drivers' alone. Motions are timed against the
law of their motion, which the simulated stages keep exactly. On a busy machine the least of several
runs says something, and processor time.
"""

import math
import statistics
import sys
import tempfile
import time
from pathlib import Path

import yaml
from bluesky import RunEngine
from bluesky import plans as bp

from drivers.base import Axis, wait_all
from drivers.bench import ConnectedBench, connect

ROOT = Path(__file__).resolve().parent.parent
ACCELERATIONS = {"mm": 400.0, "rad": math.radians(50)}  # of the simulated stages
FOUR = {
    "main_lens_stage": 10.0,
    "rotation_stage": math.radians(8),
    "goniometer": math.radians(6),
    "ring": math.radians(30),
}
RUNS = 5


def line(name: str, value: float, unit: str) -> None:
    """One line of the table."""
    sys.stdout.write(f"{name:86s} {value:9.2f} {unit}\n")


def duration(axis: Axis, way: float) -> float:
    """How long a motion takes that starts and ends at rest, s."""
    acceleration = ACCELERATIONS[axis.coordinate.unit]
    if axis.name in ("goniometer", "ring"):
        acceleration = axis.speed / 0.2  # the drives' own ramp
    way = abs(way)
    ramp = axis.speed**2 / acceleration
    return (
        way / axis.speed + axis.speed / acceleration
        if way > ramp
        else 2 * math.sqrt(way / acceleration)
    )


def four_axes(bench: ConnectedBench) -> None:
    """Wall time of a move of four axes on three wires, beyond the slowest of them; processor time
    while they move.
    """
    beyond: list[float] = []
    shares: list[float] = []
    for run in range(RUNS):
        ways = {name: (1 if run % 2 == 0 else -1) * far for name, far in FOUR.items()}
        slowest = max(duration(bench.axes[name], way) for name, way in ways.items())
        targets = {name: bench.axes[name].position() + way for name, way in ways.items()}
        wall, spent = time.perf_counter(), time.process_time()
        wait_all(*(bench.axes[name].move_to(target) for name, target in targets.items()))
        wall, spent = time.perf_counter() - wall, time.process_time() - spent
        beyond.append(wall - slowest)
        shares.append(spent / wall)
    line("four axes on three wires: time beyond the slowest, least", 1e3 * min(beyond), "ms")
    line(
        "                                                   median",
        1e3 * statistics.median(beyond),
        "ms",
    )
    line(
        "                          processor while they move, polling and starts, median",
        100 * statistics.median(shares),
        "% of a core",
    )


def polling(bench: ConnectedBench) -> None:
    """Processor time of seeing one long motion of each kind to its end."""
    for name, way in (
        ("target_stage", 75.0),
        ("rotation_stage", math.radians(15)),
        ("ring", math.radians(90)),
    ):
        axis = bench.axes[name]
        target = axis.position() + (way if axis.position() + way < axis.limits[1] else -way)
        wall, spent = time.perf_counter(), time.process_time()
        axis.move_to(target).wait()
        wall, spent = time.perf_counter() - wall, time.process_time() - spent
        line(f"polling {name}: processor over {wall:.1f} s", 100 * spent / wall, "% of a core")


def readings(bench: ConnectedBench) -> None:
    """One reading of each axis after the other, and processor time."""
    for name, axis in bench.axes.items():
        times: list[float] = []
        for _ in range(20):
            begin = time.perf_counter()
            axis.read()
            times.append(time.perf_counter() - begin)
        line(f"reading of {name}, median", 1e3 * statistics.median(times), "ms")


def points(bench: ConnectedBench) -> None:
    """What a point more of bluesky's own scan costs beyond its motion: start, notice of the end,
    reading, documents.
    """
    for name, step in (
        ("main_lens_stage", 0.2),
        ("rotation_stage", math.radians(0.2)),
        ("goniometer", math.radians(0.2)),
    ):
        axis = bench.axes[name]
        axis.move_to(0.1 * axis.limits[1]).wait()
        engine = RunEngine({}, context_managers=[])
        few, many = 5, 25
        walls: list[float] = []
        spent = time.process_time()
        for count in (few, many):
            begin = axis.position()
            wall = time.perf_counter()
            engine(bp.scan([], axis, begin + step, begin + count * step, count))
            walls.append(time.perf_counter() - wall)
        beyond = (walls[1] - walls[0]) / (many - few) - duration(axis, step)
        line(f"bluesky's scan along {name}: a point beyond motion", 1e3 * beyond, "ms")
        line(
            "                          processor a point",
            1e3 * (time.process_time() - spent) / (few + many),
            "ms",
        )


def main() -> None:
    """Print the table."""
    source = ROOT / "examples" / "benches" / "full.yaml"
    data = yaml.safe_load(source.read_text(encoding="utf-8"))
    data["optics"] = str((source.parent / data["optics"]).resolve())
    data["simulated"] |= {
        "clock": 1,
        "truths": {
            "target_stage.start": "1 mm",
            "ring.start": "1 deg",
            "main_lens_stage.start": "1 mm",
        },
    }
    for name in ("array_stage", "sensor_stage"):
        data["simulated"]["truths"][f"{name}.start"] = "1 mm"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bench.yaml"
        file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
        with connect(file) as bench:
            for names in (
                ("array_stage", "sensor_stage"),
                [name for name in bench.axes if name not in ("array_stage", "sensor_stage")],
            ):
                wait_all(*(bench.axes[name].home() for name in names))
            wait_all(*(bench.axes[name].move_to(0.1 * bench.axes[name].limits[1]) for name in FOUR))
            four_axes(bench)
            polling(bench)
            readings(bench)
            points(bench)


if __name__ == "__main__":
    main()
