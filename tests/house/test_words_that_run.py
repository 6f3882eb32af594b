"""Every command and every piece of Python in the README and the docs runs as it stands there.

The word after the language says how: ``ci`` and ``full`` are markers, ``r12a`` needs those
measurements, ``install`` is run by .ci/run, ``bench`` needs instruments. A block of commands holds
one a line.
"""

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```(bash|python)([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NOT_HERE = {"install", "bench"}


def blocks() -> Iterator[object]:
    for file in (
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *sorted((ROOT / "docs").rglob("*.md")),
    ):
        text = file.read_text(encoding="utf-8")
        for found in BLOCK.finditer(text):
            words = set(found[2].split())
            assert words <= NOT_HERE | {"ci", "full", "r12a"}, f"{file}: {found[0]}"
            if not words & NOT_HERE:
                line = text.count("\n", 0, found.start()) + 2
                marks = [getattr(pytest.mark, word) for word in sorted(words)]
                yield pytest.param(
                    found[1],
                    found[3],
                    marks=marks,
                    id=f"{file.relative_to(ROOT).as_posix()}:{line}",
                )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that looks like the project's to a reader who types the commands there: the
    examples, and the measurements beside it.
    """
    project = tmp_path / "project"
    shutil.copytree(ROOT / "examples", project / "examples")
    return project


def run(command: list[str], folder: Path) -> None:
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == 0, f"{shlex.join(command)}\n{done.stdout}\n{done.stderr}"


@pytest.mark.timeout(600)  # a page's commands together
@pytest.mark.parametrize(("language", "text"), list(blocks()))
def test_what_the_pages_show_runs(
    language: str, text: str, folder: Path, request: pytest.FixtureRequest
) -> None:
    if request.node.get_closest_marker("r12a"):
        shutil.copytree(request.getfixturevalue("r12a"), folder.parent / "shared" / "data" / "r12a")
    if language == "python":
        run([sys.executable, "-c", text], folder)
        return
    for line in text.splitlines():
        words = shlex.split(line, comments=True)
        if words:
            program = shutil.which(words[0], path=str(Path(sys.executable).parent)) or shutil.which(
                words[0]
            )
            assert program is not None, f"no program {words[0]}"
            run([program, *words[1:]], folder)
