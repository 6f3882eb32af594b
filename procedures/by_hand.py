"""What a person or a script asks of a bench between procedures: go to places of the world, say
where everything stands. The rules are those of the procedures: limits, references and gaps are
checked before anything moves, and again by every axis.
"""

from collections.abc import Mapping
from typing import Any, cast, get_args

from drivers.base import Status, wait_all
from drivers.bench import ConnectedBench
from flflab.bench import Element, Moved, Turn, coordinate_of
from flflab.errors import InputError, LimitError
from flflab.units import parse_quantity
from procedures.steps import in_order, standing

WORLD: tuple[Moved, ...] = (*get_args(Element), *get_args(Turn))
STANDS_THERE = 1e-6  # mm


def moved_by_name(name: str) -> Moved:
    """What a name means: ``sensor.z``, or ``sensor_z`` where no dot can stand.

    Raises:
        InputError: there is nothing of that name.
    """
    head, _, tail = name.replace(".", "_").rpartition("_")
    moved = f"{head}.{tail}"
    if moved not in WORLD:
        raise InputError(f"there is no {name} on a bench; what can move is {', '.join(WORLD)}")
    return moved


def where(bench: ConnectedBench) -> dict[str, float | None]:
    """Where everything stands in the world, mm, and how the array is turned, rad; None of an axis
    that has no reference.

    Raises:
        CommunicationError: an axis does not answer.
    """
    places: dict[str, float | None] = {**standing(bench.described)}
    for name, axis in bench.described.description.axes.items():
        device = bench.axes[name]
        places[axis.moves] = axis.world(device.position()) if device.is_homed() else None
    return {moved: places[moved] for moved in WORLD if moved in places}


def readings_for(bench: ConnectedBench, places: Mapping[str, float | str]) -> dict[str, float]:
    """The readings that put what axes move at places of the world.

    Args:
        bench: the connected bench; nothing moves.
        places: by name, ``sensor.z`` or ``sensor_z``; numbers in mm or rad, or texts with a unit.

    Raises:
        InputError: nothing is called so, nothing moves it, or the place has no unit it could have.
        LimitError: an axis does not reach so far.
    """
    wanted: dict[str, float] = {}
    for given, place in places.items():
        moved = moved_by_name(given)
        found = bench.described.description.axis_of(moved)
        if found is None:
            _require_standing(bench, moved, place)
            continue
        name, axis = found
        world = _place(moved, place)
        low, high = sorted(axis.world(limit) for limit in axis.limits)
        if not low <= world <= high:
            show = axis.coordinate.show
            raise LimitError(
                f"{moved}: asked to go to {show(world, '.4f')}; {name} reaches {show(low, 'g')} to"
                f" {show(high, 'g')}; nothing moved"
            )
        wanted[name] = axis.reading(world)
        bench.axes[name].check_value(wanted[name])
    return wanted


def go(
    bench: ConnectedBench,
    places: Mapping[str, float | str],
    f_number: float | None = None,
    target: str | None = None,
) -> None:
    """Go to places of the world, turn the iris, show a target, and wait until all is done; what is
    impossible is refused before anything moves.

    Args:
        bench: the connected bench.
        places: as ``readings_for`` has them.
        f_number: of the iris; None leaves it.
        target: its kind; None leaves the one that is there.

    Raises:
        InputError: as ``readings_for``.
        LimitError: a place is out of reach, or there is no such f-number or target here.
        NotHomedError: an axis has no reference.
        InterlockError: array and sensor, or other neighbours, would come too near to each other.
        DeviceError: a device failed; whatever was under way was stopped.
    """
    wanted = readings_for(bench, places)
    settings = [
        (setting, value)
        for setting, value in ((bench.iris, f_number), (bench.target, target))
        if value is not None
    ]
    for setting, value in settings:
        cast(Any, setting).check_value(value)
    for name in wanted:
        bench.axes[name].position()  # raises where it has no reference
    groups = in_order(bench.gaps, {name: axis.reach() for name, axis in bench.axes.items()}, wanted)
    try:
        under_way: list[Status] = [cast(Any, setting).set(value) for setting, value in settings]
        for group in groups:
            wait_all(*[bench.axes[name].move_to(reading) for name, reading in group.items()])
        wait_all(*under_way)
    except BaseException:  # Ctrl-C, too: in a notebook nobody leaves a `with`
        for setting, _ in settings:
            setting.stop()
        bench.stop_what_moves()
        raise


def _place(moved: Moved, place: float | str) -> float:
    if not isinstance(place, str):
        return float(place)
    try:
        return parse_quantity(place, coordinate_of(moved).dimension)
    except InputError as error:
        raise InputError(f"{moved}: {error}") from error


def _require_standing(bench: ConnectedBench, moved: Moved, place: float | str) -> None:
    """Let pass what no axis moves where it stands there already.

    Raises:
        InputError: it does not, or nobody knows.
    """
    stands = standing(bench.described).get(cast(Any, moved))
    asked = _place(moved, place)
    if stands is None or abs(stands - asked) > STANDS_THERE:
        at = "nobody knows where it stands" if stands is None else f"it stands at {stands:g} mm"
        raise InputError(
            f"{moved}: asked to go to {place}, but no axis of {bench.described.file} moves it, and"
            f" {at}"
        )
