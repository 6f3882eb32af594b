"""What a bench file says to the drivers, checked before anything is opened: driver, keys and
address of each device, no stage twice.
"""

from collections.abc import Mapping
from typing import Any

from drivers.interlocks import Mover, Standing, gap_rules
from drivers.registry import AXES, CAMERAS, IRISES, TARGETS
from flflab.bench import AxisDescription, Bench, DeviceDescription
from flflab.errors import InputError

_DRIVERS: Mapping[str, Mapping[str, Any]] = {"camera": CAMERAS, "iris": IRISES, "target": TARGETS}


def path_of(name: str) -> tuple[str, ...]:
    """Where a device stands in the bench file."""
    return (name,) if name in _DRIVERS else ("axes", name)


def device_of(bench: Bench, name: str) -> DeviceDescription:
    """An axis, the camera, iris or target as the bench file has it."""
    return getattr(bench.description, name) if name in _DRIVERS else bench.description.axes[name]


def driver_of(bench: Bench, name: str) -> Any:
    """The driver of a device.

    Raises:
        InputError: there is none of that name, or it does not count what the axis moves.
    """
    drivers, device, where = (
        _DRIVERS.get(name, AXES),
        device_of(bench, name),
        bench.where(*path_of(name), "driver"),
    )
    driver = drivers.get(device.driver)
    if driver is None:
        raise InputError(
            f"{where}: there is no driver {device.driver!r} here; there are {', '.join(drivers)}"
        )
    if isinstance(device, AxisDescription) and driver.counts not in (None, device.coordinate):
        raise InputError(
            f"{where}: {device.driver} counts {driver.counts.dimension}s, but this axis moves"
            f" {device.moves}; give what it moves, or another driver"
        )
    return driver


def require_drivable(bench: Bench) -> None:
    """Refuse what no driver could open, axes that are one stage, makers that share a line, and
    array or sensor that cannot be homed.

    Raises:
        InputError: every such fault, with file, line and field.
    """
    faults: list[str] = []
    stages: dict[tuple[object, ...], str] = {}
    lines: dict[object, str] = {}
    for name in (*bench.description.axes, *_DRIVERS):
        try:
            driver = driver_of(bench, name)
            keys = bench.own_keys(driver.keys, *path_of(name))
            place = _place(bench, name, driver)
        except InputError as fault:
            faults.append(str(fault))
            continue
        if place is None:
            continue
        spoken = device_of(bench, name).driver
        first = lines.setdefault(place, name)
        if (other := device_of(bench, first).driver) != spoken:
            faults.append(
                f"{bench.where(*path_of(name), 'address')}: {name} ({spoken}) shares {place} with"
                f" {first} ({other}); one line speaks one maker's protocol, give each its own"
                " address"
            )
        if name in _DRIVERS:
            continue
        apart: tuple[str, ...] = driver.apart
        stage = spoken, place, *(getattr(keys, key) for key in apart)
        if (twin := stages.setdefault(stage, name)) != name:
            faults.append(
                f"{bench.where('axes', name, *apart[:1])}: {name} is the same stage as {twin},"
                f" {_in_words(stage, apart)}; give each axis {' or '.join(('an address', *apart))}"
                " of its own"
            )
    if faults:
        raise InputError("\n".join(faults))
    _require_homing_free(bench)


def _require_homing_free(bench: Bench) -> None:
    """Refuse what looks for its reference towards a neighbour and cannot, though that one is homed
    and out of the way.

    Raises:
        InputError: with file, line and field.
    """
    for gap in gap_rules(
        bench, {name: axis.limits for name, axis in bench.description.axes.items()}
    ):
        for part, other, away in ((gap.before, gap.behind, "-z"), (gap.behind, gap.before, "+z")):
            if not isinstance(part, Mover) or part.axis.home_towards == away:
                continue
            if isinstance(other, Standing) and other.at is None:
                continue  # nothing says where it stands: refused when it is to move
            homed = {other.name: (other.homed, other.homed)} if isinstance(other, Mover) else {}
            if not gap.smallest(homed) >= gap.least:
                where = bench.where("axes", part.name, "home_towards")
                raise InputError(
                    f"{where}: {part.name} would look for its reference towards"
                    f" {part.axis.home_towards} and could leave {gap.smallest(homed):.3f} mm"
                    f" between {gap}; at least {gap.least:g} mm are kept: let it home towards"
                    f" {away}, or correct its limits"
                )


def _place(bench: Bench, name: str, driver: Any) -> str | None:
    """The address of a device spelt one way; None where it tells nothing, as of what is moved by
    hand or simulated.

    Raises:
        InputError: it is no address.
    """
    address = device_of(bench, name).address
    if address == "simulated":
        return None
    try:
        place = driver.place(address)
    except InputError as error:
        raise InputError(f"{bench.where(*path_of(name), 'address')}: {error}") from error
    return None if driver.place is str else place


def spelt(driver: str, address: str) -> str:
    """The address of an axis spelt one way; as it is where it, or its driver, is none."""
    try:
        return AXES[driver].place(address)
    except (KeyError, InputError):
        return address


def _in_words(stage: tuple[object, ...], apart: tuple[str, ...]) -> str:
    driver, place, *numbers = stage
    return ", ".join(
        [
            f"{driver} at {place}",
            *(f"{key} {number}" for key, number in zip(apart, numbers, strict=True)),
        ]
    )


def one_instrument(serials: Mapping[str, tuple[str, str]]) -> list[str]:
    """A sentence for each two axes behind which one instrument answers.

    Args:
        serials: of each axis the driver and the serial number, empty where its instrument tells
            none; makers count each for himself.
    """
    first: dict[tuple[str, str], str] = {}
    return [
        f"{name} and {first[known]}: one instrument, serial number {known[1]}, answers for both;"
        " correct their addresses in the bench file, nothing moved"
        for name, known in serials.items()
        if known[1] and first.setdefault(known, name) != name
    ]
