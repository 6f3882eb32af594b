"""Kinds of microlenses told apart blind, by the radii and the light of their micro-images.

Arrays of several kinds repeat them: three by (i - j) mod 3 on a hexagonal lattice, two by
(i + j) mod 2 on a square one.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.index import terms
from flflab.optics.camera import Layout

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

SURE = 6.0  # standard deviations by which kinds differ, of their means
LEAST = 1.0  # and of single lenses
FEWEST = 4  # of a kind
CUT = 5.0  # robust deviations beyond which a lens does not count


def class_of(layout: Layout, indices: Whole) -> Whole:
    """Which lenses may be alike, shape (n,)."""
    if layout == "square":
        return indices.sum(axis=1) % 2
    return (indices[:, 0] - indices[:, 1]) % 3


@dataclass(frozen=True)
class Types:
    """Kinds of microlens.

    Attributes:
        of_each: number of the kind of each lens, from 0 up, shape (n,).
        count: how many kinds there are.
    """

    of_each: Whole
    count: int


def types_of(layout: Layout, indices: Whole, whole: Flags, properties: list[Array]) -> Types:
    """Which lenses are of one kind.

    Args:
        layout: of the array.
        indices: of all micro-images, shape (n, 2).
        whole: which count.
        properties: such as radii, by any of which kinds may differ, each of shape (n,).
    """
    classes = class_of(layout, indices)
    count = int(classes.max()) + 1
    one = Types(np.zeros(len(indices), dtype=np.int64), 1)
    if min(np.count_nonzero(whole & (classes == k)) for k in range(count)) < FEWEST:
        return one
    apart = np.zeros((count, count), dtype=np.bool_)
    for values in properties:
        apart |= _differ(indices[whole], classes[whole], values[whole], count)
    kind = np.zeros(count, dtype=np.int64)
    for k in range(1, count):
        alike = [m for m in range(k) if not apart[k, m]]
        kind[k] = kind[alike[0]] if alike else kind[:k].max() + 1
    return Types(kind[classes], int(kind.max()) + 1)


def _differ(indices: Whole, classes: Whole, values: Array, count: int) -> npt.NDArray[np.bool_]:
    """Which classes differ beside a smooth course of the values over the array."""
    index = indices.astype(np.float64)
    smooth = terms(index, 2, float(np.abs(index).max()) + 1)[:, 1:]
    design = np.column_stack([*(classes == k for k in range(count)), smooth]).astype(np.float64)
    good = np.isfinite(values)
    found, spread = np.zeros(design.shape[1]), 0.0
    for _ in range(4):
        if np.count_nonzero(good) < 2 * design.shape[1]:
            return np.zeros((count, count), dtype=np.bool_)
        found = np.linalg.lstsq(design[good], values[good], rcond=None)[0]
        rest = np.abs(values - design @ found)
        spread = 1.48 * float(np.median(rest[good])) + 1e-12
        good = rest < CUT * spread
    normal = np.linalg.inv(design[good].T @ design[good])[:count, :count] * spread**2
    step = found[:count, None] - found[None, :count]
    variance = np.diag(normal)[:, None] + np.diag(normal)[None, :] - 2 * normal
    sure = np.abs(step) > SURE * np.sqrt(np.maximum(variance, 1e-30))
    return sure & (np.abs(step) > LEAST * spread)
