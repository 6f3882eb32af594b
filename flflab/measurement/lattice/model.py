"""The model of a white picture that the fit of its lattice has: its values, and what they make of
every lattice point.

Model of a pixel at p: background + sum over micro-images of light(c) (symmetric(|e|) + (slant .
e/|e|) lopsided(|e|)) with e = p - c and c = origin + i a + j b, bent by the array's tilt, which
also changes the profile from one micro-image to the next (tilting.py); light is a polynomial of
second degree over the picture, slant = slant_0 + rate (c - origin).
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.kernels import (
    BY_RISE,
    LEVER,
    OUT,
    PLACES,
    RADII_BY_RISE,
    RISE,
    TABLE,
    WIDER_PX,
    X,
    Y,
)
from flflab.measurement.lattice.kinds import Kinds
from flflab.measurement.lattice.profile import BY_LARGE, BY_SMALL, Cone, profile_table, table_step
from flflab.measurement.lattice.tilting import Tilting

Array = npt.NDArray[np.float64]

GEOMETRY = slice(0, 8)
LIGHT = slice(9, 15)
SHARE, SLANT, RATE, TILT, WIDER = 15, slice(16, 18), 18, slice(19, 21), 21
SMALLEST_PX = 0.05  # radius of a disc: a smaller one cannot be told from it
# micro-images share a table and its slope by the rise within this times sqrt(1 + r), r the smaller
# disc
SHARED_PX = 0.005

MOST_TABLES = (
    150  # for a tilt of a degree of the worked example; a larger one is seen more coarsely
)


@dataclass(frozen=True)
class LatticeModel:
    """What is fitted.

    Attributes:
        values: origin x y, a x y, b x y, larger and smaller disc radius, background, light, slants,
            tilt x y, and by how much the kinds' discs differ over what is described; shape
            (COUNT,).
        covariance: of them, shape (COUNT, COUNT).
        chi2_per_pixel: about 1 where model and noise are right.
        cone: how rays land; None where fall-off and tilt are left out.
        expected: values expected beforehand and their standard deviations, shape (2, COUNT); None
            where only the pixels count.
        kinds: of microlenses; None where there is one, or they are taken for one.
    """

    values: Array
    covariance: Array
    chi2_per_pixel: float
    cone: Cone | None = None
    expected: Array | None = None
    kinds: Kinds | None = None

    @property
    def vectors(self) -> Array:
        """Lattice vectors a and b as the columns of a 2 x 2 matrix, px."""
        return np.array([[self.values[2], self.values[4]], [self.values[3], self.values[5]]])

    @property
    def radii(self) -> tuple[float, float]:
        """Radii of the two discs, px, as fitted; of a tilted array on the axis."""
        return float(self.values[6]), float(self.values[7])

    @property
    def seen_kinds(self) -> Kinds | None:
        """The kinds with discs as wide as they are fitted."""
        return self.kinds and self.kinds.widened(float(self.values[WIDER]))

    def straight(self, half_counts: tuple[int, int]) -> Array:
        """Lattice points without a tilt, px, shape (2 half_i + 1, 2 half_j + 1, 2), the origin in
        the middle.
        """
        i, j = np.meshgrid(*(np.arange(-n, n + 1) for n in half_counts), indexing="ij")
        return self.values[:2] + np.stack([i, j], axis=-1) @ self.vectors.T

    def centres(self, half_counts: tuple[int, int]) -> Array:
        """Centres of the micro-images, px, in the same shape."""
        straight = self.straight(half_counts)
        return (
            straight
            if self.cone is None
            else self.cone.tilting.centres(straight, self.values[TILT])
        )


@dataclass(frozen=True)
class Laid:
    """What the kernels are told of every lattice point.

    Attributes:
        lights: light and the terms of its polynomial, shape (i, j, 7).
        places: see ``lattice_kernels``, shape (i, j, PLACES).
        tables: profiles by rise, shape (n, entries, columns).
        step: distance between a table's entries, px.
        shifted: most that the tilt moves any micro-image in the picture, px.
    """

    lights: Array
    places: Array
    tables: Array
    step: float
    shifted: float

    @property
    def reach(self) -> float:
        """Distance from which on the profiles are 0, px."""
        return self.step * (self.tables.shape[1] - 2)


def laid(
    model: LatticeModel,
    present: npt.NDArray[np.bool_],
    shape: tuple[int, int],
    coarser: float = 1.0,
) -> Laid:
    """Lattice points in a picture of this shape, (rows, columns); those not ``present`` have no
    light.

    Profiles are tabulated at a distance ``coarser`` than the finest.
    """
    half_counts = present.shape[0] // 2, present.shape[1] // 2
    centres = model.centres(half_counts)
    x, y = np.moveaxis((centres - (np.array([shape[1], shape[0]]) - 1) / 2) * 2 / max(shape), -1, 0)
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    light = np.where(present, terms @ model.values[LIGHT], 0.0)
    lights = np.concatenate([light[..., None], terms], axis=-1)
    places = np.zeros((*present.shape, PLACES))
    places[..., X], places[..., Y] = centres[..., 0], centres[..., 1]
    step = coarser * table_step(*model.radii)
    if model.cone is None:
        return Laid(
            lights,
            places,
            _tables(model, None, np.zeros((1, 2)), np.array([model.radii]), step),
            step,
            0.0,
        )
    cone, tilting, straight = model.cone, model.cone.tilting, model.straight(half_counts)
    rises = tilting.rises(straight, model.values[TILT])
    reach = sum(model.radii) + 2
    near = np.all((centres > -reach) & (centres < np.array([shape[1], shape[0]]) + reach), axis=-1)
    places[..., OUT], places[..., LEVER] = (
        centres - tilting.axis_px,
        tilting.per_px * (straight - tilting.axis_px),
    )
    tables, first = list[tuple[Array, Array]](), 0
    for mine, of_kind, on_axis, wider in _by_kind(model, tilting, centres):
        at, radii, by_rise = _rises_of_tables(on_axis, of_kind, rises[near & mine])
        which = np.searchsorted((at[1:] + at[:-1]) / 2, rises[mine])
        places[mine, RISE], places[mine, TABLE] = (
            np.where(near[mine], rises[mine] - at[which], 0.0),
            first + which,
        )
        places[mine, RADII_BY_RISE], places[mine, WIDER_PX] = by_rise[which], wider
        tables.append((by_rise, radii))
        first += len(at)
    shifted = float(np.abs(centres - straight)[near].max(initial=0.0))
    by_rise, radii = (np.concatenate(part) for part in zip(*tables, strict=True))
    return Laid(lights, places, _tables(model, cone, by_rise, radii, step), step, shifted)


def _by_kind(
    model: LatticeModel, tilting: Tilting, centres: Array
) -> list[tuple[npt.NDArray[np.bool_], Tilting, Array, float]]:
    """Of each kind which micro-images it has, what a tilt does to them, their radii on the axis and
    how much wider it is described.
    """
    radii, described, seen = np.array(model.radii), model.kinds, model.seen_kinds
    if described is None or seen is None:
        return [(np.ones(centres.shape[:-1], dtype=np.bool_), tilting, radii, 0.0)]
    kind = seen.of(centres)
    return [
        (kind == k, seen.tilting(tilting, k), seen.radii(radii, k), float(wider))
        for k, wider in enumerate(described.wider_px)
    ]


def _rises_of_tables(radii: Array, tilting: Tilting, rises: Array) -> tuple[Array, Array, Array]:
    """Rises for which profiles are tabulated, the discs' radii there and how they change with the
    rise, shapes (n,), (n, 2), (n, 2).
    """
    nudge = 1e-7
    fastest = float(np.abs(tilting.discs(radii, np.array([nudge])) - radii).max()) / nudge
    low, high = float(rises.min(initial=0.0)), float(rises.max(initial=0.0))
    apart = max(
        SHARED_PX * math.sqrt(1 + float(radii.min())) / max(fastest, 1e-300),
        (high - low) / MOST_TABLES,
    )
    first, last = round(low / apart), round(high / apart)
    at = np.arange(first, last + 1, dtype=np.float64) * apart
    by_rise = (tilting.discs(radii, at + nudge) - tilting.discs(radii, at - nudge)) / (2 * nudge)
    return at, np.maximum(tilting.discs(radii, at), SMALLEST_PX), by_rise


def _tables(
    model: LatticeModel, cone: Cone | None, by_rise: Array, radii: Array, step: float
) -> Array:
    """Profiles of several pairs of radii, and in a last column how each changes with the rise;
    shape (n, entries, columns).
    """
    share = float(model.values[SHARE])
    found = [
        profile_table(large, small, cone, share, step).values for large, small in radii.tolist()
    ]
    tables = np.zeros((len(found), max(map(len, found)), BY_RISE + 1))
    for table, values, (large, small) in zip(tables, found, by_rise, strict=True):
        table[: len(values), :BY_RISE] = values
        table[: len(values), BY_RISE] = large * values[:, BY_LARGE] + small * values[:, BY_SMALL]
    return tables
