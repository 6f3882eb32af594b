"""What a procedure reads at every point beside the devices themselves: the stages with world
positions, and the recorded frames.
"""

import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.base import Axis, CameraDevice, Frame, Status
from flflab.bench import Bench, Element
from flflab.errors import DeviceError, MotionError
from flflab.record import ELEMENTS, Recording, checksum, world_key
from procedures.steps import standing

NO_CONFIGURATION = -1
MOVED = "moved_steps"  # a column of records
STRAYED = 3.0  # resolutions: a motion may end one away, and a servo hunts by as much


class Triggered:
    """Anything that takes time as something to trigger in a plan.

    Args:
        name: what it is.
        start: starts it.
    """

    parent = None

    def __init__(self, name: str, start: Callable[[], Status]) -> None:
        self.name = name
        self._start = start

    def trigger(self) -> Status:
        """Start it."""
        return self._start()


class Stages:
    """All axes as one readable: their readings, and where the elements then stand, world z, mm.

    ``sent`` is kept by who moves them: where axes were sent, or homed to, and have to stand.

    Args:
        axes: the connected axes by name.
        bench: the bench file.
    """

    name = "stages"
    parent = None

    def __init__(self, axes: Mapping[str, Axis], bench: Bench) -> None:
        self.sent: dict[str, float] = {}
        self.before = Triggered("where the axes stand before an exposure", self._note)
        self._axes = axes
        self._bench = bench
        self._noted: dict[str, float] | None = None

    def _note(self) -> Status:
        """Keep where the axes stand now, for the next ``read`` to tell who moved since."""
        status = Status("read the axes before an exposure")
        self._noted = {name: axis.position() for name, axis in self._axes.items()}
        status.complete()
        return status

    def worlds(self, readings: Mapping[str, float]) -> dict[Element, float]:
        """World z of every element at these readings, mm; an element of unknown place is left
        out.
        """
        moved = {
            axis.moves: axis.world(readings[name])
            for name, axis in self._bench.description.axes.items()
        }
        places = standing(self._bench) | moved
        return {element: places[element] for element in ELEMENTS if element in places}

    def read(self) -> dict[str, Any]:
        """Each axis asked once.

        Raises:
            MotionError: one stands elsewhere than it was sent.
        """
        now = time.time()
        readings = {name: axis.position() for name, axis in self._axes.items()}
        for name, sent in self.sent.items():
            axis, reading = self._axes[name], readings[name]
            if abs(reading - sent) > STRAYED * axis.resolution:
                show = axis.coordinate.show
                raise MotionError(
                    f"{name}: sent to {show(sent, '.4f')}, it now stands at {show(reading, '.4f')};"
                    " see what pushed it, this frame was not recorded"
                )
        values = {
            self._axes[name].coordinate.column(name): reading for name, reading in readings.items()
        } | {world_key(element): z for element, z in self.worlds(readings).items()}
        values[MOVED], self._noted = self._moved(readings), None
        return {key: {"value": value, "timestamp": now} for key, value in values.items()}

    def _moved(self, readings: Mapping[str, float]) -> float:
        """By how many of its steps an axis moved since ``before``, the largest; -1 where nobody
        looked.
        """
        if self._noted is None:
            return -1.0
        return max(
            abs(readings[name] - noted) / self._axes[name].resolution
            for name, noted in self._noted.items()
        )

    def describe(self) -> dict[str, Any]:
        """What ``read`` returns."""
        units: dict[str, str] = {
            axis.coordinate.column(name): axis.coordinate.unit for name, axis in self._axes.items()
        }
        units |= dict.fromkeys(
            [world_key(element) for element in self.worlds(dict.fromkeys(self._axes, 0.0))], "mm"
        )
        units[MOVED] = ""
        return {
            key: {"source": "axes", "dtype": "number", "shape": [], "units": unit}
            for key, unit in units.items()
        }

    def read_configuration(self) -> dict[str, Any]:
        """Speeds."""
        return {
            key: value
            for axis in self._axes.values()
            for key, value in axis.read_configuration().items()
        }

    def describe_configuration(self) -> dict[str, Any]:
        """What ``read_configuration`` returns."""
        return {
            key: value
            for axis in self._axes.values()
            for key, value in axis.describe_configuration().items()
        }


@dataclass(frozen=True)
class Shot:
    """What the next picture is for and how it is exposed; the key is the point's, each once in a
    run.
    """

    key: str
    configuration: int
    repeat: int
    exposure_s: float
    gain: float = 1.0


@dataclass(frozen=True)
class Picture:
    """A frame, what it is for, and what is computed of it as soon as it is there: its checksum, and
    how many pixels are saturated.
    """

    shot: Shot
    frame: Frame
    crc32: str
    saturated: int


class Frames:
    """The camera of a procedure: prepared for a shot, triggered, and, where its picture is good,
    read into the record.

    A picture enters the record when it is read: it is written before the event that names it.
    ``light`` and ``arrival`` are what can be triggered instead of the whole: the one is done when
    the light is in and things may move, the other when the picture is there.

    Args:
        camera: any camera.
        recording: where pictures go.
        places: of the frames recorded before, by their keys.
    """

    name = "camera"
    parent = None

    def __init__(
        self, camera: CameraDevice, recording: Recording, places: Mapping[str, int] | None = None
    ) -> None:
        self.camera = camera
        self.places = dict(places or {})
        self._recording = recording
        self.shot: Shot | None = None
        self.latest: Frame | None = None
        self.light = Triggered("light", self._expose)
        self.arrival = Triggered("arrival", lambda: self._arriving)
        self._arriving = Status("no picture yet")
        self.arrived: Picture | None = None
        self._resource = str(uuid.uuid4())
        self._told = False

    def prepare(self, value: Shot) -> Status:
        """Set the exposure for a shot."""
        status = Status(f"{self.name}: expose {value.exposure_s:g} s")
        self.shot = value
        self.camera.prepare(value.exposure_s, value.gain)
        status.complete()
        return status

    def trigger(self) -> Status:
        """Take one picture in a thread."""
        self._expose()
        return self._arriving

    def _expose(self) -> Status:
        exposed, arriving = Status(f"{self.name}: expose"), Status(f"{self.name}: take a picture")
        self._arriving = arriving
        shot = self.shot

        def take() -> None:
            try:
                self.latest = frame = self.camera.grab(exposed.complete)
                saturated = int(np.count_nonzero(frame.picture >= self.camera.full_scale))
                self.arrived = (
                    Picture(shot, frame, checksum(frame.picture), saturated) if shot else None
                )
            except Exception as error:
                exposed.complete(error)
                arriving.complete(error)
            else:
                exposed.complete()
                arriving.complete()

        threading.Thread(target=take, name=f"grab {self.name}", daemon=True).start()
        return exposed

    def read(self) -> dict[str, Any]:
        """What the last picture is and was taken with.

        Raises:
            DeviceError: there is none.
        """
        shot, picture = self.shot, self.arrived
        if shot is None or picture is None:
            raise DeviceError(f"{self.name}: no picture was taken yet; prepare and trigger first")
        frame = picture.frame
        values = (
            shot.key, shot.configuration, shot.repeat, frame.exposure_s, frame.gain,
            frame.number, frame.timestamp, frame.dropped, picture.saturated, picture.crc32,
        )  # fmt: skip
        now = time.time()
        return {
            key: {"value": value, "timestamp": now}
            for key, value in zip(self._describe_facts(), values, strict=True)
        }

    def describe(self) -> dict[str, Any]:
        """What ``read`` returns, and the picture beside the document."""
        shape = [1, *(self.latest.picture.shape if self.latest else (0, 0))]
        picture = {
            "source": f"camera {self.camera.name}",
            "dtype": "array",
            "dtype_numpy": "<u2",
            "shape": shape,
            "external": "STREAM:",
        }
        return self._describe_facts() | {"frame": picture}

    def _describe_facts(self) -> dict[str, Any]:
        kinds = {
            "point": "string", "configuration": "integer", "repeat": "integer",
            "exposure_s": "number", "gain": "number",
            "number": "integer", "camera_clock_s": "number", "dropped": "integer",
            "saturated": "integer", "crc32": "string",
        }  # fmt: skip
        return {
            key: {"source": f"camera {self.camera.name}", "dtype": kind, "shape": []}
            for key, kind in kinds.items()
        }

    def get_index(self) -> int:
        """How many pictures the record holds."""
        return self._recording.recorded

    def collect_asset_docs(self, index: int | None = None) -> Iterator[tuple[str, dict[str, Any]]]:
        """Write the last picture to the record; the documents that say where it lies."""
        if self.arrived is None or self.shot is None:
            return
        place = self._recording.frame(self.arrived.frame.picture)
        self.places[self.shot.key] = place
        if not self._told:
            self._told = True
            yield "stream_resource", self._recording.stream_resource(self._resource, "frame")
        yield (
            "stream_datum",
            {
                "uid": f"{self._resource}/{place}", "stream_resource": self._resource,
                "descriptor": "",
                "indices": {"start": place, "stop": place + 1}, "seq_nums": {"start": 0, "stop": 0},
            },
        )  # fmt: skip
