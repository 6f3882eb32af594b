"""A run as one NeXus file that any viewer opens: frames, readings and provenance, the frames as
what is shown first.

The layout follows the base classes of the NeXus manual (NXroot, NXentry, NXinstrument, NXdetector,
NXpositioner, NXdata, NXprocess) and its rules for what is plotted by default: ``default`` leads
from the root to an NXdata, whose ``signal`` and ``axes`` name its fields.
"""

import csv
import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from flflab.bench import ANGLE, LENGTH
from flflab.errors import RecordError
from flflab.record.new_hdf5 import new_hdf5
from flflab.record.packing import LEVEL
from flflab.record.reading import ELEMENTS, FrameRecord, Run
from flflab.whole_file import require_writable

KEPT = ("bench.yaml", "camera.yaml", "study.yaml")


def export_nexus(run: Run, file: Path) -> None:
    """Write a run as a NeXus file that needs nothing beside it.

    Args:
        run: finished or not; with at least one frame.
        file: the HDF5 file to write, one that does not exist.

    Raises:
        RecordError: the run has no frame, a frame is not as it was recorded, or the file is there
            already or does not fit on the disk.
        InputError: the file's folder is missing or may not be written.
    """
    if not run.frames:
        raise RecordError(f"{run.folder}: no frame was recorded, there is nothing to export")
    if file.exists():
        raise RecordError(
            f"{file}: exists already and is not overwritten; give another name, or remove it"
        )
    require_writable(file)
    largest = len(run.frames) * run.picture(run.frames[0]).nbytes
    try:
        with new_hdf5(file) as (into, raise_fault):
            into.attrs.update(
                NX_class="NXroot",
                default="entry",
                file_name=file.name,
                creator="flflab",
                HDF5_Version=h5py.version.hdf5_version,
            )
            _entry(into, run, raise_fault)
    except OSError as error:
        raise RecordError(
            f"{file}: the disk does not take it ({error.strerror or error}), up to"
            f" {largest / 1e6:.3g} MB are needed; make room, or give a place on another disk"
        ) from error


def _entry(root: h5py.File, run: Run, after_each: Callable[[], None]) -> None:
    entry = _group(root, "entry", "NXentry", default="frames")
    entry["title"] = str(run.start.get("study", run.folder.name))
    entry["start_time"] = _moment(run.start.get("time", run.frames[0].time))
    entry["end_time"] = _moment((run.stop or {}).get("time", run.frames[-1].time))
    entry["entry_identifier_uuid"] = str(run.start.get("uid", ""))
    instrument = _group(entry, "instrument", "NXinstrument")
    instrument["name"] = "bench of a focused light field camera"
    _frames(_group(instrument, "detector", "NXdetector"), run, after_each)
    for axis in run.frames[0].readings:
        _positioner(_group(instrument, axis, "NXpositioner"), axis, run)
    data = _group(
        entry, "frames", "NXdata", signal="data", axes=["frame", ".", "."], frame_indices=0
    )
    data["data"] = h5py.SoftLink("/entry/instrument/detector/data")
    data["frame"] = np.arange(len(run.frames))
    data["title"] = "frames in the order taken"
    _conditions(_group(entry, "conditions", "NXcollection"), run.frames)
    _comparison(entry, run.folder / "comparison.csv")
    process = _group(entry, "process", "NXprocess")
    process["program"] = "flflab"
    process["version"] = str(dict(run.start.get("software", {})).get("flflab", ""))
    notes = {
        name: (run.folder / name).read_text(encoding="utf-8")
        for name in KEPT
        if (run.folder / name).is_file()
    }
    notes["start_document.json"] = json.dumps(dict(run.start))
    for name, text in notes.items():
        note = _group(process, name.replace(".", "_"), "NXnote")
        note["file_name"], note["data"] = name, text
        note["type"] = "application/json" if name.endswith("json") else "application/yaml"


def _frames(detector: h5py.Group, run: Run, after_each: Callable[[], None]) -> None:
    shape = run.picture(run.frames[0]).shape
    data = detector.create_dataset(
        "data",
        (len(run.frames), *shape),
        "<u2",
        chunks=(1, *shape),
        shuffle=True,
        compression="gzip",
        compression_opts=LEVEL,
    )
    data.attrs.update(units="DN", long_name="pixel value, DN", interpretation="image")
    for place, frame in enumerate(run.frames):
        data[place] = run.picture(frame)
        after_each()
    exposures = detector.create_dataset(
        "count_time", data=[frame.exposure_s for frame in run.frames]
    )
    exposures.attrs["units"] = "s"


def _positioner(positioner: h5py.Group, axis: str, run: Run) -> None:
    positioner["name"] = axis
    value = positioner.create_dataset("value", data=[frame.readings[axis] for frame in run.frames])
    value.attrs["units"] = (ANGLE if axis in run.turning else LENGTH).unit


def _conditions(group: h5py.Group, frames: tuple[FrameRecord, ...]) -> None:
    """What else was recorded with each frame, a column each."""
    columns: dict[str, tuple[list[Any], str]] = {
        "point": ([frame.key for frame in frames], ""),
        "target": ([frame.target for frame in frames], ""),
        "crc32": ([frame.crc32 for frame in frames], ""),
        "configuration": (
            [-1 if frame.configuration is None else frame.configuration for frame in frames],
            "",
        ),
        "f_number": ([frame.f_number for frame in frames], ""),
        "time": ([frame.time for frame in frames], "s"),
    }
    columns |= {
        f"world_{element.replace('.', '_')}": ([frame.worlds[element] for frame in frames], "mm")
        for element in ELEMENTS
    }
    for name, (values, unit) in columns.items():
        dataset = group.create_dataset(name, data=values)
        if unit:
            dataset.attrs["units"] = unit


def _comparison(entry: h5py.Group, file: Path) -> None:
    """Each configuration's measured and predicted MTF as curves, where the run was compared with
    the model.
    """
    if not file.is_file():
        return
    with file.open(encoding="utf-8", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["quantity"] == "mtf"]
    for index in sorted({int(row["configuration"]) for row in rows}):
        mine = sorted(
            (row for row in rows if int(row["configuration"]) == index),
            key=lambda row: float(row["cycles_per_mm"]),
        )
        data = _group(
            entry,
            f"mtf_{index}",
            "NXdata",
            signal="measured",
            axes=["cycles_per_mm"],
            auxiliary_signals=["predicted"],
        )
        for name, column in (
            ("cycles_per_mm",) * 2,
            ("measured",) * 2,
            ("measured_errors", "uncertainty"),
            ("predicted",) * 2,
        ):
            data.create_dataset(name, data=[float(row[column]) for row in mine])
        data["cycles_per_mm"].attrs.update(
            units="1/mm", long_name="frequency on the target, cycles/mm"
        )
        data["title"] = f"MTF of configuration {index}"


def _group(parent: h5py.Group, name: str, kind: str, **attributes: Any) -> h5py.Group:
    group = parent.create_group(name)
    group.attrs["NX_class"] = kind
    group.attrs.update(attributes)
    return group


def _moment(seconds: Any) -> str:
    return datetime.fromtimestamp(float(seconds), UTC).isoformat()
