"""A white picture of a camera whose file is known: what is measured without it, read as the two
discs that the camera's shape makes; and the lattice of chief rays behind them.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import pdist

from flflab.errors import MeasurementError
from flflab.measurement.lattice.chief_lattice import DiscLight, lattice_of
from flflab.measurement.lattice.disc_light import cone_of
from flflab.measurement.lattice.few import lattice_of_spots, spots_in
from flflab.measurement.lattice.find import RoughLattice, find_lattice, lattice_near
from flflab.measurement.lattice.fitted import LEAST_MISFIT
from flflab.measurement.lattice.kernel import LIGHT, SOFTER, WIDER, X, Y
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.nominal import (
    nominal_vectors_px,
    require_described,
    require_described_pitch,
)
from flflab.measurement.lattice.plausible import require_white
from flflab.measurement.lattice.registration import kind_of_each
from flflab.measurement.lattice.straight import Images
from flflab.measurement.lattice.two_discs import Shape, discs_beside, discs_in, reading
from flflab.measurement.lattice.white_picture import WhitePicture, measure_white
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.per_type import type_smms
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class CameraWhite:
    """A white picture measured with its camera's file.

    Attributes:
        white: every micro-image, and the lattice of their light.
        lattice: that of chief rays.
        radii_px: larger and smaller disc of each of ``white``'s micro-images, shape (n, 2).
        radii_covariance_px: of these, shape (n, 2, 2).
        kind: of each micro-image's microlens, by the camera's description, shape (n,).
    """

    white: WhitePicture
    lattice: Lattice
    radii_px: Array
    radii_covariance_px: Array
    kind: Whole


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
    require_described(rough, camera)
    white = measure_white(numbers, noise, rough)
    require_white(white, float(np.mean(numbers >= noise.saturated_dn)))
    kind = kind_of_each(camera, white.values[:, :2])
    focal, pixel = np.asarray(camera.array.focal_lengths), camera.sensor.pixel
    # the central kind first, where it is seen
    central, every = central_smms(camera), type_smms(camera)
    seen = sorted(set(kind[white.usual]), key=lambda k: abs(focal[k] - float(central.focal)))
    shape = Shape(cone_of(camera), 0.0, _dark(white, noise), white.profile.pixel, white.sloping)
    due = np.array([central.lens_width, central.microlens_width], dtype=np.float64) / 2 / pixel
    common, by_profile, share = discs_in(white.profile, shape, np.sort(due)[::-1])
    shape = replace(shape, share=share)
    beside, both = white.values[:, [WIDER, SOFTER]], slice(WIDER, SOFTER + 1)
    usual = np.array([np.median(beside[white.usual & (kind == k)], axis=0) for k in seen])
    discs = discs_beside(white.profile, common, usual, shape)
    place, radii, shift = np.zeros_like(kind), np.tile(common, (len(kind), 1)), np.zeros(len(kind))
    covariance = white.spread.covariance[:, both, both].copy()
    for n, k in enumerate(seen):
        mine = kind == k
        by_values, shift[mine] = reading(discs[n], shape)
        place[mine], radii[mine] = n, discs[n] + (beside[mine] - usual[n]) @ by_values.T
        covariance[mine] = by_values @ covariance[mine] @ by_values.T
    both_covariances = np.zeros((len(kind), 4, 4))
    both_covariances[:, :2, :2] = white.spread.covariance[:, :2, :2]
    both_covariances[:, 2:, 2:] = covariance
    each = Images(white.indices, white.values[:, [X, Y]], radii, both_covariances, place)
    light = DiscLight(share, shift, by_profile)
    lattice = lattice_of(camera, white, [every[k] for k in seen], light, each)
    return CameraWhite(white, lattice, radii, covariance, kind)


def _rough(camera: Camera, picture: npt.NDArray[Any]) -> RoughLattice:
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
