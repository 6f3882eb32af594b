"""What writing a run costs: which compression, and its share of a run's time, measured on a sweep
in real time.

    python benchmarks/bench_record.py FOLDER [--points 1000] | --filters

The sweep is real but for the pictures: the built-in bench's stages move at their own speed, the
camera exposes and reads out and then hands over pictures of full size that were drawn before. It is
taken as it is, and once more with nothing written. 1,000 points take 20 GB under FOLDER, removed at
the end, and an hour. Wall time, with processor time in brackets.
"""

import argparse
import contextlib
import shutil
import time
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import yaml

from drivers.base import Frame
from drivers.bench import ConnectedBench, connect
from flflab.bench import Bench, read_bench
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.record import Recording, checksum
from flflab.study import Study, read_study
from flflab.targets import Bars, FourDot, White
from flflab.verdict.expectation import expected_noise
from procedures.durations import READOUT_S, durations
from procedures.steps import most_frames, steps
from procedures.study import take_study, tell_nobody

BUILT_IN = Path(__file__).parents[1] / "flflab" / "builtin"
FILTERS: dict[str, dict[str, Any]] = {
    "raw": {},
    "lzf": {"compression": "lzf"},
    "shuffle, lzf": {"compression": "lzf", "shuffle": True},
    "deflate 1": {"compression": "gzip", "compression_opts": 1},
    "shuffle, deflate 1": {"compression": "gzip", "compression_opts": 1, "shuffle": True},
    "shuffle, deflate 4": {"compression": "gzip", "compression_opts": 4, "shuffle": True},
}
Picture = np.ndarray[Any, np.dtype[np.uint16]]
Clock = tuple[float, float]


def timed(doing: Callable[[], object]) -> Clock:
    """Wall and processor time, s."""
    wall, used = time.perf_counter(), time.process_time()
    doing()
    return time.perf_counter() - wall, time.process_time() - used


def drawn_pictures(bench: Bench) -> dict[str, Picture]:
    """What the simulated camera shows of each target in place, the brightest view at 0.7 of full
    scale.
    """
    noise, optics, rng = expected_noise(bench), bench.optics, np.random.default_rng(1)
    columns, rows = optics.sensor.resolution
    light = {
        kind.kind: np.maximum(render(one_plane(optics, kind, 507.0)), 0.0)
        for kind in (White(), FourDot(), Bars())
    }
    found: dict[str, Picture] = {}
    for kind, share in (light | {"black": np.zeros((rows, columns))}).items():
        mean = noise.offset_dn + 0.68 * (noise.full_scale_dn - noise.offset_dn) * share
        noisy = mean + np.sqrt(noise.variance(mean)) * rng.standard_normal(mean.shape)
        found[kind] = np.clip(np.rint(noisy), 0, noise.full_scale_dn).astype(np.uint16)
    return found


class ReadyMade:
    """A camera that takes as long as the real one and gives pictures drawn before."""

    def __init__(self, bench: ConnectedBench, pictures: Mapping[str, Picture]) -> None:
        self._bench, self._camera, self._pictures = bench, bench.camera, pictures
        self._exposure, self._number = 0.01, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._camera, name)

    def prepare(self, exposure_s: float, gain: float = 1.0) -> None:
        """Keep the exposure."""
        self._exposure = exposure_s

    def grab(self, exposed: Callable[[], None] = lambda: None) -> Frame:
        """Wait as long as light and read-out take."""
        picture = self._pictures[self._bench.target.value()]
        time.sleep(self._exposure)
        exposed()
        time.sleep(READOUT_S)
        self._number += 1
        return Frame(picture, self._exposure, 1.0, time.time(), self._number, 0)


class Timed(Recording):
    """A recording that says how long writing took, and how much of that no axis moved, so that the
    run waited for it.

    Args:
        folder: the run's.
        study: what is taken.
        bench: on what.
        writes: whether anything is written; else frames and documents are forgotten.
    """

    def __init__(self, folder: Path, study: Study, bench: ConnectedBench, writes: bool) -> None:
        columns, rows = bench.described.optics.sensor.resolution
        super().__init__(folder, most_frames(steps(study, bench.described)), (rows, columns))
        self._axes, self._writes = bench.axes.values(), writes
        self.wall = self.used = self.waited = 0.0

    @contextlib.contextmanager
    def _timing(self) -> Generator[None]:
        wall, used = time.perf_counter(), time.thread_time()
        yield
        took = time.perf_counter() - wall
        self.wall += took
        self.used += time.thread_time() - used
        self.waited += 0.0 if any(axis.is_moving() for axis in self._axes) else took

    def frame(self, picture: Picture) -> int:
        """Write a frame, or count it."""
        with self._timing():
            if self._writes:
                return super().frame(picture)
            self.recorded += 1
            return self.recorded - 1

    def document(self, name: str, doc: Mapping[str, Any]) -> None:
        """Write a document."""
        with self._timing():
            if self._writes:
                super().document(name, doc)


def filters(folder: Path, pictures: Mapping[str, Picture]) -> None:
    """Size, time to write and to read of every filter, over the pictures of a run."""
    print(
        "least to most over white, four-dot, bars and black: times smaller, ms (processor) a frame"
        " to write, to read"
    )
    for name, options in FILTERS.items():
        found: list[tuple[float, Clock, Clock]] = []
        for frame in pictures.values():
            file = folder / "one.h5"
            with h5py.File(file, "w") as written:
                dataset = written.create_dataset(
                    "frames",
                    (3, *frame.shape),
                    "<u2",
                    chunks=(1, *frame.shape) if options else None,
                    **options,
                )

                def store(
                    dataset: Any = dataset, written: Any = written, frame: Picture = frame
                ) -> None:
                    for place in range(3):
                        dataset[place] = frame
                        written.flush()

                writing = timed(store)
            with h5py.File(file) as read:
                reading = timed(lambda read=read: [read["frames"][place] for place in range(3)])
            found.append((frame.nbytes * 3 / file.stat().st_size, writing, reading))
        sizes = [one[0] for one in found]
        print(
            f"{name:20s} {min(sizes):4.1f} to {max(sizes):4.1f},"
            f" {_spread(one[1] for one in found)}, {_spread(one[2] for one in found)}"
        )


def _spread(clocks: Any) -> str:
    walls, used = zip(*clocks, strict=True)
    return (
        f"{1e3 * min(walls) / 3:4.0f} to {1e3 * max(walls) / 3:4.0f} ms ({1e3 * min(used) / 3:.0f}"
        f" to {1e3 * max(used) / 3:.0f})"
    )


def study_of(folder: Path, points: int, optics: Any) -> Study:
    """A grid over f-number, array and distance, the sensor refocused: three pictures a
    configuration.
    """
    distances = [
        f"{480 + 60 * k / max(points // 27, 1):.3f} mm" for k in range(max(points // 27, 1))
    ]
    grid = {
        "f_number": [2.8, 4, 5.6],
        "array": ["59.5 mm", "60 mm", "60.5 mm"],
        "distance": distances,
    }
    (folder / "study.yaml").write_text(
        yaml.safe_dump({"name": "thousand", "configurations": [grid]})
    )
    return read_study(folder / "study.yaml", optics)


def swept(
    file: Path, study: Study, pictures: Mapping[str, Picture], folder: Path, writes: bool
) -> tuple[Timed, float]:
    """The recording of a sweep, and the seconds it took."""
    folder.mkdir()
    with connect(file) as bench:
        bench.camera = ReadyMade(bench, pictures)
        recording = Timed(folder, study, bench, writes)
        began = time.perf_counter()
        take_study(bench, study, recording, tell_nobody, "sweep")
        return recording, time.perf_counter() - began


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--filters", action="store_true")
    asked = parser.parse_args()
    folder = asked.folder / "bench_record"
    folder.mkdir(parents=True)
    try:
        described = yaml.safe_load((BUILT_IN / "benches" / "simulated.yaml").read_text())
        described["simulated"]["clock"] = 1
        described["optics"] = str((BUILT_IN / "cameras" / "osinski.yaml").resolve())
        file = folder / "bench.yaml"
        file.write_text(yaml.safe_dump(described, sort_keys=False))
        bench = read_bench(file)
        pictures = drawn_pictures(bench)
        if asked.filters:
            filters(folder, pictures)
            return
        study = study_of(folder, asked.points, bench.optics)
        to_do = steps(study, bench)
        planned = sum(durations(to_do, bench))
        written, took = swept(file, study, pictures, folder / "written", writes=True)
        points = written.recorded
        print(
            f"{points} frames: the plan says {planned:.0f} s, the run took {took:.0f} s,"
            f" {1e3 * took / points:.0f} ms a frame",
            flush=True,
        )
        shares = tuple(100 * part / took for part in (written.wall, written.used, written.waited))
        print(
            f"writing: {1e3 * written.wall / points:.1f} ms ({1e3 * written.used / points:.1f}) a"
            f" frame, {shares[0]:.2f} % ({shares[1]:.2f} %) of the run, {shares[2]:.2f} % while no"
            " axis moved; beside it, in another thread, a checksum of"
            f" {1e3 * timed(lambda: checksum(pictures['bars']))[1]:.1f} ms a frame",
            flush=True,
        )
        _, without = swept(file, study, pictures, folder / "unwritten", writes=False)
        print(
            f"with nothing written the run took {without:.0f} s: writing made it"
            f" {100 * (took / without - 1):+.2f} % longer"
        )
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
