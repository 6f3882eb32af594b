"""A run's folder: made once, never overwritten, with the descriptions as used and what ran."""

import contextlib
import json
import platform
import shutil
import stat
import subprocess
import sys
from collections.abc import Generator
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import yaml

from flflab.bench import Bench, fields_of
from flflab.errors import FlflabError, InputError, RecordError
from flflab.record.checksums import SUMS, write_sums
from flflab.record.durable import force_to_disk
from flflab.whole_file import write_own
from flflab.yaml_file import edit_yaml, put

DOCUMENTS, FRAMES, DATASET = "documents.jsonl", "frames.h5", "frames"
VERSIONS = "versions.json"
DESCRIPTIONS = ("bench.yaml", "camera.yaml", "study.yaml", VERSIONS)
BEFORE = {*DESCRIPTIONS, SUMS}  # what a run writes before its first document
PACKAGES = (
    "flflab",
    "bluesky",
    "event-model",
    "h5py",
    "numba",
    "numpy",
    "opencv-contrib-python-headless",
    "pydantic",
    "pyserial",
    "scipy",
)


def new_folder(study: str, parent: Path = Path("runs")) -> Path:
    """Make ``runs/<UTC>-<study>``, a folder that did not exist before.

    Raises:
        RecordError: it cannot be made.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    for again in ("", *(f"-{count}" for count in range(2, 100))):
        folder = parent / f"{stamp}-{study}{again}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise RecordError(
                f"{folder}: cannot be made ({error.strerror or error}); give a folder you may"
                " write in"
            ) from error
        return folder
    raise RecordError(f"{parent}: a hundred runs of {study} began in this second; wait a second")


@contextlib.contextmanager
def run_folder(folder: Path | None, study: str) -> Generator[Path]:
    """A folder for one run: the one given, or a new one below ``runs``; made here and still empty
    at the end it goes again.

    Raises:
        RecordError: as ``claim_folder`` and ``new_folder``.
    """
    made = folder is None or not folder.exists()
    place = new_folder(study) if folder is None else claim_folder(folder)
    try:
        yield place
    finally:
        if made:
            with contextlib.suppress(OSError):  # it is not empty
                place.rmdir()


def claim_folder(folder: Path) -> Path:
    """Make a folder for one run, or take one that is empty or holds only the descriptions of a run
    that never began.

    Raises:
        RecordError: it holds a run already or anything else, or cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = {
            one.name for one in folder.iterdir() if not one.name.startswith(".")
        }  # those are a file browser's
    except OSError as error:
        raise RecordError(
            f"{folder}: cannot be made ({error.strerror or error}); give a folder you may write in"
        ) from error
    run = [name for name in (DOCUMENTS, FRAMES) if name in held]
    if run:
        raise RecordError(
            f"{folder}: holds a run already ({', '.join(run)}) and runs are never overwritten; give"
            " another folder"
        )
    others = sorted(held - BEFORE if VERSIONS in held else held)
    if others:
        first = ", ".join(others[:3]) + (f" and {len(others) - 3} more" if len(others) > 3 else "")
        raise RecordError(
            f"{folder}: holds other files ({first}), and a run has a folder to itself; give a new"
            " or an empty one"
        )
    return folder


def require_files(folder: Path) -> None:
    """Refuse a folder that holds a pipe or a device, or a link to one: to read it may never end.

    Raises:
        RecordError: it does, and which.
    """
    with contextlib.suppress(OSError):  # what is missing or unreadable is told by who reads it
        for file in folder.iterdir():
            mode = file.stat().st_mode if file.exists() else stat.S_IFREG
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                raise RecordError(
                    f"{file}: is a pipe or a device, where a run has files; take it from a copy"
                )


def keep_descriptions(folder: Path, bench: Bench, study_file: Path | None) -> None:
    """Write bench.yaml, camera.yaml and study.yaml as used, versions.json, and the sums of these:
    all of them, or none.

    Args:
        folder: the run's.
        bench: the bench as read; its copy names ``camera.yaml`` as its optics.
        study_file: the study's YAML file; None where a procedure has none.

    Raises:
        RecordError: the folder cannot be written.
    """
    fields: dict[str, Any] = fields_of(bench) | {"optics": "camera.yaml"}

    def change(data: Any) -> None:
        data["optics"] = fields["optics"]
        if data.get("simulated") is None and "simulated" in fields:
            data["simulated"] = fields["simulated"]
        elif data.get("simulated") != fields.get("simulated"):
            put(data["simulated"], "seed", fields["simulated"]["seed"])

    try:
        copied = edit_yaml(bench.file.read_text(encoding="utf-8"), str(bench.file), change)
    except InputError:  # anchors: without the comments, but right
        copied = yaml.safe_dump(fields, sort_keys=False, allow_unicode=True)
    try:
        optics = (bench.file.parent / bench.description.optics).read_bytes()
        write_own(folder / "bench.yaml", copied)
        write_own(folder / "camera.yaml", optics)
        if study_file is not None:
            write_own(folder / "study.yaml", study_file.read_bytes())
        else:
            (folder / "study.yaml").unlink(missing_ok=True)  # of a run that never began
        write_own(folder / VERSIONS, json.dumps(versions(), indent=1) + "\n")
        write_sums(folder, DESCRIPTIONS)
        for name in (*BEFORE, "."):  # frames without their descriptions would be worth nothing
            if (folder / name).exists():
                force_to_disk(folder / name)
    except FlflabError:
        forget_descriptions(folder)
        raise
    except OSError as error:
        forget_descriptions(folder)
        raise RecordError(
            f"{folder}: cannot be written ({error.strerror or error}); give a folder you may"
            " write in"
        ) from error


def forget_descriptions(folder: Path) -> None:
    """Remove what ``keep_descriptions`` wrote."""
    for name in BEFORE:
        (folder / name).unlink(missing_ok=True)


def versions() -> dict[str, str]:
    """What ran: Python, platform, the packages that matter, and of a checkout of flflab its commit;
    absent ones are left out.
    """
    found = {"python": sys.version.split()[0], "platform": platform.platform()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found | git_state(Path(__file__).parents[2])


def git_state(checkout: Path) -> dict[str, str]:
    """``git``: the commit of a checkout, and whether its files are changed since; empty where it is
    none or there is no git.
    """
    program = shutil.which("git")
    if program is None or not (checkout / ".git").exists():
        return {}
    asked = ("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no")
    said = [
        subprocess.run(
            [program, "-C", str(checkout), *words], capture_output=True, text=True, check=False
        )
        for words in asked
    ]
    if any(one.returncode for one in said):
        return {}
    commit, changed = (one.stdout.strip() for one in said)
    return {"git": f"{commit}, with changed files" if changed else commit}
