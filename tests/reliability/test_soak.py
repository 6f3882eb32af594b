"""Faults one after the other on every wire, by chance but seeded, beside others on the same machine
who leave strange files, want the bench too, or stop it: after each a recovery or one sentence, a
bench that is whole, and no lie.

Judged by the world, which shares nothing with the drivers: where each carriage truly is, and the
true gaps. Short time limits and a fast simulated clock let ten thousand take minutes.
"""

import collections
import contextlib
import itertools
import os
import random
import re
import secrets
import sys
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
import serial
import yaml

from drivers import locks
from drivers.axis import Axis
from drivers.base import Status, wait_all
from drivers.bench import ConnectedBench, connect
from drivers.stopping import stop_bench
from flflab.bench import read_bench
from flflab.errors import DeviceError, InterlockError, NotHomedError
from sim import faults
from sim.registry import AXES
from sim.serve import Served, serve, write_bench

RATE, TIMEOUT_S, LATE_S, AWAY_S = 10, 0.3, 0.4, 0.1
ROUNDS_A_CONNECTION = 10
PARTS = 20
RANGES = {
    "main_lens_stage": (35.0, 69.0), "array_stage": (16.0, 21.5), "sensor_stage": (16.0, 21.5),
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
GAP_AXES = ("main_lens_stage", "sensor_stage", "array_stage")  # in the order they home in
OUT_OF_THE_WAY = {"main_lens_stage": 30.0, "array_stage": 10.0, "sensor_stage": 10.0}
LOOKING_S = 0.01  # between two looks at all axes that are under way
BESIDE = 0.2  # share of the rounds in which somebody else is at work on the machine
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
        self.least_gaps = {"array and sensor": np.inf, "main lens and array": np.inf}
        self._stopped = False
        self.last: dict[str, str] = {}
        self._chance = random.Random(seed)  # noqa: S311 - not a secret
        self._described = read_bench(bench_file)
        self._served: Served = serve(self._described, pty=pty)
        self._pty = pty
        write_bench(self._described, self._served, self.file)
        self._drivers = {
            name: axis.driver for name, axis in self._described.description.axes.items()
        }
        self._looked = self._now()
        self.bench = self._connect()
        self._make_whole()

    def close(self) -> None:
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
        beside = self._chance.choice(BESIDES) if self._chance.random() < BESIDE else None
        told = self._act(
            [*planted, *self._chance.sample([name for name in RANGES if name not in planted], 2)],
            beside,
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
        if self._stopped:
            self.bench.close()
            self._stopped = False
            self.bench = self._connect()
        self._make_whole()
        self._look_at_the_gaps()

    def _act(
        self, names: list[str], beside: "Callable[[Soak], None] | None"
    ) -> dict[str, list[str]]:
        """Have axes do something all at once while others are at work, and read them on the way;
        the sentences told by each.
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
        if beside is not None:
            beside(self)
        deadline = time.monotonic() + 15
        while any(not status.done for status in under_way.values()):
            assert time.monotonic() < deadline, f"still under way: {under_way}"
            for name in under_way:
                with self._noting(name, readings):
                    self._read(self.bench.axes[name])
            time.sleep(LOOKING_S)
        for name, status in under_way.items():
            error = status.exception()
            as_told = (name in stopping or self._stopped) and "stopped on the way" in str(error)
            if error is not None and not as_told:
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

    # Others on the same machine

    def want_the_bench(self) -> None:
        """Another program that spells the addresses differently is refused, and nothing of it
        moves.
        """
        other = self.file.with_name("other.yaml")
        data = yaml.safe_load(self.file.read_text(encoding="utf-8"))
        for number, axis in enumerate(data["axes"].values()):
            place = self.file.with_name(f"link-{number}")
            if self._pty and not place.is_symlink():
                place.symlink_to(axis["address"])
            axis["address"] = (
                str(place) if self._pty else axis["address"].replace("127.0.0.1", "127.1")
            )
        other.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
        with pytest.raises(DeviceError, match="another program drives this bench"):
            connect(other)
        self.outcomes["machine", "second owner", "error"] += 1

    def stop_from_beside(self) -> None:
        """Another program stops the bench, among strange files: every axis that it does not name
        rests when it returns, and this connection moves none any more.
        """
        with strange_files(self._chance):
            begun = time.monotonic()
            missed = stop_bench(self.file).faults
            assert time.monotonic() - begun < 15
        now = self._now()
        for name, carriage in self._served.world.carriages.items():
            if not any(name in sentence for sentence in missed):
                assert not carriage.moving(now), (name, missed)
        self._stopped = True
        assert self.bench.told_to_stop()
        with pytest.raises(DeviceError):
            self.bench.sensor_stage.home()
        self.outcomes["machine", "stop", "error" if missed else "recovery"] += 1

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
                if not re.search("no answer|no right answer|not to message", str(error)):
                    raise
                self.slow_answers += 1
                time.sleep(LATE_S)  # a motion that began all the same ends
        return ask()

    def _home(self, lost: list[str]) -> None:
        """As a person would: lens and sensor away from the array first, and out of its way."""
        axes = self.bench.axes
        tilts = [name for name in lost if name not in GAP_AXES]
        for name in GAP_AXES if lost else ():
            if name in lost:
                self._answer(lambda name=name: axes[name].home().wait(15))
            away = self._answer(axes[name].position) > OUT_OF_THE_WAY[name]
            if away and (tilts or "array_stage" in lost):
                self._answer(lambda name=name: axes[name].move_to(OUT_OF_THE_WAY[name]).wait(15))
        self._answer(lambda: wait_all(*[axes[name].home() for name in tilts], timeout=15))
        for name in lost:
            self._answer(lambda name=name: self._read(axes[name]))

    def _look_at_the_gaps(self) -> None:
        now, world = self._now(), self._served.world
        instants = [float(instant) for instant in np.linspace(self._looked, now, 60)]
        self._looked = now
        for which, gap in zip(self.least_gaps, (world.gap, world.lens_gap), strict=True):
            self.least_gaps[which] = min(self.least_gaps[which], *map(gap, instants))
            assert self.least_gaps[which] >= self._described.description.gaps.array_sensor, which

    def _connect(self) -> ConnectedBench:
        return self._answer(lambda: connect(self.file))

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
        self.bench = self._connect()
        self._make_whole()

    def _now(self) -> float:
        return self._served.world.clock.now()


BESIDES = (Soak.want_the_bench, Soak.stop_from_beside)


@contextlib.contextmanager
def strange_files(chance: random.Random) -> Generator[None]:
    """Where programs say who drives a bench somebody leaves what is no such file."""
    here = locks.folder()
    users = [locks.user(), "65534"]
    places = [
        here / f"{locks.PREFIX}{secrets.token_hex(12)}.{chance.choice(users)}{kind}"
        for kind in (locks.LOCK, locks.LOCK, locks.STOP, locks.KEY)
    ]
    make: list[Callable[[Path], object]] = [
        lambda place: place.symlink_to("/dev/zero"),
        Path.mkdir,
        lambda place: place.write_bytes(b"\0" * 100_000),
        lambda place: place.write_text('{"port": 1e400, "process": [], "bench": 7}'),
        *([os.mkfifo] if sys.platform != "win32" else []),
    ]
    try:
        for place in places:
            chance.choice(make)(place)
        yield
    finally:
        for place in places:
            if place.is_dir() and not place.is_symlink():
                place.rmdir()
            else:
                place.unlink(missing_ok=True)


@pytest.fixture
def bench_file(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(faults, "LATE_S", LATE_S)
    monkeypatch.setattr(faults, "AWAY_S", AWAY_S)
    source = root / "examples" / "benches" / "full.yaml"
    bench = yaml.safe_load(source.read_text(encoding="utf-8"))
    bench["optics"] = str((source.parent / bench["optics"]).resolve())
    bench["simulated"] |= {"clock": RATE}
    bench["axes"]["main_lens_stage"]["limits"] = ["0 mm", "75 mm"]  # it reaches the array
    for axis in bench["axes"].values():
        axis["timeout"] = TIMEOUT_S
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
    return tmp_path / "bench.yaml"


def part(bench_file: Path, number: int, count: int) -> Soak:
    """One bench of its own, on pseudo terminals every other time."""
    folder = bench_file.parent / f"part-{number}"
    folder.mkdir()
    own = folder / bench_file.name
    own.write_bytes(bench_file.read_bytes())
    pty = number % 2 == 1 and sys.platform != "win32"
    with contextlib.closing(Soak(own, pty=pty, seed=number)) as running:
        try:
            running.run(count)
        except BaseException as failure:
            failure.add_note(f"part {number}")
            raise
    return running


def soak(bench_file: Path, first: int = 0) -> None:
    """Fifty faults on each of twenty benches side by side: most of their time is waiting."""
    begin = time.perf_counter(), time.process_time()
    with ThreadPoolExecutor(PARTS) as pool:
        parts = [pool.submit(part, bench_file, first + number, 50) for number in range(PARTS)]
    failures = [failure for one in parts if (failure := one.exception()) is not None]
    ended = [one.result() for one in parts if one.exception() is None]
    outcomes: collections.Counter[tuple[str, str, str]] = collections.Counter()
    for running in ended:
        outcomes.update(running.outcomes)
    sentences = {key: said for running in ended for key, said in running.sentences.items()}
    for (driver, kind, outcome), times in sorted(outcomes.items()):
        said = sentences.get((driver, kind), "")
        sys.stdout.write(f"{driver:9} {kind:14} {outcome:9} {times:5}  {said}\n")
    wall, spent = time.perf_counter() - begin[0], time.process_time() - begin[1]
    least = {
        which: round(float(min(running.least_gaps[which] for running in ended)), 4)
        for which in (ended[0].least_gaps if ended else ())
    }
    sys.stdout.write(
        f"{outcomes.total()} faults, {sum(running.readings for running in ended)} readings,"
        f" {sum(running.refusals for running in ended)} refused by the rule of the gap, least gaps"
        f" {least} mm, {sum(running.slow_answers for running in ended)} slow answers, {wall:.0f} s,"
        f" processor {spent:.0f} s\n"
    )
    if failures:
        raise BaseExceptionGroup(f"{len(failures)} of {PARTS} parts failed", failures)


@pytest.mark.ci
def test_after_a_thousand_faults_the_bench_is_whole(bench_file: Path) -> None:
    soak(bench_file)


@pytest.mark.full
@pytest.mark.timeout(7200)
def test_after_ten_thousand_faults_the_bench_is_whole(bench_file: Path) -> None:
    for first in range(0, 10 * PARTS, PARTS):
        soak(bench_file, first)
