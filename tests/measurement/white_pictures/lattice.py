"""Where the lenses are: the ideal lattice, bent, and a straight one through given places."""

import math

import numpy as np
import numpy.typing as npt
from white_pictures.spec import Array, TrueLattice, WhiteSpec

Indices = npt.NDArray[np.int64]


def template(symmetry: float) -> Array:
    """Vectors of the lattice of pitch 1 and angle 0, as columns."""
    turn = math.radians(symmetry)
    return np.array([[1.0, math.cos(turn)], [0.0, math.sin(turn)]])


def turned(angle: float) -> Array:
    """Matrix of a rotation from x to y, degrees."""
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return np.array([[c, -s], [s, c]])


def stretched(share: float, shear: float = 0.0) -> Array:
    """Symmetric matrix of determinant 1, its axes along x and y where nothing shears."""
    matrix = np.array([[1 + share / 2, shear], [shear, 1 - share / 2]])
    return matrix / math.sqrt(np.linalg.det(matrix))


def designed_vectors(spec: WhiteSpec) -> Array:
    """The lattice's vectors before anything bends it, as columns, px."""
    angle = spec.angle + (90.0 if spec.layout == "hexagonal along y" else 0.0)
    form = stretched(spec.stretch, spec.shear)
    # the stretch acts along x and y of a picture whose lattice is not turned
    along = turned(90.0) if spec.layout == "hexagonal along y" else np.eye(2)
    return spec.pitch * turned(angle) @ along.T @ form @ along @ template(spec.symmetry)


def straight_lattice(vectors: Array, origin: Array, symmetry: float) -> TrueLattice:
    """Pitch and angle of a lattice as they are defined."""
    pitch = math.sqrt(abs(np.linalg.det(vectors)) / np.linalg.det(template(symmetry)))
    u, _, vt = np.linalg.svd(vectors @ np.linalg.inv(template(symmetry)))
    rotation = u @ vt
    angle = math.degrees(math.atan2(rotation[1, 0], rotation[0, 0]))
    return TrueLattice(vectors, origin, pitch, wrapped(angle, symmetry), symmetry)


def wrapped(angle: float, symmetry: float) -> float:
    """An angle within half a symmetry of 0."""
    return angle - symmetry * round(angle / symmetry)


def fit_straight(indices: Indices, places: Array, symmetry: float) -> TrueLattice:
    """Least-squares lattice through places of known indices."""
    rows = np.column_stack([np.ones(len(indices)), indices])
    found = np.linalg.lstsq(rows, places, rcond=None)[0]
    return straight_lattice(found[1:].T.astype(np.float64), found[0].astype(np.float64), symmetry)


def indices_within(vectors: Array, origin: Array, low: Array, high: Array) -> Indices:
    """Indices of all lattice points in a rectangle, corners (x, y)."""
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    span = (corners - origin) @ np.linalg.inv(vectors).T
    first, last = np.floor(span.min(axis=0)).astype(int), np.ceil(span.max(axis=0)).astype(int)
    grid = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True)))
    indices = np.stack([axis.ravel() for axis in grid], axis=1).astype(np.int64)
    places = origin + indices @ vectors.T
    return indices[np.all((places >= low) & (places <= high), axis=1)]


def field_axis(spec: WhiteSpec) -> Array:
    """Middle of the field, (x, y) px."""
    return (np.array(spec.shape[::-1]) - 1) / 2 + np.array(spec.axis)


def field_radius(spec: WhiteSpec) -> float:
    """Distance of the farthest corner from the middle of the field, px."""
    far = np.array(spec.shape[::-1]) / 2 + np.abs(np.array(spec.axis))
    return float(np.hypot(*far))


def bent(spec: WhiteSpec, indices: Indices, places: Array, counted: npt.NDArray[np.bool_]) -> Array:
    """Places with a cubic distortion of ``spec.bend`` px rms, which leaves the best straight
    lattice through the counted ones as it was.
    """
    if spec.bend == 0:
        return places
    away = (places - field_axis(spec)) / field_radius(spec)
    cubic = away * np.sum(away**2, axis=1, keepdims=True)
    straight = fit_straight(indices[counted], cubic[counted], spec.symmetry)
    left = cubic - straight.at(indices)
    return places + left * spec.bend / math.sqrt(np.mean(np.sum(left[counted] ** 2, axis=1)))
