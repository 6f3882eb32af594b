"""Bands of rows of a picture, worked through on all cores."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

BANDS = 2  # for each core, so that none waits long for another


def in_bands(work: Callable[[int, int], None], rows: int) -> None:
    """Call ``work`` with the first row and the row after the last of each band; pixels must not
    depend on how rows are shared out.
    """
    cores = os.cpu_count() or 1
    height = max(1, -(-rows // (BANDS * cores)))
    starts = range(0, rows, height)
    if cores == 1 or len(starts) == 1:
        work(0, rows)
        return
    with ThreadPoolExecutor(cores) as pool:
        for _ in pool.map(lambda start: work(start, min(start + height, rows)), starts):
            pass
