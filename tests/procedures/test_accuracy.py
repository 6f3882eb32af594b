"""An accuracy asked for: the run takes the frames it needs, says what they gave, and is the same
run when it was cut in between.
"""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml

from flflab.bench import read_bench
from flflab.cli.run import resume_run, run_study
from flflab.record import Run, read_run
from flflab.study import read_study
from flflab.verdict.expectation import expect
from procedures.steps import CaptureUntil, most_frames, steps
from procedures.study import tell_nobody

EXAMPLES = Path(__file__).parents[2] / "examples"
WANTED = 0.0018


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """A bench with a small sensor of few electrons and a study of one configuration that asks for
    an accuracy.
    """
    camera = yaml.safe_load((EXAMPLES / "cameras" / "osinski.yaml").read_text(encoding="utf-8"))
    camera["sensor"] |= {"resolution": [760, 560]}
    camera["microlens_array"] |= {"count": [7, 7]}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera), encoding="utf-8")
    bench = yaml.safe_load((EXAMPLES / "benches" / "simulated.yaml").read_text(encoding="utf-8"))
    bench["optics"] = "camera.yaml"
    bars = {"width": "12 mm", "height": "8 mm"}
    bench["simulated"] |= {
        "clock": 100,
        "full_well_electrons": 300,
        "electrons_per_second": 3e4,
        "targets": {"bars": bars},
    }
    # out of focus a tilt, which few electrons hardly show, makes the MTF unsure however many frames
    # of bars there are
    for axis in bench["axes"].values():
        axis |= {"zero_uncertainty": "0 mm", "scale_uncertainty": 0}
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
    study = {
        "name": "sure", "configurations": [{"f_number": 4, "distance": "507 mm"}],
        "mtf_standard_uncertainty": WANTED,
        "bars": {"kind": "bars", "cycles_per_mm": [0.5, 10]} | bars,
        "exposure": {"frames": 2, "most_frames": 40},
    }  # fmt: skip
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(study), encoding="utf-8")
    return tmp_path / "study.yaml", tmp_path / "bench.yaml"


def bars_of(run: Run) -> list[str]:
    return [frame.crc32 for frame in run.frames if frame.target == "bars"]


@pytest.mark.ci
@pytest.mark.timeout(300)
def test_a_run_takes_as_many_frames_as_the_accuracy_needs_and_the_plan_knew(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    study_file, bench_file = files
    run = run_study(study_file, bench_file, tmp_path / "run", None, tell_nobody, "sweep")
    looks = [(one.frames, one.enough) for one in run.accuracy]
    assert looks[0] == (2, False)
    assert looks[-1] == (len(bars_of(run)), True)
    assert 2 < len(bars_of(run)) < 40
    assert (
        run.accuracy[-1].mtf_standard_uncertainty
        <= WANTED
        < run.accuracy[0].mtf_standard_uncertainty
    )
    bench = read_bench(bench_file)
    study = read_study(study_file, bench.optics)
    expected = expect(study.configurations[0], study, bench)
    assert expected.looks[-1].frames == pytest.approx(len(bars_of(run)), rel=0.5)
    cut_in_between(tmp_path / "run", bars_of(run)[1], most_frames(steps(study, bench)))
    resumed = resume_run(tmp_path / "run", None, tell_nobody)
    assert bars_of(resumed) == bars_of(run)
    assert [(one.frames, one.mtf_standard_uncertainty) for one in resumed.accuracy] == [
        (one.frames, one.mtf_standard_uncertainty) for one in run.accuracy
    ]


def cut_in_between(folder: Path, after: str, room: int) -> None:
    """Make the record what it was after a frame."""
    with h5py.File(folder / "frames.h5") as file:
        dataset: Any = file["frames"]
        content = dataset[:]
    with h5py.File(folder / "frames.h5", "w") as file:
        file.create_dataset(
            "frames",
            data=np.concatenate(
                [content, np.zeros((room - len(content), *content.shape[1:]), np.uint16)]
            ),
        )
    lines = (folder / "documents.jsonl").read_text().splitlines(keepends=True)
    last = next(number for number, line in enumerate(lines) if after in line)
    (folder / "documents.jsonl").write_text("".join(lines[: last + 1]))
    (folder / "SHA256SUMS").unlink()
    assert not read_run(folder).complete


def test_a_study_that_asks_for_an_accuracy_plans_up_to_the_most_frames(
    files: tuple[Path, Path],
) -> None:
    bench = read_bench(files[1])
    to_do = steps(read_study(files[0], bench.optics), bench)
    (until,) = (step for step in to_do if isinstance(step, CaptureUntil))
    assert str(until) == "c0/bars: take frames until the MTF is known to 0.0018, at most 40"
    assert most_frames(to_do) == 2 + 2 + 40 + 2
