"""What is loaded for what: help waits for no library, and a stage moves on a computer where no
picture can be read.
"""

import subprocess
import sys
from pathlib import Path
from typing import cast

import typer
from typer.core import TyperGroup

from flflab.bench import read_bench
from flflab.cli.app import COMMANDS
from flflab.cli.bench import app as bench_app
from sim.serve import serve, write_bench

HEAVY = ("cv2", "numba", "scipy", "matplotlib")
LOADED = (
    "import sys, drivers, flflab.cli.bench; drivers.connect;"
    f" print([name for name in {HEAVY} if name in sys.modules])"
)
NOT_FOR_WORDS = (  # pydantic is loaded by typer itself
    *HEAVY, "numpy", "yaml", "rich", "bluesky", "h5py", "flflab.description", "drivers",
)  # fmt: skip
HELP = f"""
import sys
from flflab.cli import main
for words in {{words}}:
    sys.argv = ["flflab", *words.split(), "--help"]
    try:
        main()
    except SystemExit as ending:
        assert not ending.code, words
    print(words, [name for name in {NOT_FOR_WORDS} if name in sys.modules], file=sys.stderr)
"""
FRONT_DOOR = f"""
import sys
import flflab as ff
print([name for name in ("numpy", "bluesky", *{HEAVY}) if name in sys.modules])
ff.connect
print([name for name in {HEAVY} if name in sys.modules])
"""
MOVES = f"""
import sys
class Fails:
    def find_spec(self, name, path, target=None):
        if name in {HEAVY}:
            raise ImportError(name)
sys.meta_path.insert(0, Fails())
import drivers
with drivers.connect(sys.argv[1]) as bench:
    bench.ring.home().wait(20)
    print(bench.ring.is_homed())
"""


def run(program: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-P", "-c", program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)


def test_to_import_drivers_loads_nothing_that_only_pictures_need() -> None:
    assert run(LOADED).stdout == "[]\n"


def test_the_list_of_commands_loads_none_of_them() -> None:
    said = run(HELP.format(words=[""]))
    assert "validate   Run a study" in said.stdout
    assert said.stderr == " []\n"


def test_no_command_loads_for_its_help_what_only_its_work_needs() -> None:
    commands = cast(TyperGroup, typer.main.get_command(bench_app)).commands
    bench = [f"bench {name}" for name in commands]
    words = ["validate", *COMMANDS, *bench, "target print"]
    said = run(HELP.format(words=words))
    assert said.stderr.splitlines() == [f"{one} []" for one in words]
    assert "Usage: flflab bench scan" in said.stdout


def test_the_front_door_loads_what_is_asked_for_and_no_more() -> None:
    assert run(FRONT_DOOR).stdout == "[]\n[]\n"


def test_a_stage_moves_where_opencv_numba_scipy_and_matplotlib_do_not_load(
    root: Path, tmp_path: Path
) -> None:
    bench = read_bench(root / "examples" / "benches" / "full.yaml")
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        assert run(MOVES, str(tmp_path / "served.yaml")).stdout == "True\n"
