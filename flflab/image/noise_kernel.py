"""The kernel from light to numbers: a run of pixels at a time, all its steps while the run lies in the cache."""

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.random_numbers import Key, draw_bits, normals, poissons, uniform

Array = npt.NDArray[np.float64]

RUN = 512  # pixels worked through together
LONGEST_ROW = 65536  # pixels; a pixel's counter is its row and its column, 16 bits each
MOST_ELECTRONS = 1e12


@numba.njit(cache=True, nogil=True, error_model="numpy")
def read_rows(
    image: Array,
    first: int,
    corner: tuple[int, int],
    keys: tuple[Key, Key, Key],
    electrons_at_white: float,
    dark: float,
    shot: bool,
    pattern: tuple[float, float],
    well: float,
    noise: float,
    scale: tuple[float, float, float],
    dead: float,
    limit: float,
    out: Array,
) -> bool:  # pragma: no cover - compiled
    """Read some rows of an image; returns whether all their light could be counted.

    Args:
        image: irradiance in units of the white level.
        first: the first row.
        corner: row and column on the sensor of the image's pixel [0, 0].
        keys: of frame, fixed pattern and dead pixels.
        electrons_at_white: mean electrons at the white level.
        dark: mean electrons of the dark current.
        shot: whether electrons come at random.
        pattern: standard deviations of gain (relative) and offset (electrons).
        well: most electrons a pixel holds.
        noise: standard deviation of the read noise, electrons.
        scale: DN per electron, DN of a dark pixel, full scale.
        dead: share of stuck pixels.
        limit: the largest number; 0 for numbers neither rounded nor limited.
        out: where the numbers of these rows go.
    """
    bits, others = np.empty(RUN, dtype=np.uint64), np.empty(RUN, dtype=np.uint64)
    room, light, counts, errors, terms = np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN)
    counted = True
    for row in range(len(out)):
        for start in range(0, image.shape[1], RUN):
            size = min(RUN, image.shape[1] - start)
            pixel = (first + row + corner[0]) * LONGEST_ROW + start + corner[1]
            run, other, space = bits[:size], others[:size], room[:size]
            means, electrons, extra = light[:size], counts[:size], errors[:size]
            for i in range(size):
                means[i] = image[first + row, start + i] * electrons_at_white
                extra[i] = 0.0
            if pattern[0] > 0 or pattern[1] > 0:
                draw_bits(pixel, keys[1], run, other)
                normals(run, 0, pixel, keys[1], extra)
                for i in range(size):
                    means[i] *= 1 + pattern[0] * extra[i]
                normals(other, 1, pixel, keys[1], extra)
                for i in range(size):
                    extra[i] *= pattern[1]
            good = True
            for i in range(size):
                means[i] += dark
                good &= (means[i] >= 0) & (means[i] < MOST_ELECTRONS)
            if not good:
                counted = False
                continue
            if shot or noise > 0:
                draw_bits(pixel, keys[0], run, other)
            if shot:
                poissons(means, run, 0, pixel, keys[0], space, terms[:size], electrons)
            else:
                electrons[:] = means
            if noise > 0:
                normals(other, 1, pixel, keys[0], space)
                for i in range(size):
                    extra[i] += noise * space[i]
            for i in range(size):
                electrons[i] = (min(electrons[i], well) + extra[i]) * scale[0] + scale[1]
            if dead > 0:
                draw_bits(pixel, keys[2], run, other)
                for i in range(size):
                    if uniform(run[i]) < dead:
                        electrons[i] = scale[2] if other[i] & np.uint64(1) else 0.0
            if limit > 0:
                for i in range(size):
                    electrons[i] = min(max(np.rint(electrons[i]), 0.0), limit)
            for i in range(size):
                out[row, start + i] = electrons[i]
    return counted
