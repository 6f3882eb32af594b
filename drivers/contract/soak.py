"""Faults one after the other on every simulated line, by chance but seeded: after each a recovery
or one sentence, a bench that is whole, and no lie.

Judged by the simulated world, which shares nothing with the drivers: where each carriage truly is,
and the true gaps.
"""

import collections
import contextlib
import itertools
import random
import re
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
import serial

from drivers.axis import Axis
from drivers.base import Status
from drivers.bench import ConnectedBench, connect
from drivers.interlocks import homing_groups
from flflab.bench import read_bench
from flflab.errors import DeviceError, InterlockError, NotHomedError
from sim.registry import AXES
from sim.serve import Served, serve, write_bench

LATE_S, AWAY_S = 0.4, 0.1  # how late an answer is, and how long a plug is out, s
ROUNDS_A_CONNECTION = 10
ON_THE_MOVE = ("stall", "limit-switch", "deaf")  # shown by a motion only
RANGE = (0.1, 0.6)  # of the travel: where axes are sent
LOOKING_S = 0.01  # between two looks at all axes that are under way
BESIDE = 0.2  # share of the rounds in which somebody else is at work on the machine
RETREAT = ("main_lens.z", "sensor.z")  # whose homing brings nothing nearer to the array
MOST_TRIES = 20  # to have a fault shown, once the motions are over
PATIENCE_S = 15.0
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
        ranges: where axes are sent, readings; a part of the travel for those without one.
        slack: what a driver may be off, mm or rad; two of its steps for those without one.
        besides: what somebody else does at the same time, one of them now and then.
    """

    def __init__(
        self,
        bench_file: Path,
        *,
        pty: bool,
        seed: int,
        ranges: Mapping[str, tuple[float, float]] | None = None,
        slack: Mapping[str, float] | None = None,
        besides: Sequence[Callable[["Soak"], None]] = (),
    ) -> None:
        self.file = bench_file.with_name("served.yaml")
        self.pty = pty
        self.outcomes: collections.Counter[tuple[str, str, str]] = collections.Counter()
        self.sentences: dict[tuple[str, str], str] = {}
        self.readings = self.refusals = self.slow_answers = 0
        self.least_gaps = {"array and sensor": np.inf, "main lens and array": np.inf}
        self.stopped = False
        self.last: dict[str, str] = {}
        self._besides = besides
        self._chance = random.Random(seed)  # noqa: S311 - not a secret
        self._described = read_bench(bench_file)
        self.served: Served = serve(self._described, pty=pty)
        write_bench(self._described, self.served, self.file)
        axes = self._described.description.axes
        self.drivers = {name: axis.driver for name, axis in axes.items()}
        low, high = RANGE
        self.ranges = {
            name: (a + low * (b - a), a + high * (b - a))
            for name, (a, b) in ((name, axis.limits) for name, axis in axes.items())
        } | dict(ranges or {})
        self._slack = dict(slack or {})
        self._lines: dict[str, list[str]] = {}
        for name, place in self.served.addresses["axes"].items():
            if AXES[self.drivers[name]].faults:
                self._lines.setdefault(place["address"], []).append(name)
        self._looked = self.now()
        self.bench: ConnectedBench = self._connect()
        self._make_whole()

    def close(self) -> None:
        """Let go of everything."""
        self.bench.close()
        self.served.stop()

    def run(self, count: int) -> None:
        """Go on until so many faults have been shown.

        Raises:
            AssertionError: a driver lied, a sentence says too little, or the bench is not whole.
        """
        rounds = 0
        while self._lines and self.outcomes.total() < count:
            try:
                self._round()
            except BaseException as failure:
                failure.add_note(f"after {self.last}")
                raise
            rounds += 1
            if rounds % ROUNDS_A_CONNECTION == 0:
                self._connect_again()

    def now(self) -> float:
        """The simulated time, s."""
        return self.served.world.clock.now()

    # One round: a fault on every wire

    def _round(self) -> None:
        planted: dict[str, str] = {}
        for names in self._lines.values():
            name = self._chance.choice(names)
            planted[name] = self._chance.choice(AXES[self.drivers[name]].faults)
            self.served.faults[name].plant(planted[name], after=self._chance.randrange(16))
        self.last = planted
        busy = bool(self._besides) and self._chance.random() < BESIDE
        beside = self._chance.choice(self._besides) if busy else None
        idle = [name for name in self.ranges if name not in planted]
        told = self._act(
            [*planted, *self._chance.sample(idle, min(2, len(idle)))],
            beside,
        )
        for name, kind in planted.items():
            for _ in range(MOST_TRIES):
                if self.served.faults[name].shown or kind in ON_THE_MOVE:
                    break
                with self._noting(name, told):
                    self.bench.axes[name].warnings()
            # a motion may have been refused, or too short to be stuck on
            if self.served.faults[name].shown:
                self._tally(name, kind, told.get(name, []))
        for fault in self.served.faults.values():
            fault.clear()
            fault.shown.clear()
        time.sleep(
            LATE_S if "late" in planted.values() else AWAY_S if "unplug" in planted.values() else 0
        )
        if self.stopped:
            self._reconnect()
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
                    else axis.move_to(self._chance.uniform(*self.ranges[name]))
                )
        for name in stopping:
            with self._noting(name, told):
                self.bench.axes[name].stop()
        if beside is not None:
            beside(self)
        deadline = time.monotonic() + PATIENCE_S
        while any(not status.done for status in under_way.values()):
            assert time.monotonic() < deadline, f"still under way: {under_way}"
            for name in under_way:
                with self._noting(name, readings):
                    self._read(self.bench.axes[name])
            time.sleep(LOOKING_S)
        for name, status in under_way.items():
            error = status.exception()
            as_told = (name in stopping or self.stopped) and "stopped on the way" in str(error)
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
        driver = self.drivers[name]
        self.outcomes[driver, kind, "error" if told else "recovery"] += 1
        if told:
            self.sentences.setdefault((driver, kind), told[0])

    # What must hold whatever happens

    def _read(self, axis: Axis) -> None:
        """A position that is told is where the axis was while it was asked."""
        before = self.now()
        told = axis.position()
        after = self.now()
        carriage = self.served.world.carriages[axis.name]
        places = [carriage.at(float(instant)) for instant in np.linspace(before, after, 33)]
        slack = self._slack.get(axis.name, 2 * axis.resolution)
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
        deadline = time.monotonic() + PATIENCE_S
        while any(carriage.moving(self.now()) for carriage in self.served.world.carriages.values()):
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
            place = self.served.world.carriages[name].at(self.now())
            with pytest.raises(NotHomedError):
                axis.move_to(self.ranges[name][0])
            with pytest.raises(NotHomedError):
                axis.position()
            assert self.served.world.carriages[name].at(self.now()) == place
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
        """As a person would: lens and sensor away from the array first, before anything that could
        come nearer to them.
        """
        axes = self._described.description.axes
        if any(axes[name].moves.startswith("array.") for name in lost):
            lost = [name for name in axes if name in lost or axes[name].moves in RETREAT]
        for group in homing_groups(self._described):
            if names := [name for name in group if name in lost]:
                self._answer(lambda names=names: self.bench.home(*names))
        for name in lost:
            self._answer(lambda name=name: self._read(self.bench.axes[name]))

    def _look_at_the_gaps(self) -> None:
        now, world = self.now(), self.served.world
        instants = [float(instant) for instant in np.linspace(self._looked, now, 60)]
        self._looked = now
        for which, gap in zip(self.least_gaps, (world.gap, world.lens_gap), strict=True):
            self.least_gaps[which] = min(self.least_gaps[which], *map(gap, instants))
            assert self.least_gaps[which] >= self._described.description.gaps.array_sensor, which

    def _reconnect(self) -> None:
        self.bench.close()
        self.stopped = False
        self.bench = self._connect()

    def _connect(self) -> ConnectedBench:
        return self._answer(lambda: connect(self.file))

    def _connect_again(self) -> None:
        """Let go and connect again; on pseudo terminals another program has a port at first."""
        self.bench.close()
        name = self._chance.choice(list(self.served.addresses["axes"]))
        if self.pty:
            address = self.served.addresses["axes"][name]["address"]
            taken = pytest.raises(DeviceError, match=r"cannot be opened.*who else holds it")
            with serial.Serial(address, exclusive=True), taken as caught:
                connect(self.file)
            assert name in str(caught.value)
            self.outcomes[self.drivers[name], "port taken", "error"] += 1
        self.bench = self._connect()
        self._make_whole()
