"""Every lens of a white picture: its place, its light, the shape of its micro-image."""

import math

import numpy as np
import numpy.typing as npt
from white_pictures.kernel import LENS
from white_pictures.lattice import (
    bent,
    designed_vectors,
    field_axis,
    field_radius,
    fit_straight,
    indices_within,
    stretched,
    turned,
)
from white_pictures.profiles import ProfileTable
from white_pictures.read_out import shading
from white_pictures.spec import Array, Flags, Truth, WhiteSpec

_DEAD = 0.02, 0.22  # light of a dead lens
_COVER = 1.5  # softness of the edge of what covers a lens's half, the profile's px

Lenses = npt.NDArray[np.void]


def place_lenses(
    spec: WhiteSpec, table: ProfileTable, margin: int, rng: np.random.Generator
) -> tuple[Lenses, Truth]:
    """All lenses whose light falls within ``margin`` of the picture; the truth has those that
    reach the picture itself.
    """
    size = np.array(spec.shape[::-1], dtype=np.float64)
    form = turned(spec.aspect_angle) @ stretched(spec.aspect) @ turned(-spec.aspect_angle)
    box = np.linalg.norm(form, axis=1) * max(spec.kinds)  # extent of a disc of radius 1
    vectors, origin = designed_vectors(spec), (size - 1) / 2 + np.array(spec.origin)
    beyond = box * table.outer + margin + 3 + 4 * (spec.bend + spec.scatter)
    low, high = -beyond, size - 1 + beyond
    if spec.margin > 0:
        low, high = np.full(2, spec.margin - 0.5), size - 0.5 - spec.margin
    index = indices_within(vectors, origin, low, high)

    places, end = origin + index @ vectors.T, box * table.falls_to(0.01)
    uncut = _inside(places, end, size)
    dead, half, missing = _spoilt(spec, np.flatnonzero(uncut), len(index), rng)
    spoilt = dead | half | missing
    smooth = bent(spec, index, places, uncut & ~spoilt)
    centre = smooth + rng.normal(0, spec.scatter, places.shape)
    i, j = index.T
    kind = (i + j) % 2 if len(spec.kinds) == 2 else (i - j) % len(spec.kinds)

    lenses = np.zeros(len(index), LENS)
    lenses["x"], lenses["y"] = centre.T
    lenses["light"] = _light(spec, centre, rng)
    lenses["light"][dead] *= rng.uniform(*_DEAD, int(dead.sum()))
    lenses["light"][missing] = 0
    _shape(lenses, spec, table, form, np.array(spec.kinds)[kind])
    _cover(lenses, half, rng)

    shown = _inside(centre, -box * table.outer, size)
    whole = shown & _inside(centre, end, size) & ~spoilt
    truth = Truth(
        fit_straight(index[whole], smooth[whole], spec.symmetry),
        index[shown],
        centre[shown],
        (lenses["light"] * shading(spec.shape, spec.readout.shading, *centre.T))[shown],
        missing[shown],
        whole[shown],
    )
    return lenses, truth


def _inside(places: Array, border: Array, size: Array) -> Flags:
    """Places that keep this distance from the picture's border."""
    return np.all((places >= border - 0.5) & (places <= size - 0.5 - border), axis=1)


def _spoilt(
    spec: WhiteSpec, among: npt.NDArray[np.intp], count: int, rng: np.random.Generator
) -> tuple[Flags, Flags, Flags]:
    """Dead, half-covered and missing lenses, drawn from those that no border cuts."""
    drawn = rng.permutation(among)
    flags: list[Flags] = []
    for number in (spec.dead, spec.half_covered, spec.missing):
        flag = np.zeros(count, dtype=np.bool_)
        flag[drawn[:number]] = True
        drawn = drawn[number:]
        flags.append(flag)
    return flags[0], flags[1], flags[2]


def _light(spec: WhiteSpec, centre: Array, rng: np.random.Generator) -> Array:
    away = np.hypot(*(centre - field_axis(spec)).T) / field_radius(spec)
    light = 1 - (1 - spec.corner) * np.minimum(away, 1.0) ** spec.falloff_power
    return light * (1 + rng.normal(0, spec.brightness, len(centre)))


def _shape(lenses: Lenses, spec: WhiteSpec, table: ProfileTable, form: Array, radii: Array) -> None:
    """Write the shapes of micro-images."""
    to_profile, half = np.linalg.inv(form), table.falls_to(0.5)
    for name, value in zip(("xx", "xy", "yx", "yy"), to_profile.ravel(), strict=True):
        lenses[name] = value / radii
    lenses["longest"] = np.linalg.norm(to_profile, 2) / radii
    reach = np.outer(radii, np.linalg.norm(form, axis=1)) * table.outer
    lenses["across"], lenses["down"] = reach.T

    away = np.column_stack([lenses["x"], lenses["y"]]) - field_axis(spec)
    away /= field_radius(spec)
    aspect = 1 + (spec.second_stop - 1) * np.hypot(*away.T) ** 2
    apart = (aspect**2 - 1) / (aspect**2 + 1)  # half of the stops' distance, in radii
    radial = away @ to_profile.T
    radial /= np.maximum(np.hypot(*radial.T), 1e-12)[:, None]
    lenses["stop_x"], lenses["stop_y"] = half * apart * radial.T

    along = math.radians(spec.slope_angle)
    slope = spec.slope * np.array([math.cos(along), math.sin(along)]) + spec.slope_at_corner * away
    lenses["slope_x"], lenses["slope_y"] = slope.T / (2 * half)
    lenses["rounding"] = spec.rounding / (1 - spec.rounding) / half**2


def _cover(lenses: Lenses, half: Flags, rng: np.random.Generator) -> None:
    """Darken half of some lenses, each from a side of its own."""
    side = rng.uniform(0, 2 * math.pi, len(lenses))
    lenses["covered"] = half
    lenses["cover_x"] = np.cos(side) / (math.sqrt(2) * _COVER)
    lenses["cover_y"] = np.sin(side) / (math.sqrt(2) * _COVER)
