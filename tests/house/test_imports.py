"""What ``import drivers`` loads: a stage moves on a computer where no picture can be read."""

import subprocess
import sys
from pathlib import Path

from flflab.bench import read_bench
from sim.serve import serve, write_bench

HEAVY = ("cv2", "numba", "scipy", "matplotlib")
LOADED = (
    "import sys, drivers, flflab.cli.bench; drivers.connect;"
    f" print([name for name in {HEAVY} if name in sys.modules])"
)
HELP = f"""
import sys
from flflab.cli import main
sys.argv = ["flflab", "--help"]
try:
    main()
except SystemExit:
    print([name for name in ("numpy", "pydantic", *{HEAVY}) if name in sys.modules])
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


def run(program: str, *arguments: str) -> str:
    command = [sys.executable, "-P", "-c", program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout


def test_to_import_drivers_loads_nothing_that_only_pictures_need() -> None:
    assert run(LOADED) == "[]\n"


def test_the_list_of_commands_loads_none_of_them() -> None:
    said = run(HELP)
    assert "validate   Run a study" in said
    assert said.endswith("[]\n")


def test_the_front_door_loads_what_is_asked_for_and_no_more() -> None:
    assert run(FRONT_DOOR) == "[]\n[]\n"


def test_a_stage_moves_where_opencv_numba_scipy_and_matplotlib_do_not_load(
    root: Path, tmp_path: Path
) -> None:
    bench = read_bench(root / "examples" / "benches" / "full.yaml")
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        assert run(MOVES, str(tmp_path / "served.yaml")) == "True\n"
