"""What it gains that stages move while the last frame is read out, checked and recorded.

    python benchmarks/bench_overlap.py [--clock 2]

The same sweep of the built-in bench, as it is and with a camera that does not say when its light is
in. The simulated camera draws its pictures while it reads out, which takes longer than a real
read-out: what is printed is the most it can gain.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from drivers.bench import ConnectedBench, connect
from flflab.bench import read_bench
from flflab.study import Study, read_study
from procedures.study import begin_recording, take_study, tell_nobody

BUILT_IN = Path(__file__).parents[1] / "flflab" / "builtin"


class Silent:
    """A camera that does not tell when its light is in."""

    def __init__(self, camera: Any) -> None:
        self._camera = camera

    def __getattr__(self, name: str) -> Any:
        return getattr(self._camera, name)

    def grab(self, exposed: Callable[[], None]) -> Any:
        """Take one picture."""
        return self._camera.grab()


def swept(bench: ConnectedBench, study: Study) -> float:
    """Seconds that a sweep takes."""
    with tempfile.TemporaryDirectory() as folder:
        recording = begin_recording(bench, study, Path(folder))
        began = time.monotonic()
        take_study(bench, study, recording, tell_nobody, "sweep")
        return time.monotonic() - began


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--clock", type=float, default=2.0)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        described = yaml.safe_load((BUILT_IN / "benches" / "simulated.yaml").read_text())
        described["simulated"]["clock"] = asked.clock
        described["optics"] = str((BUILT_IN / "cameras" / "osinski.yaml").resolve())
        file = Path(folder) / "bench.yaml"
        file.write_text(yaml.safe_dump(described, sort_keys=False))
        (Path(folder) / "study.yaml").write_text(
            "name: three\nconfigurations: [{f_number: 4, distance: [500 mm, 507 mm, 515 mm]}]\n"
        )
        study = read_study(Path(folder) / "study.yaml", read_bench(file).optics)
        for name in (
            "first, to compile",
            "overlapping",
            "one after the other",
            "overlapping",
            "one after the other",
        ):
            with connect(file) as bench:
                if name == "one after the other":
                    bench.camera = Silent(bench.camera)
                print(f"{name}: {swept(bench, study):.1f} s", flush=True)


if __name__ == "__main__":
    main()
