"""A run's folder: documents and frames written as they come, readable after a crash, read back with json and h5py alone.

``documents.jsonl`` holds event-model documents, ``{"name": ..., "doc": ...}`` on a line each; ``frames.h5`` holds one dataset
``frames`` of shape (n, rows, columns). The dataset is allocated at its full size before the first frame: adding a frame changes
nothing else in the file, so it can be read whenever the writer was killed. A frame is flushed before the event that names it.
"""

import json
import os
import platform
import re
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, cast, get_args

import h5py
import numpy as np
import numpy.typing as npt
import yaml

from flflab.bench import ANGLE, LENGTH, Bench, Element
from flflab.description import read_yaml
from flflab.errors import RecordError

ELEMENTS: tuple[Element, ...] = get_args(Element)
DOCUMENTS, FRAMES, DATASET = "documents.jsonl", "frames.h5", "frames"
SPARE_BYTES = 50_000_000  # documents, log, report
PACKAGES = ("flflab", "bluesky", "event-model", "h5py", "numba", "numpy", "opencv-contrib-python-headless", "pydantic", "pyserial", "scipy")
Picture = npt.NDArray[np.uint16]


def new_folder(study: str, parent: Path = Path("runs")) -> Path:
    """Make ``runs/<UTC>-<study>``, a folder that did not exist before.

    Raises:
        RecordError: it cannot be made.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    for again in ("", *(f"-{count}" for count in range(2, 100))):
        folder = parent / f"{stamp}-{study}{again}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise RecordError(f"{folder}: cannot be made ({error}); give a folder you may write in") from error
        return folder
    raise RecordError(f"{parent}: a hundred runs of {study} began in this second; wait a second")


def claim_folder(folder: Path) -> Path:
    """Make a folder for one run, or take one that holds no run yet.

    Raises:
        RecordError: it holds a run already, or cannot be made.
    """
    held = [name for name in (DOCUMENTS, FRAMES) if (folder / name).exists()]
    if held:
        raise RecordError(f"{folder}: holds a run already ({', '.join(held)}) and runs are never overwritten; give another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"{folder}: cannot be made ({error}); give a folder you may write in") from error
    return folder


def keep_descriptions(folder: Path, bench: Bench, study_file: Path | None) -> None:
    """Write bench.yaml, camera.yaml and study.yaml as used, and versions.json.

    Args:
        folder: the run's.
        bench: the bench as read; its copy names ``camera.yaml`` as its optics.
        study_file: the study's YAML file; None where a procedure has none.

    Raises:
        RecordError: the folder cannot be written.
    """
    text = bench.file.read_text(encoding="utf-8")
    copied, found = re.subn(r"(?m)^optics:.*$", "optics: camera.yaml", text)
    if found != 1:  # written in another style: without the comments, but right
        data, _ = read_yaml(bench.file)
        copied = yaml.safe_dump(data | {"optics": "camera.yaml"}, sort_keys=False, allow_unicode=True)
    try:
        (folder / "bench.yaml").write_text(copied, encoding="utf-8")
        shutil.copyfile(bench.file.parent / bench.description.optics, folder / "camera.yaml")
        if study_file is not None:
            shutil.copyfile(study_file, folder / "study.yaml")
        (folder / "versions.json").write_text(json.dumps(versions(), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{folder}: cannot be written ({error}); give a folder you may write in") from error


def versions() -> dict[str, str]:
    """What ran: Python, platform and the packages that matter; absent ones are left out."""
    found = {"python": sys.version.split()[0], "platform": platform.platform()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


class Recording:
    """Writes the documents and frames of one run; usable as a callback of a bluesky engine.

    Args:
        folder: the run's, made before.
        frames: how many frames there may be at most.
        shape: (rows, columns) of each.

    Raises:
        RecordError: there is a run already, too little space, or no permission.
    """

    def __init__(self, folder: Path, frames: int, shape: tuple[int, int]) -> None:
        self.folder = folder
        self.recorded = 0
        needed, free = frames * shape[0] * shape[1] * 2 + SPARE_BYTES, shutil.disk_usage(folder).free
        if needed > free:
            raise RecordError(
                f"{folder}: the run needs {needed / 1e9:.2f} GB for {frames} frames, {free / 1e9:.2f} GB are free; "
                "make room or give a folder on another disk"
            )
        try:
            self._documents = (folder / DOCUMENTS).open("x", encoding="utf-8", newline="\n")
            self._file = h5py.File(folder / FRAMES, "x")
        except OSError as error:
            raise RecordError(f"{folder}: a record cannot be begun there ({error}); give another folder") from error
        at_once = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        at_once.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        at_once.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        self._frames = self._file.create_dataset(DATASET, (frames, *shape), "<u2", dcpl=at_once)
        self._file.flush()

    def frame(self, picture: Picture) -> int:
        """Write a frame and flush it; returns its place in the dataset.

        Raises:
            RecordError: it does not fit, or the disk does not take it.
        """
        count, rows, columns = self._frames.shape
        if picture.shape != (rows, columns):
            raise RecordError(
                f"{self.folder}: the camera gives pictures of {picture.shape[1]} x {picture.shape[0]} pixels, its camera file says "
                f"{columns} x {rows}; correct sensor.resolution there"
            )
        if self.recorded == count:
            raise RecordError(f"{self.folder}: the record has room for {count} frames and they are taken; plan for more")
        try:
            self._frames[self.recorded] = picture
            self._file.flush()
        except OSError as error:
            raise RecordError(f"{self.folder}: a frame could not be written ({error}); make room and start again") from error
        self.recorded += 1
        return self.recorded - 1

    def document(self, name: str, doc: Mapping[str, Any]) -> None:
        """Write a document, on the disk before this returns.

        Raises:
            RecordError: the disk does not take it.
        """
        line = json.dumps({"name": name, "doc": doc}, default=_plain)
        try:
            self._documents.write(line + "\n")
            self._documents.flush()
            os.fsync(self._documents.fileno())
        except OSError as error:
            raise RecordError(f"{self.folder}: a document could not be written ({error}); make room and start again") from error

    def stream_resource(self, uid: str, data_key: str) -> dict[str, Any]:
        """The document that says where frames lie; its path is relative to the run's folder."""
        parameters = {"dataset": f"/{DATASET}", "chunk_shape": (1, *self._frames.shape[1:])}
        return {
            "uid": uid, "data_key": data_key, "mimetype": "application/x-hdf5", "uri": FRAMES, "parameters": parameters, "run_start": "",
        }  # fmt: skip

    def discard(self) -> None:
        """Close and remove both files, where nothing was recorded."""
        self.close()
        for name in (DOCUMENTS, FRAMES):
            (self.folder / name).unlink()

    def close(self) -> None:
        """End both files; the folder is complete then."""
        self._documents.close()
        self._file.close()


def _plain(value: object) -> object:
    """What numpy holds, as json has it."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{value!r} has no place in a document")


@dataclass(frozen=True)
class FrameRecord:
    """One recorded frame and the bench when it was taken.

    Attributes:
        key: the point's, each once in a run: ``c3/bars/0`` is the first bars frame of configuration 3, ``dark/0.01s/0`` a dark one.
        configuration: index of the study's configuration; None for a dark frame.
        target: name of the target in place.
        repeat: counts the frames of one target in one configuration.
        f_number: by the iris's reading.
        readings: of all axes, mm or rad.
        worlds: world z in mm of main lens, array, sensor and target, by those readings.
        exposure_s: as the camera says.
        gain: factor.
        saturated: number of pixels at full scale.
        number: the camera's own count of exposures.
        index: place in frames.h5.
        time: s since 1970, this computer's clock.
    """

    key: str
    configuration: int | None
    target: str
    repeat: int
    f_number: float
    readings: dict[str, float]
    worlds: dict[Element, float]
    exposure_s: float
    gain: float
    saturated: int
    number: int
    index: int
    time: float

    @property
    def distance(self) -> float:
        """Main lens to target, mm, positive in front."""
        return self.worlds["main_lens.z"] - self.worlds["target.z"]

    @property
    def array(self) -> float:
        """Main lens to array, mm."""
        return self.worlds["array.z"] - self.worlds["main_lens.z"]

    @property
    def sensor(self) -> float:
        """Main lens to sensor, mm."""
        return self.worlds["sensor.z"] - self.worlds["main_lens.z"]


@dataclass(frozen=True)
class Run:
    """A run as recorded: its start document, its frames in the order taken, its stop document (None where it never ended)."""

    folder: Path
    start: Mapping[str, Any]
    frames: tuple[FrameRecord, ...]
    stop: Mapping[str, Any] | None

    @property
    def sensor_noise(self) -> dict[str, float]:
        """What the camera said of its noise at gain 1: dn_per_electron, read_noise_dn, offset_dn, full_scale_dn."""
        return dict(self.start["sensor_noise"])

    def dark(self, exposure_s: float) -> FrameRecord | None:
        """The first dark frame of an exposure."""
        return next((frame for frame in self.frames if frame.configuration is None and frame.exposure_s == exposure_s), None)

    def picture(self, record: FrameRecord) -> Picture:
        """The picture of a frame, shape (rows, columns), DN.

        Raises:
            RecordError: frames.h5 is missing or does not hold it.
        """
        try:
            with h5py.File(self.folder / FRAMES, "r") as file:
                return np.asarray(cast(Any, file[DATASET])[record.index], dtype=np.uint16)
        except (OSError, KeyError, ValueError, IndexError) as error:
            raise RecordError(f"{self.folder / FRAMES}: frame {record.key} cannot be read ({error})") from error


def read_documents(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """The documents of a run in their order; a last line that a crash cut short is left out.

    Raises:
        RecordError: there are none, or a line before the last is no document.
    """
    file = folder / DOCUMENTS
    try:
        lines = file.read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError as error:
        raise RecordError(f"{file}: cannot be read ({error}); give the folder of a run") from error
    for number, line in enumerate(lines[:-1], start=1):  # what stands after the last line end is empty or cut short
        try:
            pair = json.loads(line)
            yield pair["name"], pair["doc"]
        except (ValueError, KeyError, TypeError) as error:
            raise RecordError(f"{file}:{number}: not a document ({error}); the file was changed after it was written") from error


def read_run(folder: Path) -> Run:
    """Read a run back, finished or not.

    Raises:
        RecordError: the folder holds no run, or one that was changed after it was written.
    """
    folder = Path(folder)
    start: dict[str, Any] | None = None
    stop: dict[str, Any] | None = None
    frames: dict[str, FrameRecord] = {}
    place = -1
    for name, doc in read_documents(folder):
        try:
            if name == "start" and start is None:
                start = doc
            elif name == "stop":
                stop = doc
            elif name == "stream_datum":
                place = int(doc["indices"]["start"])
            elif name == "event":
                frame = _frame_of(doc["data"], doc["time"], place, (start or {}).get("axes", ()))
                frames[frame.key] = frame
        except (KeyError, TypeError, ValueError) as error:
            raise RecordError(f"{folder / DOCUMENTS}: a {name} document lacks {error}; it is not a run of flflab") from error
    if start is None:
        raise RecordError(f"{folder / DOCUMENTS}: holds no start of a run")
    return Run(folder, start, tuple(frames.values()), stop)


def world_key(element: Element) -> str:
    """The column of an element's world z: ``world_array_z_mm``."""
    return f"world_{element.replace('.', '_')}_mm"


def _reading(data: Mapping[str, Any], axis: str) -> float:
    """An axis's reading: a column in rad where it turns, else one in mm."""
    return float(data[column if (column := ANGLE.column(axis)) in data else LENGTH.column(axis)])


def _frame_of(data: Mapping[str, Any], time: float, place: int, axes: Iterable[str]) -> FrameRecord:
    configuration = int(data["configuration"])
    return FrameRecord(
        key=data["point"], configuration=None if configuration < 0 else configuration, target=data["target"], repeat=int(data["repeat"]),
        f_number=float(data["iris"]), readings={axis: _reading(data, axis) for axis in axes},
        worlds={element: float(data[world_key(element)]) for element in ELEMENTS}, exposure_s=float(data["exposure_s"]),
        gain=float(data["gain"]), saturated=int(data["saturated"]), number=int(data["number"]), index=place, time=time,
    )  # fmt: skip
