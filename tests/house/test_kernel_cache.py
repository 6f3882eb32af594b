"""Compiled kernels go with the sources they were compiled from, and need no folder that can be
written.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import flflab

SAY = (
    "from flflab.image.fast.share import share_at; share_at(0.5, 0.0, 0.5, 0.5); import"
    " os; print(os.environ['NUMBA_CACHE_DIR'])"
)
SHARE = f"""
import subprocess, sys
from pathlib import Path
{SAY}
sys.stdout.flush()
subprocess.run([sys.executable, "-c", "import os, flflab; print(os.environ['NUMBA_CACHE_DIR'])"], check=True)
print(len(list(Path(os.environ["NUMBA_CACHE_DIR"]).rglob("*.nbi"))))
"""  # noqa: E501
INTERRUPTED = """
import os, signal
from flflab.cli import command
command.stranger_among_packages = lambda: (print(os.environ["NUMBA_CACHE_DIR"], flush=True), signal.raise_signal(signal.SIGINT))
command.run()
"""  # noqa: E501
WITHOUT_PRIVILEGES = [
    "setpriv",
    "--inh-caps=-all",
    "--bounding-set=-all",
]  # root itself writes everywhere


def run(home: Path, cache: Path) -> Path:
    environment = os.environ | {"PYTHONPATH": str(home), "NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-c", SAY]
    done = subprocess.run(
        command, cwd=home, env=environment, check=True, capture_output=True, text=True, timeout=120
    )
    return Path(done.stdout.strip())


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder with an installation of flflab."""
    home = tmp_path / "home"
    shutil.copytree(
        Path(flflab.__file__).parent, home / "flflab", ignore=shutil.ignore_patterns("__pycache__")
    )
    return home


@pytest.mark.ci
def test_a_change_in_what_a_kernel_calls_makes_it_compiled_anew_and_old_ones_go(
    home: Path, tmp_path: Path
) -> None:
    cache = tmp_path / "cache"
    (cache / "another's").mkdir(parents=True)
    first = run(home, cache)
    assert first.parent == cache
    assert list(first.rglob("*.nbi"))
    assert run(home, cache) == first == run(home, first)
    (home / "flflab" / "cli" / "__init__.py").write_text(
        '"""Nothing that a kernel calls."""\n', encoding="utf-8"
    )
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


def variables_that_name(place: str, folder: Path, home: Path) -> dict[str, str]:
    """Variables that have kernels kept in a place where nobody can write, or in a folder that
    somebody else made before.
    """
    file, read_only = folder / "file", folder / "read only"
    file.touch()
    if place == "given":
        return {"NUMBA_CACHE_DIR": str(file / "kernels")}
    if place == "user's":
        return {
            "NUMBA_CACHE_DIR": "",
            "XDG_CACHE_HOME": "",
            "LOCALAPPDATA": str(file),
            "HOME": str(file),
        }
    run(home, read_only).chmod(0o555)
    return {"NUMBA_CACHE_DIR": str(read_only)}


@pytest.fixture(params=["given", "user's", "read only"])
def run_without_a_place(
    request: pytest.FixtureRequest, home: Path, tmp_path: Path
) -> Iterator[Callable[[str], "subprocess.CompletedProcess[str]"]]:
    """Runs a program where no kernel can be kept; afterwards there is none anywhere."""
    prefix: list[str] = []
    if request.param == "read only":
        if sys.platform == "win32":
            pytest.skip("Windows writes into folders marked read-only")
        if os.geteuid() == 0:
            if shutil.which(WITHOUT_PRIVILEGES[0]) is None:
                pytest.skip(
                    f"root writes everywhere, and {WITHOUT_PRIVILEGES[0]} (util-linux), which takes"
                    " that away, is not here"
                )
            prefix = WITHOUT_PRIVILEGES
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    variables = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(temporary)) | variables_that_name(
        request.param, tmp_path, home
    )
    environment = os.environ | {"PYTHONPATH": str(home)} | variables

    def run(program: str) -> "subprocess.CompletedProcess[str]":
        command = [*prefix, sys.executable, "-c", program]
        return subprocess.run(
            command,
            cwd=home,
            env=environment,
            check=False,
            capture_output=True,
            text=True,
            timeout=120,
        )

    yield run
    for folder in (tmp_path / "read only").glob("flflab-*"):
        folder.chmod(0o755)
    assert list(temporary.iterdir()) == []
    assert list(home.rglob("*.nbi")) == []


@pytest.mark.ci
def test_where_no_kernel_can_be_kept_a_command_and_its_children_share_a_temporary_folder(
    run_without_a_place: Callable[[str], "subprocess.CompletedProcess[str]"], tmp_path: Path
) -> None:
    done = run_without_a_place(SHARE)
    assert done.stderr == ""
    own, childs, kept = done.stdout.splitlines()
    assert own == childs
    assert Path(own).is_relative_to(tmp_path / "temporary")
    assert int(kept) > 0, "a child that ended took its parent's kernels along"


def test_an_interrupted_command_leaves_no_temporary_folder(
    run_without_a_place: Callable[[str], "subprocess.CompletedProcess[str]"], tmp_path: Path
) -> None:
    done = run_without_a_place(INTERRUPTED)
    assert (done.returncode, done.stderr.strip()) == (130, "flflab: interrupted")
    assert Path(done.stdout.strip()).is_relative_to(tmp_path / "temporary")
