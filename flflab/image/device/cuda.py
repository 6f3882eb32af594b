"""The kernels of a CUDA device: a thread for every pixel. Only here is the device spoken to."""

from typing import Any

import numba.cuda
import numpy as np
import numpy.typing as npt
from numba.cuda.cudadrv.driver import CudaAPIError

from flflab.errors import InputError
from flflab.image.device.dots import dot_pixel
from flflab.image.device.pieces import HIGH, WIDE
from flflab.image.device.ruled import ROOM as RULED_ROOM
from flflab.image.device.ruled import ruled_pixel
from flflab.image.device.texels import ROOM as TEXEL_ROOM
from flflab.image.device.texels import texel_pixel
from flflab.image.device.work import Work, dots_work, ruled_work, texels_work
from flflab.image.light.dot_area import MOST_SQUARES
from flflab.image.light.ruled_seen import RuledSeen
from flflab.image.light.sampled import DotSeen
from flflab.image.light.texels import PictureSeen

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
cuda: Any = numba.cuda  # what a kernel calls of it has other types there


@cuda.jit(cache=True)
def _ruled(
    image: Array, first: int, begins: Whole, listed: Whole, arguments: tuple[Any, ...]
) -> None:
    column, row = cuda.grid(2)
    if row < image.shape[0] and column < image.shape[1]:
        room = cuda.local.array(RULED_ROOM, numba.float64)
        block = (cuda.blockIdx.y + first // HIGH) * cuda.gridDim.x + cuda.blockIdx.x
        near = listed[begins[block] : begins[block + 1]]
        image[row, column] = ruled_pixel(
            float(image[row, column]), row + first, column, near, room, *arguments
        )


@cuda.jit(cache=True)
def _dots(
    image: Array, first: int, begins: Whole, listed: Whole, arguments: tuple[Any, ...]
) -> None:
    column, row = cuda.grid(2)
    if row < image.shape[0] and column < image.shape[1]:
        room = cuda.local.array((MOST_SQUARES, 3), numba.float64)
        block = (cuda.blockIdx.y + first // HIGH) * cuda.gridDim.x + cuda.blockIdx.x
        near = listed[begins[block] : begins[block + 1]]
        image[row, column] = dot_pixel(
            float(image[row, column]), row + first, column, near, room, *arguments
        )


@cuda.jit(cache=True)
def _texels(
    image: Array, first: int, begins: Whole, listed: Whole, arguments: tuple[Any, ...]
) -> None:
    column, row = cuda.grid(2)
    if row < image.shape[0] and column < image.shape[1]:
        room = cuda.local.array(TEXEL_ROOM, numba.float64)
        block = (cuda.blockIdx.y + first // HIGH) * cuda.gridDim.x + cuda.blockIdx.x
        near = listed[begins[block] : begins[block + 1]]
        image[row, column] = texel_pixel(
            float(image[row, column]), row + first, column, near, room, *arguments
        )


def add_ruled(image: Array, windows: Whole, seen: RuledSeen) -> bool:
    """Add the light of every entry to an image, as ``ruled.add_ruled`` does for a band of rows; not
    where it is too much.
    """
    return _launch(_ruled, image, ruled_work(image.shape, windows, seen))


def add_dots(image: Array, windows: Whole, seen: DotSeen) -> bool:
    """Add the light of every entry to an image, as ``sampled.add_dots`` does for a band of rows;
    not where it is too much.
    """
    return _launch(_dots, image, dots_work(image.shape, windows, seen))


def add_texels(image: Array, windows: Whole, seen: PictureSeen) -> bool:
    """Add the light of every entry to an image, as ``texels.add_texels`` does for a band of rows;
    not where it is too much.
    """
    return _launch(_texels, image, texels_work(image.shape, windows, seen))


def _launch(kernel: Any, image: Array, work: Work | None) -> bool:
    if work is None:
        return False
    first, last = work.rows
    if first >= last:
        return True
    lit = image[first:last]
    blocks = (lit.shape[1] + WIDE - 1) // WIDE, (lit.shape[0] + HIGH - 1) // HIGH
    try:
        on_device = cuda.to_device(lit)
        kernel[blocks, (WIDE, HIGH)](
            on_device, first, *_to_device((work.begins, work.listed, work.arguments))
        )
        on_device.copy_to_host(lit)
    except CudaAPIError as error:
        raise InputError(
            "render: the CUDA device cannot form the picture; free its memory, or set"
            " NUMBA_DISABLE_CUDA=1 to use the processor"
        ) from error
    return True


def _to_device(given: Any) -> Any:
    """The same with all arrays on the device."""
    if isinstance(given, np.ndarray):
        return cuda.to_device(given)
    if isinstance(given, tuple):
        parts = [_to_device(part) for part in given]
        return type(given)(*parts) if hasattr(given, "_fields") else tuple(parts)
    return given
