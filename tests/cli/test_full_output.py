"""A standard output that takes nothing: one sentence where its disk is full, none where its reader
has gone.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(
    not Path("/dev/full").exists(), reason="there is no disk that is always full"
)
OSINSKI = str(Path(__file__).parents[2] / "examples" / "cameras" / "osinski.yaml")
COMMANDS = [
    ("--help",),  # a short text
    ("model", OSINSKI),  # a table
    ("model", OSINSKI, "--json"),  # more than a buffer holds
    (
        "image",
        OSINSKI,
        "--target",
        "black",
        "--distance",
        "500 mm",
        "-o",
        "black.npy",
        "--json",
    ),  # less: it is written at the end
]
CONCLUDED = """
import sys
from types import SimpleNamespace
from rich.console import Console
from flflab import cli, record
from flflab.cli import verdict

accepted, printing = sys.argv[1:]
record.read_run = lambda folder: SimpleNamespace(folder=folder, complete=True, lost=())
verdict.judged = lambda *_: (SimpleNamespace(comparison=SimpleNamespace(accepted=accepted == "yes")), "page")
verdict._tell = lambda *_: (print if printing == "plain" else Console().print)("a table")
sys.argv = ["flflab", "report", "run"]
cli.main()
"""  # noqa: E501
BUFFERED = {
    name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"
}  # as users run it


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-P", "-m", "flflab", *arguments]


@pytest.mark.parametrize("arguments", COMMANDS, ids=lambda arguments: " ".join(arguments)[-12:])
def test_a_full_disk_behind_standard_output_is_one_sentence_and_exit_1(
    arguments: tuple[str, ...],
) -> None:
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            command(*arguments),
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=100,
            env=BUFFERED,
        )
    said = (
        "flflab: standard output cannot be written (No space left on device); send it to a place"
        " with room\n"
    )
    assert (ended.returncode, ended.stderr) == (1, said)


@pytest.mark.parametrize("arguments", COMMANDS, ids=lambda arguments: " ".join(arguments)[-12:])
def test_a_reader_who_has_gone_is_told_nothing(arguments: tuple[str, ...]) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        ended = subprocess.run(
            command(*arguments),
            stdout=writer,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=100,
            env=BUFFERED,
        )
    finally:
        os.close(writer)
    assert (ended.returncode, ended.stderr) == (1, "")


@pytest.mark.ci
@pytest.mark.parametrize(
    ("printing", "accepted", "code"),
    [
        ("rich", "yes", 0),
        ("plain", "no", 3),
        pytest.param("rich", "no", 3, marks=pytest.mark.ci),
        pytest.param("plain", "yes", 0, marks=pytest.mark.ci),
    ],
)
def test_a_verdict_stays_what_it_is_where_its_reader_has_gone(
    printing: str, accepted: str, code: int
) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        concluded = [sys.executable, "-P", "-c", CONCLUDED, accepted, printing]
        ended = subprocess.run(
            concluded,
            stdout=writer,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=100,
            env=BUFFERED,
        )
    finally:
        os.close(writer)
    assert (ended.returncode, ended.stderr) == (code, "all recorded; measuring and comparing\n")


def test_what_a_command_failed_with_is_told_though_standard_output_is_full() -> None:
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            command("model", "nowhere.yaml"),
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=100,
            env=BUFFERED,
        )
    assert ended.returncode == 1
    assert ended.stderr.startswith("flflab: nowhere.yaml: cannot be read")


def test_a_standard_output_closed_beforehand_is_nothing_to_speak_of() -> None:
    closed = ["sh", "-c", 'exec "$@" >&-', "sh", *command("model", OSINSKI, "--json")]
    ended = subprocess.run(
        closed, stderr=subprocess.PIPE, text=True, check=False, timeout=100, env=BUFFERED
    )
    assert (ended.returncode, ended.stderr) == (0, "")
