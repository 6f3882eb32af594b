"""Installs flflab from this folder into an environment of its own, then runs it or its tests.

``python quickstart.py validate`` stands for ``flflab validate``, with any arguments; ``python quickstart.py tests`` for ``pytest``.
The environment is the active one, else ``.venv`` beside this file. Needs nothing but Python and pip's access to packages.
"""

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
SPREAD = ("-n", "auto", "--maxprocesses", "4", "--dist", "loadfile")  # a test file to a core
USAGE = """usage: python quickstart.py validate  (or any other command of flflab, with its arguments)
       python quickstart.py tests  (with any arguments of pytest)"""


def run(*command: str | Path) -> None:
    """Run one command, shown first; end with its exit code where that is not 0."""
    words = [str(word) for word in command]
    print("+", *words, flush=True)
    code = subprocess.run(words, check=False).returncode
    if code:
        sys.exit(code)


def environment() -> Path:
    """The folder of executables of the active virtual environment, else of one made here."""
    if sys.prefix != sys.base_prefix:
        return Path(sys.executable).parent
    run(sys.executable, "-m", "venv", HERE / ".venv")
    return HERE / ".venv" / ("Scripts" if sys.platform == "win32" else "bin")


def main(words: list[str]) -> None:
    """Install and run."""
    if not words or words[0].startswith("-"):
        sys.exit(USAGE)
    tests = words[0] == "tests"
    programs = environment()
    run(programs / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", f"{HERE}[test]" if tests else HERE)
    if tests:
        run(programs / "pytest", "--rootdir", HERE, *SPREAD, *words[1:])
    else:
        run(programs / "flflab", *words)


if __name__ == "__main__":
    main(sys.argv[1:])
