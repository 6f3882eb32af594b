"""The three plainly named packages beside flflab must be ours: other projects install packages of
the same names.
"""

import base64
import hashlib
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

NEIGHBOURS = ("drivers", "procedures", "sim")
REMEDY = "install flflab again in a virtual environment of its own"


def stranger_among_packages() -> str | None:
    """One sentence where ``drivers``, ``procedures`` or ``sim`` is missing, lies elsewhere, or was
    written over; imports none of them.
    """
    home = Path(__file__).resolve().parent.parent
    installed = _installed_hashes()
    for name in NEIGHBOURS:
        spec = find_spec(name)
        if spec is None:
            return f"the package '{name}', a part of flflab, is missing from {home}: {REMEDY}"
        if spec.origin is None or Path(spec.origin).resolve().parent.parent != home:
            found = spec.origin or ", ".join(
                spec.submodule_search_locations or ["an unknown place"]
            )
            return (
                f"the package '{name}' found first is not flflab's but {found}: start elsewhere, or"
                f" {REMEDY}"
            )
        present = (
            base64.urlsafe_b64encode(hashlib.sha256(Path(spec.origin).read_bytes()).digest())
            .rstrip(b"=")
            .decode()
        )
        if installed.get(f"{name}/__init__.py", present) != present:
            return (
                f"{spec.origin} is not the file flflab installed, another project wrote over it:"
                f" {REMEDY}"
            )
    return None


def _installed_hashes() -> dict[str, str]:
    """SHA-256 of each file the installation of these very files put in place; empty for an editable
    one or none.
    """
    try:
        installed = distribution("flflab")
    except PackageNotFoundError:
        return {}
    if Path(str(installed.locate_file("flflab/house.py"))).resolve() != Path(__file__).resolve():
        return {}
    rows = (line.rsplit(",", 2) for line in (installed.read_text("RECORD") or "").splitlines())
    return {row[0]: row[1].removeprefix("sha256=") for row in rows if len(row) == 3 and row[1]}
