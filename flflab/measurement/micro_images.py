"""Each micro-image of a white picture by itself: its centre and the radii of its two discs, each
with its covariance.

The lattice is one map with one profile that only the array's tilt changes; what else differs from
one micro-image to the next (microlenses of several kinds, a vignette) is found here. Where
neighbours overlap, each is fitted together with those that it overlaps.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.errors import MeasurementError
from flflab.measurement.lattice.model import SMALLEST_PX
from flflab.measurement.lattice.profile import profile_table
from flflab.measurement.lattice.white import Lattice
from flflab.measurement.micro_image_kernel import VALUES, sum_up, with_neighbours
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.spots.fit import light_level

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

LOOSE_CENTRE_PX, LOOSE_RADIUS, LOOSE_LIGHT = (
    2.0,
    0.25,
    0.1,
)  # standard deviations round the lattice's, of the outside radius, of the light
KNOWN = 0.05  # of the outside radius: a radius less sure than this was not seen
SHARED_PX = 0.03  # micro-images whose radii agree to this share a table of the profile
SETTLED_PX, SETTLED, ROUNDS = (
    1e-3,
    0.1,
    12,
)  # steps below so many px, or so many of their own standard deviations
AT_ONCE = 2048  # systems of neighbours in memory
SAMPLED = 100_000  # pixels among which those between micro-images are looked for


@dataclass(frozen=True)
class MicroImages:
    """Micro-images, one entry each; nan where the picture does not show enough of one.

    Attributes:
        indices: position (i, j) in the lattice, shape (n, 2).
        centres_px: (x, y), shape (n, 2).
        radii_px: larger and smaller of the two discs, shape (n, 2); their sum is the outside
            radius, their difference the inside one.
        covariance_px: of (x, y, larger, smaller), shape (n, 4, 4), scaled up by chi^2 a pixel where
            that is clearly above 1.
    """

    indices: Whole
    centres_px: Array
    radii_px: Array
    covariance_px: Array

    @property
    def inside_px(self) -> Array:
        """Radius of each bright field, and its standard uncertainty, shape (2, n)."""
        return np.stack([np.abs(self.radii_px[:, 0] - self.radii_px[:, 1]), self._spread(-1.0)])

    @property
    def outside_px(self) -> Array:
        """Radius of each total field, and its standard uncertainty, shape (2, n)."""
        return np.stack([self.radii_px.sum(axis=1), self._spread(1.0)])

    def _spread(self, sign: float) -> Array:
        large, small, both = (self.covariance_px[:, a, b] for a, b in ((2, 2), (3, 3), (2, 3)))
        return np.sqrt(np.maximum(large + small + 2 * sign * both, 0.0))


def measure_micro_images(
    white: npt.NDArray[np.generic], lattice: Lattice, noise: SensorNoise
) -> MicroImages:
    """Fit every micro-image whose centre lies on the sensor.

    Args:
        white: DN, [row, col].
        lattice: measured from the same picture.
        noise: of the sensor.

    Raises:
        MeasurementError: fewer than four of them can be fitted.
    """
    every = every_micro_image(white, lattice, noise)
    size = np.array([white.shape[1], white.shape[0]])
    good = np.isfinite(every.centres_px[:, 0]) & np.all(
        (lattice.centres_px > 0) & (lattice.centres_px < size - 1), axis=1
    )
    if np.count_nonzero(good) < 4:
        raise MeasurementError(
            f"white picture: {np.count_nonzero(good)} whole micro-images; at least 4 are due to see"
            " how they differ"
        )
    return MicroImages(
        every.indices[good], every.centres_px[good], every.radii_px[good], every.covariance_px[good]
    )


def every_micro_image(
    white: npt.NDArray[np.generic], lattice: Lattice, noise: SensorNoise
) -> MicroImages:
    """Fit every micro-image of the lattice, those that the border cuts too, by Gauss-Newton from
    where the lattice has it.

    Fall-off is the lattice's. The lattice says loosely where a micro-image lies and how bright it
    is, for those of which a part only is seen; a radius that is not known to a twentieth of the
    outside radius counts as not seen.

    Args:
        white: DN, [row, col].
        lattice: measured from the same picture.
        noise: of the sensor.

    Returns:
        One entry for each of the lattice's micro-images, in its order.
    """
    picture = np.ascontiguousarray(white, dtype=np.float32)
    start = np.zeros((len(lattice.centres_px), VALUES))
    start[:, :2] = lattice.centres_px
    start[:, 2:4] = np.maximum(lattice.discs_px, SMALLEST_PX)
    start[:, 4] = light_level(lattice, lattice.centres_px, (picture.shape[0], picture.shape[1]))
    spread = np.tile(
        [LOOSE_CENTRE_PX] * 2 + [LOOSE_RADIUS * lattice.outside_radius_px] * 2 + [1.0],
        (len(start), 1),
    )
    spread[:, 4] = LOOSE_LIGHT * np.abs(start[:, 4])
    precision = 1 / np.maximum(spread, 1e-9) ** 2
    neighbours, background = _overlapping(lattice), _background(picture, lattice, noise)
    values, covariance, chi2, count = (
        start.copy(),
        np.zeros((len(start), VALUES, VALUES)),
        np.ones(len(start)),
        np.ones(len(start)),
    )
    longest = np.array([0.15 * lattice.pitch_px] * 2)
    for _ in range(ROUNDS):
        normal, cross, right, chi2, count = _sums(
            picture, values, lattice, neighbours, background, noise
        )
        normal += np.eye(VALUES) * precision[:, None, :]
        right += precision * (start - values)
        step, covariance = _solved(neighbours, normal, cross, right)
        limit = np.concatenate(
            [np.broadcast_to(longest, (len(step), 2)), 0.5 * values[:, 2:4]], axis=1
        )
        step *= np.min(limit / np.maximum(np.abs(step[:, :4]), 1e-300), axis=1, initial=1.0)[
            :, None
        ]
        values += step
        values[:, 2:4] = np.maximum(values[:, 2:4], SMALLEST_PX)
        small = np.maximum(SETTLED_PX, SETTLED * np.sqrt(np.einsum("nkk->nk", covariance)[:, :4]))
        if not np.isfinite(values).all() or np.all(np.abs(step[:, :4]) < small):
            break
    excess = chi2 / np.maximum(count, 1)
    covariance *= np.where(excess > 1 + 3 * np.sqrt(2 / np.maximum(count, 1)), excess, 1.0)[
        :, None, None
    ]
    found = MicroImages(
        lattice.indices, values[:, :2].copy(), values[:, 2:4].copy(), covariance[:, :4, :4].copy()
    )
    moved = np.hypot(*(found.centres_px - lattice.centres_px).T)
    seen = (
        (moved < lattice.pitch_px / 4)
        & (values[:, 4] > 0)
        & (found.outside_px[1] < KNOWN * lattice.outside_radius_px)
    )
    seen &= found.inside_px[1] < KNOWN * lattice.outside_radius_px
    for part in (found.centres_px, found.radii_px, found.covariance_px):
        part[~seen] = np.nan
    return found


def _background(picture: npt.NDArray[np.float32], lattice: Lattice, noise: SensorNoise) -> float:
    """What is read between the micro-images; the lattice's own where they leave nothing between
    them.
    """
    step = max(1, round((picture.size / SAMPLED) ** 0.5))
    some = picture[::step, ::step]
    rows, columns = np.indices(some.shape) * step
    away, _ = KDTree(lattice.centres_px).query(np.stack([columns.ravel(), rows.ravel()], axis=1))
    between = (away > 1.1 * lattice.outside_radius_px + 2) & (some.ravel() < noise.full_scale_dn)
    return (
        float(some.ravel()[between].mean())
        if np.count_nonzero(between) > 0.01 * between.size
        else lattice.background_dn
    )


def _overlapping(lattice: Lattice) -> Whole:
    """Positions of the micro-images that each may overlap, -1 where there is none, shape (n,
    most).
    """
    near = KDTree(lattice.centres_px).query_ball_point(
        lattice.centres_px, 2 * lattice.outside_radius_px + 2
    )
    neighbours = np.full((len(near), max(map(len, near)) - 1), -1, dtype=np.int64)
    for n, some in enumerate(near):
        neighbours[n, : len(some) - 1] = [one for one in some if one != n]
    return neighbours


def _sums(
    picture: npt.NDArray[np.float32],
    values: Array,
    lattice: Lattice,
    neighbours: Whole,
    background: float,
    noise: SensorNoise,
) -> tuple[Array, Array, Array, Array, Whole]:
    """As ``sum_up``, of all micro-images."""
    rounded, which = np.unique(
        np.rint(values[:, 2:4] / SHARED_PX).astype(np.int64), axis=0, return_inverse=True
    )
    at = np.maximum(rounded * SHARED_PX, SMALLEST_PX)
    profiles = [
        profile_table(float(large), float(small), lattice.cone, float(lattice.slants[0]))
        for large, small in at
    ]
    tables = np.zeros(
        (len(profiles), max(len(one.values) for one in profiles), profiles[0].values.shape[1])
    )
    for table, profile in zip(tables, profiles, strict=True):
        table[: len(profile.values)] = profile.values
    slants = lattice.slants[1:3] + lattice.slants[3] * (values[:, :2] - lattice.origin_px)
    made_for = np.column_stack([at, [(one.reach, one.step) for one in profiles]])
    sensor = noise.dark_variance, noise.dn_per_electron, noise.full_scale_dn, noise.offset_dn
    arguments = values, slants, neighbours, tables, made_for, which.ravel(), background, *sensor
    bands = np.array_split(np.arange(len(values)), 4 * numba.get_num_threads())
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        parts = list(pool.map(lambda band: sum_up(picture, band, *arguments), bands))
    normal, cross, right, chi2, count = (np.concatenate(part) for part in zip(*parts, strict=True))
    return normal, cross, right, chi2, count


def _solved(neighbours: Whole, normal: Array, cross: Array, right: Array) -> tuple[Array, Array]:
    """Steps and covariances of each, its neighbours free beside it and their neighbours held."""
    steps, covariances = np.zeros(right.shape), np.zeros(normal.shape)
    for members in np.array_split(np.arange(len(right)), -(-len(right) // AT_ONCE)):
        systems, sides = with_neighbours(members, neighbours, normal, cross, right)
        scale = np.sqrt(np.einsum("nkk->nk", systems))
        inverse = np.linalg.inv(systems / (scale[:, :, None] * scale[:, None, :]))[:, :VALUES]
        steps[members] = np.einsum("nak,nk->na", inverse, sides / scale) / scale[:, :VALUES]
        covariances[members] = inverse[:, :, :VALUES] / (
            scale[:, :VALUES, None] * scale[:, None, :VALUES]
        )
    return steps, covariances
