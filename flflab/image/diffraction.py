"""The picture of a flat target in light of one wavelength: the scalar Fresnel image through every microlens's clipped pupil.

A sensor point sees the target through the part of the pupil that both stops leave of it, as rays do; the light of that part comes
from the target with the diffraction pattern of its shape and defocus instead of a point for each ray. The pattern's integral is the
light of the rays, so that white stays white. Paraxial, incoherent, first stop clipped geometrically.
"""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.image.diffraction_border import NO_BORDER, border_reach, make_borders
from flflab.image.diffraction_falloff import pupil_moments, slant_rows
from flflab.image.diffraction_fields import (
    Fields,
    Grid,
    add_fields,
    dot_spectrum,
    kept_frequencies,
    make_fields,
    make_grid,
    picture_spectrum,
)
from flflab.image.diffraction_kinds import BLURRED, Kind, find_kinds
from flflab.image.diffraction_lines import add_ruled_diffracted
from flflab.image.diffraction_ruled import make_curves, make_line
from flflab.image.diffraction_table import Known, samples_needed, shared_modes
from flflab.image.form import add_plane
from flflab.image.moving import add_moving_plane
from flflab.image.orders import MOST_PARTS, STEEP_PARTS, in_bands, is_even
from flflab.image.rim import disc_nodes
from flflab.image.setup import Setup
from flflab.optics.camera import pixel_positions
from flflab.targets import Bars, Chirp, Edge, FourDot, Picture, Target, White

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.int64]

MOMENTS = 33  # nodes over a rim for the fall-off
MOST_SAMPLES = 16.0  # a pixel, of a field over the target
SHARE = 0.7  # of the tolerance; the errors of nodes, parts and terms are each kept below it
KIND_COST: dict[type[Target], float] = {Edge: 6e3, Bars: 5e4, Chirp: 5e4, FourDot: 5e4, Picture: 5e4}  # in pixels, of a kind's tables
LEAST_TERM = 1e-4  # of white; finer terms of the sum over a rim are too many


def add_plane_with_diffraction(image: Array, setup: Setup, target: Target, wavelength: float, wanted: Chosen | None = None) -> None:
    """Add the diffracted light of one flat target, not black, to an image [row, column] in units of the geometric white level.

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
    known: Known = {}
    alike = replace(setup, tolerance=SHARE * setup.tolerance / setup.overlap)  # microlenses side by side err to the same side
    pixels = lit_counts(windows[seen], chosen)
    for kind in find_kinds(alike, wavelength, seen, pixels, KIND_COST[type(target)]) if len(seen) else []:
        if 2 * abs(kind.blur) > BLURRED or kind.cutoff * setup.tolerance > 1:  # so sharp a pattern no pixel tells
            _add_rays(image, setup, kind, target, wanted)
        elif isinstance(target, Bars | Edge):
            _add_ruled(image, finer, kind, known, windows, target, chosen)
        elif isinstance(target, Picture):
            _add_picture(image, finer, kind, known, windows, target, chosen)
        elif isinstance(target, FourDot):
            _add_dots(image, finer, kind, known, windows, target, chosen)


def _add_rays(image: Array, setup: Setup, kind: Kind, target: Target, wanted: Chosen | None) -> None:
    """Add a kind's light without diffraction."""
    part = setup.of(kind.entries, setup.window[kind.entries])
    add_moving_plane(image, replace(part, pupils=replace(part.pupils, level=part.pupils.level * kind.weights)), target, wanted)


def _add_ruled(image: Array, setup: Setup, kind: Kind, known: Known, lit: Whole, target: Bars | Edge, chosen: Chosen) -> None:
    pixel = setup.sensor.pixel
    axes = np.eye(2)
    if isinstance(target, Edge):
        cos, sin = math.cos(target.angle), math.sin(target.angle)
        axes = np.array([[cos, sin], [-sin, cos]])
    parts, steep = pixel_parts(kind, setup.tolerance)
    radii, angles = node_counts(kind, setup.tolerance)
    samples, box = samples_needed(kind, setup.tolerance), setup.pixel_width / pixel
    modes = shared_modes(known, kind, samples, (1, 1) if steep else (radii, angles), box, setup.tolerance / 10)
    centres = np.column_stack([setup.pupils.centre_x, setup.pupils.centre_y])[kind.entries]
    directions = axes @ kind.by_sensor
    scales = np.hypot(*directions.T)
    origins = setup.origin[kind.entries] @ axes.T / scales
    looks = axes @ setup.by_sensor[kind.entries] * pixel / scales[:, None]
    windows = lit[kind.entries]
    low, high = _looked_at(windows, centres, origins, looks, setup)
    seen = float(low[0] * scales[0]), float(high[0] * scales[0])
    line = make_line(modes, samples, target, seen, directions[0], setup.tolerance)
    curves = make_curves(modes, line, box, parts)
    half, borders, mirror = math.inf, [NO_BORDER, NO_BORDER], False
    at_border = modes.above(max(setup.tolerance / 3, LEAST_TERM) if isinstance(target, Bars) else math.inf)
    if isinstance(target, Bars):
        half = target.height / 2 / scales[1]
        reach = border_reach(kind, setup.tolerance)
        insides = [(half + float(low[1]), half + float(high[1])), (half - float(high[1]), half - float(low[1]))]
        lower, upper = ((nearest, min(farthest, reach)) for nearest, farthest in insides)
        if min(lower[0], upper[0]) < reach:
            mirror = kind.smear.extent == 0 and is_even(directions[None], 0.0)
            either = min(lower[0], upper[0]), max(lower[1], upper[1])
            inwards = [(directions[1], either)] if mirror else [(directions[1], lower), (-directions[1], upper)]
            borders = make_borders(at_border, line, inwards, box, parts, setup.tolerance) * (2 if mirror else 1)
    border_rows = [(some.core, some.part, some.waves, some.terms, some.turns, some.last, some.place) for some in borders]
    xs, ys = pixel_positions(setup.sensor)

    def add(rows: tuple[int, int]) -> None:
        add_ruled_diffracted(
            image,
            rows,
            windows,
            centres,
            origins,
            looks,
            setup.pupils.level[kind.entries] * kind.weights,
            kind.rims,
            steep,
            parts,
            box,
            xs,
            ys,
            pixel,
            half,
            (curves.core, curves.part, curves.waves, curves.place),
            (modes.orders, np.ascontiguousarray(modes.radial.T, dtype=np.float32)),
            border_rows[0],
            border_rows[1],
            -1.0 if mirror else 1.0,
            int(modes.orders.max(initial=0)),
            np.ascontiguousarray(at_border.radial.T),
            slant_rows(setup, kind),
            pupil_moments(kind.slope, kind.reach, 1 if steep else MOMENTS),
            kind.blur,
            disc_nodes(8, 8),
            chosen,
        )

    in_bands(add, windows)


def _add_dots(image: Array, setup: Setup, kind: Kind, known: Known, lit: Whole, dots: FourDot, chosen: Chosen) -> None:
    scales, radius = np.hypot(*kind.by_sensor.T), dots.diameter / 2
    size = float(radius / scales.min())
    # The pattern falls as its light times 2 / (pi^4 cutoff) over the third power of the distance, once round the circle.
    reach = size + kind.extent + 4 + (8 * size**2 / (math.pi**3 * kind.cutoff * setup.tolerance)) ** (1 / 3)
    samples = min(samples_needed(kind, setup.tolerance), MOST_SAMPLES)
    grid = make_grid(kind.by_sensor / scales[:, None], np.full(2, -reach), np.full(2, reach), reach, samples)
    _, _, x, y = kept_frequencies(grid, min(kind.cutoff, samples / 2))
    spectrum = dot_spectrum(-np.array(grid.first), radius / scales, x, y)
    _add_fields(image, setup, kind, known, lit, grid, spectrum, np.array(dots.centres), chosen)


def _add_picture(image: Array, setup: Setup, kind: Kind, known: Known, lit: Whole, picture: Picture, chosen: Chosen) -> None:
    scales = np.hypot(*kind.by_sensor.T)
    centres = np.column_stack([setup.pupils.centre_x, setup.pupils.centre_y])[kind.entries]
    looks = setup.by_sensor[kind.entries] * setup.sensor.pixel / scales[:, None]
    low, high = _looked_at(lit[kind.entries], centres, setup.origin[kind.entries] / scales, looks, setup)
    edge = np.array([picture.width, picture.height]) / 2 / scales
    margin = min(max(2 / (math.pi**3 * kind.cutoff) / (0.4 * setup.tolerance), 16.0), 400.0) + kind.extent
    low, high = np.maximum(low, -edge - margin), np.minimum(high, edge + margin)
    if np.any(low >= high):
        return
    samples = min(samples_needed(kind, setup.tolerance), MOST_SAMPLES)
    grid = make_grid(kind.by_sensor / scales[:, None], low, high, 2 * margin, samples)
    _, _, x, y = kept_frequencies(grid, min(kind.cutoff, samples / 2))
    spectrum = picture_spectrum(picture, scales, low - margin, high + margin, grid.first, x, y)
    _add_fields(image, setup, kind, known, lit, grid, spectrum, np.zeros((1, 2)), chosen)


def _add_fields(
    image: Array,
    setup: Setup,
    kind: Kind,
    known: Known,
    lit: Whole,
    grid: Grid,
    spectrum: npt.NDArray[np.complex128],
    places: Array,
    chosen: Chosen,
) -> None:
    """Add the light of one thing that is at several places on the target, mm, shape (P, 2)."""
    pixel = setup.sensor.pixel
    parts, steep = pixel_parts(kind, setup.tolerance)
    radii, angles = node_counts(kind, setup.tolerance)
    box = setup.pixel_width / pixel
    scales = np.hypot(*kind.by_sensor.T)
    entries = np.tile(kind.entries, len(places))
    origins = (setup.origin[entries] - np.repeat(places, len(kind.entries), axis=0)) / scales
    centres = np.column_stack([setup.pupils.centre_x, setup.pupils.centre_y])[entries]
    looks = setup.by_sensor[entries] * pixel / scales[:, None]
    seen = _looking_windows(lit[entries], centres, origins, grid, setup)
    held = (seen[:, 0] < seen[:, 1]) & (seen[:, 2] < seen[:, 3])
    if not held.any():
        return
    nodes = (1, 1) if steep else (radii, angles)
    modes = shared_modes(known, kind, grid.samples, nodes, box, max(setup.tolerance / 3, LEAST_TERM))
    xs, ys = pixel_positions(setup.sensor)
    pupil_nodes = disc_nodes(8, 8)
    levels = setup.pupils.level[entries] * np.tile(kind.weights, len(places))
    rims, slants = (np.tile(part, (len(places), 1)) for part in (kind.rims, slant_rows(setup, kind)))
    moments = pupil_moments(kind.slope, kind.reach, 1 if steep else MOMENTS)
    for fields in make_fields(modes, grid, spectrum, box, parts):
        terms = fields.terms

        def add(rows: tuple[int, int], fields: Fields = fields, terms: Whole = terms) -> None:
            add_fields(
                image,
                rows,
                seen[held],
                centres[held],
                origins[held],
                looks[held],
                levels[held],
                rims[held],
                steep,
                parts,
                box,
                xs,
                ys,
                pixel,
                (fields.whole, fields.part, fields.waves),
                modes.orders[terms],
                np.ascontiguousarray(modes.radial[terms].T),
                modes.radial.shape[1] - 1,
                grid.first,
                grid.samples,
                slants[held],
                moments,
                kind.blur,
                pupil_nodes,
                chosen,
            )

        in_bands(add, seen[held])


def _looked_at(windows: Whole, centres: Array, origins: Array, looks: Array, setup: Setup) -> tuple[Array, Array]:
    """The least and largest place on the target, pixels along x' and y', that the pixels of some windows look at."""
    pixel, positions = setup.sensor.pixel, pixel_positions(setup.sensor)
    first = np.array([along[0] for along in positions])
    low, high = ((first + (windows[:, side::2] + at) * pixel - centres) / pixel for side, at in ((0, -1.0), (1, 0.0)))
    corners = np.stack([np.column_stack([x[:, 0], y[:, 1]]) for x in (low, high) for y in (low, high)], axis=1)
    places = origins[:, None] + corners @ looks.swapaxes(1, 2)
    return places.min(axis=(0, 1)) - 1, places.max(axis=(0, 1)) + 1


def _looking_windows(windows: Whole, centres: Array, origins: Array, grid: Grid, setup: Setup) -> Whole:
    """The part of each window that looks at a grid."""
    corners = np.array([[x, y] for x in (0, grid.count[0]) for y in (0, grid.count[1])]) / grid.samples + np.array(grid.first)
    looking = np.linalg.solve(grid.axes, (corners - origins[:, None]).reshape(-1, 2).T).T.reshape(-1, 4, 2)
    positions = pixel_positions(setup.sensor)
    seen = windows.copy()
    for axis in (0, 1):
        middle = (centres[:, axis] - positions[axis][0]) / setup.sensor.pixel
        low, high = looking[..., axis].min(axis=1) + middle, looking[..., axis].max(axis=1) + middle
        seen[:, 2 * axis] = np.maximum(seen[:, 2 * axis], np.clip(np.ceil(low - 1), -1e9, 1e9).astype(np.int64))
        seen[:, 2 * axis + 1] = np.minimum(seen[:, 2 * axis + 1], np.clip(np.floor(high + 2), -1e9, 1e9).astype(np.int64))
    return seen


def pixel_parts(kind: Kind, tolerance: float) -> tuple[int, bool]:
    """Into how many parts a side a pixel on the rim is divided, and whether the rim is too steep for curves of its own.

    Across a pixel share and radiance vary together: on a rim w pixels wide n parts leave up to 0.2 / (w n^2) of a sharp edge, found on
    bars, and less of one whose light rises over several pixels; the share's own bend leaves up to 0.45 / (w n)^2, 0.45 / (w n^2) where
    w is below 1. A rim too steep for curves leaves up to 0.1 w whatever n is.
    """
    width = max(2 * kind.slope, 1e-9)
    sharp = min(1.0, 2 * kind.cutoff, 1 / math.sqrt(max(abs(kind.blur), 1e-9)))
    parts = math.ceil(math.sqrt((0.22 * sharp + 0.45 / max(width, 1.0)) / (width * tolerance)))
    parts = min(max(parts, 1), MOST_PARTS)
    return (STEEP_PARTS, True) if width * parts < 1 else (parts, False)


def node_counts(kind: Kind, tolerance: float) -> tuple[int, int]:
    """How many radii and angles of a micro-image's rim a tolerance needs; more where no pixel averages out the pupil's finest waves."""
    finer, fine = (0.002 / tolerance) ** 0.25, min(1.0, 0.3 / max(kind.cutoff, 1e-9))
    radii, angles = (9 + 6 * fine) * (1.5 + 0.1 * abs(kind.blur)), (20 + 8 * fine) * (1 + 0.1 * abs(kind.blur))
    return math.ceil(finer * radii), math.ceil(finer * angles) + 1


def lit_counts(windows: Whole, chosen: Chosen) -> Array:
    """How many chosen pixels there are in each window."""
    sums = np.pad(chosen.cumsum(axis=0, dtype=np.float64).cumsum(axis=1), ((1, 0), (1, 0)))
    left, right, low, high = windows.T
    return np.asarray(sums[high, right] - sums[low, right] - sums[high, left] + sums[low, left])


def lit_windows(setup: Setup) -> Whole:
    """The part of the sensor under each micro-image: first column, column after the last, first row, row after the last."""
    pixel, pupils = setup.sensor.pixel, setup.pupils
    outside = pupils.outside / pixel + 1
    limits: list[Array] = []
    for centre, positions in zip((pupils.centre_x, pupils.centre_y), pixel_positions(setup.sensor), strict=True):
        middle = (centre - positions[0]) / pixel
        limits += [np.ceil(middle - outside), np.floor(middle + outside) + 1]
    windows = np.clip(np.stack(limits, axis=1), -1e9, 1e9).astype(np.int64)
    for side, narrower in ((0, np.maximum), (1, np.minimum), (2, np.maximum), (3, np.minimum)):
        windows[:, side] = narrower(windows[:, side], setup.window[:, side])
    return windows
