"""A camera exactly as described, in light of 550 nm, judged with the bench file that ``flflab new
bench`` writes.
"""

from pathlib import Path

import pytest
import yaml

from flflab.bench import read_bench, with_seed
from flflab.built_in import Kind, built_in, simulated_bench
from flflab.cli.run import run_study
from flflab.study import read_study
from flflab.verdict.evaluation import evaluate
from procedures.study import tell_nobody

SEEDS, LEAST = 20, 17
STUDY = """\
name: acceptance
configurations:
  - {f_number: [4, 5.6], distance: 507 mm}
  - {f_number: 4, distance: 530 mm}
"""


@pytest.mark.full
@pytest.mark.timeout(4 * 3600)
def test_a_perfect_camera_is_accepted_by_the_file_as_new_writes_it(tmp_path: Path) -> None:
    """Its stages stand off as the simulated bench's file states; its lenses are all alike."""
    (tmp_path / "study.yaml").write_text(STUDY)
    drawn = yaml.safe_load(simulated_bench().read_text(encoding="utf-8"))
    drawn["optics"] = str(built_in(Kind.CAMERA))
    drawn["light"] = {"wavelength": "550 nm"}
    drawn["simulated"] |= {"clock": 50}
    (tmp_path / "drawn.yaml").write_text(yaml.safe_dump(drawn, sort_keys=False))
    new = read_bench(built_in(Kind.BENCH))
    accepted: list[int] = []
    for seed in range(1, SEEDS + 1):
        folder = tmp_path / f"run{seed}"
        files = tmp_path / "study.yaml", tmp_path / "drawn.yaml"
        run = run_study(*files, folder, seed, tell_nobody, "validate")
        comparison = evaluate(
            run, read_study(files[0], new.optics), with_seed(new, seed)
        ).comparison
        print(seed, {one.quantity: round(one.p_value, 4) for one in comparison.verdicts})
        accepted += [seed] * comparison.accepted
        (folder / "frames.h5").unlink()
    assert len(accepted) >= LEAST, accepted
