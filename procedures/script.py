"""A bench that a script holds in one hand: home, go to places of the world, take pictures, keep
them in a record that every command reads.
"""

import contextlib
from pathlib import Path
from types import TracebackType
from typing import Any

from event_model import ComposeDescriptorBundle, ComposeRunBundle, compose_run

from drivers.base import Frame
from drivers.bench import ConnectedBench, connect_as
from flflab.bench import read_bench
from flflab.errors import DeviceError, RecordError
from flflab.record import RECORD_SCHEMA, Recording, run_folder, versions
from flflab.units import parse_quantity
from procedures.by_hand import go, where
from procedures.descriptions import with_descriptions
from procedures.devices import NO_CONFIGURATION, Frames, Shot, Stages
from procedures.log import logged

FIRST_EXPOSURE = "10 ms"
MOST_FRAMES = 100


class ScriptBench(ConnectedBench):
    """A connected bench for scripts and notebooks; a context manager.

    Axes are attributes, too, as in ``bench.sensor_stage.move_to(18.8).wait()``; ``iris``,
    ``target``, ``camera`` and ``detector`` are the devices. Leaving it after an error stops every
    axis first.
    """

    def go(
        self, *, f_number: float | None = None, target: str | None = None, **places: float | str
    ) -> None:
        """Go to places of the world, turn the iris, show a target, and wait until all is done; what
        is impossible is refused before anything moves.

        Args:
            f_number: of the iris.
            target: its kind.
            places: ``main_lens_z``, ``array_z``, ``sensor_z``, ``target_z``, ``array_roll``,
                ``array_pitch``, ``array_yaw``: mm or rad, or a text with its unit.

        Raises:
            LimitError: a place is out of reach, or there is no such f-number or target here.
            NotHomedError: an axis has no reference.
            InterlockError: array and sensor, or other neighbours, would come too near to each
                other.
            InputError: nothing is called so, or nothing moves it.
            DeviceError: a device failed; whatever was under way was stopped.
        """
        go(self, places, f_number, target)

    def where(self) -> dict[str, float | None]:
        """Where everything stands in the world, mm, and how the array is turned, rad, by the names
        of the bench file: ``sensor.z``; None of an axis that has no reference.
        """
        return where(self)

    def snap(self, exposure: float | str = FIRST_EXPOSURE, gain: float = 1.0) -> Frame:
        """Take one picture of whatever stands before the camera; nothing is recorded.

        Args:
            exposure: s, or a text with its unit.
            gain: a factor.

        Raises:
            LimitError: outside what the camera can do.
            CommunicationError: the frame came late, torn, lost or out of turn.
        """
        self.camera.prepare(_seconds(exposure), gain)
        return self.camera.grab()

    def record(
        self, name: str, out: str | Path | None = None, frames: int = MOST_FRAMES
    ) -> "ScriptRun":
        """A record for what is taken inside its ``with`` block, of the same form as a sweep's.

        Args:
            name: of the run, a word for its folder.
            out: its folder, new or empty; ``runs/<UTC>-<name>`` without one.
            frames: how many there may be at most: the disk is asked for room before the first.
        """
        return ScriptRun(self, name, None if out is None else Path(out), frames)


class ScriptRun:
    """A run that a script records; a context manager.

    A script that ends by an error, or by Ctrl-C, leaves what was recorded so far, with the reason.

    Args:
        bench: the connected bench.
        name: of the run.
        out: its folder.
        frames: at most.
    """

    def __init__(self, bench: ScriptBench, name: str, out: Path | None, frames: int) -> None:
        self._bench, self._name, self._out, self._most = bench, name, out, frames
        self._open = contextlib.ExitStack()
        self._recording: Recording | None = None

    def __enter__(self) -> "ScriptRun":
        """Begin the record.

        Raises:
            RecordError: the folder holds a run already or cannot be written, or the disk is full.
        """
        bench, described = self._bench, self._bench.described
        columns, rows = described.optics.sensor.resolution
        with contextlib.ExitStack() as undo:
            folder = undo.enter_context(run_folder(self._out, self._name))
            recording = Recording(folder, self._most, (rows, columns))
            undo.callback(recording.close)
            with_descriptions(recording, described, None)
            undo.enter_context(logged(recording))
            self.folder = folder
            self._recording = recording
            self._frames = Frames(bench.camera, recording)
            self._stages = Stages(bench.axes, described)
            self._stream: ComposeDescriptorBundle | None = None
            self._run: ComposeRunBundle = compose_run(
                metadata={
                    "record_schema": RECORD_SCHEMA, "plan_name": "script", "study": self._name,
                    "axes": list(bench.axes),
                    "configurations": [],
                    "sensor_noise": {
                        "dn_per_electron": bench.camera.dn_per_electron,
                        "read_noise_dn": bench.camera.read_noise_dn,
                        "offset_dn": bench.camera.offset_dn,
                        "full_scale_dn": bench.camera.full_scale,
                    },
                    "devices": [row._asdict() for row in bench.identities()],
                    "seed": described.description.simulated.seed, "software": versions(),
                }
            )  # fmt: skip
            recording.document("start", self._run.start_doc)
            self._open = undo.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        recording, self._recording = self._recording, None
        with self._open:
            if error is not None:
                self._bench.stop_what_moves()
            if recording is not None:
                recording.document("stop", self._run.compose_stop(**_ending(error)))

    def snap(
        self, note: str = "", exposure: float | str = FIRST_EXPOSURE, gain: float = 1.0
    ) -> Frame:
        """Take one picture and record it with everything the bench reads.

        Args:
            note: what is to be known of it.
            exposure: s, or a text with its unit.
            gain: a factor.

        Raises:
            DeviceError: an axis moves, or the camera failed; nothing was recorded.
            MotionError: an axis, the iris or the target changed while the picture was taken.
            NotHomedError: an axis has no reference.
            LimitError: the camera cannot expose so.
            RecordError: the run has ended or has no more room, or the disk is full.
        """
        recording, stages = self._recording, self._stages
        if recording is None:
            raise RecordError(
                f"{self._name}: a picture outside the `with` block of its run; take it inside"
            )
        self._require_rest()
        stages.sent = {name: axis.position() for name, axis in self._bench.axes.items()}
        place = recording.recorded
        shot = Shot(f"snap/{place}", NO_CONFIGURATION, place, _seconds(exposure), gain)
        self._frames.prepare(shot)
        stages.before.trigger().wait()
        self._frames.trigger().wait()
        devices = (stages, self._bench.iris, self._bench.target, self._frames)
        readings: dict[str, Any] = {}
        for device in devices:
            readings |= device.read()
        assets = list(self._frames.collect_asset_docs())  # writes the picture before its event
        stream = self._stream or self._describe(*devices)
        for name, document in assets:
            if name == "stream_resource":
                recording.document(name, document | {"run_start": self._run.start_doc["uid"]})
                continue
            count = {"start": place + 1, "stop": place + 2}
            recording.document(
                name, document | {"descriptor": stream.descriptor_doc["uid"], "seq_nums": count}
            )
        data = {key: reading["value"] for key, reading in readings.items()} | {"note": note}
        stamps = {key: reading["timestamp"] for key, reading in readings.items()}
        stamps["note"] = stamps["point"]
        recording.document("event", stream.compose_event(data=data, timestamps=stamps))
        recording.settle()
        assert self._frames.latest is not None  # noqa: S101 - the trigger ended well
        return self._frames.latest

    def _require_rest(self) -> None:
        moving = [name for name, axis in self._bench.axes.items() if axis.is_moving()]
        if moving:
            raise DeviceError(
                f"{moving[0]}: it still moves; wait with `.wait()` before taking a"
                " picture. Nothing was recorded"
            )

    def _describe(self, *devices: Any) -> ComposeDescriptorBundle:
        """The descriptor of the run's events, made and recorded before the first."""
        note = {"note": {"source": "script", "dtype": "string", "shape": []}}
        keys = {device.name: list(device.describe()) for device in devices} | {"script": ["note"]}
        stages = self._stages.read_configuration()
        configuration = {
            self._stages.name: {
                "data": {key: speed["value"] for key, speed in stages.items()},
                "timestamps": {key: speed["timestamp"] for key, speed in stages.items()},
                "data_keys": self._stages.describe_configuration(),
            }
        }
        described: dict[str, Any] = {}
        for device in devices:
            described |= device.describe()
        self._stream = self._run.compose_descriptor(
            name="primary", data_keys=described | note, object_keys=keys,
            configuration=configuration,
        )  # fmt: skip
        if self._recording is not None:
            self._recording.document("descriptor", self._stream.descriptor_doc)
        return self._stream


def connect(bench: str | Path) -> ScriptBench:
    """Connect to every device of a bench file; nothing moves.

    Args:
        bench: the bench file.

    Raises:
        InputError: the bench file is wrong; every fault with file, line and field.
        DeviceError: another program drives the bench, or devices are missing or wrong: every fault
            in one message; nothing stays open.
    """
    return connect_as(ScriptBench, read_bench(Path(bench)))


def _seconds(exposure: float | str) -> float:
    return parse_quantity(exposure, "time") if isinstance(exposure, str) else float(exposure)


def _ending(error: BaseException | None) -> dict[str, Any]:
    if error is None:
        return {"exit_status": "success"}
    if isinstance(error, KeyboardInterrupt):
        return {"exit_status": "abort", "reason": "interrupted by the operator"}
    return {"exit_status": "fail", "reason": str(error) or type(error).__name__}
