"""Devices a person moves: asked for on a terminal (a pseudo terminal here), confirmed by Enter,
refused without a terminal.
"""

import math
import os
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from drivers.axis import Axis
from drivers.manual import ManualAxis, ManualAxisKeys, ManualSetting, Terminal, open_axis
from drivers.setting import Setting
from flflab.bench import LENGTH, AxisDescription
from flflab.errors import DeviceError, LimitError, MotionError, NotHomedError

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="a pseudo terminal stands for the person"
)
FOR_EVER = float("inf")


@pytest.fixture
def person(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    """Sit at the terminal; call with what to type, once the question was posed."""
    master, slave = os.openpty()
    keyboard = os.fdopen(slave, "r")
    monkeypatch.setattr(sys, "stdin", keyboard)

    def types(text: str) -> None:
        time.sleep(0.1)
        os.write(master, text.encode())

    yield types
    keyboard.close()
    os.close(master)


def manual_axis(terminal: Terminal) -> Axis:
    return Axis(
        "target_stage",
        ManualAxis("target_stage", (0.0, 100.0), terminal, LENGTH, home=0.0),
        (0.0, 100.0),
        5.0,
        patience=FOR_EVER,
    )


def described(moves: str, home_towards: str, *limits: str) -> AxisDescription:
    return AxisDescription.model_validate(
        {
            "driver": "manual",
            "moves": moves,
            "home_towards": home_towards,
            "limits": limits,
            "speed": f"1 {limits[0].split()[1]}/s",
        }
    )


def opened(axis: AxisDescription) -> Axis:
    commands = open_axis("stage", axis, ManualAxisKeys(), lambda _, opener: opener())
    return Axis(
        "stage", commands, axis.limits, axis.speed, coordinate=axis.coordinate, patience=FOR_EVER
    )


def manual_iris(terminal: Terminal) -> Setting[float]:
    return Setting(
        "iris", ManualSetting("set the iris to f/{}", (1.4, 22.0), terminal), timeout=FOR_EVER
    )


def test_a_stage_moved_by_hand_is_where_the_person_confirmed(
    person: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    axis = manual_axis(Terminal())
    with pytest.raises(NotHomedError):
        axis.move_to(12.5)
    home = axis.home()
    person("\n")
    home.wait(2)
    move = axis.move_to(12.5)
    assert not move.done
    person("\n")
    move.wait(2)
    assert axis.position() == 12.5
    asked = capsys.readouterr().err
    assert "set target_stage to 0.000 mm, then press Enter" in asked
    assert "set target_stage to 12.500 mm, then press Enter" in asked
    axis.close()


def test_what_turns_is_asked_for_in_degrees(
    person: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    axis = opened(described("array.pitch", "-pitch", "-10 deg", "10 deg"))
    home = axis.home()
    person("\n")
    home.wait(2)
    axis.move_to(math.radians(1.5))
    asked = capsys.readouterr().err
    assert "set stage to 0.000 deg, then press Enter" in asked
    assert "set stage to 1.500 deg, then press Enter" in asked
    axis.close()


@pytest.mark.parametrize(("home_towards", "end"), [("-z", "-25"), ("+z", "25")])
def test_an_array_is_asked_for_where_the_rule_of_the_gap_has_it_home(
    home_towards: str, end: str, person: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    axis = opened(described("array.z", home_towards, "-25 mm", "25 mm"))
    axis.home()
    assert f"set stage to {end}.000 mm, then press Enter" in capsys.readouterr().err
    axis.close()


def test_an_enter_from_before_the_question_confirms_nothing(person: Callable[[str], None]) -> None:
    person("\n")
    iris = manual_iris(Terminal())
    change = iris.set(4.0)
    time.sleep(0.1)
    assert not change.done
    person("\n")
    change.wait(2)
    assert iris.value() == 4.0
    iris.close()


def test_two_steps_are_asked_for_one_after_the_other(person: Callable[[str], None]) -> None:
    terminal = Terminal()
    iris = manual_iris(terminal)
    target = Setting(
        "target",
        ManualSetting("put the target {} in place", ("bars", "white"), terminal),
        timeout=FOR_EVER,
    )
    first, second = iris.set(4.0), target.set("bars")
    person("\n")
    first.wait(2)
    assert not second.done
    person("\n")
    second.wait(2)
    assert (iris.value(), target.value()) == (4.0, "bars")
    iris.close()
    target.close()


def test_what_is_in_place_already_is_not_asked_for_again(person: Callable[[str], None]) -> None:
    iris = manual_iris(Terminal())
    change = iris.set(4.0)
    person("\n")
    change.wait(2)
    iris.set(4.0).wait(2)
    iris.close()


def test_a_person_can_give_up(person: Callable[[str], None]) -> None:
    iris = manual_iris(Terminal())
    change = iris.set(4.0)
    person("q\n")
    with pytest.raises(MotionError, match=r"set the iris to f/4\.0: given up"):
        change.wait(2)
    iris.close()


def test_closing_takes_the_question_back(person: Callable[[str], None]) -> None:
    axis, iris = manual_axis(Terminal()), manual_iris(Terminal())
    home, change = axis.home(), iris.set(4.0)
    axis.close()
    iris.close()
    assert isinstance(home.exception(), MotionError)
    assert isinstance(change.exception(), MotionError)


def test_without_a_terminal_the_step_is_named_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    axis, iris = manual_axis(Terminal()), manual_iris(Terminal())
    with pytest.raises(DeviceError, match=r"set target_stage to 0\.000 mm; there is no terminal"):
        axis.home()
    with pytest.raises(DeviceError, match=r"set the iris to f/4\.0; there is no terminal"):
        iris.set(4.0)
    with pytest.raises(LimitError):
        iris.set(32.0)
    with pytest.raises(DeviceError, match="not confirmed yet"):
        iris.value()
    axis.close()
    iris.close()
