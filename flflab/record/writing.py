"""Writes a run as it goes, in a thread of its own: every frame is forced to the disk before the
event that names it, and so is every document.

The dataset of frames is allocated at its full size before the first frame: adding a frame changes
nothing else in the file, so it can be read whenever the writer was killed, and gone on with. Pixels
go into it past HDF5, whose lock would hold up everything else meanwhile.
"""

import contextlib
import json
import os
import queue
import shutil
import threading
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np
import numpy.typing as npt

from flflab.errors import RecordError, reason
from flflab.file_lock import try_lock
from flflab.files.hdf5 import cut_short
from flflab.record.checksums import write_sums
from flflab.record.durable import force_data, force_to_disk
from flflab.record.folder import DATASET, DESCRIPTIONS, DOCUMENTS, FRAMES
from flflab.record.reading import Run, opened_frames, read_run
from flflab.waiting import wait_for
from flflab.whole_file import open_own

UNLOCKED = (
    "{}: this disk knows no locks, so nothing keeps a second program from writing the same run;"
    " start no other on it"
)
UNFORCED = (
    "{}: this disk cannot be asked to keep what is written at once, so a power cut may take the"
    " last frames; `flflab resume` takes those again"
)
LOST = "lost.jsonl"
SPARE_BYTES = 50_000_000  # documents, log, report
Picture = npt.NDArray[np.uint16]


class Recording:
    """Writes the documents and frames of one run; usable as a callback of a bluesky engine.

    What is handed over is written while the run goes on, in that order. ``frame`` returns when
    everything before it is on the disk, so no more than one frame and its event is ever on the way.
    What could not be written is told by the next call, and nothing that was to follow it is
    written.

    Args:
        folder: the run's, made before.
        frames: how many frames there may be at most.
        shape: (rows, columns) of each.

    Attributes:
        remark: a sentence on what the disk cannot promise; empty where there is nothing to say.

    Raises:
        RecordError: there is a run already, too little space, or no permission.
    """

    def __init__(self, folder: Path, frames: int, shape: tuple[int, int]) -> None:
        needed, free = (
            frames * shape[0] * shape[1] * 2 + SPARE_BYTES,
            shutil.disk_usage(folder).free,
        )
        if needed > free:
            raise RecordError(
                f"{folder}: the run needs {needed / 1e9:.2f} GB for {frames} frames,"
                f" {free / 1e9:.2f} GB are free; make room or give a folder on another disk"
            )
        at_once = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        at_once.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        at_once.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        with _beginning(folder):
            documents = (folder / DOCUMENTS).open("x", encoding="utf-8", newline="\n")
            self.remark = _keep_for_oneself(documents, folder)
            with h5py.File(folder / FRAMES, "x", locking=False) as file:
                file.create_dataset(DATASET, (frames, *shape), "<u2", dcpl=at_once)
            self._begin(folder, documents)
        self.recorded, self.empty = 0, True

    def _begin(self, folder: Path, documents: Any) -> None:
        self.folder = folder
        self._documents = documents
        # a power cut must not shorten what events point into
        forced = [force_to_disk(place) for place in (folder / FRAMES, folder)]
        if not all(forced):
            self.remark = "; ".join(filter(None, (self.remark, UNFORCED.format(folder))))
        with opened_frames(folder) as dataset:
            if dataset.chunks is not None:
                raise RecordError(f"{folder}: its frames are packed, and a packed run has ended")
            self._shape, self._start = (
                cast(tuple[int, int, int], dataset.shape),
                cast(int, dataset.id.get_offset()),
            )
        self._pixels = open_own(folder / FRAMES, "r+b")
        self._ended = False
        self._fault: RecordError | None = None
        self._todo: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._writer = threading.Thread(
            target=self._write, name=f"record in {folder.name}", daemon=True
        )
        self._writer.start()

    def picture(self, place: int) -> Picture:
        """A frame written before, shape (rows, columns), DN."""
        self.settle()
        count = self._shape[1] * self._shape[2]
        pixels = np.fromfile(
            self.folder / FRAMES, "<u2", count, offset=self._start + place * 2 * count
        )
        return pixels.astype(np.uint16, copy=False).reshape(self._shape[1:])

    def frame(self, picture: Picture) -> int:
        """Hand over a frame, not to be changed any more; returns its place in the dataset.

        Raises:
            RecordError: it does not fit, or the disk did not take what was handed over before.
        """
        count, rows, columns = self._shape
        if picture.shape != (rows, columns):
            raise RecordError(
                f"{self.folder}: the camera gives pictures of {picture.shape[1]} x"
                f" {picture.shape[0]} pixels, its camera file says {columns} x {rows}; correct"
                " sensor.resolution there"
            )
        if self.recorded == count:
            raise RecordError(
                f"{self.folder}: the record has room for {count} frames and they are taken; plan"
                " for more"
            )
        self.settle()
        place, self.recorded = self.recorded, self.recorded + 1
        self._todo.put(lambda: self._attempt("a frame", lambda: self._write_frame(place, picture)))
        return place

    def document(self, name: str, doc: Mapping[str, Any]) -> None:
        """Hand over a document.

        Raises:
            RecordError: the disk did not take what was handed over before.
        """
        line = json.dumps({"name": name, "doc": doc}, default=_plain)
        self._raise_fault()
        self.empty = False
        self._todo.put(
            lambda: self._attempt("a document", lambda: self._write_document(name, line))
        )

    def settle(self) -> None:
        """Wait until everything handed over is on the disk.

        Raises:
            RecordError: the disk did not take it.
        """
        self._wait()
        self._raise_fault()

    def _wait(self) -> None:
        if self._writer.is_alive():
            done = threading.Event()
            self._todo.put(done.set)
            wait_for(done)

    def _raise_fault(self) -> None:
        if self._fault is not None:
            self._wait()
            fault, self._fault = self._fault, None
            raise fault

    def _write(self) -> None:
        while (job := self._todo.get()) is not None:
            job()

    def _attempt(self, what: str, write: Callable[[], None]) -> None:
        if self._fault is None:
            try:
                write()
            # whatever it is, the thread goes on, or those who wait for it would for ever
            except Exception as error:
                self._fault = RecordError(
                    f"{self.folder}: {what} could not be written ({reason(error)}); make room"
                    " before you go on"
                )

    def _write_frame(self, place: int, picture: Picture) -> None:
        pixels: Any = np.ascontiguousarray(picture, dtype="<u2")
        left = memoryview(pixels).cast("B")
        self._pixels.seek(self._start + place * len(left))
        while left:
            left = left[self._pixels.write(left) :]
        force_data(self._pixels.fileno())  # its event is on the disk with the next document

    def _write_document(self, name: str, line: str) -> None:
        self._documents.write(line + "\n")
        self._documents.flush()
        if name != "stream_datum":  # the event after it is
            force_data(self._documents.fileno())
        self._ended = name == "stop"

    def stream_resource(self, uid: str, data_key: str) -> dict[str, Any]:
        """The document that says where frames lie; its path is relative to the run's folder."""
        parameters = {"dataset": f"/{DATASET}", "chunk_shape": (1, *self._shape[1:])}
        return {
            "uid": uid, "data_key": data_key, "mimetype": "application/x-hdf5", "uri": FRAMES,
            "parameters": parameters, "run_start": "",
        }  # fmt: skip

    def discard(self) -> None:
        """Close and remove both files, where nothing was recorded."""
        self._close_files()
        for name in (DOCUMENTS, FRAMES):
            (self.folder / name).unlink()

    def close(self) -> None:
        """Write what is left and end both files; where the run has ended write the sums of the
        folder's files. May be called again.

        Raises:
            RecordError: the disk did not take it all.
        """
        if self._writer.is_alive():
            self._close_files()
            if self._ended:
                write_sums(self.folder, (*DESCRIPTIONS, DOCUMENTS))
        self._raise_fault()

    def _close_files(self) -> None:
        self._todo.put(None)
        self._writer.join()
        try:
            self._pixels.close()
            self._documents.close()
        except OSError as error:
            raise RecordError(
                f"{self.folder}: its files could not be closed ({reason(error)}); make room,"
                " the record is whole"
            ) from error


@contextlib.contextmanager
def _beginning(folder: Path) -> Generator[None]:
    try:
        yield
    except FileExistsError as error:
        raise RecordError(
            f"{folder}: another run is recorded there; give another folder"
        ) from error
    except OSError as error:
        raise RecordError(
            f"{folder}: a record cannot be begun there ({reason(error)}); give another folder"
        ) from error


def _keep_for_oneself(documents: Any, folder: Path) -> str:
    """Let no other program write this record; a remark where the disk cannot promise that.

    Raises:
        RecordError: another one writes it.
    """
    held = try_lock(documents)
    if held == "by another":
        raise RecordError(
            f"{folder}: another program is writing this run; wait until it finishes, or"
            " interrupt it first"
        )
    return UNLOCKED.format(folder) if held == "unknown" else ""


class ContinuedRecording(Recording):
    """Goes on with a record that was cut short: what was recorded stays, but for a last line
    without its end and for the last points whose pixels were lost (``Run.lost``). Their documents
    go to ``lost.jsonl``, and their places are written again.

    Args:
        folder: of a run that did not end well.

    Raises:
        RecordError: it holds no run, or cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        file = folder / DOCUMENTS
        with _beginning(folder):
            documents = open_own(file, "a")
        try:
            self.remark = _keep_for_oneself(documents, folder)
            run = read_run(folder)
            if not (folder / FRAMES).exists():
                raise RecordError(f"{folder / FRAMES}: is missing; take it from a copy")
            with _beginning(folder):
                write_sums(
                    folder, DESCRIPTIONS
                )  # the documents grow: theirs are written anew at the end
                documents.truncate(_set_lost_aside(folder, run))
                _lengthen(folder / FRAMES)
                self._begin(folder, documents)
        except RecordError:
            documents.close()
            raise
        self.empty = False
        self.recorded = 1 + max(
            (frame.index for frame in run.frames), default=-1
        )  # a frame without its event is written over

    def discard(self) -> None:
        """Close it; nothing was added."""
        self.close()


def _set_lost_aside(folder: Path, run: Run) -> int:
    """Keep the documents of lost points in a file of their own; returns how many bytes of the
    documents stay.
    """
    lines = (folder / DOCUMENTS).read_bytes().split(b"\n")[:-1]
    kept, lost = lines[: run.documents], lines[run.documents :]
    if run.lost:
        with open_own(folder / LOST, "a") as aside:
            aside.writelines(line.decode("utf-8", errors="replace") + "\n" for line in lost)
            aside.flush()
            force_data(aside.fileno())
    return sum(len(line) + 1 for line in kept)


def _lengthen(frames: Path) -> None:
    """Give a file of frames that was cut short its whole size again; what it lacked is zeros."""
    if (short := cut_short(frames)) is not None:
        os.truncate(frames, short.whole)


def _plain(value: object) -> object:
    """What numpy holds, as json has it."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{value!r} has no place in a document")
