"""The picture of a flat target in light of one wavelength: the scalar Fresnel image through every
microlens's clipped pupil.

A sensor point sees the target through the part of the pupil that both stops leave of it, as rays
do; the light of that part comes from the target with the diffraction pattern of its shape and
defocus instead of a point for each ray. The pattern's integral is the light of the rays, so that
white stays white. Paraxial, incoherent, first stop clipped geometrically.
"""

import math
from dataclasses import replace
from functools import partial
from itertools import groupby

import numpy as np
import numpy.typing as npt

from flflab.image.diffraction.border import NO_BORDER, Border, border_reach, make_borders
from flflab.image.diffraction.dots import add_dots_diffracted, add_picture_diffracted
from flflab.image.diffraction.falloff import pupil_moments, slant_rows
from flflab.image.diffraction.kinds import BLURRED, Kind, find_kinds
from flflab.image.diffraction.lines import add_ruled_diffracted
from flflab.image.diffraction.modes import Known, shared_modes
from flflab.image.diffraction.orders import (
    LEAST_TERMS,
    MOMENTS,
    PixelParts,
    divisions,
    finest_lines,
    lit_counts,
    lit_windows,
    looked_at,
    node_counts,
    pixel_parts,
)
from flflab.image.diffraction.ruled import Curves, make_curves, make_line
from flflab.image.diffraction.shading import MEAN, find_shading, within_pixel
from flflab.image.diffraction.table import samples_needed
from flflab.image.flat_target.form import add_plane
from flflab.image.flat_target.moving import add_moving_plane
from flflab.image.geometry.rim import disc_nodes
from flflab.image.geometry.setup import Setup
from flflab.image.light.askew_orders import is_even
from flflab.image.light.orders import in_bands
from flflab.optics.camera import pixel_positions
from flflab.targets import Bars, Chirp, Edge, FourDot, Picture, Target, White

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.int64]

NO_BORDERS = [NO_BORDER, NO_BORDER]
SHARE = 0.7  # of the tolerance; the errors of nodes, parts and terms are each kept below it
# of it, for terms left out: the same lines pass all of them, and a border leaves out its own
LINE_TERMS = 0.5
KIND_COST: dict[type[Target], float] = {
    Edge: 6e3,
    Bars: 5e4,
    Chirp: 5e4,
    FourDot: 5e4,
    Picture: 5e4,
}  # in pixels, of a kind's tables


def add_plane_with_diffraction(
    image: Array, setup: Setup, target: Target, wavelength: float, wanted: Chosen | None = None
) -> None:
    """Add the diffracted light of one flat target, not black, to an image [row, column] in units of
    the geometric white level.

    Args:
        image: the image to add to.
        setup: what is formed.
        target: the target.
        wavelength: of the light, mm.
        wanted: which pixels to compute, [row, column]; the others stay as they are. None for all.
    """
    if isinstance(target, White):
        add_plane(image, setup, target, wanted)
        return
    chosen = np.ones(image.shape, dtype=np.bool_) if wanted is None else wanted
    finer = replace(setup, tolerance=SHARE * setup.tolerance / math.sqrt(setup.overlap))
    windows = lit_windows(setup)
    seen = np.flatnonzero((windows[:, 0] < windows[:, 1]) & (windows[:, 2] < windows[:, 3]))
    alike = replace(
        setup, tolerance=SHARE * setup.tolerance / setup.overlap
    )  # microlenses side by side err to the same side
    pixels = lit_counts(windows[seen], chosen)
    kinds = (
        find_kinds(alike, target, wavelength, seen, pixels, KIND_COST[type(target)])
        if len(seen)
        else []
    )
    for _, same in groupby(sorted(kinds, key=lambda kind: kind.pupil), key=lambda kind: kind.pupil):
        known: Known = {}  # tables of many pupils at a time would fill any memory
        for kind in same:
            if (
                2 * abs(kind.blur) > BLURRED or kind.cutoff * setup.tolerance > 1
            ):  # so sharp a pattern no pixel tells
                _add_rays(image, setup, kind, target, wanted)
            elif isinstance(target, Bars | Edge):
                _add_ruled(image, finer, kind, known, windows, target, chosen)
            elif isinstance(target, Picture):
                add_picture_diffracted(image, finer, kind, known, windows, target, chosen)
            elif isinstance(target, FourDot):
                add_dots_diffracted(image, finer, kind, known, windows, target, chosen)


def _add_rays(
    image: Array, setup: Setup, kind: Kind, target: Target, wanted: Chosen | None
) -> None:
    """Add a kind's light without diffraction."""
    part = setup.of(kind.entries, setup.window[kind.entries])
    add_moving_plane(
        image,
        replace(part, pupils=replace(part.pupils, level=part.pupils.level * kind.weights)),
        target,
        wanted,
    )


def _add_ruled(
    image: Array,
    setup: Setup,
    kind: Kind,
    known: Known,
    lit: Whole,
    target: Bars | Edge,
    chosen: Chosen,
) -> None:
    pixel = setup.sensor.pixel
    axes = np.eye(2)
    if isinstance(target, Edge):
        cos, sin = math.cos(target.angle), math.sin(target.angle)
        axes = np.array([[cos, sin], [-sin, cos]])
    within = within_pixel(setup, kind)
    divided = pixel_parts(kind, setup.tolerance, within=within)
    shading = find_shading(setup, kind, divided.steep)
    radii, angles = node_counts(kind, setup, finest_lines(kind, target))
    samples, box, left_out = (
        samples_needed(kind, setup.tolerance),
        setup.pixel_width / pixel,
        max(LINE_TERMS * setup.tolerance, LEAST_TERMS),
    )
    modes = shared_modes(
        known,
        kind,
        samples,
        (1, 1) if divided.steep else (radii, angles),
        box,
        left_out,
        shading=shading,
    )
    centres = np.column_stack([setup.pupils.centre_x, setup.pupils.centre_y])[kind.entries]
    directions = axes @ kind.by_sensor
    scales = np.hypot(*directions.T)
    origins = setup.origin[kind.entries] @ axes.T / scales
    looks = axes @ setup.by_sensor[kind.entries] * pixel / scales[:, None]
    windows = lit[kind.entries]
    low, high = looked_at(windows, centres, origins, looks, setup)
    seen = float(low[0] * scales[0]), float(high[0] * scales[0])
    line = make_line(modes, samples, target, seen, directions[0], setup.tolerance)
    half, mirror = math.inf, False
    inwards: list[tuple[Array, tuple[float, float]]] = []
    at_border = modes.but_for(left_out if isinstance(target, Bars) else math.inf)
    if isinstance(target, Bars):
        half = target.height / 2 / scales[1]
        reach = border_reach(kind, setup.tolerance)
        insides = [
            (half + float(low[1]), half + float(high[1])),
            (half - float(high[1]), half - float(low[1])),
        ]
        lower, upper = ((nearest, min(farthest, reach)) for nearest, farthest in insides)
        if min(lower[0], upper[0]) < reach:
            mirror = kind.smear.extent == 0 and is_even(directions[None], 0.0)
            either = min(lower[0], upper[0]), max(lower[1], upper[1])
            inwards = (
                [(directions[1], either)]
                if mirror
                else [(directions[1], lower), (-directions[1], upper)]
            )
    xs, ys = pixel_positions(setup.sensor)

    def add(
        rows: tuple[int, int], parts: PixelParts, curves: Curves, borders: list[Border]
    ) -> None:
        border_rows = [
            (some.core, some.part, some.waves, some.terms, some.turns, some.last, some.place)
            for some in borders
        ]
        add_ruled_diffracted(
            image,
            rows,
            windows,
            centres,
            origins,
            looks,
            setup.pupils.level[kind.entries] * kind.weights,
            kind.rims,
            parts.steep,
            parts.bright,
            parts.ring,
            parts.offsets,
            parts.amounts,
            box,
            xs,
            ys,
            pixel,
            half,
            (curves.core, curves.part, curves.waves, curves.place),
            (modes.orders, modes.weights, np.ascontiguousarray(modes.radial.T, dtype=np.float32)),
            border_rows[0],
            border_rows[1],
            -1.0 if mirror else 1.0,
            int(modes.orders.max(initial=0)),
            (at_border.weights, np.ascontiguousarray(at_border.radial.T)),
            slant_rows(setup, kind),
            pupil_moments(kind.slope, kind.reach, 1 if divided.steep else MOMENTS),
            shading.fit,
            kind.blur,
            disc_nodes(8, 8),
            chosen,
        )

    for parts in divisions(kind, setup.tolerance, divided, within, shading is not MEAN):
        side = box * parts.side
        curves = make_curves(modes, line, box, side)
        borders = (
            make_borders(at_border, line, inwards, box, side, setup.tolerance)
            * (2 if mirror else 1)
            if inwards
            else NO_BORDERS
        )
        in_bands(partial(add, parts=parts, curves=curves, borders=borders), windows)
