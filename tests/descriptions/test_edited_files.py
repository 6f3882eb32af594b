"""Files written back keep what their user wrote into them."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from flflab.bench import read_bench
from flflab.cli.aligned import with_zeros
from flflab.errors import InputError
from flflab.record.folder import keep_descriptions
from flflab.yaml_file import edit_yaml, put

FILES = [
    "benches/simulated.yaml", "benches/full.yaml", "cameras/osinski.yaml", "cameras/r12a.yaml",
    "scenes/occluded.yaml",
]  # fmt: skip
FOUR = """\
# mine
axes:
    stage:           # the one on the left
        limits:
            - 0 mm   # at the wall
            - '50 mm'
        "speed": 1e1

# and the rest
rest: {a: 1.50, b: yes}
"""


@pytest.mark.parametrize("name", FILES)
def test_what_is_not_changed_stays_to_the_letter(name: str, root: Path) -> None:
    text = (root / "examples" / name).read_text(encoding="utf-8")
    assert edit_yaml(text, name, lambda data: None) == text


def test_another_indentation_quotes_and_comments_stay() -> None:
    def change(data: Any) -> None:
        put(data["axes"]["stage"], "zero", "3 mm")
        put(data["rest"], "a", 2.5)

    changed = edit_yaml(FOUR, "mine.yaml", change).splitlines()
    assert changed.pop(3).split() == ["zero:", "3", "mm"]
    assert changed == FOUR.replace("1.50", "2.5").splitlines()


def test_a_value_that_an_anchor_shares_is_not_changed() -> None:
    text = "x: &any {zero: 1}\ny: *any\n"
    with pytest.raises(InputError, match=r"mine\.yaml: cannot be changed .*anchor.* by hand"):
        edit_yaml(text, "mine.yaml", lambda data: put(data["y"], "zero", 2))


def comments(text: str) -> list[str]:
    return re.findall(r"#.*", text)


def test_a_run_of_another_seed_and_an_alignment_keep_the_comments_of_the_bench_file(
    root: Path, tmp_path: Path
) -> None:
    given = root / "examples" / "benches" / "full.yaml"
    text = given.read_text(encoding="utf-8").replace("  seed: 1\n", "  seed: 1  # of the day\n")
    bench = tmp_path / "bench.yaml"
    optics = root / "examples" / "cameras" / "osinski.yaml"
    bench.write_text(text.replace("../cameras/osinski.yaml", str(optics)), encoding="utf-8")
    described = read_bench(bench)
    run = tmp_path / "run"
    run.mkdir()
    keep_descriptions(run, described, None)
    kept = (run / "bench.yaml").read_text(encoding="utf-8")
    assert comments(kept) == comments(text)
    assert yaml.safe_load(kept)["optics"] == "camera.yaml"
    turned: Any = SimpleNamespace(
        axis="ring", unit="rad", after=0.01, reading=0.2, uncertainty=1e-4, why="straight"
    )
    aligned = with_zeros(kept, (turned,), described)
    assert comments(aligned)[-len(comments(text)) :] == comments(text)
    (run / "bench.yaml").write_text(aligned, encoding="utf-8")
    ring = read_bench(run / "bench.yaml").description.axes["ring"]
    assert ring.zero == pytest.approx(0.01 - 0.2, abs=1e-6)
    assert ring.zero_uncertainty == pytest.approx(1e-4, rel=0.1)
