"""What a bench must do before a run is trusted to it. Every axis moves, by a quarter of its travel
at most; iris and target holder that a person moves are left alone.
"""

import contextlib
import math
import threading
from collections.abc import Generator
from typing import Any

import numpy as np
import pytest
from bluesky import RunEngine, protocols
from bluesky import plan_stubs as bps
from bluesky import plans as bp
from bluesky.simulators import check_limits

from drivers.base import Axis, Status
from drivers.bench import ConnectedBench
from flflab.errors import InterlockError, LimitError, MotionError

SHARE = 0.05  # of an axis's travel
LONG_ENOUGH = 0.25  # of it, so that a stop that is late on a busy computer comes on the way
BEFORE_THE_STOP_S = 0.01
PATIENCE_S = 600.0
PROMISES = (
    "Movable", "Readable", "Locatable", "Stoppable", "Checkable", "Configurable", "HasHints",
)  # fmt: skip
BY_HAND = "manual"


def inwards(axis: Axis, share: float = SHARE) -> float:
    """A share of the travel from where the axis stands, towards the farther limit."""
    low, high = axis.limits
    here = min(max(axis.position(), low), high)
    return here + share * (high - low) * (1 if high - here > here - low else -1)


@contextlib.contextmanager
def engine_of_its_own() -> Generator[RunEngine]:
    """A RunEngine whose loop and thread end with the block."""
    engine = RunEngine({}, context_managers=[])
    try:
        yield engine
    finally:
        engine.loop.call_soon_threadsafe(engine.loop.stop)
        engine._th.join()  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
        engine.loop.close()


def test_every_device_says_who_it_is(bench: ConnectedBench) -> None:
    """In the table that ``flflab bench check`` prints."""
    rows = bench.identities()
    assert [row.name for row in rows] == [*bench.axes, "camera", "iris", "target"]
    for row in rows:
        assert row.identity, row
        assert row.identity != "does not answer", row


def test_an_axis_keeps_the_protocols_of_bluesky(axis: Axis) -> None:
    """All that plans ask of a motor."""
    for promise in PROMISES:
        assert isinstance(axis, getattr(protocols, promise)), promise


def test_an_axis_that_was_homed_has_a_reference_and_no_warnings(axis: Axis) -> None:
    """Homing ended with nothing left to say."""
    assert axis.is_homed()
    assert axis.warnings() == ()


def test_an_axis_goes_where_it_is_sent_and_says_so(axis: Axis) -> None:
    """To its own resolution, there and back."""
    start, end = axis.position(), inwards(axis)
    axis.move_to(end).wait(PATIENCE_S)
    assert axis.position() == pytest.approx(end, abs=2 * axis.resolution)
    low, high = axis.limits
    back = min(max(start, low), high)
    axis.move_to(back).wait(PATIENCE_S)
    assert axis.position() == pytest.approx(back, abs=2 * axis.resolution)


def test_an_axis_stopped_on_its_way_stands_between_its_ends(axis: Axis) -> None:
    """And still knows where it is."""
    start, end = axis.position(), inwards(axis, LONG_ENOUGH)
    motion = axis.move_to(end)
    axis.stop()
    with pytest.raises(MotionError):
        motion.wait(60)
    slack = 2 * axis.resolution
    assert not axis.is_moving()
    assert min(start, end) - slack <= axis.position() <= max(start, end) + slack
    assert axis.is_homed()


def test_a_stop_from_another_thread_ends_the_motion_short(axis: Axis) -> None:
    """What ended short never passes for arrived."""
    end = inwards(axis, LONG_ENOUGH)
    status = axis.move_to(end)
    threading.Timer(BEFORE_THE_STOP_S, axis.stop).start()
    with contextlib.suppress(MotionError):
        status.wait(60)
    assert not axis.is_moving()
    if abs(axis.position() - end) > 2.5 * axis.resolution:  # else it had just arrived
        assert not status.success
        assert "stopped on the way" in str(status.exception())


def test_beyond_its_limits_an_axis_refuses_and_stays_where_it_is(axis: Axis) -> None:
    """The sentence names the axis."""
    before = axis.position()
    low, high = axis.limits
    for beyond in (low - 1, high + 1, low - 1e-6, high + 1e-6, math.nan, math.inf):
        with pytest.raises(LimitError, match=axis.name):
            axis.move_to(beyond)
    assert not axis.is_moving()
    assert axis.position() == pytest.approx(before, abs=axis.resolution)


def test_a_plan_of_the_run_engine_moves_an_axis_and_reads_it(axis: Axis) -> None:
    """Its column is the axis's name."""
    documents: list[tuple[str, Any]] = []
    first, last = inwards(axis, SHARE / 5), inwards(axis)
    with engine_of_its_own() as engine:
        check_limits(bp.scan([], axis, first, last, 3))
        engine(bp.scan([], axis, first, last, 3), lambda *document: documents.append(document))
    events = [document["data"][axis.name] for name, document in documents if name == "event"]
    assert events == pytest.approx([first, (first + last) / 2, last], abs=2 * axis.resolution)


def test_a_plan_beyond_the_limits_is_refused_before_it_runs(axis: Axis) -> None:
    """By bluesky's own check, and as the plan comes there."""
    before = axis.position()
    with engine_of_its_own() as engine:
        with pytest.raises(LimitError):
            check_limits(bp.scan([], axis, inwards(axis), 1e4, 3))
        with pytest.raises(LimitError):
            engine(bps.mv(axis, 1e4))
    assert axis.position() == pytest.approx(before, abs=2 * axis.resolution)


def test_the_camera_gives_frames_as_large_and_as_long_as_asked(bench: ConnectedBench) -> None:
    """Longer is not darker."""
    columns, rows = bench.described.optics.sensor.resolution
    shortest, longest = bench.camera.exposure_limits
    means = list[float]()
    for exposure in (max(shortest, 1e-3), min(longest, 2e-2)):
        bench.camera.prepare(exposure)
        frame = bench.camera.grab()
        assert frame.picture.shape == (rows, columns)
        assert frame.exposure_s == pytest.approx(exposure, rel=0.05)
        means.append(float(np.mean(frame.picture)))
    assert means[1] >= means[0] - 1


def test_iris_and_target_holder_go_through_what_they_offer(bench: ConnectedBench) -> None:
    """As far as motors move them."""
    description = bench.described.description
    if description.target.driver != BY_HAND:
        for kind in ("white", "four-dot"):
            bench.target.set(kind).wait(120)
            assert bench.target.locate()["readback"] == kind
    if description.iris.driver != BY_HAND:
        for f_number in (2.8, 4.0):
            bench.iris.set(f_number).wait(120)
            assert bench.iris.locate()["readback"] == pytest.approx(f_number, rel=1e-3)


def test_one_stop_stops_every_axis(bench: ConnectedBench) -> None:
    """Also those that stand."""
    axes = [
        axis
        for name, axis in bench.axes.items()
        if bench.described.description.axes[name].driver != BY_HAND
    ]
    starts = [axis.position() for axis in axes]
    motions = list[Status]()
    for axis in axes:
        with contextlib.suppress(InterlockError):  # a neighbour stands or moves in its way
            motions.append(axis.move_to(inwards(axis)))
    bench.stop()
    for motion in motions:
        with contextlib.suppress(MotionError):
            motion.wait(60)
    assert not any(axis.is_moving() for axis in axes)
    for axis, start in zip(axes, starts, strict=True):
        low, high = axis.limits
        axis.move_to(min(max(start, low), high)).wait(PATIENCE_S)
