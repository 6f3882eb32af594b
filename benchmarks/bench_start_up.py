"""What commands cost before they do anything: processor seconds, as a table for
docs/evidence/start-up.md.

    python benchmarks/bench_start_up.py

Each line is the least of nine starts; the served bench is simulated and already runs.
"""

import json
import resource
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

STARTS = 9
BENCH = Path(__file__).parents[1] / "examples" / "benches" / "simulated.yaml"
COMMANDS = (
    "--help", "--version", "bench --help", "bench check", "bench where", "bench home",
    "bench move array_stage '5 mm'", "bench stop", "model --help", "validate --help",
)  # fmt: skip


def processor_seconds(command: list[str]) -> float:
    """What one start of a command costs, user and system together."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> None:
    """Print the table."""
    flflab = [sys.executable, "-P", "-m", "flflab"]
    with tempfile.TemporaryDirectory() as folder:
        served = Path(folder) / "served.yaml"
        sim = subprocess.Popen(
            [*flflab, "sim", str(BENCH), "--json", "--write-bench", str(served)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        try:
            json.loads(sim.stdout.readline() if sim.stdout else b"")
            subprocess.run([*flflab, "bench", "home", "--bench", str(served)], check=True)
            print("| command | processor, s |\n|---|---|")
            for given in COMMANDS:
                words = shlex.split(given)
                if given.startswith("bench") and "--help" not in given:
                    words += ["--bench", str(served)]
                least = min(processor_seconds([*flflab, *words]) for _ in range(STARTS))
                print(f"| `flflab {given}` | {least:.2f} |", flush=True)
        finally:
            sim.terminate()
            sim.communicate()


if __name__ == "__main__":
    main()
