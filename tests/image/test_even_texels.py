"""Which parts of a picture look alike to a pixel, against a look at every texel."""

import math

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from flflab.image.light.even_texels import count_borders, even_radiance
from flflab.image.light.texels import FRAME

VALUES = np.repeat(
    np.repeat(np.random.default_rng(3).choice([0.0, 0.4, 1.0], (4, 5)), 3, axis=0), 2, axis=1
)
BORDERS = count_borders(VALUES)
place = st.floats(-6.0, 18.0)
size = st.floats(0.0, 3.0)


def radiances_seen(x: tuple[float, float], y: tuple[float, float]) -> set[float]:
    """Of every texel that a box touches; black beyond the picture."""
    rows = range(math.floor(y[0]), math.floor(y[1]) + 1)
    columns = range(math.floor(x[0]), math.floor(x[1]) + 1)
    return {
        float(VALUES[j, i]) if 0 <= j < VALUES.shape[0] and 0 <= i < VALUES.shape[1] else 0.0
        for j in rows
        for i in columns
    }


@given(place, place, size, size, st.integers(-3, 4), st.integers(-3, 4))
def test_texels_count_as_alike_where_each_that_is_seen_is(
    x: float, y: float, pupil: float, side: float, column: int, row: int
) -> None:
    frame = np.zeros(FRAME)
    frame[2], frame[5], frame[6], frame[9], frame[17], frame[18] = (
        pupil,
        0.5 * pupil,
        0.7,
        -1.1,
        column,
        row,
    )
    half_x, half_y = pupil + 0.35 * side, 0.5 * pupil + 0.55 * side
    ends = [x + column - half_x, x + column + half_x, y + row - half_y, y + row + half_y]
    assume(all(abs(end - round(end)) > 1e-9 for end in ends))
    seen = radiances_seen((ends[0], ends[1]), (ends[2], ends[3]))
    found = even_radiance(x, y, frame, side, VALUES, BORDERS)
    assert found == (seen.pop() if len(seen) == 1 else -1.0)
