"""Packs the frames of a finished run on request: the room not needed goes, the rest is compressed
so that plain h5py reads it.

While a run is written its frames lie raw in their places, which survives every crash. Afterwards
each is compressed by HDF5's own shuffle and deflate filters, in threads of its own; the packed file
takes the place of the raw one only when it is whole and on the disk.
"""

import os
import zlib
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from pathlib import Path

import numpy as np

from flflab.errors import RecordError
from flflab.record.folder import DATASET, FRAMES
from flflab.record.new_hdf5 import new_hdf5
from flflab.record.reading import FrameRecord, Run, opened_frames

LEVEL = 1  # docs/decisions/0015: higher ones cost twice the time for a tenth of the size
AHEAD = 4  # frames in memory


def pack(run: Run) -> None:
    """Compress the frames of a run that was taken to its end; nothing where it was not, or where
    they are packed.

    Raises:
        RecordError: a frame is missing or not as it was recorded, or the disk is full; the raw
            frames are left as they are then.
    """
    file = run.folder / FRAMES
    if not run.complete or not run.frames or _is_packed(run.folder):
        return
    frames = sorted(run.frames, key=lambda frame: frame.index)
    try:
        with new_hdf5(file) as (into, raise_fault):
            shape = run.picture(frames[0]).shape
            whole = (frames[-1].index + 1, *shape)
            dataset = into.create_dataset(
                DATASET,
                whole,
                "<u2",
                chunks=(1, *shape),
                shuffle=True,
                compression="gzip",
                compression_opts=LEVEL,
            )
            for frame, chunk in _compressed(run, frames):
                dataset.id.write_direct_chunk((frame.index, 0, 0), chunk)
                raise_fault()
    except OSError as error:
        raise RecordError(
            f"{file}: cannot be packed, the disk does not take the packed file beside it"
            f" ({error.strerror or error}); make room"
        ) from error


def _compressed(run: Run, frames: list[FrameRecord]) -> Iterator[tuple[FrameRecord, bytes]]:
    def compress(frame: FrameRecord) -> bytes:
        pixels = run.picture(frame).astype("<u2", copy=False)
        return zlib.compress(
            np.ascontiguousarray(pixels.reshape(-1, 1).view(np.uint8).T).data, LEVEL
        )

    rest = iter(frames)
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        under_way: list[tuple[FrameRecord, Future[bytes]]] = [
            (frame, pool.submit(compress, frame)) for frame in islice(rest, AHEAD)
        ]
        while under_way:
            frame, chunk = under_way.pop(0)
            yield frame, chunk.result()
            under_way += [(frame, pool.submit(compress, frame)) for frame in islice(rest, 1)]


def _is_packed(folder: Path) -> bool:
    with opened_frames(folder) as frames:
        return frames.chunks is not None
