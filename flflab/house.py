"""The three plainly named packages beside flflab must be ours: other projects install packages of the same names."""

import base64
import hashlib
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

from flflab.errors import FlflabError

NEIGHBOURS = ("drivers", "procedures", "sim")
REMEDY = "install flflab again in a virtual environment of its own"


def check_neighbours() -> None:
    """Refuse to start where ``drivers``, ``procedures`` or ``sim`` is somebody else's; imports none of them.

    Raises:
        FlflabError: one of the three lies elsewhere, is missing, or was overwritten by another project's installation.
    """
    home = Path(__file__).resolve().parent.parent
    recorded = _recorded_hashes()
    for name in NEIGHBOURS:
        spec = find_spec(name)
        if spec is None:
            raise FlflabError(f"the package '{name}' that belongs to flflab is missing from {home}: {REMEDY}")
        if spec.origin is None or Path(spec.origin).resolve().parent.parent != home:
            found = spec.origin or ", ".join(spec.submodule_search_locations or ["an unknown place"])
            raise FlflabError(f"the package '{name}' found first is not flflab's but {found}: rename or leave that folder, or {REMEDY}")
        written = base64.urlsafe_b64encode(hashlib.sha256(Path(spec.origin).read_bytes()).digest()).rstrip(b"=").decode()
        if recorded.get(f"{name}/__init__.py", written) != written:
            raise FlflabError(f"{spec.origin} is not the file flflab installed, another project wrote over it: {REMEDY}")


def _recorded_hashes() -> dict[str, str]:
    """SHA-256 of each file the installation put in place; empty for an editable one or none."""
    try:
        record = distribution("flflab").read_text("RECORD") or ""
    except PackageNotFoundError:
        return {}
    rows = (line.rsplit(",", 2) for line in record.splitlines())
    return {row[0]: row[1].removeprefix("sha256=") for row in rows if len(row) == 3 and row[1]}
