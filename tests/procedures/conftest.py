"""A bench with a small sensor, in memory (its devices do at once what they are told) or served by
the simulation.
"""

import threading
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from drivers.base import Axis, CameraDevice, Frame, Setting
from drivers.bench import ConnectedBench
from flflab.bench import Bench, read_bench
from flflab.errors import LimitError
from flflab.study import Study, read_study
from sim.serve import Served, serve, write_bench

Write = Callable[..., tuple[Path, Path]]


@dataclass
class MemoryAxis:
    """An axis that is where it is told to be a moment later; satisfies ``AxisCommands``."""

    travel: tuple[float, float]
    home_end: float
    resolution: float = 1e-3
    place: float = 0.0
    homed: bool = False
    measured: bool = True
    heard: list[tuple[str, float]] = field(default_factory=list[tuple[str, float]])

    def start_home(self) -> None:
        self.heard.append(("home", self.home_end))
        self.place, self.homed = self.home_end, True

    def start_move(self, position: float) -> None:
        self.heard.append(("move", position))
        self.place = position

    def position(self) -> float:
        return self.place

    def reading(self) -> float | None:
        return self.place if self.homed else None

    def is_busy(self) -> bool:
        return False

    def is_homed(self) -> bool:
        return self.homed

    def stop(self) -> None:
        self.heard.append(("stop", self.place))

    def faults(self) -> tuple[str, ...]:
        return ()

    def warnings(self) -> tuple[str, ...]:
        return ()

    def identity(self) -> str:
        return "memory axis"

    def serial(self) -> str:
        return ""

    def close(self) -> None:
        pass


@dataclass
class MemorySetting:
    """A setting that is at once what it is told to be; satisfies ``SettingCommands``."""

    allowed: tuple[Any, ...]
    current: Any
    heard: list[Any] = field(default_factory=list[Any])

    def start(self, value: Any) -> None:
        self.heard.append(value)
        self.current = value

    def is_busy(self) -> bool:
        return False

    def value(self) -> Any:
        return self.current

    def fault(self) -> str:
        return ""

    def stop(self) -> None:
        pass

    def identity(self) -> str:
        return "memory setting"

    def close(self) -> None:
        pass


class MemoryCamera:
    """A camera under a lamp: a third of its pixels get ``rate`` DN a second on top of the offset;
    satisfies ``CameraDevice``.
    """

    name = "camera"
    full_scale = 4095
    dn_per_electron = 0.34
    read_noise_dn = 1.0
    offset_dn = 64.0
    exposure_limits = (1e-5, 10.0)
    offered_exposures: tuple[float, ...] = ()

    def __init__(self, rate: float = 4e5, shape: tuple[int, int] = (30, 40)) -> None:
        self.rate = rate
        self.shape = shape
        self.number = 0
        self.exposures: list[float] = []
        self._rng = np.random.default_rng(5)

    def prepare(self, exposure_s: float, gain: float = 1.0) -> None:
        low, high = self.exposure_limits
        if not low <= exposure_s <= high or (
            self.offered_exposures and exposure_s not in self.offered_exposures
        ):
            raise LimitError(f"camera: {exposure_s} s")
        self.exposures.append(exposure_s)

    def grab(self, exposed: Callable[[], None] = lambda: None) -> Frame:
        self.number += 1
        exposed()
        level = np.where(np.arange(self.shape[1]) % 3 == 0, self.rate * self.exposures[-1], 0.0)
        noisy = self._rng.normal(
            self.offset_dn + level, np.sqrt(1 + self.dn_per_electron * level), self.shape
        )
        picture = np.clip(np.rint(noisy), 0, self.full_scale).astype(np.uint16)
        return Frame(picture, self.exposures[-1], 1.0, time.time(), self.number, 0)

    def identity(self) -> str:
        return "memory camera"

    def close(self) -> None:
        pass


@pytest.fixture
def write(root: Path, tmp_path: Path) -> Write:
    """Write a study of two configurations and the built-in bench with a sensor of 120 x 90 pixels;
    both may be changed.
    """

    def write_files(
        study: dict[str, Any] | None = None, axes: dict[str, Any] | None = None, **simulated: object
    ) -> tuple[Path, Path]:
        camera = yaml.safe_load((root / "examples/cameras/osinski.yaml").read_text())
        camera["sensor"] |= {"resolution": [120, 90], "pixel": "10 um"}
        (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
        bench = yaml.safe_load((root / "examples/benches/simulated.yaml").read_text())
        bench["optics"] = "camera.yaml"
        for name, changed in (axes or {}).items():
            bench["axes"][name] |= changed
        bench["simulated"] |= {"clock": 100} | simulated
        (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench, sort_keys=False))
        small = {
            "name": "small",
            "configurations": [{"f_number": 4, "distance": ["500 mm", "515 mm"]}],
        }
        (tmp_path / "study.yaml").write_text(yaml.safe_dump(small | (study or {})))
        return tmp_path / "study.yaml", tmp_path / "bench.yaml"

    return write_files


@pytest.fixture
def described(write: Write) -> Callable[..., tuple[Study, Bench]]:
    """Study and bench as read; the arguments are those of ``write``."""

    def read(**changes: Any) -> tuple[Study, Bench]:
        study_file, bench_file = write(**changes)
        bench = read_bench(bench_file)
        return read_study(study_file, bench.optics), bench

    return read


@pytest.fixture
def in_memory() -> Callable[..., ConnectedBench]:
    """Connect a bench's axes, iris and target in memory to a camera, as a kind of bench."""

    def connect(
        bench: Bench, camera: MemoryCamera, kind: type[ConnectedBench] = ConnectedBench
    ) -> ConnectedBench:
        device: CameraDevice = camera  # a camera as far as the type checker can tell
        axes = {
            name: Axis(name, MemoryAxis(axis.limits, axis.limits[0]), axis.limits, axis.speed)
            for name, axis in bench.description.axes.items()
        }
        iris = Setting[float]("iris", MemorySetting((1.0, 32.0), 8.0))
        target = Setting[str](
            "target", MemorySetting(("four-dot", "bars", "white", "black"), "white")
        )
        return kind(
            bench,
            axes,
            device,
            iris,
            target,
            dict.fromkeys((*axes, "camera", "iris", "target"), ""),
            None,
            ExitStack(),
            ExitStack(),
        )

    return connect


@pytest.fixture
def served(write: Write) -> Callable[..., Any]:
    """Serve the bench of ``write`` and write a bench file that leads there: a context manager of
    (world and lines, study, bench).
    """

    @contextmanager
    def start(**changes: Any) -> Generator[tuple[Served, Path, Path], None, None]:
        study, bench_file = write(**changes)
        bench = read_bench(bench_file)
        with serve(bench) as running:
            write_bench(bench, running, bench_file.with_name("served.yaml"))
            yield running, study, bench_file.with_name("served.yaml")

    return start


@pytest.fixture
def memory_camera() -> Callable[..., MemoryCamera]:
    """Makes cameras in memory."""
    return MemoryCamera


@pytest.fixture
def until() -> Callable[[Callable[[], object], float], None]:
    """Wait until something holds."""

    def wait(holds: Callable[[], object], seconds: float = 60.0) -> None:
        end = time.monotonic() + seconds
        while not holds():
            assert time.monotonic() < end, "waited in vain"
            threading.Event().wait(0.005)

    return wait
