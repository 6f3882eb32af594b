"""Writes a run as it goes: documents forced to the disk one by one, frames flushed before the event that names them.

The dataset of frames is allocated at its full size before the first frame: adding a frame changes nothing else in the file, so it can be
read whenever the writer was killed, and gone on with.
"""

import contextlib
import json
import os
import shutil
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np
import numpy.typing as npt

from flflab.errors import RecordError
from flflab.record.checksums import SUMS, write_sums
from flflab.record.folder import DATASET, DOCUMENTS, FRAMES
from flflab.record.reading import read_run

SPARE_BYTES = 50_000_000  # documents, log, report
SUMMED = ("bench.yaml", "camera.yaml", "study.yaml", "versions.json", DOCUMENTS)
Picture = npt.NDArray[np.uint16]


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
        needed, free = frames * shape[0] * shape[1] * 2 + SPARE_BYTES, shutil.disk_usage(folder).free
        if needed > free:
            raise RecordError(
                f"{folder}: the run needs {needed / 1e9:.2f} GB for {frames} frames, {free / 1e9:.2f} GB are free; "
                "make room or give a folder on another disk"
            )
        at_once = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        at_once.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        at_once.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        with self._beginning(folder):
            self._documents = (folder / DOCUMENTS).open("x", encoding="utf-8", newline="\n")
            self._file = h5py.File(folder / FRAMES, "x")
            self._frames: h5py.Dataset = self._file.create_dataset(DATASET, (frames, *shape), "<u2", dcpl=at_once)
            self._file.flush()
        self.recorded = 0

    @contextlib.contextmanager
    def _beginning(self, folder: Path) -> Generator[None]:
        self.folder = folder
        self._ended = False
        try:
            yield
        except OSError as error:
            raise RecordError(f"{folder}: a record cannot be begun there ({error}); give another folder") from error

    def picture(self, place: int) -> Picture:
        """A frame written before, shape (rows, columns), DN."""
        return np.asarray(self._frames[place], dtype=np.uint16)

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
        except (OSError, RuntimeError) as error:  # HDF5 tells of a full disk as either
            raise RecordError(f"{self.folder}: a frame could not be written ({_in_a_line(error)}); make room and start again") from error
        self.recorded += 1
        return self.recorded - 1

    def document(self, name: str, doc: Mapping[str, Any]) -> None:
        """Write a document; all but where a frame lies, which the event after it names, are on the disk before this returns.

        Raises:
            RecordError: the disk does not take it.
        """
        self._ended = name == "stop"
        line = json.dumps({"name": name, "doc": doc}, default=_plain)
        try:
            self._documents.write(line + "\n")
            self._documents.flush()
            if name != "stream_datum":
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
        self._close_files()
        for name in (DOCUMENTS, FRAMES):
            (self.folder / name).unlink()

    def close(self) -> None:
        """End both files; where the run has ended write the sums of the folder's files. May be called again."""
        if self._file:
            self._close_files()
            if self._ended:
                write_sums(self.folder, SUMMED)

    def _close_files(self) -> None:
        try:
            self._documents.close()
            self._file.close()
        except (OSError, RuntimeError) as error:
            raise RecordError(
                f"{self.folder}: its files could not be closed ({_in_a_line(error)}); make room, the record is whole"
            ) from error


def _in_a_line(error: BaseException) -> str:
    return " ".join(str(error).split())


class ContinuedRecording(Recording):
    """Goes on with a record that was cut short: what was recorded stays, a last line without its end goes.

    Args:
        folder: of a run that did not end well.

    Raises:
        RecordError: it holds no run, or cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        run = read_run(folder)
        file = folder / DOCUMENTS
        with self._beginning(folder):
            (folder / SUMS).unlink(missing_ok=True)  # the documents grow: written anew at the end
            with file.open("rb+") as documents:
                documents.truncate(file.read_bytes().rfind(b"\n") + 1)
            self._documents = file.open("a", encoding="utf-8", newline="\n")
            self._file = h5py.File(folder / FRAMES, "r+")
            self._frames = cast(h5py.Dataset, self._file[DATASET])
        self.recorded = 1 + max((frame.index for frame in run.frames), default=-1)  # a frame without its event is written over

    def discard(self) -> None:
        """Close it; nothing was added."""
        self.close()


def _plain(value: object) -> object:
    """What numpy holds, as json has it."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{value!r} has no place in a document")
