"""Reads a run back, finished or not, with json and h5py alone; every frame is checked against the
sum recorded with it.
"""

import contextlib
import json
import math
import os
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import h5py
import numpy as np
import numpy.typing as npt

from flflab.bench import ANGLE, LENGTH, Element
from flflab.errors import InputError, RecordError
from flflab.files.hdf5 import CutShort, cut_short, member, opened_hdf5
from flflab.record.checksums import checksum, verify_sums
from flflab.record.folder import DATASET, DOCUMENTS, FRAMES, require_files
from flflab.record.frame_record import AccuracyRecord, FrameRecord
from flflab.record.validity import validities

ELEMENTS: tuple[Element, ...] = get_args(Element)
ACCURACY = (  # the column that tells an event of accuracy from one of a frame
    "mtf_standard_uncertainty"
)
Picture = npt.NDArray[np.uint16]
Document = tuple[str, dict[str, Any]]


@dataclass(frozen=True)
class Run:
    """A run as recorded, in one go or in several.

    Attributes:
        folder: where it lies.
        start: its first start document.
        frames: in the order taken.
        stop: its last stop document; None where it never ended.
        resumed: the start documents of its later parts.
        cut: what ended the part before each of these: its stop document; None where it was cut off
            without one.
        accuracy: how the uncertainty fell with the frames taken.
        turning: names of the axes whose readings are in rad; those of the others are in mm.
        lost: keys of the last points recorded, where the pixels of none of them are as they were
            recorded, as after a power cut; they are not among ``frames``.
        documents: how many documents there are before those of the lost points.
    """

    folder: Path
    start: Mapping[str, Any]
    frames: tuple[FrameRecord, ...]
    stop: Mapping[str, Any] | None
    resumed: tuple[Mapping[str, Any], ...] = ()
    cut: tuple[Mapping[str, Any] | None, ...] = ()
    accuracy: tuple[AccuracyRecord, ...] = ()
    turning: frozenset[str] = frozenset()
    lost: tuple[str, ...] = ()
    documents: int = 0

    @property
    def complete(self) -> bool:
        """Whether it was taken to its end, and nothing was lost there since."""
        return self.stop is not None and self.stop["exit_status"] == "success" and not self.lost

    @property
    def loss(self) -> str:
        """What was lost at its end, for a sentence; empty where nothing was."""
        if not self.lost:
            return ""
        if len(self.lost) == 1:
            return (
                f"the last frame ({self.lost[0]}) is not as it was recorded, as after a power cut"
            )
        return (
            f"the last {len(self.lost)} frames ({self.lost[0]} and after) are not as they were"
            " recorded, as after a power cut"
        )

    @property
    def sensor_noise(self) -> dict[str, float]:
        """What the camera said of its noise at gain 1: dn_per_electron, read_noise_dn, offset_dn,
        full_scale_dn.
        """
        return dict(self.start["sensor_noise"])

    def table(self) -> dict[str, npt.NDArray[Any]]:
        """One row a frame, a column for each fact: what a data frame is made of.

        ``frame`` is the place in ``pictures``; readings and world places in mm, or rad of what
        turns; NaN where nobody knows.
        """
        columns: dict[str, list[Any]] = {
            "frame": list(range(len(self.frames))),
            "point": [frame.key for frame in self.frames],
            "configuration": [
                -1 if frame.configuration is None else frame.configuration for frame in self.frames
            ],
        }
        for name in (
            "target", "repeat", "f_number", "exposure_s", "gain", "saturated", "time", "note",
        ):  # fmt: skip
            columns[name] = [getattr(frame, name) for frame in self.frames]
        columns["validity"] = [frame.validity.status for frame in self.frames]
        columns["why_not_admitted"] = [frame.validity.reason for frame in self.frames]
        for axis in self.start.get("axes", ()):
            unit = ANGLE if axis in self.turning else LENGTH
            columns[unit.column(axis)] = [frame.readings[axis] for frame in self.frames]
        for element in ELEMENTS:
            columns[world_key(element)] = [
                frame.worlds.get(element, math.nan) for frame in self.frames
            ]
        return {name: np.asarray(values) for name, values in columns.items()}

    def pictures(self) -> npt.NDArray[np.uint16]:
        """All pictures, shape (frames, rows, columns), DN, in the order of ``frames``; errors as
        ``picture``.
        """
        return np.stack([self.picture(frame) for frame in self.frames])

    def dark(self, exposure_s: float) -> FrameRecord | None:
        """The first dark frame of an exposure."""
        return next(
            (
                frame
                for frame in self.frames
                if frame.configuration is None
                and frame.exposure_s == exposure_s
                and frame.validity.admitted
            ),
            None,
        )

    def picture(self, record: FrameRecord) -> Picture:
        """The picture of a frame, shape (rows, columns), DN.

        Raises:
            RecordError: frames.h5 is missing, does not hold it, or holds other pixels than were
                recorded.
        """
        with opened_frames(self.folder) as frames:
            if record.index >= len(frames):
                raise RecordError(
                    f"{self.folder / FRAMES}: holds {len(frames)} frames and not {record.key}; take"
                    " it from a copy"
                )
            _require_room(self.folder / FRAMES, frames, record)
            picture = np.asarray(frames[record.index], dtype=np.uint16)
        if record.crc32 and checksum(picture) != record.crc32:
            raise RecordError(
                f"{self.folder / FRAMES}: frame {record.key} (number {record.index} of the file) is"
                " not as it was recorded: its CRC-32 is another; take the file from a copy, see to"
                " the disk"
            )
        return picture


def _require_room(file: Path, frames: h5py.Dataset, record: FrameRecord) -> None:
    """Refuse a frame that lies beyond the end of a file that was cut short."""
    start, size = frames.id.get_offset(), file.stat().st_size
    picture = frames.dtype.itemsize * int(np.prod(frames.shape[1:]))
    if start is not None and start + (record.index + 1) * picture > size:
        whole = CutShort(size, start + len(frames) * picture)
        raise RecordError(
            f"{file}: is cut short, {_of(whole)}, and not {record.key}; take it from a copy"
        )


def _of(short: CutShort) -> str:
    return f"{short.there / 1e6:.3g} of {short.whole / 1e6:.3g} MB are there"


@contextlib.contextmanager
def opened_frames(folder: Path) -> Generator[h5py.Dataset]:
    """The dataset of a run's frames, to be read.

    Raises:
        RecordError: the file is missing, cut short or damaged, or may not be read.
    """
    file = folder / FRAMES
    try:
        with opened_hdf5(file) as opened:
            frames = member(opened, DATASET, file)
            if frames.ndim != 3 or frames.dtype != np.dtype("<u2"):
                raise KeyError(DATASET)
            yield frames
    except InputError as error:
        raise RecordError(str(error)) from error
    except (OSError, KeyError) as error:
        number = getattr(error, "errno", None)
        if not file.exists():
            why = "is missing"
        elif (short := cut_short(file)) is not None:
            why = f"is cut short, {_of(short)}"
        elif number:
            why = f"cannot be read ({os.strerror(number)})"
        else:
            why = "is damaged, or no file of frames"
        raise RecordError(f"{file}: {why}; take it from a copy") from error


def read_documents(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """The documents of a run in their order; a last line that a crash cut short is left out.

    Raises:
        RecordError: there are none, a line before the last is no document, or something else
            than a file or a folder stands among the run's files.
    """
    require_files(folder)
    file = folder / DOCUMENTS
    try:
        lines = file.read_text(encoding="utf-8", errors="replace").split("\n")
    except FileNotFoundError as error:
        if folder.is_dir():
            raise RecordError(
                f"{folder}: nothing was recorded there yet; begin the run anew, or give the folder"
                " of another"
            ) from error
        raise RecordError(f"{folder}: there is no such folder; give the folder of a run") from error
    except OSError as error:
        raise RecordError(
            f"{file}: cannot be read ({error.strerror or error}); give the folder of a run"
        ) from error
    for number, line in enumerate(
        lines[:-1], start=1
    ):  # what stands after the last line end is empty or cut short
        try:
            pair = json.loads(line)
            yield pair["name"], pair["doc"]
        except (ValueError, KeyError, TypeError) as error:
            raise RecordError(
                f"{file}:{number}: not a document ({error}); the file was changed after it was"
                " written"
            ) from error


def read_run(folder: Path) -> Run:
    """Read a run back, finished or not.

    Raises:
        RecordError: the folder holds no run, or one that was changed after it was written.
    """
    folder = Path(folder)
    documents = list(read_documents(folder))
    whole = _run_of(folder, documents)
    verify_sums(folder)
    lost = _lost_at_the_end(whole)
    if not lost:
        return _validated(whole)
    kept = _documents_before(lost[0], documents)
    cut = replace(
        _run_of(folder, documents[:kept]),
        stop=None,
        lost=tuple(frame.key for frame in lost),
        documents=kept,
    )
    return _validated(cut)


def _validated(run: Run) -> Run:
    """A run whose frames say whether verdicts may use them."""
    try:
        with opened_frames(run.folder) as pictures:
            pixels = int(np.prod(pictures.shape[1:]))
    except (RecordError, OSError):
        pixels = None
    found = validities(run.frames, run.start, pixels)
    frames = (
        replace(frame, validity=validity) for frame, validity in zip(run.frames, found, strict=True)
    )
    return replace(run, frames=tuple(frames))


def _lost_at_the_end(run: Run) -> tuple[FrameRecord, ...]:
    """The last frames of a run that are not as they were recorded, up to the last one that is;
    none where the file of frames cannot be read, or was packed, which is done with whole ones.
    """
    lost: list[FrameRecord] = []
    try:
        with opened_frames(run.folder) as pictures:
            if pictures.chunks is not None:
                return ()
            for frame in reversed(run.frames):
                if not frame.crc32 or (
                    frame.index < len(pictures)
                    and checksum(np.asarray(pictures[frame.index])) == frame.crc32
                ):
                    break
                lost.insert(0, frame)
    except (RecordError, OSError):
        return ()
    return tuple(lost)


def _documents_before(frame: FrameRecord, documents: Sequence[Document]) -> int:
    """How many documents there are before those of a frame."""
    for number, (name, doc) in enumerate(documents):
        if name == "event" and doc["data"].get("point") == frame.key:
            return number - (documents[number - 1][0] == "stream_datum")
    return len(documents)


def _run_of(folder: Path, documents: Sequence[Document]) -> Run:
    """A run as its documents have it."""
    starts: list[dict[str, Any]] = []
    stop: dict[str, Any] | None = None
    cut: list[dict[str, Any] | None] = []
    frames: dict[str, FrameRecord] = {}
    accuracy: list[AccuracyRecord] = []
    turning = frozenset[str]()
    place = -1
    for name, doc in documents:
        try:
            if name == "start":
                cut += [stop] if starts else []
                starts.append(doc)
                stop = None
            elif name == "stop":
                stop = doc
            elif name == "stream_datum":
                place = int(doc["indices"]["start"])
            elif name == "event" and ACCURACY in doc["data"]:
                accuracy.append(_accuracy_of(doc["data"], doc["time"]))
            elif name == "event" and "point" in doc["data"]:
                frame = _frame_of(
                    doc["data"], doc["time"], place, starts[0].get("axes", ()) if starts else ()
                )
                frames[frame.key] = frame
                turning = frozenset(
                    axis for axis in frame.readings if ANGLE.column(axis) in doc["data"]
                )
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise RecordError(
                f"{folder / DOCUMENTS}: a {name} document lacks {error}; it is not a run of flflab"
            ) from error
    if not starts:
        raise RecordError(
            f"{folder / DOCUMENTS}: holds no start of a run: nothing was recorded; begin it again"
            " in another folder"
        )
    return Run(
        folder,
        starts[0],
        tuple(frames.values()),
        stop,
        tuple(starts[1:]),
        tuple(cut),
        tuple(accuracy),
        turning,
        documents=len(documents),
    )


def world_key(element: Element) -> str:
    """The column of an element's world z: ``world_array_z_mm``."""
    return f"world_{element.replace('.', '_')}_mm"


def _reading(data: Mapping[str, Any], axis: str) -> float:
    """An axis's reading: a column in rad where it turns, else one in mm."""
    return float(data[column if (column := ANGLE.column(axis)) in data else LENGTH.column(axis)])


def _frame_of(data: Mapping[str, Any], time: float, place: int, axes: Iterable[str]) -> FrameRecord:
    configuration = int(data["configuration"])
    return FrameRecord(
        key=data["point"], configuration=None if configuration < 0 else configuration,
        target=data["target"], repeat=int(data["repeat"]),
        f_number=float(data["iris"]), readings={axis: _reading(data, axis) for axis in axes},
        worlds={
            element: float(data[key]) for element in ELEMENTS if (key := world_key(element)) in data
        },
        exposure_s=float(data["exposure_s"]),
        gain=float(data["gain"]), saturated=int(data["saturated"]), number=int(data["number"]),
        index=place, time=time,
        crc32=data.get("crc32", ""),
        note=data.get("note", ""),
        moved=None if (moved := data.get("moved_steps", -1.0)) < 0 else float(moved),
        temperature=data.get("temperature_degc"),
    )  # fmt: skip


def _accuracy_of(data: Mapping[str, Any], time: float) -> AccuracyRecord:
    enough = bool(data["enough"])
    return AccuracyRecord(
        int(data["accuracy_of"]), int(data["frames"]), float(data[ACCURACY]), enough, time
    )
