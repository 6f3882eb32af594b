"""A camera as anybody's bluesky engine triggers and reads it: every frame goes into a file, and
documents say where it lies.
"""

import threading
import time
import uuid
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.camera import CameraDevice, Frame
from drivers.status import Status
from flflab.errors import DeviceError, RecordError, reason

if TYPE_CHECKING:
    pass

DATASET = "frames"


class Detector:
    """A camera for bluesky; satisfies its Triggerable, Readable, Stageable, Preparable, HasHints
    and WritesStreamAssets.

    Staging begins a new file, ``<UTC>-<camera>.h5`` in ``folder``, with one dataset ``frames`` of
    shape (frames, rows, columns) in DN. A frame is in the file before the event that names it.

    Args:
        camera: any camera; exposure and gain are those last prepared.

    Attributes:
        folder: where files are written; made with the first frame.
        latest: the frame of the last trigger.
    """

    parent = None

    def __init__(self, camera: CameraDevice) -> None:
        self.name = camera.name
        self.camera = camera
        self.folder = Path("frames")
        self.latest: Frame | None = None
        self._file: FrameFile | None = None
        self._pending: list[tuple[str, dict[str, Any]]] = []

    def stage(self) -> list[Any]:
        """Begin a new file with the next frame."""
        self.close()
        return [self]

    def unstage(self) -> list[Any]:
        """End the file."""
        self.close()
        return [self]

    def prepare(self, value: float) -> Status:
        """Set the exposure, s, at gain 1."""
        status = Status(f"{self.name}: expose {value:g} s")
        self.camera.prepare(value, 1.0)
        status.complete()
        return status

    def trigger(self) -> Status:
        """Take one picture in a thread and write it."""
        status = Status(f"{self.name}: take a picture")

        def take() -> None:
            try:
                frame = self.camera.grab()
                self._write(frame)
                self.latest = frame
            except Exception as error:
                status.complete(error)
            else:
                status.complete()

        threading.Thread(target=take, name=f"grab {self.name}", daemon=True).start()
        return status

    def read(self) -> dict[str, Any]:
        """What the last picture is and was taken with.

        Raises:
            DeviceError: there is none.
        """
        now, frame = time.time(), self.latest
        if frame is None:
            raise DeviceError(
                f"{self.name}: asked for a picture before one was taken; trigger it first"
            )
        saturated = int((frame.picture >= self.camera.full_scale).sum())
        values = (
            frame.number, frame.dropped, frame.exposure_s, frame.gain,
            float(frame.picture.mean()), saturated,
        )  # fmt: skip
        return {
            key: {"value": value, "timestamp": now}
            for key, value in zip(self._describe_facts(), values, strict=True)
        }

    def describe(self) -> dict[str, Any]:
        """What ``read`` returns, and the picture beside the document."""
        shape = [1, *(self.latest.picture.shape if self.latest else (0, 0))]
        picture = {
            "source": f"camera {self.name}",
            "dtype": "array",
            "dtype_numpy": "<u2",
            "shape": shape,
            "external": "STREAM:",
        }
        return self._describe_facts() | {self.name: picture}

    def _describe_facts(self) -> dict[str, Any]:
        kinds = {
            "number": ("integer", ""), "dropped": ("integer", ""), "exposure_s": ("number", "s"),
            "gain": ("number", ""), "mean_dn": ("number", "DN"), "saturated": ("integer", ""),
        }  # fmt: skip
        return {
            f"{self.name}_{fact}": {
                "source": f"camera {self.name}", "dtype": kind, "shape": [], "units": unit,
            }
            for fact, (kind, unit) in kinds.items()
        }  # fmt: skip

    @property
    def hints(self) -> dict[str, Any]:
        """What tables and plots show: how bright the picture is, and how much of it saturated."""
        return {"fields": [f"{self.name}_mean_dn", f"{self.name}_saturated"]}

    def get_index(self) -> int:
        """How many pictures the present file holds."""
        return 0 if self._file is None else self._file.count

    def collect_asset_docs(self, index: int | None = None) -> Iterator[tuple[str, dict[str, Any]]]:
        """The documents that say where the last picture lies."""
        pending, self._pending = self._pending, []
        yield from pending

    def close(self) -> None:
        """End the file; may be called again."""
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _write(self, frame: Frame) -> None:
        if self._file is None:
            self._file = FrameFile(self.folder, self.name, frame.picture.shape)
            self._pending.append(("stream_resource", self._file.resource(self.name)))
        self._pending.append(("stream_datum", self._file.add(frame)))


class FrameFile:
    """A file of frames, complete after each: it can be read however the program ends.

    Args:
        folder: made where it is missing.
        name: of the camera.
        shape: (rows, columns).

    Raises:
        RecordError: it cannot be made.
    """

    def __init__(self, folder: Path, name: str, shape: tuple[int, ...]) -> None:
        import h5py  # who only moves a stage does not wait for it

        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%fZ")
        self._place = folder.absolute() / f"{stamp}-{name}.h5"
        self._uid = str(uuid.uuid4())
        self._shape = shape
        self.count = 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file: h5py.File = h5py.File(self._place, "x", locking=False)
            self._frames: Any = self._file.create_dataset(
                DATASET, (0, *shape), "<u2", maxshape=(None, *shape), chunks=(1, *shape)
            )
        except OSError as error:
            raise RecordError(
                f"{self._place}: cannot be made ({reason(error)}); set `folder` of the detector to"
                " one you may write in"
            ) from error

    def resource(self, data_key: str) -> dict[str, Any]:
        """The document that says where the file lies."""
        return {
            "uid": self._uid, "data_key": data_key, "mimetype": "application/x-hdf5",
            "uri": self._place.as_uri(), "run_start": "",
            "parameters": {"dataset": f"/{DATASET}", "chunk_shape": (1, *self._shape)},
        }  # fmt: skip

    def add(self, frame: Frame) -> dict[str, Any]:
        """Write a frame; the document that says which one of the file it is.

        Raises:
            RecordError: the disk did not take it, or it has another size than the first.
        """
        if frame.picture.shape != self._shape:
            raise RecordError(
                f"{self._place}: holds pictures of {self._shape[1]} x {self._shape[0]} pixels, and"
                " another size came; stage the detector anew"
            )
        place = self.count
        try:
            self._frames.resize(place + 1, axis=0)
            self._frames[place] = frame.picture
            self._file.flush()
        except OSError as error:
            raise RecordError(
                f"{self._place}: a frame could not be written ({reason(error)}); make room"
            ) from error
        self.count += 1
        return {
            "uid": f"{self._uid}/{place}", "stream_resource": self._uid, "descriptor": "",
            "indices": {"start": place, "stop": place + 1}, "seq_nums": {"start": 0, "stop": 0},
        }  # fmt: skip

    def close(self) -> None:
        """End it."""
        self._file.close()
