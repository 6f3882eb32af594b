"""What writing a run costs: share of a thousand points' time, and which compression.

    python benchmarks/bench_record.py FOLDER [--points 1000] [--megapixels 10]

Writes that many frames under FOLDER (20 GB as it stands) and removes them. Wall time, with processor time in brackets.
"""

import argparse
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from flflab.bench import read_bench
from flflab.record import Recording, checksum, pack, read_run
from flflab.study import Configuration, read_study
from procedures.durations import durations
from procedures.steps import steps

BUILT_IN = Path(__file__).parents[1] / "flflab" / "builtin"
FILTERS: dict[str, dict[str, Any]] = {
    "raw": {},
    "lzf": {"compression": "lzf"},
    "shuffle, lzf": {"compression": "lzf", "shuffle": True},
    "deflate 1": {"compression": "gzip", "compression_opts": 1},
    "shuffle, deflate 1": {"compression": "gzip", "compression_opts": 1, "shuffle": True},
    "shuffle, deflate 4": {"compression": "gzip", "compression_opts": 4, "shuffle": True},
}


def timed(doing: Callable[[], object]) -> tuple[float, float]:
    """Wall and processor time, s."""
    wall, used = time.perf_counter(), time.process_time()
    doing()
    return time.perf_counter() - wall, time.process_time() - used


def picture(rows: int, columns: int) -> np.ndarray[Any, np.dtype[np.uint16]]:
    """A third lit, as a picture of a target is: shot noise on black level."""
    light = np.where(np.arange(columns) % 300 < 100, 2400.0, 0.0)
    return np.rint(np.random.default_rng(1).normal(64 + light, np.sqrt(1 + 0.34 * light), (rows, columns))).clip(0).astype(np.uint16)


def event(number: int, crc32: str) -> dict[str, Any]:
    """As a run writes it."""
    worlds = {f"world_{element}_z_mm": 1.0 for element in ("main_lens", "array", "sensor", "target")}
    data = {
        "point": f"c{number}/bars/0", "configuration": number, "target": "bars", "repeat": 0, "iris": 4.0, "exposure_s": 0.01, "gain": 1.0,
        "saturated": 0, "number": number, "crc32": crc32, **worlds,
    }  # fmt: skip
    return {"time": float(number), "data": data}


def write(folder: Path, points: int, frame: np.ndarray[Any, np.dtype[np.uint16]]) -> None:
    """Write a run of so many points."""
    recording = Recording(folder, points, (frame.shape[0], frame.shape[1]))
    recording.document("start", {"uid": "u", "axes": [], "time": 0.0})
    for number in range(points):
        crc32, place = checksum(frame), recording.frame(frame)
        recording.document("stream_datum", {"indices": {"start": place, "stop": place + 1}})
        recording.document("event", event(number, crc32))
    recording.document("stop", {"exit_status": "success"})
    recording.close()


def run_time(points: int) -> float:
    """How long a run of so many points on the built-in bench takes on real stages, s."""
    bench = read_bench(BUILT_IN / "benches" / "simulated.yaml")
    study = read_study(BUILT_IN / "studies" / "first.yaml", bench.optics)
    first = study.configurations[0]
    places = [replace(first, index=k, distance=480 + 60 * k / (points // 3)) for k in range(points // 3)]  # small moves: a fast run
    return sum(durations(steps(replace(study, configurations=tuple[Configuration, ...](places)), bench), bench))


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--megapixels", type=float, default=10.07)
    asked = parser.parse_args()
    rows = round((asked.megapixels * 1e6 * 0.75) ** 0.5)
    frame = picture(rows, round(rows / 0.75))
    folder = asked.folder / "bench_record"
    folder.mkdir(parents=True)
    try:
        for name, options in FILTERS.items():
            with h5py.File(folder / "one.h5", "w") as file:
                dataset = file.create_dataset("frames", (3, *frame.shape), "<u2", chunks=(1, *frame.shape) if options else None, **options)

                def store(dataset: Any = dataset, file: Any = file) -> None:
                    for place in range(3):
                        dataset[place] = frame
                        file.flush()

                wall, used = timed(store)
            size = (folder / "one.h5").stat().st_size / 3
            print(f"{name:20s} {frame.nbytes / size:5.2f} times smaller, {1e3 * wall / 3:5.0f} ms ({1e3 * used / 3:.0f}) a frame")
        total = run_time(asked.points)
        wall, used = timed(lambda: write(folder, asked.points, frame))
        shares = f"{100 * wall / total:.2f} % ({100 * used / total:.2f} %)"
        print(f"writing {asked.points} points: {wall:.1f} s ({used:.1f}), {shares} of the {total:.0f} s that the run takes")
        wall, used = timed(lambda: pack(read_run(folder)))
        print(f"packing them afterwards: {wall:.1f} s ({used:.1f})")
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
