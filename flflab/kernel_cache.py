"""Where compiled kernels are kept from one process to the next: in a folder of their own for every state of the sources.

The compiler's own cache sees a change in a kernel's file alone, not in the files of what the kernel calls: after an upgrade it would go
on with formulas of before.
"""

import contextlib
import hashlib
import os
import re
import shutil
import sys
from pathlib import Path

KEPT = 3  # states of the sources


def kernel_sources() -> list[Path]:
    """The files that compile kernels, and the modules they import."""
    home = Path(__file__).parent
    texts = {file: file.read_text(encoding="utf-8") for file in sorted(home.rglob("*.py"))}
    kernels = [file for file, text in texts.items() if "numba" in text]
    names = sorted({name for file in kernels for name in re.findall(r"^from (flflab[\w.]*) import", texts[file], re.MULTILINE)})
    imported = (home.parent.joinpath(*name.split(".")).with_suffix(".py") for name in names)
    return kernels + [file for file in imported if file in texts]


def kernel_cache() -> Path:
    """The folder: within NUMBA_CACHE_DIR, or within the user's own cache.

    Raises:
        RuntimeError: neither is known.
    """
    name = f"flflab-{hashlib.sha256(b''.join(file.read_bytes() for file in kernel_sources())).hexdigest()[:16]}"
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given) if Path(given).name == name else Path(given) / name
    users = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME")
    return (Path(users) if users else Path.home() / ".cache") / "flflab" / name


def use_kernel_cache() -> None:
    """Have this process and those that it starts keep kernels there; without a place for them they are compiled anew each time."""
    with contextlib.suppress(OSError, RuntimeError):
        folder = kernel_cache()
        new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        if new:
            for older in sorted(folder.parent.glob("flflab-*"), key=os.path.getmtime)[:-KEPT]:
                shutil.rmtree(older, ignore_errors=True)
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        if "numba" in sys.modules:  # it has looked at the environment already
            sys.modules["numba"].config.CACHE_DIR = str(folder)
