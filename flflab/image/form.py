"""The light of one flat target on the sensor, by the kernels that suit the target."""

import math

import numpy as np
import numpy.typing as npt

from flflab.image.orders import grid_counts, in_bands, lit_windows, pixel_parts, rim_rows, spot_parts, strip_counts
from flflab.image.profile import profile_table
from flflab.image.rim import STEEP, disc_nodes
from flflab.image.ruled import add_ruled, strip_nodes
from flflab.image.sampled import add_sampled, chord_nodes
from flflab.image.setup import Setup
from flflab.optics.camera import pixel_positions
from flflab.targets import Bars, Edge, FourDot, Picture, Target, White

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]

LARGE_BLUR = 0.7  # pixels; from here on a dot's image is the area common to three discs


def add_plane(image: Array, setup: Setup, target: Target, wanted: Chosen | None = None) -> None:
    """Add the light of one flat target, not black, to an image [row, column] in units of the white level.

    Args:
        image: the image to add to.
        setup: what is formed.
        target: the target.
        wanted: which pixels to compute, [row, column]; the others stay as they are. None for all.
    """
    chosen = np.zeros((0, 0), dtype=np.bool_) if wanted is None else wanted
    match target:
        case FourDot():
            for x, y in target.centres:
                _add_sampled(image, setup.seen_from(x, y), target.diameter / 2, target.diameter / 2, target.diameter / 2, None, chosen)
        case Picture():
            _add_sampled(image, setup, 0.0, target.width / 2, target.height / 2, target, chosen)
        case _:
            _add_ruled(image, setup, target, chosen)


def _rows_of(setup: Setup, axes: Array) -> tuple[Array, Array]:
    """Centres of the micro-images (N, 2) and what the kernels know of a pupil (N, 6), directions in the target's axes."""
    pupils = setup.pupils
    known = np.column_stack([pupils.slope, pupils.reach, setup.by_pupil[:, 0, 0], setup.by_sensor[:, 0, 0], setup.origin @ axes.T])
    return np.column_stack([pupils.centre_x, pupils.centre_y]), known


def _add_ruled(image: Array, setup: Setup, target: Target, chosen: Chosen) -> None:
    axes, bounds = np.eye(2), np.array([-np.inf, np.inf])
    table, law = np.zeros((0, 8)), np.zeros(5)
    half_x = half_y = math.inf
    if isinstance(target, Bars):
        table, law = profile_table(target)
        half_x, half_y = target.width / 2, target.height / 2
        bounds = np.array([-half_y, half_y])
    elif isinstance(target, Edge):
        cos, sin = math.cos(target.angle), math.sin(target.angle)
        axes, bounds = np.array([[sin, -cos], [cos, sin]]), np.array([0.0, np.inf])
    parts, steep = pixel_parts(setup)
    if isinstance(target, White):
        parts = np.where(setup.rims.width < STEEP, parts, 1)
    counts = strip_counts(setup.kind_blur(largest=True), setup.tolerance / setup.overlap)
    strips, rims, nodes = strip_nodes(counts), rim_rows(setup, parts, steep), disc_nodes(8, 8)
    windows = lit_windows(setup, half_x, half_y)
    xs, ys = pixel_positions(setup.sensor)
    centres, known = _rows_of(setup, axes)

    def add(rows: tuple[int, int]) -> None:
        add_ruled(
            image,
            rows,
            windows,
            setup.rims.kind,
            centres,
            known,
            setup.pupils.level,
            parts,
            counts,
            strips,
            rims,
            nodes,
            xs,
            ys,
            setup.sensor.pixel,
            axes,
            table,
            law,
            bounds,
            chosen,
        )

    in_bands(add, windows)


def _add_sampled(image: Array, setup: Setup, radius: float, half_x: float, half_y: float, picture: Picture | None, chosen: Chosen) -> None:
    """Add a disc of this radius round the origin of the target's coordinates, or a picture where the radius is 0."""
    texel, sums = 1.0, np.zeros((2, 2))
    if picture is not None:
        texel, sums = picture.texel, np.pad(picture.values.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    parts, steep = pixel_parts(setup)
    blur = setup.kind_blur(largest=True)
    counts = grid_counts(blur, setup.tolerance / setup.overlap / (1 if picture is None else 2.5))  # a picture has more edges than a dot
    if picture is None:
        counts = np.where(blur > LARGE_BLUR, 0, counts)
        finer = np.maximum(parts, spot_parts(setup.kind_blur(largest=False), setup.tolerance))
        parts = np.where(counts == 0, finer, parts)
    strips, chords, rims, nodes = strip_nodes(counts), chord_nodes(counts), rim_rows(setup, parts, steep), disc_nodes(8, 8)
    windows = lit_windows(setup, half_x, half_y)
    xs, ys = pixel_positions(setup.sensor)
    centres, known = _rows_of(setup, np.eye(2))

    def add(rows: tuple[int, int]) -> None:
        add_sampled(
            image,
            rows,
            windows,
            setup.rims.kind,
            centres,
            known,
            setup.pupils.level,
            parts,
            counts,
            strips,
            chords,
            rims,
            nodes,
            xs,
            ys,
            setup.sensor.pixel,
            radius,
            texel,
            sums,
            chosen,
        )

    in_bands(add, windows)
