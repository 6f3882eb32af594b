"""The lattice of micro-images from a white picture: pitch, angle, origin and the circles of bright
and total field.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.lattice.fit import Region, finish, micro_images_present, refine
from flflab.measurement.lattice.kernels import COUNT
from flflab.measurement.lattice.kinds import Kinds
from flflab.measurement.lattice.model import GEOMETRY, LIGHT, RATE, SHARE, SLANT, TILT, LatticeModel
from flflab.measurement.lattice.profile import Cone
from flflab.measurement.lattice.search import RoughLattice, search_lattice
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Layout

Array = npt.NDArray[np.float64]

ROUGHLY, WITHOUT_SLANT, FULLY = (
    np.arange(10),
    np.arange(15),
    np.arange(COUNT),
)  # which of the model's values are free
# of what varies in a picture: square micro-images taken for hexagonal ones leave nearly half
MOST_LEFT = 0.2
TILTED = np.concatenate([ROUGHLY, FULLY[TILT]])  # before what might pass for fall-off is


@dataclass(frozen=True)
class Lattice:
    """Where the micro-images lie; pixels, (x, y), the top-left pixel's centre is (0, 0).

    Attributes:
        layout: square or hexagonal.
        pitch_px: distance between nearest neighbours.
        angle: from the columns' axis towards +y, modulo 90 degrees (hexagonal 60), nearest zero;
            rad.
        origin_px: the centre nearest the sensor's, shape (2,).
        vectors_px: lattice vectors a, b as columns, of a tilted array on the axis, shape (2, 2).
        indices: (i, j) of every micro-image of which any part is seen: centre = origin + i a + j b
            but for a tilt; shape (N, 2).
        centres_px: their centres, shape (N, 2).
        inside_radius_px: radius of the bright field, of a tilted array on the axis.
        outside_radius_px: radius of the total field, the same.
        pitch_uncertainty_px: standard uncertainties of the above follow.
        angle_uncertainty: rad.
        origin_uncertainty_px: shape (2,).
        inside_uncertainty_px: of the inside radius.
        outside_uncertainty_px: of the outside radius.
        covariance_px: of (origin x, y, a x, y, b x, y), shape (6, 6).
        sizes_covariance_px: of (inside radius, outside radius, pitch), shape (3, 3).
        chi2_per_pixel: about 1 where the model holds; the uncertainties are already scaled up by
            its root where above 1.
        background_dn: what the picture reads where no light falls.
        light: polynomial of the light over the picture (1, x, y, x^2, x y, y^2), DN; x and y in
            half the longer side.
        cone: how rays land, as was taken; None where fall-off and tilt were left out.
        slants: share of the fall-off within a micro-image, slope (x, y) of the middle ray at the
            origin and how it grows per px.
        tilt: slope of the array's plane along (x, y).
        tilt_uncertainty: of both.
        kinds: of microlenses, as wide as seen, the radii being the central one's; None where there
            is one, or they were taken for one.
        light_uncertainty_dn: of the light in the middle of the picture.
    """

    layout: Layout
    pitch_px: float
    angle: float
    origin_px: Array
    vectors_px: Array
    indices: npt.NDArray[np.int64]
    centres_px: Array
    inside_radius_px: float
    outside_radius_px: float
    pitch_uncertainty_px: float
    angle_uncertainty: float
    origin_uncertainty_px: Array
    inside_uncertainty_px: float
    outside_uncertainty_px: float
    covariance_px: Array
    sizes_covariance_px: Array
    chi2_per_pixel: float
    background_dn: float
    light: Array
    cone: Cone | None = None
    slants: Array = field(default_factory=lambda: np.zeros(4))
    tilt: Array = field(default_factory=lambda: np.zeros(2))
    tilt_uncertainty: Array = field(default_factory=lambda: np.zeros(2))
    light_uncertainty_dn: float = 0.0
    kinds: Kinds | None = None

    @property
    def rises(self) -> Array:
        """How much further each microlens lies from the main lens than the axis's, as a share of
        that distance; 0 without a tilt.
        """
        if self.cone is None:
            return np.zeros(len(self.centres_px))
        tilting = self.cone.tilting
        return tilting.rises(tilting.straightened(self.centres_px, self.tilt), self.tilt)

    @property
    def discs_px(self) -> Array:
        """Radii of larger and smaller disc of every micro-image, shape (N, 2): sum and difference
        are outside and inside.
        """
        radii = (
            np.array(
                [
                    self.outside_radius_px + self.inside_radius_px,
                    self.outside_radius_px - self.inside_radius_px,
                ]
            )
            / 2
        )
        if self.cone is None:
            return np.tile(radii, (len(self.centres_px), 1))
        if self.kinds is None:
            return self.cone.tilting.discs(radii, self.rises)
        return self.kinds.discs(
            radii, self.kinds.of(self.centres_px), self.cone.tilting, self.rises
        )


def find_lattice(
    white_picture: npt.NDArray[np.generic],
    layout: Layout,
    rough_pitch_px: float,
    noise: SensorNoise,
    cone: Cone | None = None,
    kinds: Kinds | None = None,
) -> Lattice:
    """Measure the lattice of micro-images in a picture of a white target.

    A first lattice from the spectrum is refined by Gauss-Newton, from the middle outwards, in the
    end on every unsaturated pixel, with one profile for all micro-images: two overlapping discs
    averaged over the pixel. Overlapping neighbours add. Where the camera is known, so is what a
    tilt of the array does to lattice and profile, and the tilt is fitted.

    Args:
        white_picture: DN, [row, col].
        layout: of the microlens array.
        rough_pitch_px: expected distance between nearest micro-images, right within 12 %.
        noise: of the sensor; weights the pixels and makes the uncertainties.
        cone: how rays land, from the camera's description; how much of that fall-off there is,
            round which axis, and how the array is tilted, is fitted. None: light does not fall off
            within a micro-image, as paraxial pictures have it, and nothing is tilted.
        kinds: of microlenses, each with a profile of its own; None: one profile for all. Without a
            cone they are taken for one.

    Raises:
        MeasurementError: not a picture of at least 2 x 2 micro-images, not finite, dark or
            saturated, or no such lattice in it.
    """
    picture = np.ascontiguousarray(white_picture, dtype=np.float32)
    read: npt.NDArray[Any] = (
        white_picture if white_picture.dtype.kind == "u" else picture
    )  # half the bytes, and all finite
    if picture.ndim != 2 or (read is picture and not np.isfinite(picture).all()):
        raise MeasurementError(
            "white picture: a two-dimensional picture of finite numbers is due, not shape"
            f" {picture.shape}"
        )
    if not (math.isfinite(rough_pitch_px) and rough_pitch_px >= 4):
        raise MeasurementError(
            f"white picture: the rough pitch must be at least 4 px, not {rough_pitch_px:g}"
        )
    if np.count_nonzero(read >= noise.full_scale_dn) > 0.8 * picture.size:
        raise MeasurementError(
            "white picture: more than four fifths of its pixels are saturated; expose it shorter"
        )
    if float(read.max()) <= noise.offset_dn + 5 * math.sqrt(noise.dark_variance):
        raise MeasurementError(
            "white picture: no pixel lies above the dark level by five times its noise; expose it"
            " longer"
        )
    rough = search_lattice(picture, layout, rough_pitch_px, noise.offset_dn)
    model, present = _fit(picture, rough, noise, cone, kinds)
    some = picture[:: max(1, picture.shape[0] // 500), :: max(1, picture.shape[1] // 500)]
    some = some[some < noise.full_scale_dn]
    left = (
        model.chi2_per_pixel * float(noise.variance(some.mean())) / max(float(some.var()), 1e-300)
    )
    if left > MOST_LEFT:
        raise MeasurementError(
            f"white picture: a {layout} lattice of about {rough_pitch_px:g} px leaves"
            f" {min(100 * left, 100):.0f} % of what varies in it unexplained, {100 * MOST_LEFT:.0f}"
            " % is allowed; check layout, pitch, exposure and that the target was white"
        )
    return lattice_of(model, layout, present, (picture.shape[0], picture.shape[1]))


def half_counts(vectors: Array, shape: tuple[int, ...], reach: float) -> tuple[int, int]:
    """How far lattice indices go on either side of the middle until no part of a micro-image is on
    the sensor.
    """
    corners = np.array(
        [
            [sx * (shape[1] / 2 + reach), sy * (shape[0] / 2 + reach)]
            for sx in (-1, 1)
            for sy in (-1, 1)
        ]
    )
    most = np.abs(np.linalg.inv(vectors) @ corners.T).max(axis=1)
    return int(most[0]) + 2, int(most[1]) + 2


def _fit(
    picture: npt.NDArray[np.float32],
    rough: RoughLattice,
    noise: SensorNoise,
    cone: Cone | None,
    kinds: Kinds | None,
) -> tuple[LatticeModel, npt.NDArray[np.bool_]]:
    """From the middle of the picture outwards, so that no step is larger than the profile's own
    width.
    """
    pitch = float(np.linalg.norm(rough.vectors[:, 0]))
    light, slants, tilt = [rough.light, 0.0, 0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0], [0.0, 0.0]
    values = np.concatenate(
        [
            rough.origin,
            rough.vectors.T.ravel(),
            rough.radii,
            [noise.offset_dn],
            light,
            slants,
            tilt,
            [1.0],
        ]
    )
    model = LatticeModel(values, np.zeros((COUNT, COUNT)), math.inf, None)
    counts = half_counts(rough.vectors, picture.shape, sum(rough.radii) + 2)
    present = np.ones((2 * counts[0] + 1, 2 * counts[1] + 1), dtype=np.bool_)
    half_size, whole = 1.5 * pitch, max(picture.shape) / 2 + 1
    for part in (half_size, *(half_size * 3**n for n in range(1, 20) if half_size * 3**n < whole)):
        model = refine(
            picture, model, present, noise, _sparse(min(part, whole), pitch, 80), ROUGHLY, 12, 0.02
        )
        _require_settled(model, pitch)
    present = micro_images_present(picture, model, counts, noise)
    free = WITHOUT_SLANT
    if cone is not None:
        model, free = (
            refine(
                picture,
                replace(model, cone=cone, kinds=kinds),
                present,
                noise,
                _sparse(whole, pitch, 80),
                TILTED,
                8,
                0.02,
            ),
            FULLY,
        )
    model = refine(picture, model, present, noise, _sparse(whole, pitch, 150), free, 8, 5e-3)
    _require_settled(model, pitch)
    present = micro_images_present(picture, model, counts, noise)
    model = finish(picture, model, present, noise, _sparse(whole, pitch, 250), free)
    _require_settled(model, pitch)
    return model, present


def _sparse(half_size: float, pitch: float, most: int) -> Region:
    """About (2 ``most``)^2 pixels of the middle, in steps that share no factor with the pitch for
    long.
    """
    wanted = min(half_size / most, max(2.0, pitch / 12))
    step = min((1, 2, 3, 5, 7, 11, 13, 17, 19), key=lambda prime: abs(math.log(prime / wanted)))
    return Region(half_size, step, step)


def _require_settled(model: LatticeModel, pitch: float) -> None:
    drift = (
        abs(math.sqrt(abs(float(np.linalg.det(model.vectors)))) / pitch - 1)
        if np.isfinite(model.values).all()
        else math.inf
    )
    if drift > 0.2 or model.values[9] <= 0 or sum(model.radii) > 3 * pitch:
        raise MeasurementError(
            "white picture: the fit of the lattice did not settle; check layout, pitch and that the"
            " target was white"
        )


def _similarity(layout: Layout, vectors: Array) -> tuple[Array, Array]:
    """Vectors of the square lattice behind (a, b), and the matrix that makes them: identity, or
    hexagonal made square.
    """
    mix = (
        np.eye(2)
        if layout == "square"
        else np.array([[1.0, -1 / math.sqrt(3)], [0.0, 2 / math.sqrt(3)]])
    )
    return vectors @ mix, mix


def pitch_and_angle(layout: Layout, vectors: Array) -> tuple[float, float]:
    """Pitch (from the area of a cell) and angle (of the nearest similarity) of lattice vectors a, b
    given as columns.
    """
    square, _ = _similarity(layout, vectors)
    turn = math.pi / 2 if layout == "square" else math.pi / 3
    angle = math.atan2(square[1, 0] - square[0, 1], square[0, 0] + square[1, 1])
    return math.sqrt(abs(float(np.linalg.det(square)))), (angle + turn / 2) % turn - turn / 2


def lattice_of(
    model: LatticeModel, layout: Layout, present: npt.NDArray[np.bool_], shape: tuple[int, int]
) -> Lattice:
    """What a fitted model says of the micro-images of which any part is seen."""
    vectors = model.vectors
    scaled = model.covariance * max(1.0, model.chi2_per_pixel)
    covariance = scaled[GEOMETRY, GEOMETRY]
    large, small = model.radii
    half_i, half_j = present.shape[0] // 2, present.shape[1] // 2
    i, j = np.nonzero(present)
    indices = np.stack([i - half_i, j - half_j], axis=1).astype(np.int64)
    centres = model.centres((half_i, half_j))[present]
    # nearest point of the sensor's rectangle to each centre: any part is seen when it lies within
    # the outside circle
    height, width = shape
    outwards = centres - np.clip(centres, -0.5, [width - 0.5, height - 0.5])
    seen = np.hypot(*outwards.T) < large + small
    indices, centres = indices[seen], centres[seen]
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    nearest = int(np.argmin(np.hypot(*(centres - middle).T)))
    shift = np.eye(6)
    shift[:2, 2:4] = np.eye(2) * indices[nearest, 0]
    shift[:2, 4:6] = np.eye(2) * indices[nearest, 1]
    placed = shift @ covariance[:6, :6] @ shift.T
    pitch, angle = pitch_and_angle(layout, vectors)
    by_vectors = np.zeros((2, 4))
    for n, (row, column) in enumerate([(0, 0), (1, 0), (0, 1), (1, 1)]):
        nudged = vectors.copy()
        nudged[row, column] += 1e-4 * pitch
        there = pitch_and_angle(layout, nudged)
        by_vectors[:, n] = (there[0] - pitch) / (1e-4 * pitch), (there[1] - angle) / (1e-4 * pitch)
    spread = np.sqrt(np.diag(by_vectors @ placed[2:, 2:] @ by_vectors.T))
    sizes = np.zeros((3, 8))
    sizes[0, 6:], sizes[1, 6:], sizes[2, 2:6] = (
        [math.copysign(1, large - small), math.copysign(1, small - large)],
        1.0,
        by_vectors[0],
    )
    of_sizes = sizes @ covariance @ sizes.T
    spread_of_sizes = np.sqrt(np.maximum(np.diag(of_sizes), 0.0))
    share, slant, rate = model.values[SHARE], model.values[SLANT], model.values[RATE]
    return Lattice(
        layout=layout,
        pitch_px=pitch,
        angle=angle,
        origin_px=centres[nearest],
        vectors_px=vectors,
        indices=indices - indices[nearest],
        centres_px=centres,
        inside_radius_px=abs(large - small),
        outside_radius_px=large + small,
        pitch_uncertainty_px=float(spread_of_sizes[2]),
        angle_uncertainty=float(spread[1]),
        origin_uncertainty_px=np.sqrt(np.diag(placed)[:2]),
        inside_uncertainty_px=float(spread_of_sizes[0]),
        outside_uncertainty_px=float(spread_of_sizes[1]),
        covariance_px=placed,
        sizes_covariance_px=of_sizes,
        chi2_per_pixel=model.chi2_per_pixel,
        background_dn=float(model.values[8]),
        light=model.values[LIGHT],
        cone=model.cone,
        slants=np.concatenate(
            [[share], slant + rate * (centres[nearest] - model.values[:2]), [rate]]
        ),
        tilt=model.values[TILT],
        tilt_uncertainty=np.sqrt(np.diag(scaled)[TILT]),
        light_uncertainty_dn=math.sqrt(scaled[LIGHT.start, LIGHT.start]),
        kinds=model.seen_kinds,
    )
