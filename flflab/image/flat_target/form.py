"""The light of one flat target on the sensor, by the kernels that suit the target."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.image.device.found import device_kernels, is_worth_it
from flflab.image.flat_target.moments import ways_along
from flflab.image.geometry.rim import STEEP, disc_nodes
from flflab.image.geometry.setup import Setup
from flflab.image.light.askew_orders import (
    end_points,
    is_even,
    is_turn,
    picture_parts,
    picture_points,
)
from flflab.image.light.even_texels import count_borders
from flflab.image.light.falloff_orders import (
    falloff_chunks,
    falloff_counts,
    falloff_parts,
    falloff_pieces,
    weighing_chords,
)
from flflab.image.light.lenses import Lenses, packed
from flflab.image.light.orders import (
    TEXELS,
    TIP,
    grid_counts,
    in_bands,
    is_sharp,
    left_at_tips,
    lit_windows,
    pixel_parts,
    rim_rows,
    spot_parts,
    strip_counts,
)
from flflab.image.light.ruled import add_ruled
from flflab.image.light.ruled_seen import RuledSeen
from flflab.image.light.sampled import DotSeen, add_dots, chord_nodes
from flflab.image.light.strips import strip_nodes
from flflab.image.light.texels import PictureSeen, add_texels
from flflab.image.radiance.profile import Cropped, Ruled, cropped, half_plane, profile_table
from flflab.optics.camera import pixel_positions
from flflab.targets import Edge, FourDot, Picture, Target, White

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

FINE = 0.05  # of the tolerance goes to the tables of antiderivatives
# of it to those of the fall-off; micro-images that overlap share it, as all of them are off the
# same way
FALL = 0.2
PICTURE = 10.0  # how much rougher than bars a picture is: it has edges along the strips, too
# of white: what a table leaves in the last pixels of a rim, times the 3/2 power of half its width
# in pixels
WHITE_EDGE = 0.002
# of the tolerance, for how the area common to three discs bends within a pixel; micro-images that
# overlap share it
SPOT_BEND = 0.3
# What takes as long as so many strips of bars: a strip with fall-off, a strip of a picture, a pixel
# of a dot.
FALL_STEPS, TEXEL_STEPS, SPOT_STEPS = 4.0, 20.0, 1000.0
ELLIPSE = 2.0  # 2/pi over the share of the tolerance that a dot's skew may take, a third
LARGE_BLUR = 0.7  # pixels; from here on a dot's image is the area common to three discs


def add_plane(
    image: Array, setup: Setup, target: Target | Cropped, wanted: Chosen | None = None
) -> None:
    """Add the light of one flat target, not black, to an image [row, column] in units of the white
    level.

    Of what a target does during the exposure only the movement across its lines counts; see
    ``add_moving_plane`` for the rest.

    Args:
        image: the image to add to.
        setup: what is formed.
        target: the target.
        wanted: which pixels to compute, [row, column]; the others stay as they are. None for all.
    """
    if not len(setup.blur):
        return
    chosen = np.zeros((0, 0), dtype=np.bool_) if wanted is None else wanted
    match target:
        case FourDot():
            _add_dots(image, setup, target, chosen)
        case Picture():
            _add_texels(image, setup, target, chosen)
        case _:
            _add_ruled(image, setup, target, chosen)


def _form(
    add: Callable[..., None],
    steps: float,
    image: Array,
    windows: Whole,
    seen: RuledSeen | DotSeen | PictureSeen,
) -> None:
    """Add the light in these windows by a kernel on all cores, or by the one of the same name of a
    device that is worth it.
    """
    windows, seen = np.ascontiguousarray(windows), packed(seen)
    kernels = device_kernels() if is_worth_it(windows, steps) else None
    if kernels is None or not getattr(kernels, add.__name__)(image, windows, seen):
        in_bands(lambda rows: add(image, rows, windows, seen), windows)


def _turned(setup: Setup, axes: Array) -> Setup:
    """The same with the target's coordinates counted along other axes, the rows of ``axes``."""
    maps = {
        "by_pupil": axes @ setup.by_pupil,
        "by_sensor": axes @ setup.by_sensor,
        "by_motion": axes @ setup.by_motion,
    }
    return replace(setup, origin=setup.origin @ axes.T, **maps)


def _maps(setup: Setup) -> Array:
    """The affine maps to the target, shape (N, 10): origin, by pupil, by sensor, row by row."""
    count = len(setup.origin)
    return np.concatenate(
        [setup.origin, setup.by_pupil.reshape(count, 4), setup.by_sensor.reshape(count, 4)], axis=1
    )


def _lenses(setup: Setup, parts: Whole, steep: Chosen, chosen: Chosen) -> Lenses:
    """The entries before the sensor, pixels in the rim divided into so many parts a side."""
    pupils = setup.pupils
    slants = np.column_stack(
        [pupils.slant_x, pupils.slant_y, pupils.slant_scale, pupils.slant_spread]
    )
    xs, ys = pixel_positions(setup.sensor)
    return Lenses(
        kinds=setup.rims.kind,
        centres=np.column_stack([pupils.centre_x, pupils.centre_y]),
        cones=np.column_stack([pupils.slope, pupils.reach]),
        maps=_maps(setup),
        slants=slants if setup.falloff else np.zeros_like(slants),
        levels=pupils.level,
        parts=parts,
        rims=rim_rows(setup, parts, steep),
        nodes=disc_nodes(8, 8),
        xs=xs,
        ys=ys,
        pixel=setup.sensor.pixel,
        width=setup.pixel_width,
        wanted=chosen,
    )


def _add_ruled(image: Array, setup: Setup, target: Target | Cropped, chosen: Chosen) -> None:
    bounds = np.array([-np.inf, np.inf])
    table, law = np.zeros((0, 8)), np.zeros(6)
    half_x = half_y = math.inf
    if isinstance(target, Ruled):
        seen = cropped(target)
        table, law = profile_table(seen.bars, seen.width)
        half_x, half_y = seen.width / 2, seen.height / 2
        bounds = np.array([-half_y, half_y])
    elif isinstance(target, Edge):
        cos, sin = math.cos(target.angle), math.sin(target.angle)
        table, law = half_plane()
        setup = _turned(setup, np.array([[cos, sin], [-sin, cos]]))
    ways = ways_along(setup) if len(table) else np.zeros((len(setup.origin), 1))
    counts, sharp = strip_counts(setup), is_sharp(setup)
    parts, steep = pixel_parts(setup, sharp)
    if isinstance(target, White):
        left = np.maximum(
            WHITE_EDGE * (2 / np.maximum(setup.rims.width, 1e-9)) ** 1.5, left_at_tips(setup, TIP)
        )
        parts = np.where((setup.rims.width < STEEP) | (left > 0.2 * setup.tolerance), parts, 1)
    whole, divided = falloff_parts(setup, edges=not isinstance(target, White))
    nodes = strip_nodes(counts.ravel())
    grids, grid = np.unique(
        end_points(setup) if isinstance(target, Ruled) else np.zeros_like(setup.rims.kind),
        return_inverse=True,
    )
    seen = RuledSeen(
        lenses=_lenses(
            setup, -(-parts // divided) * divided, steep, chosen
        ),  # each part lies in one cell of the fall-off
        sharp=sharp,
        counts=counts,
        strips=nodes.reshape(*counts.shape, *nodes.shape[1:]),
        grid=grid,
        grids=grids,
        rows_of_points=strip_nodes(grids)[:, :2],
        chords=chord_nodes(grids),
        chunks=falloff_pieces(setup),
        whole=whole,
        divided=divided,
        fall=FALL * setup.tolerance / setup.overlap,
        fine=FINE * setup.tolerance,
        table=table,
        law=law,
        ways=ways,
        bounds=bounds,
        numbers=np.array([bounds[1], 0.0, 0.0]),
        no_sums=np.zeros((2, 2)),
    )
    windows = lit_windows(setup, half_x + float(np.abs(ways).max()), half_y)
    steps = 1.0 if sharp.all() else float(counts.mean()) * (FALL_STEPS if setup.falloff else 1.0)
    _form(add_ruled, steps, image, windows, seen)


def _add_texels(image: Array, setup: Setup, picture: Picture, chosen: Chosen) -> None:
    sharp = is_sharp(setup)
    counts, points = strip_counts(setup, PICTURE)[:, 0], picture_points(setup)
    grids, grid = np.unique(points, return_inverse=True)
    parts, steep = pixel_parts(setup, sharp | (points > 0), TEXELS)
    whole, divided = falloff_parts(setup)
    seen = PictureSeen(
        lenses=_lenses(setup, np.maximum(parts, divided), steep, chosen),
        sharp=sharp,
        askew=not is_even(setup.by_sensor, setup.tolerance),
        divisions=np.maximum(
            np.where(sharp | (points > 0), 1, picture_parts(setup)), whole[setup.rims.kind]
        ),
        grid=grid,
        grids=grids,
        rows_of_points=strip_nodes(grids)[:, :2],
        chords=chord_nodes(grids),
        counts=counts,
        strips=strip_nodes(counts),
        chunks=falloff_chunks(setup),
        texel=picture.texel,
        values=np.ascontiguousarray(picture.values, dtype=np.float64),
        borders=count_borders(np.asarray(picture.values, dtype=np.float64)),
        numbers=np.array([1.0, 0.0, 0.0]),
        table=np.zeros((0, 8)),
        law=np.zeros(6),
    )
    windows = lit_windows(setup, picture.width / 2, picture.height / 2)
    _form(add_texels, TEXEL_STEPS * float(counts.mean()), image, windows, seen)


def _add_dots(image: Array, setup: Setup, dots: FourDot, chosen: Chosen) -> None:
    blur = setup.kind_blur(largest=True)
    counts, chords = (
        np.maximum(grid_counts(blur, setup.tolerance / setup.overlap), falloff_counts(setup)),
        weighing_chords(setup),
    )
    parts, steep = pixel_parts(setup, np.ones(len(setup.blur), dtype=np.bool_))
    _, divided = falloff_parts(setup)
    # a dot seen as an ellipse is off by the skew times its radius, where the blur makes its edge as
    # steep as a disc's
    size = float(
        np.max(
            0.5
            * dots.diameter
            / np.maximum(np.linalg.norm(setup.by_pupil, axis=(1, 2)) / math.sqrt(2), 1e-300)
        )
    )
    if is_turn(setup.by_pupil, setup.tolerance / max(1.0, ELLIPSE * size)):
        counts = np.where(blur > LARGE_BLUR, 0, counts)
        finer = np.maximum(parts, spot_parts(setup.kind_blur(largest=False), setup.tolerance))
        parts = np.where(counts == 0, finer, parts)
    parts = np.where((counts > 0) | steep, np.maximum(parts, divided), parts)
    seen = DotSeen(
        lenses=_lenses(setup, parts, steep, chosen),
        counts=counts,
        divided=divided,
        strips=strip_nodes(counts)[:, :2],
        chords=chord_nodes(counts),
        weighing=strip_nodes(np.array([chords]))[0, :2, :chords],
        allowed=SPOT_BEND * setup.tolerance / setup.overlap,
        numbers=np.array([dots.diameter / 2, 0.0, 0.0]),
        table=np.zeros((0, 8)),
        law=np.zeros(6),
        sums=np.zeros((2, 2)),
    )
    for x, y in dots.centres:
        from_dot = setup.seen_from(x, y)
        windows = lit_windows(from_dot, dots.diameter / 2, dots.diameter / 2)
        _form(
            add_dots,
            SPOT_STEPS,
            image,
            windows,
            seen._replace(lenses=seen.lenses._replace(maps=_maps(from_dot))),
        )
