"""A white picture of a camera whose file is known: what is measured without it, read as the two
discs that the camera's shape makes; and the lattice of chief rays behind them.
"""

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
from flflab.measurement.lattice.fitted import LEAST_MISFIT, Fitted, fitted_near
from flflab.measurement.lattice.kernel import LIGHT, SLOPE_X, SOFTER, WIDER, X, Y
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.nominal import (
    kind_of_each,
    nominal_lattice,
    nominal_vectors_px,
    require_described,
    require_described_pitch,
)
from flflab.measurement.lattice.plausible import require_white
from flflab.measurement.lattice.profile import SMALLEST_PX, cone_of
from flflab.measurement.lattice.slopes import SLOPE_OF_BLOB
from flflab.measurement.lattice.tilted import Images
from flflab.measurement.lattice.two_discs import Shape, TwoDiscs, discs_in, seen_beside, two_discs
from flflab.measurement.lattice.white_picture import (
    WhitePicture,
    require_contrast,
    with_grid,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

SLOPE_LEFT = 0.006  # of the light over a radius: what fall-off leaves unsure of a blob's slope


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
    fitted = fitted_near(numbers, noise, rough)
    white = with_grid(rough, fitted, numbers.shape)
    require_white(white, float(np.mean(numbers >= noise.saturated_dn)))
    kind = kind_of_each(camera, white.values[:, :2])
    cone, dark = cone_of(camera), _dark(white, noise)
    seen = discs_in(white.profile, cone, dark, _nominal_discs(camera))
    shape = Shape(cone, seen.share, dark, white.profile.pixel)
    discs = two_discs(seen.radii, shape)
    if fitted.slopes.doubt >= SLOPE_OF_BLOB:  # a blob's slope is hardly told from a shift
        likely = seen.share * expected_slopes(white.values[:, :2], discs, cone.tilting)
        white = with_grid(rough, _sloped(fitted, likely), numbers.shape)
    radii, spreads = _radii(white, discs, shape, kind)
    slopes = replace(white.slopes, mean=white.slopes.mean[white.whole])
    falling = fall_off(white.values[white.whole, :2], slopes, discs, cone.tilting, seen.share)
    whole = _whole(white, radii, spreads, falling)
    lattice = lattice_of(camera, white, whole, kind, falling, seen.covariance)
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


def _dark(white: WhitePicture, noise: SensorNoise) -> float:
    """Variance of pixels without light over what light adds to that of the brightest."""
    light = float(np.median(white.values[white.whole, LIGHT]))
    without = noise.dark_variance + (max(white.misfit, LEAST_MISFIT) * light) ** 2
    return without / max(noise.dn_per_electron * light, 1e-6 * without)


def _sloped(fitted: Fitted, mean: Array) -> Fitted:
    """Micro-images where they are found if their light slopes so, shape (n, 2)."""
    values = fitted.values.copy()
    values[:, [X, Y]] += fitted.spread.by_slope * (mean - values[:, SLOPE_X:])
    values[:, SLOPE_X:] = mean
    slopes = replace(fitted.slopes, mean=mean, doubt=SLOPE_LEFT)
    return replace(fitted, values=values, slopes=slopes)


def _nominal_discs(camera: Camera) -> Array:
    """Radii of larger and smaller disc by the camera's description, px, shape (2,)."""
    due = nominal_lattice(camera, 1.0)
    inside, outside = due.inside_radius_px, due.outside_radius_px
    return np.array([outside + inside, outside - inside]) / 2


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
