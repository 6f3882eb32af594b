"""The script of the README's two commands."""

import ast
import os
import shutil
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

CHILD = """
import sys, time
try:
    print("stages move", flush=True)
    time.sleep(30)
except KeyboardInterrupt:
    time.sleep(1)
    print("stages stopped", flush=True)
    sys.exit(7)
"""
RUN = "import runpy, sys; runpy.run_path(sys.argv[1])['run'](sys.executable, '-c', sys.argv[2])"
# As started by a Python outside any virtual environment, of the version in argv[2].
OUTSIDE = """
import runpy, sys
sys.prefix = sys.base_prefix
sys.version_info = (*map(int, sys.argv[2].split(".")), 0)
sys.argv[:] = [sys.argv[1], "validate", "--json"]
runpy.run_path(sys.argv[0], run_name="__main__")
"""
PROGRAM = '#!/bin/sh\necho "$(basename "$0")" "$@"\n'


@pytest.fixture
def script(root: Path, tmp_path: Path) -> Path:
    """The script in a folder with a virtual environment whose programs say how they are called."""
    programs = tmp_path / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in ("python", "flflab"):
        (programs / name).write_text(PROGRAM, encoding="utf-8")
        (programs / name).chmod(0o755)
    return Path(shutil.copy(root / "quickstart.py", tmp_path))


def run_outside(script: Path, version: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", OUTSIDE, str(script), version]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


def test_quickstart_without_a_command_says_how_it_is_used(root: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(root / "quickstart.py")], capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert done.stderr.startswith("usage: python quickstart.py validate")


def test_an_older_python_is_told_which_one_is_needed_and_touches_nothing(script: Path) -> None:
    before = sorted(script.parent.rglob("*"))
    done = run_outside(script, "3.10")
    assert done.returncode != 0
    assert done.stdout == ""
    assert "3.11 or later" in done.stderr
    assert "this is 3.10" in done.stderr
    assert done.stderr.count("\n") == 1
    assert sorted(script.parent.rglob("*")) == before


def test_an_older_python_can_read_what_it_is_told(root: Path) -> None:
    text = (root / "quickstart.py").read_text(encoding="utf-8")
    ast.parse(text, feature_version=(3, 8))
    assert (
        text.count("from __future__ import annotations") == 1
    )  # annotations with | are read by no Python before 3.10
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"OLDEST = ({project['requires-python'].removeprefix('>=').replace('.', ', ')})" in text


@pytest.mark.skipif(
    sys.platform == "win32", reason="the programs of the environment are shell scripts"
)
def test_an_environment_that_works_is_left_as_it_is(script: Path) -> None:
    before = sorted(script.parent.rglob("*"))
    done = run_outside(script, "3.11")
    assert (done.returncode, done.stderr) == (0, "")
    said = [line for line in done.stdout.splitlines() if not line.startswith("+")]
    assert "flflab validate --json" in said
    assert sorted(script.parent.rglob("*")) == before


@pytest.mark.skipif(sys.platform == "win32", reason="a program is not ended by a signal there")
def test_of_a_command_that_a_signal_ends_it_says_what_a_shell_would(root: Path) -> None:
    killed = "import os, signal; os.kill(os.getpid(), signal.SIGTERM)"
    command = [sys.executable, "-c", RUN, str(root / "quickstart.py"), killed]
    assert (
        subprocess.run(command, capture_output=True, check=False, timeout=60).returncode
        == 128 + signal.SIGTERM
    )


@pytest.mark.skipif(
    sys.platform == "win32",
    reason="an interrupt cannot be sent to one group of processes alone there",
)
def test_who_presses_ctrl_c_hears_how_the_command_ends(root: Path) -> None:
    command = [sys.executable, "-c", RUN, str(root / "quickstart.py"), CHILD]
    heard = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # though a shell tells jobs in the background to ignore it
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as quickstart:
        signal.signal(signal.SIGINT, heard)
        assert quickstart.stdout is not None
        while quickstart.stdout.readline() != "stages move\n":
            assert quickstart.poll() is None
        os.killpg(quickstart.pid, signal.SIGINT)
        said, complained = quickstart.communicate(timeout=20)
    assert said == "stages stopped\n"
    assert complained == ""
    assert quickstart.returncode == 7
