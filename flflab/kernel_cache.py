"""Where compiled kernels are kept from one process to the next: in a folder of their own for every
state of the sources.

The compiler's own cache sees a change in a kernel's file alone, not in the files of what the kernel
calls: after an upgrade it would go on with formulas of before.
"""

import atexit
import contextlib
import hashlib
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

KEPT = 3  # states of the sources
_temporary: Path | None = None


def kernel_sources() -> list[Path]:
    """The files that compile kernels, and the modules they import."""
    home = Path(__file__).parent
    texts = {file: file.read_text(encoding="utf-8") for file in sorted(home.rglob("*.py"))}
    kernels = [file for file, text in texts.items() if "numba" in text]
    names = sorted(
        {
            name
            for file in kernels
            for name in re.findall(r"^from (flflab[\w.]*) import", texts[file], re.MULTILINE)
        }
    )
    imported = (home.parent.joinpath(*name.split(".")).with_suffix(".py") for name in names)
    return kernels + [file for file in imported if file in texts]


def name_of_the_state() -> str:
    """What the folder for the present state of the sources is called."""
    return f"flflab-{hashlib.sha256(b''.join(file.read_bytes() for file in kernel_sources())).hexdigest()[:16]}"  # noqa: E501


def kernel_cache(name: str) -> Path:
    """The folder of that name: within NUMBA_CACHE_DIR, or within the user's own cache.

    Raises:
        RuntimeError: neither is known.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given) if Path(given).name == name else Path(given) / name
    users = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME")
    return (Path(users) if users else Path.home() / ".cache") / "flflab" / name


def use_kernel_cache() -> None:
    """Have this process and those that it starts keep kernels there.

    Where no file can be written they share a temporary folder, which ends with this process: every
    command compiles anew.

    Raises:
        OSError: not even a temporary folder can be made.
    """
    name = name_of_the_state()
    folder = _kept(name) or _temporary_folder() / name
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:  # it has looked at the environment already
        sys.modules["numba"].config.CACHE_DIR = str(folder)


def _kept(name: str) -> Path | None:
    """The folder, made where there is none, and older ones removed then; None where no file can be
    written in it.
    """
    try:
        folder = kernel_cache(name)
        new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):  # one that was there may be another user's
            pass
    except (OSError, RuntimeError):
        return None
    if new:
        with contextlib.suppress(OSError):  # another process removes the same ones
            for older in sorted(folder.parent.glob("flflab-*"), key=os.path.getmtime)[:-KEPT]:
                shutil.rmtree(older, ignore_errors=True)
    return folder


def _temporary_folder() -> Path:
    global _temporary
    _temporary = Path(tempfile.mkdtemp(prefix="kernels-of-flflab-"))
    atexit.register(remove_temporary_kernels)
    return _temporary


def remove_temporary_kernels() -> None:
    """Remove the temporary folder that this process made, if any; Python does so by itself unless
    ``os._exit`` ends it.
    """
    if _temporary is not None:
        shutil.rmtree(_temporary, ignore_errors=True)
