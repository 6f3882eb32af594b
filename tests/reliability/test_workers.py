"""Workers end with the program that started them, however it ends."""

import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

PROGRAM = textwrap.dedent("""
    import sys
    from flflab.workers import results

    if __name__ == "__main__":
        import signal, time
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # who runs the tests may have it ignored
        from busily import busy

        function, given = (time.sleep, (600,)) if sys.argv[1] == "sleeping" else (busy, ())
        list(results(function, [given] * 9, None))
""")
BUSY = "def busy():\n    while True:\n        pass\n"


def children(pid: int) -> set[int]:
    """All that descend from a process."""
    parents: dict[int, int] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it ended just now
        if fields[0] != "Z":
            parents[int(stat.parent.name)] = int(fields[1])
    found, more = {pid}, {pid}
    while more:
        more = {one for one, parent in parents.items() if parent in more}
        found |= more
    return found - {pid}


def alive(pids: set[int]) -> set[int]:
    return {
        pid
        for pid in pids
        if (stat := Path(f"/proc/{pid}/stat")).exists()
        and stat.read_text().rpartition(")")[2].split()[0] != "Z"
    }


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes as on Linux")
@pytest.mark.parametrize(
    ("ending", "work"),
    [
        (signal.SIGTERM, "sleeping"),
        (signal.SIGHUP, "sleeping"),
        (signal.SIGKILL, "sleeping"),
        (signal.SIGKILL, "busy"),
    ],
)
def test_no_worker_outlives_a_killed_program(
    ending: signal.Signals, work: str, tmp_path: Path
) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    (tmp_path / "busily.py").write_text(BUSY)
    with subprocess.Popen([sys.executable, str(program), work], cwd=tmp_path) as process:
        try:
            started: set[int] = set()
            wait_until = time.monotonic() + 60
            # one worker a core and the tracker of what they share
            while len(started) < 2 and time.monotonic() < wait_until:
                time.sleep(0.05)
                started = children(process.pid)
            time.sleep(1.0)  # they are at work
            started = children(process.pid)
            assert len(started) >= 2
            process.send_signal(ending)
            process.wait(30)
        finally:
            process.kill()
        wait_until = time.monotonic() + 30
        while alive(started) and time.monotonic() < wait_until:
            time.sleep(0.05)
        left = alive(started)
        for pid in left:
            subprocess.run(["kill", "-9", str(pid)], check=False)
        assert left == set()
