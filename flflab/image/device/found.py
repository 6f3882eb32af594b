"""Whether there is a CUDA device, and whether a picture is worth the way to it."""

import importlib.util
import os
from functools import cache
from types import ModuleType

import numpy as np
import numpy.typing as npt

# steps of a pixel for every core of the processor; a step is a strip of bars (measured: an H100
# beside 16 cores)
WORTH = 1.2e7


@cache
def device_kernels() -> ModuleType | None:
    """The kernels that run on a device; None without the extra ``cuda``, without a device, or with
    NUMBA_DISABLE_CUDA=1.
    """
    if importlib.util.find_spec("numba_cuda") is None:
        return None
    from numba import cuda

    if not cuda.is_available():
        return None
    from flflab.image.device import cuda as kernels

    return kernels


def is_worth_it(windows: npt.NDArray[np.int64], steps: float) -> bool:
    """Whether windows hold so much work that a device does it sooner than it takes to bring the
    picture there and back.

    Args:
        windows: first column, column after the last, first row, row after the last of every entry,
            shape (N, 4).
        steps: that a pixel takes.
    """
    sides = np.maximum(windows[:, 1::2] - windows[:, ::2], 0)
    return steps * float(np.sum(sides[:, 0] * sides[:, 1])) >= WORTH * (os.cpu_count() or 1)
