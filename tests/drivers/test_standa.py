"""The Standa driver on the controller that the maker's own library emulates."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import libximc.highlevel as ximc
import pytest

from drivers.axis import Axis
from drivers.standa import StandaAxis, StandaController, StandaKeys, open_axis
from flflab.bench import AxisDescription
from flflab.errors import CommunicationError, DeviceError, MotionError, NotHomedError

STEP = 0.0025  # mm, of an 8MT175
PARTS = 256


@pytest.fixture
def emulated(tmp_path: Path) -> Callable[..., str]:
    """The address of an emulated controller, set up before by the library alone."""

    def make(*set_ups: Callable[[Any], None]) -> str:
        address = f"xi-emu:///{(tmp_path / 'controller.bin').as_posix().lstrip('/')}"
        axis: Any = ximc.Axis(address)
        axis.open_device()
        for set_up in set_ups:
            set_up(axis)
        axis.close_device()
        return address

    return make


@pytest.fixture
def stage() -> Iterator[Callable[..., StandaAxis]]:
    controllers: list[StandaController] = []

    def connect(address: str, speed: float = 100.0, *, homes_up: bool = False) -> StandaAxis:
        controllers.append(StandaController(address))
        return StandaAxis(
            "stage",
            controllers[-1],
            StandaKeys.model_validate({"step": "2.5 um"}),
            speed,
            homes_up=homes_up,
        )

    yield connect
    for controller in controllers:
        controller.close()


def lose(controller: StandaController) -> None:
    """As a plug pulled does: the next who needs it opens it anew."""
    line = vars(controller)["_line"]
    line.lose(line.get())


def turn_home_round(axis: Any) -> None:
    home = axis.get_home_settings()
    home.HomeFlags |= ximc.HomeFlags.HOME_DIR_FIRST
    axis.set_home_settings(home)


def compensate_play(axis: Any) -> None:
    engine = axis.get_engine_settings()
    engine.EngineFlags |= ximc.EngineFlags.ENGINE_ANTIPLAY
    axis.set_engine_settings(engine)


def set_ends(axis: Any) -> None:
    edges = axis.get_edges_settings()
    edges.BorderFlags |= ximc.BorderFlags.BORDER_IS_ENCODER
    edges.LeftBorder, edges.RightBorder, edges.uRightBorder = -400, 10_000, 128
    axis.set_edges_settings(edges)


def count_an_encoder(axis: Any) -> None:
    feedback = axis.get_feedback_settings()
    feedback.FeedbackType = ximc.FeedbackType.FEEDBACK_ENCODER
    axis.set_feedback_settings(feedback)


def test_it_has_no_reference_until_it_was_homed_and_forgets_it_with_the_connection(
    emulated: Callable[..., str], stage: Callable[..., StandaAxis]
) -> None:
    address = emulated()
    axis = Axis("stage", stage(address), (0.0, 25.0), 100.0)
    with pytest.raises(NotHomedError, match="home it first, nothing moved"):
        axis.move_to(1.0)
    axis.home().wait(5)
    assert axis.warnings() == ()
    axis.move_to(1.0).wait(5)
    assert not stage(address).is_homed()  # another program cannot know


@pytest.mark.parametrize("position", [12.3456789, -0.7654321, 0.0025 / 256, 0.0])
def test_a_move_reads_back_to_the_microstep(
    position: float, emulated: Callable[..., str], stage: Callable[..., StandaAxis]
) -> None:
    axis = Axis("stage", stage(emulated()), (-1.0, 25.0), 100.0)
    axis.home().wait(5)
    axis.move_to(position).wait(5)
    assert axis.position() == pytest.approx(position, abs=STEP / PARTS / 2 * (1 + 1e-9))
    assert axis.position() / STEP * PARTS == pytest.approx(
        round(axis.position() / STEP * PARTS), abs=1e-6
    )


def test_a_controller_that_was_switched_off_since_its_way_was_found_free_does_not_move(
    emulated: Callable[..., str], tmp_path: Path
) -> None:
    controller = StandaController(emulated())
    device = StandaAxis(
        "stage", controller, StandaKeys.model_validate({"step": "2.5 um"}), 100.0, homes_up=False
    )
    axis = Axis("stage", device, (0.0, 25.0), 100.0)

    def switch_off(*_: object) -> None:
        lose(controller)
        (tmp_path / "controller.bin").unlink()  # where the emulated controller remembers

    try:
        axis.home().wait(5)
        axis.guard = switch_off
        with pytest.raises(NotHomedError, match="just lost its reference"):
            axis.move_to(20.0)
        assert device.position() == 0.0
    finally:
        axis.close()
        controller.close()


def test_a_stop_ends_a_motion_on_the_way(
    emulated: Callable[..., str], stage: Callable[..., StandaAxis]
) -> None:
    axis = Axis("stage", stage(emulated(), 5.0), (0.0, 25.0), 5.0)
    axis.home().wait(5)
    status = axis.move_to(20.0)
    axis.stop()
    with pytest.raises(MotionError, match=r"stopped on the way at 0\.\d+ mm"):
        status.wait(5)
    assert not axis.is_moving()
    assert 0 <= axis.position() < 20


def test_the_controllers_own_ends_are_its_travel(
    emulated: Callable[..., str], stage: Callable[..., StandaAxis]
) -> None:
    assert stage(emulated(set_ends)).travel == pytest.approx((-1.0, 25.00125))


def test_connecting_switches_play_compensation_off(emulated: Callable[..., str]) -> None:
    seen: list[int] = []
    controller = StandaController(
        emulated(
            compensate_play, lambda axis: seen.append(int(axis.get_engine_settings().EngineFlags))
        )
    )
    StandaAxis(
        "stage", controller, StandaKeys.model_validate({"step": "2.5 um"}), 100.0, homes_up=False
    )
    controller.close()  # the emulated controller's memory is written then
    emulated(lambda axis: seen.append(int(axis.get_engine_settings().EngineFlags)))
    assert [flags & 8 for flags in seen] == [8, 0]


def test_a_controller_that_was_off_is_told_again_before_it_homes(
    emulated: Callable[..., str], tmp_path: Path
) -> None:
    seen: list[tuple[int, int]] = []

    def look(axis: Any) -> None:
        seen.append(
            (int(axis.get_engine_settings().EngineFlags) & 8, axis.get_move_settings().Speed)
        )

    controller = StandaController(emulated())
    axis = Axis(
        "stage",
        StandaAxis(
            "stage",
            controller,
            StandaKeys.model_validate({"step": "2.5 um"}),
            100.0,
            homes_up=False,
        ),
        (0, 25),
        100,
    )
    axis.home().wait(5)
    lose(controller)
    (tmp_path / "controller.bin").unlink()  # where the emulated controller remembers
    emulated(compensate_play, look)  # as it was delivered
    axis.home().wait(5)
    axis.close()
    controller.close()
    emulated(look)
    assert seen == [(8, 1000), (0, 40_000)]


def test_a_controller_that_homes_the_other_way_is_refused(
    emulated: Callable[..., str], stage: Callable[..., StandaAxis]
) -> None:
    """The rule of the gap relies on ``home_towards``."""
    address = emulated(turn_home_round)
    with pytest.raises(
        DeviceError,
        match="stage: its controller homes towards higher readings; correct `home_towards`",
    ):
        stage(address)
    assert stage(address, homes_up=True).position() == 0


def test_a_controller_that_counts_an_encoder_is_refused(
    emulated: Callable[..., str], stage: Callable[..., StandaAxis]
) -> None:
    with pytest.raises(DeviceError, match="this driver counts motor steps"):
        stage(emulated(count_an_encoder))


def test_it_says_who_it_is(emulated: Callable[..., str], stage: Callable[..., StandaAxis]) -> None:
    assert stage(emulated()).identity() == "XIMC XISM-USB, serial 0, firmware 0.0.0"


def test_nobody_at_the_address_is_said() -> None:
    with pytest.raises(
        CommunicationError, match="xi-com:/dev/no-such-port: cannot be opened; check the address"
    ):
        StandaController("/dev/no-such-port")


@pytest.mark.parametrize("vertical", [True, False])
def test_a_vertical_axis_whose_controller_lets_go_of_it_at_rest_is_refused(
    vertical: bool, emulated: Callable[..., str]
) -> None:
    def save_power(axis: Any) -> None:
        power = axis.get_power_settings()
        power.PowerFlags |= ximc.PowerFlags.POWER_OFF_ENABLED
        axis.set_power_settings(power)

    described = AxisDescription.model_validate(
        {
            "driver": "standa", "address": emulated(save_power), "moves": "sensor.z", "sign": -1,
            "zero": "80 mm", "limits": ["0 mm", "25 mm"], "speed": "2 mm/s", "home_towards": "+z",
            "zero_uncertainty": "0.1 mm", "scale_uncertainty": 0, "vertical": vertical,
        }
    )  # fmt: skip
    keys = StandaKeys.model_validate({"step": "2.5 um"})
    opened: list[Any] = []

    def share(address: str, opener: Callable[[], Any], /) -> Any:
        opened.append(opener())
        return opened[-1]

    try:
        if vertical:
            with pytest.raises(DeviceError, match=r"it is vertical.*would fall.*XILab"):
                open_axis("stage", described, keys, share)
        else:
            open_axis("stage", described, keys, share)
    finally:
        for controller in opened:
            controller.close()
