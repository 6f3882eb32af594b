"""The promise of ``auto`` over random scenes: ``python benchmarks/bench_promise.py FILE [--first N]
[--scenes N] [--late S] [--finer N]``.

Every scene tried adds a line to FILE (CSV), and those in it are not tried again: start it again and
it goes on. At the end it says of all in the file how many kept the promise, and how long every
effect on takes against ``auto`` at the same tolerance. A scene that takes more processor time than
``--late`` is written down as late and not counted; with ``--again`` late ones are tried again.
Several may add to one file: ``--first 0 --step 2`` beside ``--first 1 --step 2``. With ``--rays``
the light is rays, without diffraction. The finer pictures cost most: dear scenes can be held
against less fine ones, ``--finer 4``, which the file tells. ``promise_trials.csv`` beside this
holds the trials of docs/pictures-trials.md. Set OPENBLAS_NUM_THREADS=1: on busy cores BLAS's
threads count the time that they wait for each other.
"""

import argparse
import csv
import math
import signal
import time
from dataclasses import astuple, fields
from pathlib import Path
from types import FrameType

import numpy as np

from flflab.image.promise import Trial, try_scene

WARM = 5  # scenes of other seeds before, so that nothing is compiled or loaded at the first
HEADER = [field.name for field in fields(Trial)]


class LateError(Exception):
    """A scene takes too long."""


def late(number: int, frame: FrameType | None) -> None:
    """Stop the scene at hand."""
    raise LateError


def read(file: Path) -> list[Trial]:
    """The trials in a file, the last of each seed; a late one has no figures."""
    if not file.exists():
        return []
    with file.open(newline="", encoding="utf-8") as stream:
        trials = [
            Trial(int(row["seed"]), *(float(row[name]) for name in HEADER[1:]))
            for row in csv.DictReader(stream)
        ]
    return list({trial.seed: trial for trial in trials}.values())


def spent_by(trials: list[Trial]) -> tuple[list[float], list[float]]:
    """Seconds of ``auto`` for each, without and with the estimate."""
    return [trial.picture for trial in trials], [trial.seconds for trial in trials]


def tried_within(late_s: float, seed: int, *, waves: bool, finer: float | None) -> Trial:
    """A scene tried, or one without figures where it takes more processor time."""
    signal.setitimer(signal.ITIMER_PROF, late_s)
    try:
        return try_scene(seed, waves=waves, finer=finer)
    except LateError:
        return Trial(seed, *[math.nan] * (len(HEADER) - 1))
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def told(trials: list[Trial]) -> str:
    """What became of the promise."""
    done = [trial for trial in trials if math.isfinite(trial.achieved)]
    lines = [f"{len(done)} scenes tried, {len(trials) - len(done)} late"]
    compared = [
        trial for trial in done if math.isfinite(trial.every)
    ]  # those too dear to form with every effect as well are not
    above = [trial.seed for trial in compared if not trial.every_achieved < trial.asked]
    missed = [trial.seed for trial in done if not trial.achieved < trial.asked]
    short = [trial.seed for trial in done if trial.estimated < trial.achieved]
    lines.append(f"error not below the tolerance: {len(missed)} {missed}")
    lines.append(f"estimate below the error: {len(short)} {short}")
    telling = [trial for trial in done if trial.telling]
    if telling:
        ratios = np.array([trial.estimated / trial.achieved for trial in telling])
        shares = np.percentile([trial.achieved / trial.asked for trial in done], [50, 95, 100])
        lines.append(
            f"estimate over error: median {np.median(ratios):.2f}, at most 5 in"
            f" {100 * np.mean(ratios <= 5):.1f} % of {len(telling)}"
        )
        lines.append(
            f"error over tolerance: median {shares[0]:.3f}, 95 % {shares[1]:.3f}, largest"
            f" {shares[2]:.3f}"
        )
        times = [
            [one.every / spent for one, spent in zip(compared, some, strict=True) if spent > 0]
            for some in spent_by(compared)
        ]
        lines.append(
            f"every effect on takes, in the median of {len(compared)}, {np.median(times[0]):.2f}"
            f" times the time of auto's picture, {np.median(times[1]):.2f} times that with its"
            f" estimate; its own error is not below the tolerance in {len(above)} {above}"
        )
    return "\n".join(lines)


def main() -> None:
    """Try scenes, write each down, and tell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--first", type=int, default=0, help="seed of the first scene")
    parser.add_argument(
        "--scenes",
        type=int,
        default=1000,
        help="seeds run from the first to below the first and this",
    )
    parser.add_argument("--step", type=int, default=1, help="from one seed to the next")
    parser.add_argument("--again", action="store_true", help="try late scenes again")
    parser.add_argument(
        "--late", type=float, default=600, help="processor seconds after which a scene is given up"
    )
    parser.add_argument(
        "--finer",
        type=float,
        help="how much finer than asked for the picture is that auto's is held against",
    )
    parser.add_argument("--rays", action="store_true", help="without diffraction")
    parser.add_argument(
        "--seconds", type=float, default=math.inf, help="begin no other scene after so long"
    )
    asked = parser.parse_args()
    trials = read(asked.file)
    tried = {trial.seed for trial in trials if not (asked.again and math.isnan(trial.achieved))}
    end = time.monotonic() + asked.seconds
    signal.signal(signal.SIGPROF, late)
    for seed in range(WARM):
        tried_within(asked.late, 10_000 + seed, waves=not asked.rays, finer=asked.finer)
    with asked.file.open("a", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        if stream.tell() == 0:
            writer.writerow(HEADER)
        for seed in range(asked.first, asked.first + asked.scenes, asked.step):
            if seed in tried or time.monotonic() > end:
                continue
            trial = tried_within(asked.late, seed, waves=not asked.rays, finer=asked.finer)
            writer.writerow([seed, *(f"{figure:.4g}" for figure in astuple(trial)[1:])])
            stream.flush()
            figures = (
                f"asked {trial.asked:.1e}  error {trial.achieved:.1e}  estimate"
                f" {trial.estimated:.1e}"
            )
            figures += (
                f"  {trial.seconds:7.2f} s (picture {trial.picture:.2f}, every effect"
                f" {trial.every:.2f})"
            )
            print(
                f"{seed:4d} "
                f" {figures}{'' if trial.kept else '  NOT KEPT' if math.isfinite(trial.achieved) else '  late'}",  # noqa: E501
                flush=True,
            )
    print(told(read(asked.file)))


if __name__ == "__main__":
    main()
