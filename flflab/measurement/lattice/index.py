"""Every micro-image of a white picture found and indexed: those round a first one give the profile
of light across all, with which each is then looked for where it is expected.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.lattice.find import RoughLattice
from flflab.measurement.lattice.kernel import GROUND, LIGHT, VALUES, WIDER
from flflab.measurement.lattice.mean_profile import (
    Profile,
    measured_profile,
    soft_disc,
)
from flflab.measurement.lattice.micro_images import (
    BLOB,
    Model,
    expected,
    fit,
)
from flflab.measurement.lattice.neighbours import neighbours_within
from flflab.measurement.lattice.pixels import Pixels
from flflab.measurement.lattice.spread import Spread, spread

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

FIRST = 4.0  # pitches from the origin: those that give the profile of all
GROWTH = 1.6  # from ring to ring
BENT = 40  # micro-images that show how a lattice bends
BRIGHTEST = 2.0  # of the median light
FEWEST = 6  # whole micro-images
ENOUGH = 20  # for a profile of their own
LEAST_LIGHT = 0.02  # of the brightest ones'
WORST = 0.25  # of a micro-image's light: what it may leave
ALIGN, STEPS = 6, 3  # of the first fit and of that of all
UNLIKE, UNLIKE_WIDTH, UNLIKE_MISFIT = 4.0, 0.02, 0.03  # of three quarters; radii; of the light
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
        ground: DN below them, where they overlap so far that it is nowhere seen by itself; None
            where it is.
    """

    indices: Whole
    values: Array
    found: Flags
    profile: Profile
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
    """Find every micro-image from the middle outwards: those of each ring lie where the lattice
    through all that were found puts them.

    Args:
        pixels: of the picture, looked at as sparsely as the rough radius allows.
        rough: lattice round one micro-image.

    Raises:
        MeasurementError: fewer than six whole ones.
    """
    profile, shape = soft_disc(rough.radius, rough.softness), pixels.picture.shape
    joint = rough.radius + rough.softness / 2 > OVERLAP * rough.pitch / 2
    ground = pixels.noise.offset_dn if joint else None  # nowhere seen by itself
    indices = _candidates(rough, shape, profile.end)
    away = np.hypot(*(indices @ (rough.vectors / rough.pitch).T).T)
    values, below = np.zeros((len(indices), VALUES)), rough.background if ground is None else ground
    values[:, :2] = rough.origin + indices @ rough.vectors.T
    values[:, LIGHT], values[:, GROUND] = rough.light + rough.background - below, below
    found, looked = np.zeros(len(indices), dtype=np.bool_), np.zeros(len(indices), dtype=np.bool_)
    rings = math.ceil(math.log(max(float(away.max()) / FIRST, 1.0)) / math.log(GROWTH)) + 1
    for reach in FIRST * GROWTH ** np.arange(rings):
        values[~found] = _likely(pixels, rough, indices, values, found)[~found]
        fresh = np.flatnonzero(_shown(values[:, :2], shape, 0.0) & (away <= reach) & ~looked)
        if len(fresh) == 0:
            continue
        mean, apart = expected(values, profile, rough.pitch, ground)
        apart[:, LIGHT] *= 4
        model = Model(profile, neighbours_within(values[:, :2], 2 * profile.end), mean, apart, BLOB)
        fitted = fit(pixels, values, fresh, model, STEPS if looked.any() else ALIGN)
        doubt = spread(pixels, fitted, fresh, model)
        near = np.hypot(*(fitted - values)[fresh, :2].T) < MOVED * rough.pitch
        found[fresh] = near & looks_right(fitted[fresh], doubt, profile, rough.pitch)
        members = np.flatnonzero(found & _shown(fitted[:, :2], shape, -profile.end))
        if not looked.any() and len(members) >= ENOUGH:
            profile, fitted = measured_profile(pixels, fitted, members, profile, ground is None)
        values, looked[fresh] = fitted, True
    if np.count_nonzero(found) < FEWEST:
        raise MeasurementError(
            "white picture: is it one, of an evenly lit target, well exposed? It shows"
            f" {np.count_nonzero(found)} whole micro-images, {FEWEST} are needed; else show more of"
            " the array"
        )
    values[~found] = _likely(pixels, rough, indices, values, found)[~found]
    return Indexed(indices, values, found, profile, ground)


def _likely(
    pixels: Pixels, rough: RoughLattice, indices: Whole, values: Array, found: Flags
) -> Array:
    """Values where the lattice through those found puts all, as bright as the picture is there."""
    likely, count = values.copy(), np.count_nonzero(found)
    if count < FEWEST:
        return likely
    degree, scale = 1 if count < BENT else 2, float(np.abs(indices).max()) + 1.0
    smooth = smooth_map(indices[found], values[found, :2], degree, scale)
    likely[:, :2] = terms(indices.astype(np.float64), degree, scale) @ smooth
    usual = np.median(values[found], axis=0)
    likely[:, LIGHT:] = usual[LIGHT:]
    # some pixels round each centre, for those beside the picture at its border
    steps = np.array(list(itertools.product((-0.5, 0.0, 0.5), repeat=2))) * rough.radius
    at = np.rint(likely[:, None, :2] + steps).astype(np.int64)
    x, y = np.clip(at, 0, np.array(pixels.picture.shape[::-1]) - 1).transpose(2, 0, 1)
    local = pixels.picture[y, x].mean(axis=1) - usual[GROUND]
    level = local / max(float(np.median(local[found])), 1e-9)
    likely[:, LIGHT] *= np.clip(level, LEAST_LIGHT, BRIGHTEST)
    return likely


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
        & (doubt.pixels > doubt.left_out)
        & (np.abs(values[:, WIDER]) < 0.3 * profile.radius)
    )


def unlike_most(values: Array, doubt: Spread, profile: Profile, whole: Flags) -> Flags:
    """Which differ from most whole ones, as those do that a border within the picture cuts.

    Args:
        values: of some micro-images, shape (n, VALUES).
        doubt: how sure they are.
        profile: that all share.
        whole: those to compare with.
    """
    odd = np.zeros(len(values), dtype=np.bool_)
    aside = np.abs(values[:, WIDER] - np.median(values[whole, WIDER]))
    worse = np.abs(doubt.misfit - np.median(doubt.misfit[whole]))
    for apart, floor in ((aside, UNLIKE_WIDTH * profile.radius), (worse, UNLIKE_MISFIT)):
        # a third of all may be of another kind
        odd |= apart > max(UNLIKE * float(np.quantile(apart[whole], 0.75)), floor)
    return odd
