"""The guards in tests/conftest.py catch what they are there for."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

LEAVERS = """
import subprocess, sys, threading, time
import pytest

def test_leaves_a_thread():
    threading.Thread(target=time.sleep, args=(2,)).start()

def test_waits_for_its_thread():
    thread = threading.Thread(target=time.sleep, args=(0.05,))
    thread.start()
    thread.join()

def test_leaves_a_child(keep):
    keep.append(subprocess.Popen([sys.executable, "-c", "import time; time.sleep(30)"]))

@pytest.fixture(scope="module")
def keep():
    children = []
    yield children
    for child in children:
        child.kill()
        child.wait()

@pytest.mark.r12a
def test_needs_the_measurements():
    pass
"""


def run_pytest(root: Path, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    (folder / "tests").mkdir()
    shutil.copy(root / "tests" / "conftest.py", folder / "tests")
    shutil.copy(root / "pyproject.toml", folder)
    (folder / "tests" / "test_leavers.py").write_text(LEAVERS, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", str(folder)]
    variables = {**os.environ, "COLUMNS": "250", **environment}
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, env=variables
    )


@pytest.mark.skipif(
    not Path("/proc/self/task").exists(), reason="children are listed by the Linux kernel only"
)
def test_a_test_that_leaves_a_thread_or_a_child_fails(root: Path, tmp_path: Path) -> None:
    done = run_pytest(root, tmp_path, FLFLAB_R12A=str(tmp_path / "nowhere"))
    assert "3 passed, 1 deselected, 2 errors" in done.stdout
    assert (
        "ERROR tests/test_leavers.py::test_leaves_a_thread - Failed: left running: threads"
        in done.stdout
    )
    assert (
        "ERROR tests/test_leavers.py::test_leaves_a_child - Failed: left running: threads [],"
        " processes" in done.stdout
    )
    assert "deselected" in next(
        line for line in done.stdout.splitlines() if line.startswith("r12a: not here")
    )
