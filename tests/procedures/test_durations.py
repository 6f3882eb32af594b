"""What a plan says of its duration, against what the run takes on the simulated bench's own
clock.
"""

import itertools
import math
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import sim.camera
from flflab.bench import Bench, read_bench
from flflab.cli.run import run_study
from flflab.study import Study, read_study
from procedures.durations import START_S, durations, left_at, seconds_left
from procedures.steps import Capture, CaptureDark, Expose, Home, Move, ShowTarget, steps
from procedures.sweep import Progress
from sim.serve import serve, write_bench

Write = Callable[..., tuple[Path, Path]]
TICK_S = 0.002
FASTER = 2.0


class TickingClock:
    """A clock that counts ticks, so that load does not look like time, and that stands while
    pictures are drawn: a camera draws nothing.
    """

    def __init__(self) -> None:
        self._now = 0.0
        self._drawing = 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._tick, name="ticks")

    def now(self) -> float:
        return self._now

    def wait_until(self, instant: float, given_up: threading.Event) -> bool:
        while self._now < instant:
            if given_up.wait(TICK_S):
                return False
        return not given_up.is_set()

    def _tick(self) -> None:
        last = time.monotonic()
        while not self._over.wait(TICK_S):
            now = time.monotonic()
            self._now += 0.0 if self._drawing else FASTER * min(now - last, 2 * TICK_S)
            last = now

    def standing(self, draw: Callable[..., Any]) -> Callable[..., Any]:
        """A function that draws, outside time."""

        def drawn(*what: Any, **how: Any) -> Any:
            self._drawing += 1
            try:
                return draw(*what, **how)
            finally:
                self._drawing -= 1

        return drawn

    @contextmanager
    def going(self) -> Generator[None]:
        self._thread.start()
        try:
            yield
        finally:
            self._over.set()
            self._thread.join()


@pytest.mark.full
@pytest.mark.timeout(300)
def test_a_run_takes_as_long_as_its_plan_says_within_a_tenth(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study_file, file = write(
        study={"configurations": [{"f_number": [4, 2.8], "distance": ["490 mm", "530 mm"]}]}
    )
    bench = read_bench(file)
    study = read_study(study_file, bench.optics)
    clock, began = TickingClock(), list[float]()
    for drawing in ("render_light", "digitise"):
        monkeypatch.setattr(sim.camera, drawing, clock.standing(getattr(sim.camera, drawing)))
    with clock.going(), serve(bench, clock=clock) as running:
        write_bench(bench, running, tmp_path / "served.yaml")

        def tell(progress: Progress) -> None:
            began.append(clock.now())

        run_study(study_file, tmp_path / "served.yaml", tmp_path / "run", None, tell, "sweep")
    took, said = (
        [after - before for before, after in itertools.pairwise(began)],
        durations(steps(study, bench), bench),
    )
    # The first step waits for the process that watches over the axes, which starts in this
    # machine's time.
    assert sum(took[1:]) == pytest.approx(sum(said[1:]), rel=0.1), [
        f"{one:.2f} s, {other:.2f} s" for one, other in zip(took, said, strict=True)
    ]


@pytest.fixture
def read(write: Write) -> Callable[..., tuple[Study, Bench]]:
    def read_both(**changes: Any) -> tuple[Study, Bench]:
        study_file, file = write(**changes)
        bench = read_bench(file)
        return read_study(study_file, bench.optics), bench

    return read_both


def test_homing_begins_where_the_camera_file_has_everything(
    read: Callable[..., tuple[Study, Bench]],
) -> None:
    study, bench = read()
    start = left_at(bench)
    assert start["array_stage"] == pytest.approx(20)  # 60 mm behind the lens, zero at 40 mm
    assert start["main_lens_stage"] == pytest.approx(10)
    to_do = steps(study, bench)
    homes = [
        seconds
        for step, seconds in zip(to_do, durations(to_do, bench), strict=True)
        if isinstance(step, Home)
    ]
    assert homes == pytest.approx(
        [1.885 + START_S, 2.0, 3.0], abs=0.1
    )  # the sensor, 18.85 mm at 10 mm/s, beside the lens; the array, 20 mm; the target from the
    # middle of 150 mm at 25 mm/s


def test_what_moves_after_a_frame_takes_no_longer_for_its_read_out(
    read: Callable[..., tuple[Study, Bench]],
) -> None:
    study, bench = read()
    to_do = steps(study, bench)
    lasting = dict(zip(map(str, to_do), durations(to_do, bench), strict=True))
    first, second = (step for step in to_do if isinstance(step, Move) and step.configuration == 1)
    assert lasting[str(first)] > 0.5 > lasting["c1/four-dot/0: take a frame"]
    assert second is not first


def test_a_manual_target_takes_a_person_and_a_faster_clock_makes_nobody_faster(
    read: Callable[..., tuple[Study, Bench]],
) -> None:
    study, bench = read()
    by_hand = bench.description.model_copy(
        update={"target": bench.description.target.model_copy(update={"driver": "manual"})}
    )
    manual = Bench(by_hand, bench.file, bench.lines, bench.optics)
    to_do = steps(study, manual)
    for rate in (1.0, 20.0):
        shown = [
            s
            for step, s in zip(to_do, durations(to_do, manual, rate=rate), strict=True)
            if isinstance(step, ShowTarget)
        ]
        assert min(shown) >= 30
    assert isinstance(to_do[-1], CaptureDark)
    assert sum(isinstance(step, Expose) for step in to_do) == 2


def test_what_is_left_learns_from_motions_and_frames_apart_how_long_they_take(
    read: Callable[..., tuple[Study, Bench]],
) -> None:
    """Frames that are drawn for four seconds more and motions that take as long as they should,
    after half of the steps.
    """
    study, bench = read()
    to_do = steps(study, bench)
    said = durations(to_do, bench)
    took = [
        seconds + 4.0 * isinstance(step, Expose | Capture | CaptureDark)
        for step, seconds in zip(to_do, said, strict=True)
    ]
    assert sum(took) > 1.5 * sum(said)
    done = len(to_do) // 2
    assert seconds_left(to_do, said, took[:done]) == pytest.approx(sum(took[done:]), rel=0.05)
    assert seconds_left(to_do, said, []) == pytest.approx(sum(said))
    assert seconds_left(to_do, said, [0.0] * (len(to_do) - 1)) >= 0.0


def test_a_first_frame_that_pays_for_a_start_does_not_stretch_what_is_left(
    read: Callable[..., tuple[Study, Bench]],
) -> None:
    study, bench = read()
    to_do = steps(study, bench)
    said = durations(to_do, bench)
    frames = [
        place
        for place, step in enumerate(to_do)
        if isinstance(step, Expose | Capture | CaptureDark)
    ]
    took = list(said)
    took[frames[0]] += 90.0  # its kernels were compiled
    assert math.isnan(seconds_left(to_do, said, took[: frames[0] + 1]))
    after = frames[1] + 1
    assert seconds_left(to_do, said, took[:after]) == pytest.approx(sum(took[after:]), rel=0.02)
