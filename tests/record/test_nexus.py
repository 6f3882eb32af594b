"""The NeXus export as silx sees it, a reader and checker of other people's."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import RecordError
from flflab.record import Recording, export_nexus, read_run

SHAPE = (30, 40)
silx, nxdata = cast(Any, import_module("silx.io")), cast(Any, import_module("silx.io.nxdata"))


def picture(number: int) -> npt.NDArray[np.uint16]:
    return np.random.default_rng(number).poisson(100, SHAPE).astype(np.uint16)


LIMITED = """
import resource, sys
from pathlib import Path
from flflab.errors import RecordError
from flflab.record import export_nexus, read_run

resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]),) * 2)  # a write beyond the limit then fails as on a full disk
try:
    export_nexus(read_run(Path(sys.argv[1])), Path(sys.argv[2]))
except RecordError as error:
    print(error)
"""  # noqa: E501


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    recording = Recording(folder, 5, SHAPE)
    recording.document(
        "start",
        {
            "uid": "u",
            "time": 1e9,
            "study": "small",
            "axes": ["array_stage", "ring"],
            "software": {"flflab": "0.1.0"},
        },
    )
    for number in range(3):
        place = recording.frame(picture(number))
        recording.document("stream_datum", {"indices": {"start": place, "stop": place + 1}})
        worlds = {
            f"world_{element}_z_mm": 1.0 for element in ("main_lens", "array", "sensor", "target")
        }
        data = {
            "point": f"c0/bars/{number}", "configuration": 0, "target": "bars", "repeat": number,
            "iris": 4.0, "exposure_s": 0.01,
            "gain": 1.0, "saturated": 0, "number": number, "array_stage_mm": 20.0 + number,
            "ring_rad": 0.25, **worlds,
        }  # fmt: skip
        recording.document("event", {"time": 1e9 + number, "data": data})
    recording.document("stop", {"exit_status": "success", "time": 1e9 + 9})
    recording.close()
    (folder / "comparison.csv").write_text(
        "configuration,cycles_per_mm,quantity,measured,uncertainty,predicted\n0,2,mtf,0.8,0.01,0.81\n0,1,mtf,0.9,0.01,0.91\n0,,views,5,0,5\n"
    )
    return folder


def test_silx_finds_the_frames_as_what_to_show_first_and_no_fault(
    run: Path, tmp_path: Path
) -> None:
    export_nexus(read_run(run), tmp_path / "run.nxs")
    with silx.open(str(tmp_path / "run.nxs")) as file:
        shown = nxdata.get_default(file)
        assert (shown.group.name, shown.signal_dataset_name, shown.interpretation) == (
            "/entry/frames",
            "data",
            "image",
        )
        assert shown.axes_dataset_names == ["frame", None, None]
        for number in range(3):
            np.testing.assert_array_equal(shown.signal[number], picture(number))
        curve = nxdata.NXdata(file["entry/mtf_0"])
        assert curve.is_valid
        assert curve.is_curve
        assert (list(curve.axes[0]), list(curve.signal), list(curve.errors)) == (
            [1, 2],
            [0.9, 0.8],
            [0.01, 0.01],
        )
        assert curve.auxiliary_signals_dataset_names == ["predicted"]


def test_everything_recorded_is_there_with_its_unit(run: Path, tmp_path: Path) -> None:
    export_nexus(read_run(run), tmp_path / "run.nxs")
    with h5py.File(tmp_path / "run.nxs") as file:
        entry = cast(Any, file["entry"])
        assert (entry["title"].asstr()[()], entry["start_time"].asstr()[()]) == (
            "small",
            "2001-09-09T01:46:40+00:00",
        )
        stage, ring = (entry[f"instrument/{axis}/value"] for axis in ("array_stage", "ring"))
        assert (list(stage[:]), stage.attrs["units"], ring[0], ring.attrs["units"]) == (
            [20, 21, 22],
            "mm",
            0.25,
            "rad",
        )
        assert list(entry["conditions/point"].asstr()[:]) == [
            f"c0/bars/{number}" for number in range(3)
        ]
        kinds: list[str] = []
        file.visititems(
            lambda _, found: (
                kinds.append(str(found.attrs["NX_class"]))
                if isinstance(found, h5py.Group)
                else None
            )
        )
        assert set(kinds) == {
            "NXentry", "NXinstrument", "NXdetector", "NXpositioner", "NXdata", "NXcollection",
            "NXprocess", "NXnote",
        }  # fmt: skip


def test_a_file_is_never_overwritten_and_a_run_without_frames_refused(
    run: Path, tmp_path: Path
) -> None:
    (tmp_path / "there.nxs").write_text("mine")
    with pytest.raises(RecordError, match=r"there\.nxs: exists already and is not overwritten"):
        export_nexus(read_run(run), tmp_path / "there.nxs")
    assert (tmp_path / "there.nxs").read_text() == "mine"
    empty = tmp_path / "empty"
    empty.mkdir()
    recording = Recording(empty, 1, SHAPE)
    recording.document("start", {"uid": "u", "axes": []})
    recording.close()
    with pytest.raises(RecordError, match="no frame was recorded"):
        export_nexus(read_run(empty), tmp_path / "empty.nxs")


@pytest.mark.skipif(sys.platform == "win32", reason="limits the size of files the POSIX way")
@pytest.mark.parametrize("room", [0, 1000, 4000, 8000, 12_000])
def test_a_full_disk_is_one_sentence_with_what_is_needed_and_leaves_nothing(
    run: Path, tmp_path: Path, room: int
) -> None:
    place = tmp_path / "out" / "a.nxs"
    place.parent.mkdir()
    command = [sys.executable, "-c", LIMITED, str(run), str(place), str(room)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    said = (
        f"{place}: the disk does not take it (File too large), up to 0.0072 MB are needed; make"
        " room, or give a place on another disk\n"
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, said, "")
    assert list(place.parent.iterdir()) == []
