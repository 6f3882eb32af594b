"""Sums of texels along chords of the pupil against the same integrals in fractions, however short
the chord.
"""

from fractions import Fraction

import numpy as np
import pytest

from flflab.image.light.texel_sums import chord_sum, fill_sums, rows_between

TEXELS = np.random.default_rng(5).random((30, 60))
# Columns and rows from the corner: inside, at a side, at the ends, past one.
PLACES = ((41.3, 17.4), (5.0, 0.2), (59.6, 28.9), (-0.3, 12.5))


def overlap(low: Fraction, high: Fraction, cell: int) -> Fraction:
    return max(Fraction(0), min(high, Fraction(cell + 1)) - max(low, Fraction(cell)))


def twice_summed(columns: list[Fraction], x: Fraction) -> Fraction:
    """Second antiderivative at x of what is so much in each column, both 0 at the first one's left
    side.
    """
    return sum(
        (
            light * ((max(x - i, Fraction(0))) ** 2 - (max(x - i - 1, Fraction(0))) ** 2) / 2
            for i, light in enumerate(columns)
        ),
        Fraction(0),
    )


def exact(
    at: tuple[float, float], chord: tuple[float, float], boxes: tuple[float, float], height: float
) -> Fraction:
    x, y, half = Fraction(at[0]), Fraction(at[1]), Fraction(height) / 2
    columns = [
        sum(
            (Fraction(float(v)) * overlap(y - half, y + half, j) for j, v in enumerate(column)),
            Fraction(0),
        )
        for column in TEXELS.T
    ]
    ends = [x + Fraction(end) for end in chord]
    before, after = (
        (
            twice_summed(columns, end + Fraction(box) / 2)
            - twice_summed(columns, end - Fraction(box) / 2)
        )
        / Fraction(box)
        for end, box in zip(ends, boxes, strict=True)
    )
    return after - before


@pytest.mark.parametrize("at", PLACES)
@pytest.mark.parametrize("length", [1e-9, 1e-6, 1e-3, 0.1, 1.4, 2.5, 20.0])
@pytest.mark.parametrize("boxes", [(0.3, 0.3), (0.3, 0.25)], ids=["one box", "two boxes"])
def test_light_along_a_chord_has_the_digits_of_the_chord_not_of_the_picture(
    at: tuple[float, float], length: float, boxes: tuple[float, float]
) -> None:
    sums, height = fill_sums(TEXELS, 0, 0, 60, 30), 0.7
    chord = (-0.4, -0.4 + length)
    rows = rows_between(sums, at[1], height)
    off = abs(
        float(
            Fraction(chord_sum(sums, at[0], *chord, *boxes, rows)) - exact(at, chord, boxes, height)
        )
    )
    assert off < (1e-15 if length < 0.01 else 3e-14 if length < 1.5 else 4e-12)
