"""Installs flflab from this folder into an environment of its own, then runs it or its tests.

``python quickstart.py validate`` stands for ``flflab validate``, with any arguments; ``python
quickstart.py tests`` for ``pytest``. The environment is the active one, else ``.venv`` beside this
file. Needs nothing but Python and pip's access to packages.
"""

from __future__ import annotations  # an older Python, too, comes as far as to be told so

import signal
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
OLDEST = (3, 11)
SPREAD = ("-n", "auto", "--maxprocesses", "4", "--dist", "loadfile")  # a test file to a core
USAGE = """usage: python quickstart.py validate  (or any other command of flflab, with its arguments)
       python quickstart.py tests  (with any arguments of pytest)"""  # noqa: E501


def run(*command: str | Path) -> None:
    """Run one command, shown first; end with its exit code where that is not 0."""
    words = [str(word) for word in command]
    print("+", *words, flush=True)
    if (
        signal.getsignal(signal.SIGINT) is not signal.SIG_IGN
    ):  # Ctrl-C reaches the command too, which says itself how it ends
        signal.signal(signal.SIGINT, lambda number, frame: None)
    code = subprocess.run(words, check=False).returncode
    if code:
        sys.exit(code if code > 0 else 128 - code)  # of one that a signal ended, what a shell says


def environment() -> Path:
    """The folder of executables of the active virtual environment, else of the one here, made where
    it has no Python with pip.
    """
    if sys.prefix != sys.base_prefix:
        return Path(sys.executable).parent
    programs = HERE / ".venv" / ("Scripts" if sys.platform == "win32" else "bin")
    if not has_pip(programs / "python"):
        run(sys.executable, "-m", "venv", HERE / ".venv")
    return programs


def has_pip(python: Path) -> bool:
    """Whether that Python starts and finds pip."""
    try:
        return (
            subprocess.run(
                [str(python), "-c", "import pip"], stderr=subprocess.DEVNULL, check=False
            ).returncode
            == 0
        )
    except OSError:
        return False


def main(words: list[str]) -> None:
    """Install and run."""
    if sys.version_info < OLDEST:
        needed, here = (f"{version[0]}.{version[1]}" for version in (OLDEST, sys.version_info))
        sys.exit(
            f"quickstart.py: flflab needs Python {needed} or later and this is {here}; start it"
            f" with a newer one, say python{needed}"
        )
    if not words or words[0].startswith("-"):
        sys.exit(USAGE)
    tests = words[0] == "tests"
    programs = environment()
    run(
        programs / "python",
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        f"{HERE}[test]" if tests else HERE,
    )
    if tests:
        run(programs / "pytest", "--rootdir", HERE, *SPREAD, *words[1:])
    else:
        run(programs / "flflab", *words)


if __name__ == "__main__":
    main(sys.argv[1:])
