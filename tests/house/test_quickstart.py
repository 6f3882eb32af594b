"""The script of the README's two commands."""

import subprocess
import sys
from pathlib import Path


def test_quickstart_without_a_command_says_how_it_is_used(root: Path) -> None:
    done = subprocess.run([sys.executable, str(root / "quickstart.py")], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert done.stderr.startswith("usage: python quickstart.py validate")
