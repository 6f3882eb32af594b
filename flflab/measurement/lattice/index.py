"""Every micro-image of a white picture found and indexed, ring by ring from a first one."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.errors import MeasurementError
from flflab.measurement.lattice.find import RoughLattice
from flflab.measurement.lattice.kernel import GROUND, LIGHT, VALUES, WIDER
from flflab.measurement.lattice.mean_profile import (
    Profile,
    measured_profile,
    recentred,
    soft_disc,
)
from flflab.measurement.lattice.micro_images import (
    BLOB,
    Model,
    expected,
    fit,
    neighbours_within,
    with_ground,
)
from flflab.measurement.lattice.pixels import Pixels
from flflab.measurement.lattice.spread import Spread, spread

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

GROWTH = 1.8  # by which the radius of the part that is indexed grows
FEWEST = 6  # whole micro-images
ENOUGH = 20  # for a profile of their own
LEAST_LIGHT = 0.02  # of the brightest ones'
WORST = 0.25  # of a micro-image's light: what it may leave
MOVED = 0.25  # of the pitch: how far from where it was expected
OVERLAP = 1.04  # of half the pitch: wider micro-images are fitted together
CUT = 4.0  # robust deviations beyond which a centre does not count for the map


@dataclass(frozen=True)
class Indexed:
    """Micro-images with their indices.

    Attributes:
        indices: (i, j), shape (n, 2).
        values: as of ``kernel``, shape (n, VALUES).
        found: which were seen; the others are where they are expected.
        profile: with which they were fitted.
        joint: whether they overlap so far that they have to be fitted together.
        ground: DN below them, where it is nowhere seen by itself; None where it is.
    """

    indices: Whole
    values: Array
    found: Flags
    profile: Profile
    joint: bool
    ground: float | None


def terms(indices: Array, degree: int, scale: float) -> Array:
    """Powers of (i, j)/scale up to a total degree, shape (n, terms)."""
    i, j = (indices / scale).T
    return np.stack(
        [i ** (total - k) * j**k for total in range(degree + 1) for k in range(total + 1)], axis=1
    )


def smooth_map(indices: Whole, centres: Array, degree: int, scale: float) -> Array:
    """Coefficients of a polynomial map through centres, those far off left out, shape (terms,
    2).
    """
    design = terms(indices.astype(np.float64), degree, scale)
    good = np.ones(len(centres), dtype=np.bool_)
    found = np.zeros((design.shape[1], 2))
    for _ in range(4):
        found = np.asarray(np.linalg.lstsq(design[good], centres[good], rcond=None)[0], np.float64)
        off = np.hypot(*(centres - design @ found).T)
        limit = CUT * 1.2 * float(np.median(off[good])) + 0.02
        good = off <= limit
        if np.count_nonzero(good) < 2 * design.shape[1]:
            break
    return found


def index_lattice(pixels: Pixels, rough: RoughLattice) -> Indexed:
    """Find every micro-image by growing a map of the lattice outwards.

    Args:
        pixels: of the picture, looked at as sparsely as the rough radius allows.
        rough: lattice round one micro-image.

    Raises:
        MeasurementError: fewer than six whole ones.
    """
    profile = soft_disc(rough.radius, rough.softness)
    joint = rough.radius + rough.softness / 2 > OVERLAP * rough.pitch / 2
    indices = _candidates(rough, pixels.picture.shape, profile.end)
    scale = float(np.abs(indices).max()) + 1.0
    centres = rough.origin + indices @ rough.vectors.T
    values = np.zeros((len(indices), VALUES))

    ground = pixels.noise.offset_dn if joint else None  # nowhere seen by itself
    below = rough.background if ground is None else ground
    values[:, LIGHT], values[:, GROUND] = rough.light + rough.background - below, below
    found, tried = (np.zeros(len(indices), dtype=np.bool_) for _ in range(2))
    far = np.hypot(*(indices @ (rough.vectors / rough.pitch).T).T)
    ring, profiled, shape = 1.6, False, pixels.picture.shape
    while True:
        values[~tried, :2] = centres[~tried]
        now = (far <= ring) & ~tried & (_shown(centres, shape, 0.0) | (ring < 3))
        if now.any():
            values, good = _fitted(pixels, values, now, found, profile, rough.pitch, joint, ground)
            off = np.hypot(*(values[:, :2] - centres).T)
            good &= off < MOVED * rough.pitch
            found[now] = good[now]
            tried |= now
        count = np.count_nonzero(found)
        if count >= ENOUGH and not profiled:
            members = np.flatnonzero(found & _shown(values[:, :2], shape, -profile.end))
            if len(members) >= ENOUGH:
                around = neighbours_within(values[:, :2], 2 * profile.end)
                before = profile
                profile = measured_profile(pixels, values, members, around, before)
                values, profiled = recentred(values, profile, before, members), True
        if count >= FEWEST:
            degree = 1 if count < 24 else 2 if count < 80 else 3
            linear = smooth_map(indices[found], values[found, :2], degree, scale)
            centres = terms(indices.astype(np.float64), degree, scale) @ linear
            # what was missed may lie elsewhere than it was expected
            missed = tried & ~found & (far > 0.5 * ring)
            tried[missed & (np.hypot(*(values[:, :2] - centres).T) > 0.1 * rough.pitch)] = False
            values[~found, :2] = centres[~found]
        if ring > far.max():
            break
        ring *= GROWTH
    if np.count_nonzero(found) < FEWEST:
        raise MeasurementError(
            f"white picture: {np.count_nonzero(found)} whole micro-images were found,"
            f" {FEWEST} are needed; show more of the array, or check that the target was evenly"
            " lit and the exposure"
        )
    values[~found, :2] = centres[~found]
    return Indexed(indices, values, found, profile, joint, ground)


def _candidates(rough: RoughLattice, shape: tuple[int, ...], reach: float) -> Whole:
    """Indices whose micro-images may lie on the picture, with room for a bent lattice."""
    room = reach + 0.05 * max(shape)
    corners = np.array(
        [[x, y] for x, y in itertools.product((-room, shape[1] + room), (-room, shape[0] + room))]
    )
    most = np.abs(np.linalg.inv(rough.vectors) @ (corners - rough.origin).T).max(axis=1)
    i, j = (np.arange(-math.ceil(one), math.ceil(one) + 1) for one in most)
    every = np.stack(np.meshgrid(i, j, indexing="ij"), axis=-1).reshape(-1, 2)
    centres = rough.origin + every @ rough.vectors.T
    return every[_shown(centres, shape, room)]


def _shown(centres: Array, shape: tuple[int, ...], room: float) -> Flags:
    """Which lie on the picture or at most so far beside it."""
    top = np.array([shape[1], shape[0]]) - 0.5
    return np.all((centres > -0.5 - room) & (centres < top + room), axis=1)


def _fitted(
    pixels: Pixels,
    values: Array,
    now: Flags,
    found: Flags,
    profile: Profile,
    pitch: float,
    joint: bool,
    ground: float | None,
) -> tuple[Array, Flags]:
    """Values with those that are looked at now fitted, and which look like micro-images."""
    values = values.copy()
    if found.any():
        light = float(np.median(values[found, LIGHT]))
        values[~found, LIGHT] = light
        values[~found, GROUND] = float(np.median(values[found, GROUND]))
        values[~found, WIDER] = float(np.median(values[found, WIDER]))
    # those beside them light their pixels too
    beside = KDTree(values[now, :2]).query(values[:, :2])[0] < 2 * profile.end
    members = np.flatnonzero(now | beside)
    some, fresh = values[members], np.flatnonzero(now[members])
    around = neighbours_within(some[:, :2], 2 * profile.end)
    prior = expected(some, profile, pitch)
    prior.spread[:, LIGHT] *= 4
    if ground is not None:
        prior = with_ground(prior, ground)
    model = Model(profile, around, prior, BLOB, joint)
    some = fit(pixels, some, fresh, model, 8 if joint else 3)
    doubt = spread(pixels, some, fresh, model)
    values[members] = some
    good = np.zeros(len(values), dtype=np.bool_)
    good[members[fresh]] = looks_right(some[fresh], doubt, profile, pitch)
    return values, good


def looks_right(values: Array, doubt: Spread, profile: Profile, pitch: float) -> Flags:
    """Which are seen well enough: by their light, what they leave of it, width and sureness.

    Args:
        values: of some micro-images, shape (n, VALUES).
        doubt: how sure they are.
        profile: that all share.
        pitch: px.
    """
    sure = np.sqrt(np.einsum("nkk->nk", doubt.covariance)[:, : LIGHT + 1])
    light = values[:, LIGHT]
    return (
        (light > LEAST_LIGHT * float(np.quantile(light, 0.9)))
        & (light > 6 * sure[:, LIGHT])
        & (sure[:, :LIGHT].max(axis=1) < 0.1 * pitch)
        & (doubt.misfit < WORST)
        & (np.abs(values[:, WIDER]) < 0.3 * profile.radius)
    )
