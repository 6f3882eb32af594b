"""Ten thousand faults on the bench of every axis, beside others on the same machine who leave
strange files, want the bench too, or stop it: the soak of the wheel, on twenty benches at once.

Short time limits and a fast simulated clock let ten thousand take minutes.
"""

import collections
import contextlib
import os
import random
import secrets
import sys
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import yaml

from drivers import locks
from drivers.bench import connect
from drivers.contract.soak import AWAY_S, LATE_S, Soak
from drivers.stopping import stop_bench
from flflab.errors import DeviceError
from sim import faults

RATE, TIMEOUT_S = 10, 0.3
PARTS = 20
RANGES = {
    "main_lens_stage": (35.0, 69.0), "array_stage": (16.0, 21.5), "sensor_stage": (16.0, 21.5),
    "target_stage": (1.0, 20.0),
    "rotation_stage": (-0.08, 0.08), "goniometer": (-0.08, 0.08), "ring": (-0.5, 0.5),
}  # fmt: skip
SLACK = {
    "main_lens_stage": 0.0005, "array_stage": 0.0005, "sensor_stage": 0.0005,
    "target_stage": 0.0005,
    "rotation_stage": 1.9e-5, "goniometer": 7e-5, "ring": 7e-4,
}  # fmt: skip  # mm or rad: what a driver may be off; the ring's are 2 steps of 0.02 degrees


def want_the_bench(soak: Soak) -> None:
    """Another program that spells the addresses differently is refused, and nothing of it
    moves.
    """
    other = soak.file.with_name("other.yaml")
    data = yaml.safe_load(soak.file.read_text(encoding="utf-8"))
    for number, axis in enumerate(data["axes"].values()):
        place = soak.file.with_name(f"link-{number}")
        if soak.pty and not place.is_symlink():
            place.symlink_to(axis["address"])
        axis["address"] = str(place) if soak.pty else axis["address"].replace("127.0.0.1", "127.1")
    other.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    with pytest.raises(DeviceError, match="another program drives this bench"):
        connect(other)
    soak.outcomes["machine", "second owner", "error"] += 1


def stop_from_beside(soak: Soak) -> None:
    """Another program stops the bench, among strange files: every axis that it does not name
    rests when it returns, and this connection moves none any more.
    """
    with strange_files(random.Random(soak.outcomes.total())):  # noqa: S311 - not a secret
        begun = time.monotonic()
        missed = stop_bench(soak.file).faults
        assert time.monotonic() - begun < 15
    now = soak.now()
    for name, carriage in soak.served.world.carriages.items():
        if not any(name in sentence for sentence in missed):
            assert not carriage.moving(now), (name, missed)
    soak.stopped = True
    assert soak.bench.told_to_stop()
    with pytest.raises(DeviceError):
        soak.bench.sensor_stage.home()
    soak.outcomes["machine", "stop", "error" if missed else "recovery"] += 1


BESIDES = (want_the_bench, stop_from_beside)


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
    with contextlib.closing(
        Soak(own, pty=pty, seed=number, ranges=RANGES, slack=SLACK, besides=BESIDES)
    ) as running:
        try:
            running.run(count)
        except BaseException as failure:
            failure.add_note(f"part {number}")
            raise
    return running


def soak(bench_file: Path, faults_each: int, first: int = 0) -> None:
    """Faults on each of twenty benches side by side: most of their time is waiting."""
    begin = time.perf_counter(), time.process_time()
    with ThreadPoolExecutor(PARTS) as pool:
        parts = [
            pool.submit(part, bench_file, first + number, faults_each) for number in range(PARTS)
        ]
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


@pytest.mark.parametrize(
    "faults_each",
    [pytest.param(10, marks=pytest.mark.ci), pytest.param(50, marks=pytest.mark.full)],
)
def test_after_hundreds_of_faults_the_bench_is_whole(bench_file: Path, faults_each: int) -> None:
    soak(bench_file, faults_each)


@pytest.mark.full
@pytest.mark.timeout(7200)
def test_after_ten_thousand_faults_the_bench_is_whole(bench_file: Path) -> None:
    for first in range(0, 10 * PARTS, PARTS):
        soak(bench_file, 50, first)
