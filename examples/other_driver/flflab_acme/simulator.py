"""The stage at the other end of the line, in the world of a simulated bench. It is written from the
maker's manual and shares nothing with the driver, so that an error of one shows at the other.
"""

from collections.abc import Sequence

from flflab.bench import Bench
from sim.faults import JAM, Faults
from sim.registry import LINE_FAULTS, MOTOR_FAULTS, Line, SimulatedAxes, faults_of
from sim.stage import RefusedError, Stage
from sim.world import World

COUNT = 1 / 2000  # mm, as the stage leaves the factory
ACCELERATION = 400.0  # mm/s^2
WORDS = {"FS": "stall", "WL": "switch", "NI": "stopped"}


class Controller:
    """A stage with what it says."""

    def __init__(self, stage: Stage, faults: Faults, world: World, serial: int) -> None:
        self.stage, self.faults, self.lock, self._serial = stage, faults, world.lock, serial
        stage.obstruct(faults.obstacle, JAM)

    def answer(self, line: bytes) -> bytes:
        """What it says to one line; nothing to one whose sum is wrong."""
        body, _, given = line.rpartition(b":")
        if given.strip() != f"{sum(body) % 256:02X}".encode() or not self.faults.before(self.stage):
            return b""
        number, command, *words = body.decode("ascii").split(" ")
        try:
            said = f"{number} OK {self._do(command, words)}"
        except (RefusedError, ValueError) as refusal:
            said = f"{number} NO {refusal}"
        return self.faults.reply(sealed(said), one_off=spoilt) or b""

    def _do(self, command: str, words: Sequence[str]) -> str:
        stage = self.stage
        if command == "STATUS":
            wrong = ",".join(WORDS[flag] for flag in sorted(stage.raised) if flag in WORDS)
            return (
                f"{stage.position()} {'homed' if stage.reference == 'homed' else 'lost'}"
                f" {'busy' if stage.busy() else 'idle'} {wrong or '-'}"
            )
        if command == "LIMITS":
            return f"{stage.lower} {stage.upper}"
        if command == "NAME":
            return f"LS-50 {self._serial}"
        if command == "SPEED":
            stage.speed = float(words[0])
        elif command == "CLEAR":
            stage.raised.clear()
        elif command == "HOME":
            stage.home()
        elif command == "MOVE":
            stage.move_to(stage.position() + int(words[0]))
        elif command == "STOP":
            stage.stop()
        else:
            raise RefusedError(f"no command {command}")
        return ""


class Session:
    """One client's conversation."""

    def __init__(self, controller: Controller) -> None:
        self._controller, self._heard = controller, b""

    def receive(self, data: bytes) -> bytes:
        """Answer every whole line."""
        *lines, self._heard = (self._heard + data).split(b"\n")
        with self._controller.lock:
            return b"".join(self._controller.answer(line) for line in lines)

    def unasked(self) -> bytes:
        """Answers that come late."""
        return self._controller.faults.late_answer()


def sealed(text: str) -> bytes:
    """A line with its sum."""
    body = text.encode("ascii")
    return body + f":{sum(body) % 256:02X}\n".encode()


def spoilt(line: bytes) -> bytes:
    """The line with a sum that is one off."""
    body = line[:-4]
    return body + f":{(sum(body) + 1) % 256:02X}\n".encode()


def line_of(bench: Bench, world: World, names: Sequence[str]) -> Line:
    """What answers at the address of one stage."""
    (name,) = names
    axis = bench.description.axes[name]
    low, high = axis.limits
    stage = Stage(
        world.carriages[name], (min(low, 0.0), high), COUNT, axis.speed / COUNT,
        ACCELERATION / COUNT, home=high if axis.homes_up else min(low, 0.0),
    )  # fmt: skip
    serial = 4000 + list(bench.description.axes).index(name)
    controller = Controller(stage, faults_of(bench, name), world, serial)
    return Line(lambda: Session(controller), {name: {}}, {name: controller.faults}, {name: stage})


FAULTS = tuple(kind for kind in LINE_FAULTS if kind != "stranger")  # one stage on a line
AXES = SimulatedAxes(
    line_of, (*MOTOR_FAULTS, *FAULTS, "flip", "wrong-checksum"), share_a_line=False
)
