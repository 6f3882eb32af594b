"""What a CUDA device gains: ``python benchmarks/bench_cuda.py [--repeats N]``, where there is one.

Every scene is formed on the processor's cores and on the device, in a process each
(``NUMBA_DISABLE_CUDA=1`` is all the difference): the first picture, which waits for kernels to be
compiled or loaded, the median of the others, and the largest difference of the two.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench_image import CHART, bench_camera

from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import Scene, one_plane
from flflab.targets import Bars, Edge, FourDot, Picture, White

PICTURE = Picture(np.random.default_rng(0).random((300, 400)), 160.0)


def scenes() -> dict[str, tuple[Scene, float]]:
    """Name, scene and tolerance of each."""
    sharp, blurred, wide = (
        one_plane(bench_camera(f), CHART, d) for f, d in ((4.0, 1000.0), (4.0, 900.0), (1.6, 900.0))
    )
    turned = replace(blurred, planes=(replace(blurred.planes[0], roll=0.2),))
    return {
        "chirp, in focus, F/4": (sharp, 0.002),
        "chirp, defocused, F/4": (blurred, 0.002),
        "chirp, defocused, F/4, finer": (blurred, 0.0005),
        "chirp, defocused, F/1.6": (wide, 0.002),
        "chirp, F/4, turned, fall-off": (replace(turned, falloff=Falloff()), 0.002),
        "white, F/4": (one_plane(bench_camera(4.0), White(), 900.0), 0.002),
        "edge, defocused, F/4": (one_plane(bench_camera(4.0), Edge(0.3), 900.0), 0.002),
        "bars, defocused, F/4": (one_plane(bench_camera(4.0), Bars(), 900.0), 0.002),
        "dots, defocused, F/4": (
            one_plane(bench_camera(4.0), FourDot(diameter=40.0, spacing=60.0), 900.0),
            0.0005,
        ),
        "picture, in focus, F/4": (one_plane(bench_camera(4.0), PICTURE, 1000.0), 0.002),
        "picture, defocused, F/4": (one_plane(bench_camera(4.0), PICTURE, 900.0), 0.01),
    }


def form(folder: Path, repeats: int) -> None:
    """Form all scenes in this process; keep pictures and times."""
    for index, (scene, tolerance) in enumerate(scenes().values()):
        times: list[float] = []
        image = np.zeros(0)
        for _ in range(repeats + 1):
            started = time.perf_counter()
            image = render(scene, tolerance=tolerance)
            times.append(time.perf_counter() - started)
        np.save(folder / f"{index}.npy", image)
        np.save(folder / f"{index}.times.npy", times)
        print(
            f"  {index}: {' '.join(f'{seconds:.3f}' for seconds in times)}",
            file=sys.stderr,
            flush=True,
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument(
        "--into", type=Path, help="form all scenes in this process and keep them in this folder"
    )
    asked = parser.parse_args()
    if asked.into:
        form(asked.into, asked.repeats)
        return
    from numba import cuda

    print(
        f"{os.cpu_count()} cores,"
        f" {cuda.get_current_device().name if cuda.is_available() else 'no device'}"
    )
    with tempfile.TemporaryDirectory() as scratch:
        folders = {name: Path(scratch) / name for name in ("device", "cores")}
        for name, folder in folders.items():
            folder.mkdir()
            environment = os.environ | ({"NUMBA_DISABLE_CUDA": "1"} if name == "cores" else {})
            command = [
                sys.executable,
                __file__,
                "--into",
                str(folder),
                "--repeats",
                str(asked.repeats),
            ]
            subprocess.run(command, check=True, env=environment)
        print(
            f"{'scene':30} {'cores s':>9} {'device s':>9} {'first s':>9} {'ratio':>7} largest"
            " difference, pixels beyond 1e-12"
        )
        for index, name in enumerate(scenes()):
            pictures = [np.load(folder / f"{index}.npy") for folder in folders.values()]
            on_device, on_cores = (
                np.load(folder / f"{index}.times.npy") for folder in folders.values()
            )
            cores, device = (
                statistics.median(times[1:].tolist()) for times in (on_cores, on_device)
            )
            off = np.abs(pictures[0] - pictures[1])
            beyond = f"{off.max():.1e}, {np.count_nonzero(off > 1e-12)}"
            print(
                f"{name:30} {cores:9.3f} {device:9.3f} {on_device[0]:9.3f} {cores / device:7.1f}"
                f" {beyond}"
            )


if __name__ == "__main__":
    main()
