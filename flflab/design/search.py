"""The search: all configurations of a grid in chunks, the front of those that meet the
requirements, and what hinders where none does.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from flflab.design.chunk_log import Chunk, ChunkLog, Found, fingerprint
from flflab.design.figures import Figures, figures_at, objectives, solve_figures
from flflab.design.front import empty_front, merged
from flflab.design.grid import Candidates, Grid, candidates, make_grid
from flflab.design.judgement import Demand, demands, margins, met
from flflab.design.requirements import Requirements

Array = npt.NDArray[np.float64]
Progress = Callable[[int, int], None]

CHUNK = 1 << 18


@dataclass(frozen=True)
class Hindrance:
    """Why nothing meets the requirements.

    Attributes:
        alone: for a demand that is the only one missed somewhere: the best value its figure has
            there.
        nearest: number of the configuration whose worst relative miss is least; None where none can
            be built.
        misses: that configuration's misses: demand and value.
    """

    alone: tuple[tuple[Demand, float], ...]
    nearest: int | None
    misses: tuple[tuple[Demand, float], ...]


@dataclass
class _Best:
    """The best seen so far while hindrances are looked for."""

    alone: dict[int, float] = field(default_factory=dict[int, float])
    worst: float = -np.inf
    nearest: int | None = None
    misses: tuple[tuple[Demand, float], ...] = ()


def chunks(grid: Grid) -> Iterator[Chunk]:
    """First number and number after the last of every chunk."""
    return ((first, min(first + CHUNK, grid.size)) for first in range(0, grid.size, CHUNK))


def search_chunk(
    wanted: Requirements, grid: Grid, first: int, last: int, threads: int | None = None
) -> Found:
    """Search the configurations from first to below last: what misses a demand at the near end is
    not looked at again.
    """
    asked = demands(wanted)
    found = Found(empty_front(len(wanted.maximise), wanted.search.epsilon), ((first, last),), 0, 0)
    for given in candidates(grid, first, last):
        built = given.number
        near = figures_at(given, wanted, 0, threads)
        good = met(asked, near)
        given, near = given.kept(good), near.kept(good)
        if given.number:
            figures = near.worst(figures_at(given, wanted, 1, threads))
            good = met(asked, figures)
            given, figures = given.kept(good), figures.kept(good)
        else:
            figures = near
        front = found.front
        if given.number:
            front = merged(front, given.number_in_grid, objectives(given, wanted, figures, threads))
        found = Found(front, found.chunks, found.built + built, found.met + given.number)
    return found


def search(
    wanted: Requirements, log: Path | None = None, progress: Progress | None = None
) -> Found:
    """Search the whole grid on this machine's cores; memory stays that of one chunk and the front.

    Args:
        wanted: the requirements.
        log: where every chunk's result is written when it is there; a search that was interrupted
            goes on from it.
        progress: called with the configurations done and their number.

    Raises:
        InputError: as ``make_grid``; or the log is another search's.
    """
    grid = make_grid(wanted)
    return gathered(
        wanted,
        grid,
        lambda todo: (search_chunk(wanted, grid, *chunk) for chunk in todo),
        log,
        progress,
    )


def gathered(
    wanted: Requirements,
    grid: Grid,
    run: Callable[[list[Chunk]], Iterable[Found]],
    log: Path | None,
    progress: Progress | None = None,
) -> Found:
    """All chunks together, in whatever order ``run`` has them ready; those in the log are not
    searched again.
    """
    total = Found(empty_front(len(wanted.maximise), wanted.search.epsilon), (), 0, 0)
    with ChunkLog(log, fingerprint(wanted)) as kept:
        for part in kept.done:
            total = total.with_more(part)
        done = {chunk for part in kept.done for chunk in part.chunks}
        for part in run([chunk for chunk in chunks(grid) if chunk not in done]):
            kept.add(part)
            total = total.with_more(part)
            if progress is not None:
                progress(total.tried, grid.size)
    return total


def hindrance(wanted: Requirements, threads: int | None = None) -> Hindrance:
    """Which demands clash and by how much, where no configuration meets them all; looks at every
    configuration once more.
    """
    asked, grid, best = demands(wanted), make_grid(wanted), _Best()
    for first, last in chunks(grid):
        for given in candidates(grid, first, last):
            figures = solve_figures(given, wanted, threads)
            _compare(best, asked, given, figures)
    alone = tuple((asked[index], value) for index, value in sorted(best.alone.items()))
    return Hindrance(alone, best.nearest, best.misses)


def _compare(best: _Best, asked: tuple[Demand, ...], given: Candidates, figures: Figures) -> None:
    rows = margins(asked, figures)
    missed = rows < 0
    only = missed.sum(axis=0) == 1
    for index, demand in enumerate(asked):
        here = only & missed[index]
        if here.any():
            values = getattr(figures, demand.figure)[here]
            value = float(values.max() if demand.least else values.min())
            before = best.alone.get(index, value)
            best.alone[index] = max(before, value) if demand.least else min(before, value)
    worst = rows.min(axis=0)
    at = int(np.argmax(worst))
    if worst[at] > best.worst:
        best.worst, best.nearest = float(worst[at]), int(given.number_in_grid[at])
        best.misses = tuple(
            (demand, float(getattr(figures, demand.figure)[at]))
            for demand, miss in zip(asked, rows[:, at], strict=True)
            if miss < 0
        )


def chosen(grid: Grid, numbers: npt.NDArray[np.int64]) -> list[Candidates]:
    """The configurations of these numbers, one each."""
    return [candidates(grid, int(number), int(number) + 1)[0] for number in numbers]
