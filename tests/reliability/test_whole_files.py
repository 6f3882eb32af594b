"""Pictures and tables on a disk that takes no more: one sentence, nothing half written, and what
was there stays.
"""

import errno
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from flflab.errors import InputError
from flflab.files.image import write_picture
from flflab.whole_file import (
    open_own,
    part_of,
    require_writable,
    write_csv,
    write_own,
    write_whole,
)

POSIX = pytest.mark.skipif(
    sys.platform == "win32", reason="limits the size of files, and names devices, the POSIX way"
)
WRITER = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from flflab.errors import InputError
from flflab.files.image import write_picture
from flflab.whole_file import write_csv

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write beyond the limit then fails as on a full disk
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
file, picture = Path(sys.argv[1]), np.random.default_rng(1).integers(0, 4096, (100, 100)).astype(np.uint16)
try:
    write_csv(file, picture.tolist()) if file.suffix == ".csv" else write_picture(file, picture)
except InputError as error:
    print(error)
"""  # noqa: E501
KILLED = """
import os, signal, sys
from pathlib import Path
from flflab.record.new_hdf5 import new_hdf5
from flflab.whole_file import part_of

file = Path(sys.argv[1])
with new_hdf5(file) if file.suffix == ".nxs" else part_of(file) as part:
    os.kill(os.getpid(), signal.SIGKILL)
"""


@POSIX
@pytest.mark.parametrize(
    "name", ["a.csv", "a.nxs", f"{'a' * 250}.csv"], ids=["table", "hdf5", "the longest name"]
)
def test_what_a_killed_program_began_goes_when_the_file_is_written_next(
    tmp_path: Path, name: str
) -> None:
    file, other = tmp_path / name, tmp_path / "b.csv"
    for killed in (file, other):
        ended = subprocess.run([sys.executable, "-c", KILLED, str(killed)], check=False)
        assert ended.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 2
    write_whole(file, "whole")
    (left,) = set(tmp_path.iterdir()) - {file}  # of the other file
    write_whole(other, "whole too")
    assert not left.exists()
    assert {one.name: one.read_text() for one in tmp_path.iterdir()} == {
        name: "whole",
        "b.csv": "whole too",
    }


def test_two_who_write_one_file_at_once_leave_each_other_alone(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    with part_of(file) as part:
        write_whole(file, "the second, sooner ready")
        assert file.read_text() == "the second, sooner ready"
        part.write_text("the first")
    assert {one.name: one.read_text() for one in tmp_path.iterdir()} == {"a.csv": "the first"}


@POSIX
@pytest.mark.parametrize("ending", [".npy", ".png", ".tiff", ".dng", ".csv"])
@pytest.mark.parametrize("before", [None, b"an older one"], ids=["new", "there already"])
def test_a_file_that_does_not_fit_leaves_what_was_there(
    tmp_path: Path, ending: str, before: bytes | None
) -> None:
    file = tmp_path / f"a{ending}"
    if before is not None:
        file.write_bytes(before)
    said = subprocess.run(
        [sys.executable, "-c", WRITER, str(file)], stdout=subprocess.PIPE, text=True, check=True
    ).stdout
    assert said.startswith(f"{file}: cannot be written (File too large)")
    assert said.count("\n") == 1
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == (
        {} if before is None else {file.name: before}
    )


def test_a_full_disk_is_told_with_what_is_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a.npy"
    file.write_bytes(b"an older one")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(
        InputError, match=r"a\.npy: the disk is full, 0\.0801 MB are needed; make room"
    ):
        write_picture(file, np.zeros((100, 100)))
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == {"a.npy": b"an older one"}


@POSIX
def test_a_pipe_takes_the_bytes_as_they_come(tmp_path: Path) -> None:
    pipe, read = tmp_path / "pipe", list[bytes]()
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()))
    reader.start()
    write_csv(pipe, [("a", "b"), (1, 2)])
    reader.join(10)
    assert read == [b"a,b\r\n1,2\r\n"]
    assert pipe.is_fifo()


@POSIX
def test_what_is_overwritten_keeps_its_link_and_who_may_read_it(tmp_path: Path) -> None:
    real, link = tmp_path / "real.csv", tmp_path / "link.csv"
    real.write_bytes(b"older")
    real.chmod(0o600)
    link.symlink_to(real)
    write_whole(link, "newer")
    assert link.is_symlink()
    assert (real.read_bytes(), real.stat().st_mode & 0o777) == (b"newer", 0o600)


@POSIX
@pytest.mark.skipif(
    hasattr(os, "geteuid") and os.geteuid() == 0,
    reason="nothing is write-protected from the administrator",
)
def test_what_is_write_protected_is_not_replaced(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_bytes(b"older")
    file.chmod(0o400)
    for refused in (require_writable, lambda file: write_whole(file, "newer")):
        with pytest.raises(InputError, match="write-protected"):
            refused(file)
    assert file.read_bytes() == b"older"


def test_where_nothing_can_be_written_is_refused_beforehand(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    nowhere = tmp_path / "no" / "a.csv", tmp_path / "file" / "a.csv"
    for place, says in (
        (tmp_path, "it is a folder"),
        *((place, "there is no folder") for place in nowhere),
    ):
        with pytest.raises(InputError, match=says):
            require_writable(place)
    require_writable(tmp_path / "a.csv")
    assert [one.name for one in tmp_path.iterdir()] == ["file"]


def test_a_name_that_is_not_utf_8_does_not_get_into_a_file(tmp_path: Path) -> None:
    file = tmp_path / "bench.yaml"
    with pytest.raises(
        InputError, match=r"bench\.yaml: would hold a file's name that is not UTF-8"
    ):
        write_whole(file, f"optics: {os.fsdecode(bytes([0x63, 0xE9]))}.yaml")
    assert list(tmp_path.iterdir()) == []


def test_in_a_runs_folder_a_link_is_replaced_and_what_it_leads_to_is_left(tmp_path: Path) -> None:
    victim, run = tmp_path / "victim", tmp_path / "run"
    victim.write_text("mine")
    run.mkdir()
    for target in (victim, tmp_path / "not there"):
        (run / "report.html").unlink(missing_ok=True)
        (run / "report.html").symlink_to(target)
        write_own(run / "report.html", "page")
        assert not (run / "report.html").is_symlink()
        assert (run / "report.html").read_text() == "page"
    assert victim.read_text() == "mine"
    assert {one.name for one in tmp_path.iterdir()} == {"victim", "run"}


@pytest.mark.parametrize("mode", ["a", "r+b"])
def test_in_a_runs_folder_a_link_is_not_opened_for_writing(tmp_path: Path, mode: str) -> None:
    (tmp_path / "victim").write_text("mine")
    (tmp_path / "log.txt").symlink_to(tmp_path / "victim")
    with pytest.raises(OSError, match="is a link, and links are not written through"):
        open_own(tmp_path / "log.txt", mode)
