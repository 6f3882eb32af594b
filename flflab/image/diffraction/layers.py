"""Diffracted light by fields over the target, in one layer or in two.

What reaches far varies slowly, and what varies fast stays near. So where that is less work a
Gaussian parts the frequencies, as in Ewald's sums: the slow ones make a coarse field as wide as the
light reaches, the others a fine one little wider than what is looked at.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.image.diffraction.falloff import pupil_moments, slant_rows
from flflab.image.diffraction.fields import (
    Fields,
    Grid,
    add_fields,
    kept_frequencies,
    make_fields,
    on_sensor,
)
from flflab.image.diffraction.kinds import Kind
from flflab.image.diffraction.modes import ALL, Known, Modes, Sieve, shared_modes
from flflab.image.diffraction.orders import (
    LEAST_TERMS,
    MOMENTS,
    PixelParts,
    divisions,
    lit_counts,
    node_counts,
    pixel_parts,
)
from flflab.image.diffraction.shading import MEAN, Shading, find_shading, within_pixel
from flflab.image.diffraction.table import samples_needed
from flflab.image.geometry.rim import disc_nodes
from flflab.image.geometry.setup import Setup
from flflab.image.light.orders import in_bands
from flflab.optics.camera import pixel_positions

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Chosen = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.int64]

MOST_SAMPLES = 16.0  # a pixel, of a field over the target
SOFTNESSES = (1.0, 2.0, 4.0, 8.0, 16.0)  # pixels: standard deviations of the Gaussian
SOFT_SAMPLES = 2.25  # to a standard deviation: splines are right to 6e-5 of white there
FELT = 5.0  # standard deviations that a Gaussian reaches


@dataclass(frozen=True)
class Layer:
    """A part of what is imaged.

    Attributes:
        grid: where.
        margin: from how far around it light comes, pixels.
        sieve: of its frequencies.
    """

    grid: Grid
    margin: float
    sieve: Sieve = ALL

    @property
    def work(self) -> float:
        """How many numbers its Fourier sums and its field have; half as many as both ways of the
        sums and the field.
        """
        (columns, rows), (across, along) = self.grid.length, self.grid.count
        return 0.5 * (float(columns) * (rows + along) + float(across) * along)

    def of(self, spectrum: ComplexArray, x: Array, y: Array) -> ComplexArray:
        """Its part of a spectrum at frequencies along x' and y'."""
        f = on_sensor(self.grid, x, y)
        return spectrum * self.sieve.keeps(np.hypot(f[..., 0], f[..., 1]))


@dataclass(frozen=True)
class Looks:
    """How micro-images look at a thing; see ``add_fields``, whose arguments these are, ``turns``
    being its looks.
    """

    centres: Array
    origins: Array
    turns: Array
    levels: Array
    rims: Array
    slants: Array


@dataclass(frozen=True)
class Thing:
    """What is imaged at one place or several.

    Attributes:
        places: on the target, mm, shape (P, 2).
        margin: how far its light reaches, pixels, but for blur and motion.
        near: how far what a Gaussian of a softness does not keep does.
        grid: for light that reaches so far, at so many samples a pixel; None where no pixel looks.
        spectrum: over a grid, of light from no farther than a margin, at frequencies along x' and
            y'.
    """

    places: Array
    margin: float
    near: Callable[[float], float]
    grid: Callable[[float, float], Grid | None]
    spectrum: Callable[[Grid, float, Array, Array], ComplexArray]


def layers(
    thing: Thing, samples: float, tolerance: float, reads: float
) -> tuple[float, list[Layer]]:
    """The least work that images a thing, and how it is done: one field, or a coarse and a fine
    one.

    Args:
        thing: the thing.
        samples: a pixel, that all its frequencies need.
        tolerance: largest error asked for, of white.
        reads: how often pixels read a field; two are read twice.
    """
    whole = thing.grid(thing.margin, samples)
    if whole is None:
        return 0.0, []
    found = [Layer(whole, thing.margin)]
    least = found[0].work + reads
    for softness in SOFTNESSES:
        coarse = SOFT_SAMPLES / softness * max(1.0, (6e-4 / tolerance) ** 0.25)
        margin = thing.near(softness)
        if coarse >= samples or margin >= thing.margin:
            continue
        wide, near = thing.grid(thing.margin, coarse), thing.grid(margin, samples)
        both = [
            Layer(grid, far, Sieve(softness, slow))
            for grid, far, slow in ((wide, thing.margin, True), (near, margin, False))
            if grid
        ]
        work = sum(layer.work for layer in both) + 2 * reads
        if work < least:
            found, least = both, work
    return least, found


def add_thing(
    image: Array,
    setup: Setup,
    kind: Kind,
    known: Known,
    lit: Whole,
    things: list[Thing],
    finest: float,
    chosen: Chosen,
) -> None:
    """Add the light of a thing, told in one way or another, by the way of least work; ``finest``:
    see ``finest_lines``.
    """
    within = within_pixel(setup, kind)
    divided = pixel_parts(kind, setup.tolerance, finest, within)
    shading = find_shading(setup, kind, divided.steep)
    divided_so = divisions(kind, setup.tolerance, divided, within, shading is not MEAN)
    box, samples = (
        setup.pixel_width / setup.sensor.pixel,
        min(samples_needed(kind, setup.tolerance), MOST_SAMPLES),
    )
    inside = 1 if divided_so[0] is divided else divided_so[0].count
    bright = (kind.inner / kind.outer) ** 2
    reads = float(lit_counts(lit[kind.entries], chosen).sum()) * (
        bright * inside + (1 - bright) * divided.count
    )
    nodes = (1, 1) if divided.steep else node_counts(kind, setup, finest)
    ways = [layers(thing, samples, setup.tolerance, reads * len(thing.places)) for thing in things]
    way = min(range(len(ways)), key=lambda index: ways[index][0])
    for layer in ways[way][1]:
        looks, windows = _looks(setup, kind, lit, things[way], layer.grid)
        if len(windows):
            modes = shared_modes(
                known,
                kind,
                samples,
                nodes,
                box,
                max(setup.tolerance, LEAST_TERMS),
                layer.sieve,
                shading,
            )
            for parts in divided_so:
                _add_layer(
                    image,
                    setup,
                    kind,
                    modes,
                    things[way],
                    layer,
                    looks,
                    windows,
                    parts,
                    shading,
                    chosen,
                )


def _looks(setup: Setup, kind: Kind, lit: Whole, thing: Thing, grid: Grid) -> tuple[Looks, Whole]:
    """Who looks at a thing's grid, from where, and the windows of the pixels that do."""
    count, scales = len(thing.places), np.hypot(*kind.by_sensor.T)
    entries = np.tile(kind.entries, count)
    origins = (setup.origin[entries] - np.repeat(thing.places, len(kind.entries), axis=0)) / scales
    centres = np.column_stack([setup.pupils.centre_x, setup.pupils.centre_y])[entries]
    turns = setup.by_sensor[entries] * setup.sensor.pixel / scales[:, None]
    seen = _looking_windows(lit[entries], centres, origins, grid, setup)
    held = (seen[:, 0] < seen[:, 1]) & (seen[:, 2] < seen[:, 3])
    levels = setup.pupils.level[entries] * np.tile(kind.weights, count)
    rims, slants = (np.tile(part, (count, 1)) for part in (kind.rims, slant_rows(setup, kind)))
    return Looks(
        centres[held], origins[held], turns[held], levels[held], rims[held], slants[held]
    ), seen[held]


def _add_layer(
    image: Array,
    setup: Setup,
    kind: Kind,
    modes: Modes,
    thing: Thing,
    layer: Layer,
    looks: Looks,
    windows: Whole,
    divided: PixelParts,
    shading: Shading,
    chosen: Chosen,
) -> None:
    """Add the light of a layer to some windows."""
    box, grid = setup.pixel_width / setup.sensor.pixel, layer.grid
    _, _, x, y = kept_frequencies(grid, modes.band)
    spectrum = layer.of(thing.spectrum(grid, layer.margin, x, y), x, y)
    moments, pupil_nodes = (
        pupil_moments(kind.slope, kind.reach, 1 if divided.steep else MOMENTS),
        disc_nodes(8, 8),
    )
    xs, ys = pixel_positions(setup.sensor)
    for fields in make_fields(modes, grid, spectrum, box, box * divided.side):

        def add(
            rows: tuple[int, int], fields: Fields = fields, terms: Whole = fields.terms
        ) -> None:
            add_fields(
                image,
                rows,
                windows,
                looks.centres,
                looks.origins,
                looks.turns,
                looks.levels,
                looks.rims,
                divided.steep,
                divided.bright,
                divided.ring,
                divided.offsets,
                divided.amounts,
                box,
                xs,
                ys,
                setup.sensor.pixel,
                (fields.whole, fields.part, fields.waves),
                (
                    modes.orders[terms],
                    modes.weights[terms],
                    np.ascontiguousarray(modes.radial[terms].T),
                ),
                modes.radial.shape[1] - 1,
                grid.first,
                grid.samples,
                looks.slants,
                moments,
                shading.fit,
                kind.blur,
                pupil_nodes,
                chosen,
            )

        in_bands(add, windows)


def _looking_windows(
    windows: Whole, centres: Array, origins: Array, grid: Grid, setup: Setup
) -> Whole:
    """The part of each window that looks at a grid."""
    corners = np.array(
        [[x, y] for x in (0, grid.count[0]) for y in (0, grid.count[1])]
    ) / grid.samples + np.array(grid.first)
    looking = np.linalg.solve(grid.axes, (corners - origins[:, None]).reshape(-1, 2).T).T.reshape(
        -1, 4, 2
    )
    positions = pixel_positions(setup.sensor)
    seen = windows.copy()
    for axis in (0, 1):
        middle = (centres[:, axis] - positions[axis][0]) / setup.sensor.pixel
        low, high = looking[..., axis].min(axis=1) + middle, looking[..., axis].max(axis=1) + middle
        seen[:, 2 * axis] = np.maximum(
            seen[:, 2 * axis], np.clip(np.ceil(low - 1), -1e9, 1e9).astype(np.int64)
        )
        seen[:, 2 * axis + 1] = np.minimum(
            seen[:, 2 * axis + 1], np.clip(np.floor(high + 2), -1e9, 1e9).astype(np.int64)
        )
    return seen
