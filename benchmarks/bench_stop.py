"""How long a stop takes from Enter until the last axis was told, by the command and by the library.

Run by hand: ``python benchmarks/bench_stop.py [RUNS]``. Another process drives two axes of a bench
that is simulated in real time here and served on TCP; a motion that is replaced by its braking was
stopped. In half of the runs the other process is suspended, so that only the lines opened past it
help.
"""

import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import yaml

from drivers.stopping import stop_bench
from flflab.bench import read_bench
from sim.serve import Served, serve, write_bench

ROOT = Path(__file__).resolve().parent.parent
MOVING = ("array_stage", "sensor_stage")
OWNER = """
import sys
from drivers.base import wait_all
from drivers.bench import connect
with connect(sys.argv[1]) as bench:
    for names in (("main_lens_stage", "sensor_stage"), ("array_stage",)):
        wait_all(*(bench.axes[name].home() for name in names if not bench.axes[name].is_homed()))
    wait_all(*(bench.axes[name].move_to(0.5) for name in ("array_stage", "sensor_stage")))
    moving = [bench.axes[name].move_to(18.0) for name in ("array_stage", "sensor_stage")]
    print("moving", flush=True)
    sys.stdin.readline()
"""


def command(file: Path) -> None:
    """What an operator types."""
    subprocess.run(
        [sys.executable, "-P", "-m", "flflab", "bench", "stop", "--bench", str(file)],
        check=True, capture_output=True,
    )  # fmt: skip


def library(file: Path) -> None:
    """What a script calls."""
    stop_bench(file)


def until_the_last_stop(
    served: Served, file: Path, stop: Callable[[Path], None], *, suspended: bool
) -> float:
    """Seconds from the begin of a stop until both axes brake."""
    with subprocess.Popen(
        [sys.executable, "-P", "-c", OWNER, str(file)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
    ) as owner:  # fmt: skip
        if owner.stdout is None or owner.stdout.readline() != b"moving\n":
            raise RuntimeError("the program that is to be stopped moves nothing")
        time.sleep(0.3)
        if suspended:
            os.kill(owner.pid, signal.SIGSTOP)
        carriages = [served.world.carriages[name] for name in MOVING]
        before = [carriage.motion for carriage in carriages]
        begin = time.perf_counter()
        stopping = threading.Thread(target=stop, args=(file,))
        stopping.start()
        while any(
            carriage.motion is motion for carriage, motion in zip(carriages, before, strict=True)
        ):
            time.sleep(0.0005)
        took = time.perf_counter() - begin
        stopping.join()
        owner.kill()
    time.sleep(0.5)  # its sentinel ends
    return took


def main() -> None:
    """Print the table."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    source = ROOT / "examples" / "benches" / "simulated.yaml"
    data = yaml.safe_load(source.read_text(encoding="utf-8"))
    data["optics"] = str((source.parent / data["optics"]).resolve())
    data["simulated"] |= {"clock": 1}
    for axis in data["axes"].values():
        axis["speed"] = "4 mm/s"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bench.yaml"
        file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
        bench = read_bench(file)
        with serve(bench) as served:
            write_bench(bench, served, Path(folder) / "served.yaml")
            for stop in (command, library):
                for suspended in (False, True):
                    took = sorted(
                        until_the_last_stop(
                            served, Path(folder) / "served.yaml", stop, suspended=suspended
                        )
                        for _ in range(runs)
                    )
                    whose = "its owner suspended" if suspended else "its owner running"
                    sys.stdout.write(
                        f"stop by the {stop.__name__}, {whose:20}: median"
                        f" {1e3 * statistics.median(took):5.0f} ms, least {1e3 * took[0]:5.0f},"
                        f" most {1e3 * took[-1]:5.0f} ({runs} runs)\n"
                    )


if __name__ == "__main__":
    main()
