"""A white picture of a camera whose file is known: every micro-image by itself, as without it, but
fitted with the two discs that the camera's shape makes; and the lattice of chief rays behind them.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial.distance import pdist

from flflab.errors import MeasurementError
from flflab.measurement.lattice.chief_lattice import lattice_of
from flflab.measurement.lattice.chief_rays import FallOff, expected_slopes, fall_off
from flflab.measurement.lattice.few import lattice_of_spots, spots_in
from flflab.measurement.lattice.find import RoughLattice, find_lattice, lattice_near
from flflab.measurement.lattice.index import FEWEST, Indexed, index_lattice
from flflab.measurement.lattice.kernel import GROUND, LIGHT, OUTLIER, SLOPE_X, SOFTER, WIDER
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.micro_images import (
    DISC,
    Model,
    expected,
    fit,
    neighbours_within,
    sums,
    with_ground,
)
from flflab.measurement.lattice.nominal import (
    kind_of_each,
    nominal_lattice,
    nominal_vectors_px,
    require_described,
    require_described_pitch,
)
from flflab.measurement.lattice.pixels import Pixels, finer
from flflab.measurement.lattice.plausible import require_white
from flflab.measurement.lattice.profile import SMALLEST_PX, cone_of
from flflab.measurement.lattice.slopes import (
    SLOPE_OF_BLOB,
    Slopes,
    course_of_slopes,
    unknown_slopes,
)
from flflab.measurement.lattice.spread import spread
from flflab.measurement.lattice.tilted import Images
from flflab.measurement.lattice.two_discs import Shape, TwoDiscs, discs_in, seen_beside, two_discs
from flflab.measurement.lattice.white_picture import (
    LEAST_MISFIT,
    START_MISFIT,
    Fitted,
    WhitePicture,
    begun,
    inside,
    require_contrast,
    require_enough,
    with_grid,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

SPARSE, CLOSE = 12, 35  # pixels along a radius that are looked at to begin with, and in the end
ENOUGH = 2_500_000  # pixels: a smaller picture is looked at whole
STEPS = 4, 3, 2, 2  # of the fit in each turn
SHARES = 0.0, 0.5, 1.0  # of natural fall-off, that are tried
SEEN = 60  # micro-images that show it
LOOSE_SHARE = 0.5  # standard deviation of what is expected of it
LAST = 2  # of the one that looks closely
FAR = 0.75  # of the pitch: wider micro-images overlap so far that edges are hardly told apart
GAPLESS = 0.95  # of the way to the farthest point between micro-images


@dataclass(frozen=True)
class CameraWhite:
    """A white picture measured with its camera's file.

    Attributes:
        white: every micro-image, and the lattice of their light.
        lattice: that of chief rays.
        radii_px: larger and smaller disc of each of ``white``'s micro-images, shape (n, 2).
        radii_covariance_px: of these, shape (n, 2, 2).
        kind: of each micro-image's microlens, by the camera's description, shape (n,).
        fall_off: within micro-images.
    """

    white: WhitePicture
    lattice: Lattice
    radii_px: Array
    radii_covariance_px: Array
    kind: Whole
    fall_off: FallOff


def lattice_behind(camera: Camera, white: npt.NDArray[Any], noise: SensorNoise) -> Lattice:
    """The lattice in a white picture of a camera; arguments and errors of ``white_behind``."""
    return white_behind(camera, white, noise).lattice


def white_behind(camera: Camera, picture: npt.NDArray[Any], noise: SensorNoise) -> CameraWhite:
    """Measure a white picture of a camera.

    Of its description are taken layout and rough pitch, the shape of micro-images, the way in which
    fall-off and a tilt change them, and which kind of microlens stands where; all sizes are
    measured.

    Args:
        camera: as described.
        picture: DN, [row, col].
        noise: of the sensor.

    Raises:
        MeasurementError: there is no such lattice in the picture.
    """
    numbers = np.ascontiguousarray(picture, dtype=np.float32)
    rough = _rough(camera, numbers)
    require_contrast(rough, noise)
    require_described(rough, camera)
    pixels = Pixels(numbers, noise, START_MISFIT, max(1, int(rough.radius / SPARSE)))
    fitted, discs, shape = _fitted(pixels, rough, index_lattice(pixels, rough), camera)
    border = _border(fitted.values, fitted.found, numbers.shape, discs, rough.pitch)
    cut = discs.profile.end - border
    white = with_grid(rough, fitted, numbers.shape, cut)
    require_white(white, float(np.mean(numbers >= noise.saturated_dn)))
    kind = kind_of_each(camera, white.values[:, :2])
    radii, spreads = _radii(white, discs, shape, kind)
    centres = white.values[white.whole, :2]
    slopes = _those(white.slopes, white.whole)
    falling = fall_off(centres, slopes, discs, cone_of(camera).tilting, shape.share)
    whole = _whole(white, radii, spreads, falling)
    by_share = discs.by_share * shape.share_spread
    lattice = lattice_of(camera, white, whole, kind, falling, by_share)
    return CameraWhite(white, lattice, radii, spreads, kind, falling)


def _rough(camera: Camera, picture: npt.NDArray[np.float32]) -> RoughLattice:
    """The lattice found blind, or where too little of it is seen for that by single spots, or else
    as described.
    """
    try:
        return find_lattice(picture)
    except MeasurementError:
        spots = spots_in(picture)
        if (found := lattice_of_spots(picture, spots)) is not None:
            return found
        if len(spots) > 1:
            require_described_pitch(float(pdist(spots).min()), camera)
        vectors = nominal_vectors_px(camera)
        if min(picture.shape) < 2 * float(np.hypot(*vectors).max()):
            raise
        return lattice_near(picture, camera.array.layout, vectors)


def _fitted(
    pixels: Pixels, rough: RoughLattice, indexed: Indexed, camera: Camera
) -> tuple[Fitted, TwoDiscs, Shape]:
    """Micro-images fitted with discs, these discs, and what else makes their light."""
    tilting, picture = cone_of(camera).tilting, pixels.picture.shape
    discs, shape = _begun(pixels, rough, indexed, camera)
    indices, values, found, lit = begun(indexed, picture, discs.profile.end)
    values[:, WIDER:] = 0.0
    slopes, every = unknown_slopes(len(values)), np.arange(len(values))
    closest = min(discs.profile.radius / CLOSE, math.sqrt(pixels.picture.size / ENOUGH))
    closest = max(1, round(closest))
    for turn, steps in enumerate(STEPS):
        model = _model(pixels, values, discs, rough, slopes)
        values[:, GROUND] = model.prior.mean[:, GROUND]
        values = fit(pixels, values, lit, model, 2 * steps if model.joint else steps)
        inner = found & inside(values, picture, _border(values, found, picture, discs, rough.pitch))
        require_enough(inner)
        doubt = spread(pixels, values, every, model)
        misfit = float(np.median(doubt.misfit[inner]))
        discs, values = _next(discs, values, inner, shape)
        if turn > 0:
            pixels = finer(pixels, pixels.misfit, max(closest, pixels.every // 2))
            # where micro-images overlap far it is hardly told from that
            if turn == len(STEPS) - 2 and discs.profile.end < FAR * rough.pitch:
                shape = _share_seen(pixels, values, inner, lit, discs, shape, model)
        pixels = finer(pixels, max(misfit, LEAST_MISFIT), pixels.every)
        shape = replace(shape, dark=_dark(pixels, float(np.median(values[inner, LIGHT]))))
        discs = two_discs(discs.radii, shape)
    doubt = spread(pixels, values, every, _model(pixels, values, discs, rough, slopes))
    inner = found & inside(values, picture, _border(values, found, picture, discs, rough.pitch))
    slopes = course_of_slopes(indices, values, doubt, inner, slopes, discs.profile.radius)
    if slopes.doubt >= SLOPE_OF_BLOB:
        likely = expected_slopes(values[:, :2], discs, tilting)
        slopes = replace(slopes, mean=shape.share * likely)
    values[:, SLOPE_X:] = slopes.mean
    pixels = finer(pixels, pixels.misfit, closest)
    model = _model(pixels, values, discs, rough, slopes)
    values = fit(pixels, values, lit, model, 2 * LAST if model.joint else LAST)
    doubt = spread(pixels, values, every, model)
    inner = found & inside(values, picture, _border(values, found, picture, discs, rough.pitch))
    misfit = float(np.median(doubt.misfit[inner]))
    fitted = Fitted(indices, values, found, discs.profile, doubt, slopes, model.joint, misfit)
    return fitted, discs, shape


def _begun(
    pixels: Pixels, rough: RoughLattice, indexed: Indexed, camera: Camera
) -> tuple[TwoDiscs, Shape]:
    """Discs and share of fall-off by the mean of all micro-images, roughly."""
    tried = list[tuple[float, Array, Shape]]()
    for share in SHARES:
        shape = Shape(cone_of(camera), share, LOOSE_SHARE, _dark(pixels, rough.light))
        radii, left = discs_in(indexed.profile, shape, _nominal_discs(camera))
        tried.append((left, radii, shape))
    _, radii, shape = min(tried, key=lambda one: one[0])
    return two_discs(radii, shape), shape


def _share_seen(
    pixels: Pixels,
    values: Array,
    inner: Flags,
    lit: Whole,
    discs: TwoDiscs,
    shape: Shape,
    model: Model,
) -> Shape:
    """With the share of fall-off that leaves least of the light, by a parabola through three."""
    looked, left = np.flatnonzero(inner), list[float]()
    # drawn, for a regular choice may see one kind only; neighbours that touch all take part
    some = np.sort(np.random.default_rng(0).permutation(looked)[:SEEN])
    together = bool((model.neighbours >= 0).any())
    members = lit if together else some
    counted = np.isin(members, looked)
    for share in SHARES:
        one = replace(model, profile=two_discs(discs.radii, replace(shape, share=share)).profile)
        fitted = fit(pixels, values, members, one, 8 if model.joint else 3)
        found = sums(pixels, fitted, members, one).fit[counted]
        left.append(float(np.sum(found[:, 0] + OUTLIER * found[:, 2])))
    low, middle, high = left
    bend = low - 2 * middle + high
    if bend <= 0:
        return shape
    # half of it is expected, loosely
    known, loose = 2 * bend, 1 / LOOSE_SHARE**2
    best = 0.5 + 0.25 * (low - high) / bend
    share = float(np.clip((best * known + 0.5 * loose) / (known + loose), 0, 1))
    return replace(shape, share=share, share_spread=(known + loose) ** -0.5)


def _dark(pixels: Pixels, light: float) -> float:
    """Variance of pixels without light over what light adds to that of the brightest."""
    noise = pixels.noise
    without = noise.dark_variance + (pixels.misfit * light) ** 2
    return without / max(noise.dn_per_electron * light, 1e-6 * without)


def _nominal_discs(camera: Camera) -> Array:
    """Radii of larger and smaller disc by the camera's description, px, shape (2,)."""
    due = nominal_lattice(camera, 1.0)
    inside, outside = due.inside_radius_px, due.outside_radius_px
    return np.array([outside + inside, outside - inside]) / 2


def _border(
    values: Array, found: Flags, picture: tuple[int, ...], discs: TwoDiscs, pitch: float
) -> float:
    """How far from the border centres must lie to count, px: where few micro-images are whole,
    those whose centre is on the picture tell the lattice too, unless they overlap far.
    """
    end = discs.profile.end
    enough = np.count_nonzero(found & inside(values, picture, end)) >= FEWEST
    return end if enough or end > FAR * pitch else 0.0


def _those(slopes: Slopes, which: Flags) -> Slopes:
    return replace(slopes, mean=slopes.mean[which])


def _next(discs: TwoDiscs, values: Array, inner: Flags, shape: Shape) -> tuple[TwoDiscs, Array]:
    """Discs as wide and soft as micro-images are in the middle, and values beside them."""
    middle = np.median(values[inner][:, [WIDER, SOFTER]], axis=0)
    moved = discs.by_values @ middle
    longest = 0.5 * discs.radii
    radii = discs.radii + np.clip(moved, -longest, longest)
    rest = values.copy()
    rest[:, [WIDER, SOFTER]] -= middle
    return two_discs(np.sort(radii)[::-1], shape), rest


def _model(
    pixels: Pixels, values: Array, discs: TwoDiscs, rough: RoughLattice, slopes: Slopes
) -> Model:
    profile, outside = discs.profile, float(discs.radii.sum())
    prior = expected(values, profile, rough.pitch)
    prior.mean[:, SLOPE_X:] = slopes.mean
    prior.spread[:, SLOPE_X:] = slopes.apart
    farthest = rough.pitch / math.sqrt(2 if rough.layout == "square" else 3)
    if outside > GAPLESS * farthest:
        prior = with_ground(prior, pixels.noise.offset_dn)
    neighbours = neighbours_within(values[:, :2], 2 * profile.end)
    return Model(profile, neighbours, prior, DISC, outside > rough.pitch / 2)


def _radii(white: WhitePicture, discs: TwoDiscs, shape: Shape, kind: Whole) -> tuple[Array, Array]:
    """Radii of each micro-image's discs, and their covariances: beside those of its kind."""
    beside = white.values[:, [WIDER, SOFTER]]
    kinds = np.unique(kind[white.whole])
    seen = np.array([np.median(beside[white.whole & (kind == one)], axis=0) for one in kinds])
    usual = np.median(beside[white.whole], axis=0)
    radii = discs.radii + discs.by_values @ usual + (beside - usual) @ discs.by_values.T
    if len(kinds) > 1:
        for one, middle, found in zip(kinds, seen, _of_kinds(discs, shape, seen), strict=True):
            mine = kind == one
            radii[mine] = found + (beside[mine] - middle) @ discs.by_values.T
    both = np.array([WIDER, SOFTER])
    covariance = white.spread.covariance[:, both[:, None], both]
    return radii, discs.by_values @ covariance @ discs.by_values.T


def _of_kinds(discs: TwoDiscs, shape: Shape, seen: Array) -> Array:
    """Radii of the discs of every kind of microlens from the width and softness that each is seen
    with: the main lens's shadow is the same for all.

    Args:
        discs: with which they were fitted.
        shape: what else the light depends on.
        seen: median ``WIDER`` and ``SOFTER`` of each kind, shape (n, 2).

    Returns:
        Shape (n, 2), larger first.
    """

    def left(free: Array) -> Array:
        each = [seen_beside(discs, np.array([free[0], small]), shape) for small in free[1:]]
        return ((np.array(each) - seen) * [1.0, discs.profile.radius]).ravel()

    begun = np.concatenate([[discs.radii[0]], discs.radii[1] * np.exp(seen[:, 1])])
    low = np.full(len(begun), SMALLEST_PX)
    found = least_squares(left, begun, bounds=(low, np.inf), diff_step=1e-3, max_nfev=15).x
    return np.stack([np.full(len(seen), found[0]), found[1:]], axis=1)


def _whole(white: WhitePicture, radii: Array, spreads: Array, falling: FallOff) -> Images:
    """Whole micro-images where their chief rays land."""
    some = white.whole.copy()
    some[np.flatnonzero(white.whole)[white.grid.off]] = False
    centres = white.values[some, :2]
    covariance = np.zeros((len(centres), 4, 4))
    covariance[:, :2, :2] = white.spread.covariance[some][:, :2, :2]
    covariance[:, 2:, 2:] = spreads[some]
    return Images(white.indices[some], centres - falling.moved(centres), radii[some], covariance)
