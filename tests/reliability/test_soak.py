"""Faults one after the other on every wire, by chance but seeded: after each a recovery or one
sentence, a bench that is whole, and no lie.

Judged by the world, which shares nothing with the drivers: where each carriage truly is, and the
true gap. The drivers' time limits are shorter than by default and the simulated time runs faster
than real time, so that ten thousand take minutes.
"""

import collections
import contextlib
import itertools
import random
import re
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
import serial
import yaml

from drivers.axis import Axis
from drivers.base import Status, wait_all
from drivers.bench import ConnectedBench, connect
from flflab.bench import read_bench
from flflab.errors import DeviceError, InterlockError, NotHomedError
from sim import faults
from sim.registry import AXES
from sim.serve import Served, serve, write_bench

RATE, TIMEOUT_S, LATE_S, AWAY_S = 10, 0.3, 0.4, 0.1
ROUNDS_A_CONNECTION = 200
RANGES = {
    "main_lens_stage": (1.0, 9.0), "array_stage": (16.0, 21.5), "sensor_stage": (16.0, 21.5),
    "target_stage": (1.0, 20.0),
    "rotation_stage": (-0.08, 0.08), "goniometer": (-0.08, 0.08), "ring": (-0.5, 0.5),
}  # fmt: skip
STEPS = {
    "zaber": 0.0005,
    "thorlabs": 1.9e-5,
    "oriental": 7e-5,
}  # mm or rad: what a driver may be off, the ring's 2 steps of 0.02 degrees apart
STEPS_OF = {"ring": 7e-4}
ON_THE_MOVE = ("stall", "limit-switch", "deaf")  # shown by a motion only
GAP_AXES = ("array_stage", "sensor_stage")
WHAT_TO_DO = re.compile(
    r"check|look|home it|cut its|see that|try again|correct|enable|give|free|wait|stop|end"
    r" what|close|cut",
    re.IGNORECASE,
)
WHAT_WAS_ASKED = re.compile(r"asked|told|wrote|move to|look for its reference")

Answer = TypeVar("Answer")


class Soak:
    """A served bench, connected, and what became of each fault.

    Args:
        bench_file: of the bench as given.
        pty: on pseudo terminals instead of TCP.
        seed: of what happens.
    """

    def __init__(self, bench_file: Path, *, pty: bool, seed: int) -> None:
        self.file = bench_file.with_name("served.yaml")
        self.outcomes: collections.Counter[tuple[str, str, str]] = collections.Counter()
        self.sentences: dict[tuple[str, str], str] = {}
        self.readings = self.refusals = self.slow_answers = 0
        self.last: dict[str, str] = {}
        self.least_gap = np.inf
        self._chance = random.Random(seed)  # noqa: S311 - not a secret
        self._described = read_bench(bench_file)
        self._served: Served = serve(self._described, pty=pty)
        self._pty = pty
        write_bench(self._described, self._served, self.file)
        self._drivers = {
            name: axis.driver for name, axis in self._described.description.axes.items()
        }
        self._looked = self._now()
        self.bench: ConnectedBench = connect(self.file)
        self._make_whole()

    def close(self) -> None:
        """Let go of everything."""
        self.bench.close()
        self._served.stop()

    def run(self, count: int) -> None:
        """Go on until so many faults have been shown."""
        rounds = 0
        while self.outcomes.total() < count:
            try:
                self._round()
            except BaseException as failure:
                failure.add_note(f"after {self.last}")
                raise
            rounds += 1
            if rounds % ROUNDS_A_CONNECTION == 0:
                self._connect_again()

    # One round: a fault on every wire

    def _round(self) -> None:
        planted: dict[str, str] = {}
        for names in (list(RANGES)[:4], ["rotation_stage"], ["goniometer", "ring"]):
            name = self._chance.choice(names)
            planted[name] = self._chance.choice(AXES[self._drivers[name]].faults)
            self._served.faults[name].plant(planted[name], after=self._chance.randrange(16))
        self.last = planted
        told = self._act(
            [*planted, *self._chance.sample([name for name in RANGES if name not in planted], 2)]
        )
        for name, kind in planted.items():
            for _ in range(20):
                if self._served.faults[name].shown or kind in ON_THE_MOVE:
                    break
                with self._noting(name, told):
                    self.bench.axes[name].warnings()
            if self._served.faults[
                name
            ].shown:  # a motion may have been refused, or too short to be stuck on
                self._tally(name, kind, told.get(name, []))
        for fault in self._served.faults.values():
            fault.clear()
            fault.shown.clear()
        time.sleep(
            LATE_S if "late" in planted.values() else AWAY_S if "unplug" in planted.values() else 0
        )
        self._make_whole()
        self._look_at_the_gap()

    def _act(self, names: list[str]) -> dict[str, list[str]]:
        """Have axes do something all at once, and read them on the way; the sentences told by
        each.
        """
        told: dict[str, list[str]] = {}
        readings: dict[str, list[str]] = {}
        under_way: dict[str, Status] = {}
        stopping = [name for name in names if self._chance.random() < 0.1]
        for name in names:
            with self._noting(name, told):
                axis = self.bench.axes[name]
                under_way[name] = (
                    axis.home()
                    if self._chance.random() < 0.1
                    else axis.move_to(self._chance.uniform(*RANGES[name]))
                )
        for name in stopping:
            with self._noting(name, told):
                self.bench.axes[name].stop()
        deadline = time.monotonic() + 15
        while any(not status.done for status in under_way.values()):
            assert time.monotonic() < deadline, f"still under way: {under_way}"
            for name in under_way:
                with self._noting(name, readings):
                    self._read(self.bench.axes[name])
        for name, status in under_way.items():
            error = status.exception()
            if error is not None and not (name in stopping and "stopped on the way" in str(error)):
                assert isinstance(error, DeviceError), repr(error)
                told.setdefault(name, []).append(str(error))
        return {name: told.get(name, []) + readings.get(name, []) for name in {**told, **readings}}

    @contextlib.contextmanager
    def _noting(self, name: str, told: dict[str, list[str]]) -> Generator[None]:
        try:
            yield
        except InterlockError:
            self.refusals += 1
        except DeviceError as error:
            told.setdefault(name, []).append(str(error))

    def _tally(self, name: str, kind: str, told: list[str]) -> None:
        """Count how it ended; a sentence says which device, what was asked, and what to do."""
        for sentence in told:
            assert sentence.count("\n") == 0, sentence
            assert name in sentence, sentence
            assert WHAT_WAS_ASKED.search(sentence), sentence
            assert WHAT_TO_DO.search(sentence), sentence
        driver = self._drivers[name]
        self.outcomes[driver, kind, "error" if told else "recovery"] += 1
        if told:
            self.sentences.setdefault((driver, kind), told[0])

    # What must hold whatever happens

    def _read(self, axis: Axis) -> None:
        """A position that is told is where the axis was while it was asked."""
        before = self._now()
        told = axis.position()
        after = self._now()
        carriage = self._served.world.carriages[axis.name]
        places = [carriage.at(float(instant)) for instant in np.linspace(before, after, 33)]
        slack = STEPS_OF.get(axis.name, STEPS[self._drivers[axis.name]])
        travelled = max(
            abs(one - other) for one, other in itertools.pairwise(places)
        )  # between two instants it is anywhere
        self.readings += 1
        assert min(places) - slack - travelled <= told <= max(places) + slack + travelled, (
            f"{axis.name} told {told}, was {places[0]} to {places[-1]}"
        )

    def _make_whole(self) -> None:
        """Every axis, with nothing wrong any more: at rest, and either true or refusing until
        homed; then all can be used again.
        """
        deadline = time.monotonic() + 15
        while any(
            carriage.moving(self._now()) for carriage in self._served.world.carriages.values()
        ):
            assert time.monotonic() < deadline
            time.sleep(0.002)
        lost: list[str] = []
        for name, axis in self.bench.axes.items():
            assert not self._answer(axis.is_moving), name
            if self._answer(axis.is_homed):
                self._answer(lambda axis=axis: self._read(axis))
                faulty = any("alarm" in phrase for phrase in self._answer(axis.warnings))
                lost += [name] if faulty else []
                continue
            lost.append(name)
            place = self._served.world.carriages[name].at(self._now())
            with pytest.raises(NotHomedError):
                axis.move_to(RANGES[name][0])
            with pytest.raises(NotHomedError):
                axis.position()
            assert self._served.world.carriages[name].at(self._now()) == place
        self._home(lost)

    def _answer(self, ask: Callable[[], Answer]) -> Answer:
        """What a device says when nothing is wrong; on a busy machine an answer may take longer
        than this soak's short limit: counted.
        """
        for _ in range(3):
            try:
                return ask()
            except DeviceError as error:
                if not re.search("no answer|No response|not to message", str(error)):
                    raise
                self.slow_answers += 1
        return ask()

    def _home(self, lost: list[str]) -> None:
        """As a person would: array and sensor away from each other first."""
        axes = self.bench.axes
        wait_all(*[self._answer(axes[name].home) for name in lost if name in GAP_AXES], timeout=15)
        others = [name for name in lost if name not in GAP_AXES]
        if others:
            wait_all(*[axes[name].move_to(10.0) for name in GAP_AXES], timeout=15)
            wait_all(*[self._answer(axes[name].home) for name in others], timeout=15)
        for name in lost:
            self._read(axes[name])

    def _look_at_the_gap(self) -> None:
        now = self._now()
        gaps = [
            self._served.world.gap(float(instant)) for instant in np.linspace(self._looked, now, 60)
        ]
        self._looked = now
        self.least_gap = min(self.least_gap, *gaps)
        assert min(gaps) >= self._described.description.minimum_gap

    def _connect_again(self) -> None:
        """Let go and connect again; on pseudo terminals another program has a port at first."""
        self.bench.close()
        name = self._chance.choice(list(RANGES))
        if self._pty:
            address = self._served.addresses["axes"][name]["address"]
            taken = pytest.raises(DeviceError, match=r"cannot be opened.*who else holds it")
            with serial.Serial(address, exclusive=True), taken as caught:
                connect(self.file)
            assert name in str(caught.value)
            self.outcomes[self._drivers[name], "port taken", "error"] += 1
        self.bench = connect(self.file)
        self._make_whole()

    def _now(self) -> float:
        return self._served.world.clock.now()


@pytest.fixture
def bench_file(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(faults, "LATE_S", LATE_S)
    monkeypatch.setattr(faults, "AWAY_S", AWAY_S)
    source = root / "examples" / "benches" / "full.yaml"
    bench = yaml.safe_load(source.read_text(encoding="utf-8"))
    bench["optics"] = str((source.parent / bench["optics"]).resolve())
    bench["simulated"] |= {"clock": RATE}
    for axis in bench["axes"].values():
        axis["timeout"] = TIMEOUT_S
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
    return tmp_path / "bench.yaml"


def soak(bench_file: Path, count: int, *, pty: bool, seed: int) -> None:
    begin = time.perf_counter(), time.process_time()
    with contextlib.closing(Soak(bench_file, pty=pty, seed=seed)) as running:
        try:
            running.run(count)
        finally:
            for (driver, kind, outcome), times in sorted(running.outcomes.items()):
                sys.stdout.write(
                    f"{driver:9} {kind:14} {outcome:9} {times:5} "
                    f" {running.sentences.get((driver, kind), '')}\n"
                )
            wall, spent = time.perf_counter() - begin[0], time.process_time() - begin[1]
            sys.stdout.write(
                f"{running.outcomes.total()} faults, {running.readings} readings,"
                f" {running.refusals} refused by the rule of the gap, least gap"
                f" {running.least_gap:.4f} mm, {running.slow_answers} slow answers, {wall:.0f} s,"
                f" processor {spent:.0f} s\n"
            )


no_pty = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo terminals")


@pytest.mark.ci
@pytest.mark.parametrize("pty", [False, pytest.param(True, marks=no_pty)], ids=["tcp", "pty"])
def test_after_some_faults_the_bench_is_whole(bench_file: Path, pty: bool) -> None:
    soak(bench_file, 20, pty=pty, seed=int(pty))


@pytest.mark.full
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("seed", range(11, 17))
@pytest.mark.parametrize("pty", [False, pytest.param(True, marks=no_pty)], ids=["tcp", "pty"])
def test_after_each_of_ten_thousand_faults_the_bench_is_whole(
    bench_file: Path, pty: bool, seed: int
) -> None:
    soak(bench_file, 1000, pty=pty, seed=seed + 10 * pty)
