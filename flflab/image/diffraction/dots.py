"""Diffracted light of dots and pictures: how far it reaches, and the fields over the target that
hold it.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.image.diffraction.cut import cut_dots_spectrum, side_of_arc
from flflab.image.diffraction.fields import Grid, dots_spectrum, make_grid, picture_spectrum
from flflab.image.diffraction.kinds import Kind
from flflab.image.diffraction.layers import FELT, Thing, add_thing
from flflab.image.diffraction.modes import Known
from flflab.image.diffraction.orders import finest_lines, looked_at
from flflab.image.geometry.setup import Setup
from flflab.targets import FourDot, Picture

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Chosen = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.int64]

APART = 1.3  # times the margin, from dots to where their light repeats itself
WORTH = 250.0  # sides of cut dots that cost as much as a field as large as what is left of it
MARGINS = (16.0, 400.0)  # pixels, least and largest, from which light comes to what is looked at


def add_dots_diffracted(
    image: Array, setup: Setup, kind: Kind, known: Known, lit: Whole, dots: FourDot, chosen: Chosen
) -> None:
    """Add the diffracted light of one kind of microlens from dots; see
    ``add_plane_with_diffraction``.

    All dots share the field of one, as large as a dot's light, or lie in one field of what is
    looked at.
    """
    scales, radius = np.hypot(*kind.by_sensor.T), dots.diameter / 2
    size, tail, axes = float(radius / scales.min()), _tail(kind), kind.by_sensor / scales[:, None]
    low, high = _looked_at(setup, kind, lit, scales)

    def near(softness: float) -> float:
        """Of a straight edge the light that a Gaussian does not keep falls as tail softness^2 /
        d^3, of a dot by two powers faster.
        """
        edge, round_dot = (
            _near_edge(kind, setup, softness),
            (18 * size**2 * tail * softness**2 / setup.tolerance) ** (1 / 5),
        )
        return max(MARGINS[0], FELT * softness, min(edge, round_dot))

    def grid(margin: float, samples: float) -> Grid:
        reach = size + kind.extent + margin
        return make_grid(
            axes, np.full(2, -reach), np.full(2, reach), np.full(2, margin + kind.extent), samples
        )

    def spectrum(grid: Grid, margin: float, x: Array, y: Array) -> ComplexArray:
        return dots_spectrum(-np.array([grid.first]), radius / scales, x, y)

    def felt(margin: float) -> Array:
        """The dots whose light reaches what is looked at, pixels."""
        centres, reach = np.array(dots.centres) / scales, size + kind.extent + margin
        return centres[np.all((low - reach < centres) & (centres < high + reach), axis=1)]

    def place(margin: float) -> tuple[Array, Array, Array, Array, bool]:
        """The dots that are felt, where pixels look and their light falls, how far beyond it
        nothing repeats, whether dots are cut.

        Dots that reach far beyond what is looked at are cut where their light does not come from.
        """
        centres, reach = felt(margin), size + kind.extent + margin
        if not len(centres):
            return centres, low, high, np.zeros(2), False
        least, most = centres.min(axis=0), centres.max(axis=0)
        first, last = np.maximum(low, least - reach), np.minimum(high, most + reach)
        beyond = reach + (APART - 1) * margin  # where the sums repeat the dots
        whole, cut = (
            np.maximum(last - least, most - first) + beyond - (last - first),
            np.full(2, 2 * (kind.extent + margin)),
        )
        smaller = float(np.prod(last - first + whole) / np.prod(last - first + cut))
        rims = len(centres) * min(2 * math.pi * size, 2 * float(np.sum(last - first + cut)))
        cuts = rims / side_of_arc(size, kind.cutoff, kind.blur, setup.tolerance) < WORTH * (
            smaller - 1
        )
        return centres, first, last, cut if cuts else whole, cuts

    def grid_of_all(margin: float, samples: float) -> Grid | None:
        centres, first, last, pad, _ = place(margin)
        return make_grid(axes, first, last, pad, samples) if len(centres) else None

    def spectrum_of_all(grid: Grid, margin: float, x: Array, y: Array) -> ComplexArray:
        centres, first, last, _, cuts = place(margin)
        if not cuts:
            return dots_spectrum(centres - grid.first, radius / scales, x, y)
        shortest = min(kind.cutoff, float(max(np.abs(x).max(), np.abs(y).max())))
        reach, side = margin + kind.extent, side_of_arc(size, shortest, kind.blur, setup.tolerance)
        return cut_dots_spectrum(
            centres - grid.first,
            radius / scales,
            first - reach - grid.first,
            last + reach - grid.first,
            side,
            x,
            y,
        )

    # The pattern falls as its light times tail / (2 pi) over the third power of the distance, once
    # round the circle. In one field all dots are left out or repeated at once, and behind all
    # micro-images that overlap: it errs to one side.
    least = 4 * size**2 * tail / setup.tolerance
    at_once = least * len(dots.centres) * math.sqrt(setup.overlap)
    things = [
        Thing(np.array(dots.centres), 4 + least ** (1 / 3), near, grid, spectrum),
        Thing(np.zeros((1, 2)), 4 + at_once ** (1 / 3), near, grid_of_all, spectrum_of_all),
    ]
    add_thing(image, setup, kind, known, lit, things, finest_lines(kind, dots), chosen)


def add_picture_diffracted(
    image: Array,
    setup: Setup,
    kind: Kind,
    known: Known,
    lit: Whole,
    picture: Picture,
    chosen: Chosen,
) -> None:
    """Add the diffracted light of one kind of microlens from a picture; see
    ``add_plane_with_diffraction``.
    """
    scales = np.hypot(*kind.by_sensor.T)
    low, high = _looked_at(setup, kind, lit, scales)
    edge = np.array([picture.width, picture.height]) / 2 / scales

    def near(softness: float) -> float:
        return max(MARGINS[0], FELT * softness, min(_near_edge(kind, setup, softness), MARGINS[1]))

    def inside(margin: float) -> tuple[Array, Array]:
        reach = margin + kind.extent
        return np.maximum(low, -edge - reach), np.minimum(high, edge + reach)

    def grid(margin: float, samples: float) -> Grid | None:
        first, last = inside(margin)
        axes = kind.by_sensor / scales[:, None]
        return (
            None
            if np.any(first >= last)
            else make_grid(axes, first, last, np.full(2, 2 * (margin + kind.extent)), samples)
        )

    def spectrum(grid: Grid, margin: float, x: Array, y: Array) -> ComplexArray:
        (first, last), reach = inside(margin), margin + kind.extent
        return picture_spectrum(picture, scales, first - reach, last + reach, grid.first, x, y)

    margin = min(max(_tail(kind) / (0.4 * setup.tolerance), MARGINS[0]), MARGINS[1])
    thing = Thing(np.zeros((1, 2)), margin, near, grid, spectrum)
    add_thing(image, setup, kind, known, lit, [thing], finest_lines(kind, picture), chosen)


def _looked_at(setup: Setup, kind: Kind, lit: Whole, scales: Array) -> tuple[Array, Array]:
    """The least and largest place on the target that pixels look at, pixels along x' and y', target
    mm over ``scales``.
    """
    centres = np.column_stack([setup.pupils.centre_x, setup.pupils.centre_y])[kind.entries]
    looks = setup.by_sensor[kind.entries] * setup.sensor.pixel / scales[:, None]
    return looked_at(lit[kind.entries], centres, setup.origin[kind.entries] / scales, looks, setup)


def _tail(kind: Kind) -> float:
    """Of a whole pupil: beyond d pixels from a straight edge its light is the tail over d."""
    return 2 / (math.pi**3 * kind.cutoff)


def _near_edge(kind: Kind, setup: Setup, softness: float) -> float:
    return float((softness**2 * _tail(kind) / (0.4 * setup.tolerance)) ** (1 / 3))
