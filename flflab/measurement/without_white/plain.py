"""The lattice of micro-images from the parts of a picture in which the target is plain white, where
there is no white picture.

There the illumination of the micro-images can be read. Origin, vectors, discs, light and fall-off
are fitted to these pixels, from the camera's nominal lattice; what they leave open stays nominal.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial import KDTree

from flflab.errors import MeasurementError
from flflab.measurement.lattice.find import pitch_and_angle
from flflab.measurement.lattice.grid import by_vectors
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.profile import (
    FALLOFF,
    LOPSIDED,
    SMALLEST_PX,
    VALUE,
    Cone,
    profile_table,
)
from flflab.measurement.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

MOST = 60_000  # pixels that are looked at
FEWEST = 100
NEAREST = 4  # micro-images whose light a pixel may have
LOOSE_PX = 20.0  # standard deviations of the nominal lattice: origin
LOOSE_PITCH = 2e-3  # of the pitch
LOOSE_RADIUS_PX = 1.0
LOOSE_LIGHT = 0.05  # each of the terms by which the light may vary over the picture, relative
ORIGIN, VECTORS, RADII, LIGHT, SHARE = slice(0, 2), slice(2, 6), slice(6, 8), slice(8, 14), 14


@dataclass(frozen=True)
class _Pixels:
    """What is fitted: pixels, what they read above the offset, their deviation, and the positions
    in the lattice of the micro-images next to each.
    """

    places: Array
    read: Array
    spread: Array
    near: Whole
    terms: Array


def lattice_within(
    plain: npt.NDArray[np.float32],
    nominal: Lattice,
    light: float,
    noise: SensorNoise,
    cone: Cone,
) -> Lattice:
    """Measure the lattice on the pixels that are not saturated.

    Args:
        plain: DN, [row, col]; at full scale wherever the target is not plain white.
        nominal: the camera's lattice, right to a few pixels.
        light: of white, DN above the background, roughly.
        noise: of the sensor.
        cone: how rays land, from the camera's description.

    Raises:
        MeasurementError: hardly any pixel is left.
    """
    pixels = _pixels(plain, nominal, noise)
    start, loose = _expected(nominal, light)
    scale = loose / 10

    def residuals(values: Array) -> Array:
        rest = (_light(values, pixels, nominal, cone) - pixels.read) / pixels.spread
        return np.concatenate([rest, (values - start) / loose])

    low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
    low[RADII], low[SHARE], high[SHARE] = SMALLEST_PX, -0.5, 1.5
    found = least_squares(
        residuals,
        start,
        bounds=(low, high),
        x_scale=scale,
        loss="soft_l1",
        f_scale=4.0,
        max_nfev=30,
    )
    jacobian = found.jac * scale
    chi2 = 2 * float(found.cost) / len(pixels.read)
    covariance = np.linalg.inv(jacobian.T @ jacobian) * np.outer(scale, scale) * max(1.0, chi2)
    return _lattice(np.asarray(found.x, np.float64), covariance, nominal, cone)


def _pixels(plain: npt.NDArray[np.float32], nominal: Lattice, noise: SensorNoise) -> _Pixels:
    rows, columns = np.nonzero(plain < noise.full_scale_dn)
    if len(rows) < FEWEST:
        raise MeasurementError(
            f"{len(rows)} pixels look into plain white, {FEWEST} are due to show the lattice"
        )
    some = np.s_[:: max(1, -(-len(rows) // MOST))]
    rows, columns = rows[some], columns[some]
    places = np.stack([columns, rows], axis=1).astype(np.float64)
    read = plain[rows, columns].astype(np.float64)
    x, y = ((places - (np.array(plain.shape[::-1]) - 1) / 2) * 2 / max(plain.shape)).T
    near = KDTree(nominal.centres_px).query(places, k=min(NEAREST, len(nominal.centres_px)))[1]
    return _Pixels(
        places,
        read - noise.offset_dn,
        np.sqrt(noise.variance(read)),
        near.reshape(len(places), -1),
        np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1),
    )


def _expected(nominal: Lattice, light: float) -> tuple[Array, Array]:
    """Values to begin with and their standard deviations."""
    inside, outside = nominal.inside_radius_px, nominal.outside_radius_px
    values, loose = np.zeros(15), np.ones(15)
    values[ORIGIN], values[VECTORS] = nominal.origin_px, nominal.vectors_px.T.ravel()
    values[RADII] = (outside + inside) / 2, max((outside - inside) / 2, 1.01 * SMALLEST_PX)
    values[LIGHT.start], values[SHARE] = light, 0.5
    loose[ORIGIN], loose[VECTORS] = LOOSE_PX, LOOSE_PITCH * nominal.pitch_px
    loose[RADII], loose[LIGHT], loose[LIGHT.start] = LOOSE_RADIUS_PX, LOOSE_LIGHT * light, light
    loose[SHARE] = 0.5
    return values, loose


def _light(values: Array, pixels: _Pixels, nominal: Lattice, cone: Cone) -> Array:
    """Light of the pixels, DN above the offset: the micro-images next to each added up."""
    table = profile_table(float(values[6]), float(values[7]), cone)
    at, share = np.arange(len(table.values)) * table.step, float(values[SHARE])
    even = table.values[:, VALUE] + share * table.values[:, FALLOFF]
    odd = share * table.values[:, LOPSIDED]
    centres = values[ORIGIN] + nominal.indices @ values[VECTORS].reshape(2, 2)
    slants = cone.tilting.per_px * (centres - cone.tilting.axis_px)
    total = np.zeros(len(pixels.read))
    for lens in pixels.near.T:
        away = pixels.places - centres[lens]
        r = np.hypot(*away.T)
        along = np.sum(slants[lens] * away, axis=1) / np.maximum(r, 1e-9)
        total += np.interp(r, at, even, right=0.0) + along * np.interp(r, at, odd, right=0.0)
    return total * (pixels.terms @ values[LIGHT])


def _lattice(values: Array, covariance: Array, nominal: Lattice, cone: Cone) -> Lattice:
    vectors, share = values[VECTORS].reshape(2, 2).T, float(np.clip(values[SHARE], 0.0, 1.0))
    pitch, angle = pitch_and_angle(nominal.layout, vectors)
    moved = by_vectors(nominal.layout, vectors)
    placed = covariance[:6, :6]
    sizes = np.zeros((3, 8))
    sizes[0, 6:], sizes[1, 6:], sizes[2, :6] = (1.0, -1.0), (1.0, 1.0), moved[0]
    of_sizes = sizes @ covariance[:8, :8] @ sizes.T
    doubts = np.sqrt(np.diag(of_sizes))
    slant = share * cone.tilting.per_px * (values[ORIGIN] - cone.tilting.axis_px)
    return replace(
        nominal,
        pitch_px=pitch,
        angle=angle,
        origin_px=values[ORIGIN],
        vectors_px=vectors,
        centres_px=values[ORIGIN] + nominal.indices @ vectors.T,
        inside_radius_px=abs(float(values[6] - values[7])),
        outside_radius_px=float(values[6] + values[7]),
        pitch_uncertainty_px=float(doubts[2]),
        angle_uncertainty=math.sqrt(float((moved @ placed @ moved.T)[1, 1])),
        origin_uncertainty_px=np.sqrt(np.diag(placed)[:2]),
        inside_uncertainty_px=float(doubts[0]),
        outside_uncertainty_px=float(doubts[1]),
        covariance_px=placed,
        sizes_covariance_px=of_sizes,
        light=values[LIGHT],
        cone=cone,
        slants=np.array([share, *slant, share * cone.tilting.per_px]),
        light_uncertainty_dn=math.sqrt(float(covariance[LIGHT.start, LIGHT.start])),
    )
