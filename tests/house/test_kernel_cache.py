"""Compiled kernels go with the sources they were compiled from."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import flflab

SAY = "from flflab.image.clipping import clip; clip(9.0, 0.0, 1.0, 0.0, 0.5, 1.0); import os; print(os.environ['NUMBA_CACHE_DIR'])"


def run(home: Path, cache: Path) -> Path:
    environment = os.environ | {"PYTHONPATH": str(home), "NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-c", SAY]
    done = subprocess.run(command, cwd=home, env=environment, check=True, capture_output=True, text=True, timeout=120)
    return Path(done.stdout.strip())


def test_a_change_in_what_a_kernel_calls_makes_it_compiled_anew_and_old_ones_go(tmp_path: Path) -> None:
    home, cache = tmp_path / "home", tmp_path / "cache"
    shutil.copytree(Path(flflab.__file__).parent, home / "flflab", ignore=shutil.ignore_patterns("__pycache__"))
    (cache / "another's").mkdir(parents=True)
    first = run(home, cache)
    assert first.parent == cache
    assert list(first.rglob("*.nbi"))
    assert run(home, cache) == first == run(home, first)
    (home / "flflab" / "cli" / "__init__.py").write_text('"""Nothing that a kernel calls."""\n', encoding="utf-8")
    assert run(home, cache) == first
    folders = {first}
    for number in range(4):
        with (home / "flflab" / "optics" / "discs.py").open("a", encoding="utf-8") as file:
            file.write(f"# {number}\n")
        folders.add(run(home, cache))
    assert len(folders) == 5
    assert first not in set(cache.iterdir())
    assert len(list(cache.glob("flflab-*"))) == 3
    assert (cache / "another's").is_dir()
