"""Images of one round dot in many micro-images: least squares fit of centre and brightness, all at
once.

A spot is a disc blurred by a disc, averaged over the pixel, times the light that the micro-image
has there: expected = offset + brightness * light * illumination(|p - micro-image|) * profile(p -
centre).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numba
import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.profile import (
    BY_LARGE,
    BY_SMALL,
    SMALLEST_PX,
    VALUE,
    ProfileTable,
    profile_table,
    table_step,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.spots.profile import SpotProfile

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Picture = npt.NDArray[np.generic]
Sums = Callable[[Whole, Array, Array], tuple[Array, Array, Array, Array]]

MOST_STEPS, SETTLED_PX, WIDEST_STEP_PX = 10, 1e-4, 2.0  # of Gauss-Newton
DARKEST = 1e-3  # brightness that a spot is kept above
LEAST_BRIGHTNESS = 0.05  # of a spot
LIT = 0.2  # share of the light from which on a spot says where the dots are, and in which focus
SHARED_PX = 0.03  # micro-images whose radii agree to this share a table of the light
WEAKEST_ILLUMINATION = 0.05  # pixels with less light say nothing of a spot


@dataclass(frozen=True)
class Spots:
    """Fitted spots, one entry each.

    Attributes:
        centres: (x, y), px, shape (n, 2).
        brightness: plateau over the light of a white target there, shape (n,).
        covariance: of (x, y, brightness), shape (n, 3, 3); infinite where the pixels say nothing.
        chi2_per_pixel: of each, shape (n,).
        together: how the centres move with a standard deviation along either axis of what is shared
            and not sure, focus and radius of the dots; shape (n, 2, 2).
    """

    centres: Array
    brightness: Array
    covariance: Array
    chi2_per_pixel: Array
    together: Array

    @property
    def seen(self) -> npt.NDArray[np.bool_]:
        """Which are bright enough to be there."""
        return np.isfinite(self.covariance[:, 0, 0]) & (self.brightness > LEAST_BRIGHTNESS)

    def those(self, which: Whole) -> "Spots":
        """Some of them."""
        return Spots(**{part.name: getattr(self, part.name)[which] for part in fields(Spots)})

    def with_those(self, which: Whole, others: "Spots") -> "Spots":
        """These, but others at some positions."""
        parts = {part.name: getattr(self, part.name).copy() for part in fields(Spots)}
        for name, part in parts.items():
            part[which] = getattr(others, name)
        return Spots(**parts)


@dataclass(frozen=True)
class Lit:
    """Micro-images in which spots are looked for, one entry a spot.

    Attributes:
        centres: of the micro-image, px, shape (n, 2).
        light: of a white target in its bright field, DN above the background, shape (n,).
        sizes: of what it shows, over that behind the microlens on the axis, shape (n,); 1 but for a
            tilted array.
        shares: of the light, by the distance from its centre: each falls off towards its own rim,
            shape (n, entries).
        step: distance between these entries, px.
    """

    centres: Array
    light: Array
    sizes: Array
    shares: Array
    step: float

    def those(self, which: Whole) -> "Lit":
        """Some of them."""
        return Lit(
            self.centres[which], self.light[which], self.sizes[which], self.shares[which], self.step
        )

    def share_at(self, centres: Array) -> Array:
        """Relative illumination at a place in each, px, shape (n, 2); 1 inside its bright field."""
        place = np.minimum(
            np.hypot(*(centres - self.centres).T) / self.step, self.shares.shape[1] - 1.001
        )
        k, each = place.astype(np.int64), np.arange(len(place))
        return self.shares[each, k] + (place - k) * (
            self.shares[each, k + 1] - self.shares[each, k]
        )


def illumination(table: ProfileTable, distance: Array) -> Array:
    """Relative illumination at distances in px from the centre of a micro-image, 1 inside."""
    return np.interp(distance / table.step, np.arange(len(table.values)), table.values[:, 0])


def illumination_table(lattice: Lattice) -> ProfileTable:
    """The lattice's measured profile."""
    large, small = (
        (lattice.outside_radius_px + lattice.inside_radius_px) / 2,
        (lattice.outside_radius_px - lattice.inside_radius_px) / 2,
    )
    return profile_table(large, max(0.05, small))


def light_level(lattice: Lattice, centres: Array, shape: tuple[int, int]) -> Array:
    """Light of a white target in the bright fields of micro-images at these centres, DN above the
    background, shape (n,).
    """
    x, y = ((centres - (np.array([shape[1], shape[0]]) - 1) / 2) * 2 / max(shape)).T
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1) @ lattice.light


def lit(lattice: Lattice, lens: Whole, shape: tuple[int, int], sizes: Array) -> Lit:
    """The micro-images at positions ``lens`` of the lattice; ``sizes`` are those of all its
    micro-images.
    """
    centres = np.ascontiguousarray(lattice.centres_px[lens])
    return Lit(
        centres, light_level(lattice, centres, shape), sizes[lens], *_shares(lattice.discs_px[lens])
    )


def _shares(discs_px: Array) -> tuple[Array, float]:
    """``shares`` and ``step`` of micro-images with these discs, shape (n, 2): kinds and a tilt make
    them wider or narrower.

    Those that are nearly alike share a table, and its slope by the radii says what is not.
    """
    discs = np.maximum(discs_px, SMALLEST_PX)
    at, which = np.unique(
        np.maximum(np.rint(discs / SHARED_PX) * SHARED_PX, SMALLEST_PX), axis=0, return_inverse=True
    )
    which = which.ravel()
    step = min((table_step(large, small) for large, small in at.tolist()), default=1.0)
    tables = [profile_table(large, small, step=step).values for large, small in at.tolist()]
    shares = np.zeros((len(discs), max(map(len, tables), default=2)))
    for k, table in enumerate(tables):
        mine = which == k
        by_radii = (discs[mine] - at[k]) @ table[:, [BY_LARGE, BY_SMALL]].T
        shares[mine, : len(table)] = np.maximum(table[:, VALUE] + by_radii, 0.0)
    return shares, step


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _flat(
    picture: Picture,
    places: Array,
    half: int,
    centres: Array,
    light: Array,
    shares: Array,
    step: float,
    offset: float,
    ceiling: float,
) -> npt.NDArray[np.float32]:  # pragma: no cover - compiled
    """Windows round places of what the picture reads over the light there; 0 where nothing is
    known.
    """
    flat = np.zeros((len(places), 2 * half + 1, 2 * half + 1), dtype=np.float32)
    for n in range(len(places)):
        left, top = int(np.rint(places[n, 0])) - half, int(np.rint(places[n, 1])) - half
        for row in range(max(0, top), min(picture.shape[0], top + 2 * half + 1)):
            for column in range(max(0, left), min(picture.shape[1], left + 2 * half + 1)):
                place = math.hypot(column - centres[n, 0], row - centres[n, 1]) / step
                near = math.hypot(column - places[n, 0], row - places[n, 1]) <= half
                if place >= shares.shape[1] - 2 or not near or picture[row, column] >= ceiling:
                    continue
                share = shares[n, int(place)]
                if share > WEAKEST_ILLUMINATION:
                    flat[n, row - top, column - left] = (picture[row, column] - offset) / (
                        light[n] * share
                    )
    return flat


def flat_centroids(
    picture: Picture, places: Array, half: int, radius: float, own: Lit, noise: SensorNoise
) -> tuple[Array, Array]:
    """Centroid of the flat-fielded light within ``half`` px of each place, and the light's sum, in
    white pixels.

    What is darker than a quarter of a dot's light is left out: it is mostly noise and the light of
    elsewhere.
    """
    flat = _flat(
        picture,
        places,
        half,
        own.centres,
        own.light,
        own.shares,
        own.step,
        noise.offset_dn,
        noise.full_scale_dn,
    )
    if flat.size == 0:
        return places.copy(), np.zeros(len(places))
    bright = float(np.quantile(flat, max(0.5, 1 - 0.3 * math.pi * radius**2 / flat[0].size)))
    flat = np.where(flat > 0.25 * bright, flat, np.float32(0))
    total = flat.sum(axis=(1, 2), dtype=np.float64)
    window = np.arange(-half, half + 1)
    offsets = np.stack([flat.sum(axis=1) @ window, flat.sum(axis=2) @ window], axis=1)
    return np.rint(places) + offsets / np.maximum(total, 1e-12)[:, None], total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def light_share(
    x: float, y: float, shares: Array, step: float
) -> float:  # pragma: no cover - compiled
    """Share of the light at (x, y) px from a micro-image's centre, by its own shares; 0 where it is
    too little to say anything.
    """
    place = math.hypot(x, y) / step
    if place >= len(shares) - 2:
        return 0.0
    k = int(place)
    share = shares[k] + (place - k) * (shares[k + 1] - shares[k])
    return share if share > WEAKEST_ILLUMINATION else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sums(
    picture: Picture,
    at: Array,
    half: int,
    spots: Array,
    centres: Array,
    light: Array,
    sizes: Array,
    shares: Array,
    step: float,
    profile: Array,
    profile_step: float,
    flat: float,
    dark: float,
    gain: float,
    offset: float,
    ceiling: float,
) -> tuple[Array, Array, Array, Array]:  # pragma: no cover - compiled
    """Normal matrices, right sides, chi^2 and numbers of pixels of (x, y, brightness) in windows
    round ``at``.
    """
    normal, right = np.zeros((len(at), 3, 3)), np.zeros((len(at), 3))
    chi2, count = np.zeros(len(at)), np.zeros(len(at))
    turns = profile.shape[0] - 1
    for n in range(len(at)):
        left, top = int(np.rint(at[n, 0])) - half, int(np.rint(at[n, 1])) - half
        for row in range(max(0, top), min(picture.shape[0], top + 2 * half + 1)):
            for column in range(max(0, left), min(picture.shape[1], left + 2 * half + 1)):
                share = light_share(column - centres[n, 0], row - centres[n, 1], shares[n], step)
                if share == 0.0 or picture[row, column] >= ceiling:
                    continue
                dx, dy = column - spots[n, 0], row - spots[n, 1]
                r = math.hypot(dx, dy) / sizes[n]
                value, slope = 1.0, 0.0
                place = r / profile_step
                if place >= profile.shape[1] - 1:
                    value = 0.0
                elif r > flat:
                    # the direction within an eighth of a turn: a square pixel looks the same in the
                    # others
                    turn = (
                        math.atan2(min(abs(dx), abs(dy)), max(abs(dx), abs(dy)))
                        * (4 / math.pi)
                        * turns
                    )
                    m = min(int(turn), turns - 1)
                    k = int(place)
                    u, t = turn - m, place - k
                    near = (1 - u) * profile[m, k] + u * profile[m + 1, k]
                    far = (1 - u) * profile[m, k + 1] + u * profile[m + 1, k + 1]
                    value = near + t * (far - near)
                    slope = (far - near) / (profile_step * max(r, 1e-9) * sizes[n] ** 2)
                level = light[n] * share * spots[n, 2]
                weight = 1 / (dark + gain * max(level * value, 0.0))
                rest = picture[row, column] - offset - level * value
                gx, gy, gb = -level * slope * dx, -level * slope * dy, light[n] * share * value
                normal[n, 0, 0] += weight * gx * gx
                normal[n, 0, 1] += weight * gx * gy
                normal[n, 0, 2] += weight * gx * gb
                normal[n, 1, 1] += weight * gy * gy
                normal[n, 1, 2] += weight * gy * gb
                normal[n, 2, 2] += weight * gb * gb
                right[n, 0] += weight * rest * gx
                right[n, 1] += weight * rest * gy
                right[n, 2] += weight * rest * gb
                chi2[n] += weight * rest * rest
                count[n] += 1
        normal[n, 1, 0], normal[n, 2, 0], normal[n, 2, 1] = (
            normal[n, 0, 1],
            normal[n, 0, 2],
            normal[n, 1, 2],
        )
    return normal, right, chi2, count


def inverted(normal: Array, usable: npt.NDArray[np.bool_]) -> Array:
    """Inverses of normal matrices of (x, y, brightness), shape (n, 3, 3); infinite where they say
    nothing or are not usable.
    """
    scale = np.sqrt(np.maximum(np.einsum("nkk->nk", normal), 1e-300))
    scaled = normal / (scale[:, :, None] * scale[:, None, :])
    good = (np.linalg.det(scaled) > 1e-9) & usable
    solved = np.full(normal.shape, np.inf)
    solved[good] = np.linalg.inv(scaled[good]) / (scale[good][:, :, None] * scale[good][:, None, :])
    return solved


def moved_by(spots: Array, steps: Array) -> Array:
    """(x, y, brightness) of spots after a step, kept from running away; shape (n, 3)."""
    moved = spots + np.concatenate(
        [np.clip(steps[:, :2], -WIDEST_STEP_PX, WIDEST_STEP_PX), steps[:, 2:]], axis=1
    )
    moved[:, 2] = np.clip(moved[:, 2], DARKEST, 10.0)
    return moved


def gauss_newton(places: Array, brightness: Array, half: int, sums: Sums) -> Spots:
    """Gauss-Newton for (x, y, brightness) of every spot, each until its centre stays.

    Args:
        places: where to start, px, shape (n, 2).
        brightness: to start with, shape (n,).
        half: half width of the windows round them, px.
        sums: gives, for the spots at some positions of these, windows round some places and (x, y,
            brightness) now, normal matrices, right sides, chi squared and numbers of pixels.
    """
    spots = np.concatenate([places, brightness[:, None]], axis=1)
    inverse, chi2 = np.full((len(places), 3, 3), np.inf), np.zeros(len(places))
    at, moving = places, np.arange(len(places))
    for n in range(MOST_STEPS):
        if n == 2:
            at = spots[:, :2].copy()
        normal, right, misfit, count = sums(moving, at[moving], spots[moving])
        chi2[moving] = misfit / np.maximum(count - 3, 1)
        solved = inverted(normal, spots[moving, 2] > DARKEST)
        good = np.isfinite(solved[:, 0, 0])
        inverse[moving] = solved
        step = np.zeros((len(moving), 3))
        step[good] = np.einsum("nkm,nm->nk", solved[good], right[good])
        spots[moving] = moved_by(spots[moving], step)
        moving = moving[np.abs(step[:, :2]).max(axis=1, initial=0.0) > SETTLED_PX]
        if len(moving) == 0:
            break
    lost = np.hypot(*(spots[:, :2] - places).T) > (2 * half + 1) / 3
    inverse[lost] = np.inf
    there, bright = np.where(lost[:, None], places, spots[:, :2]), np.where(lost, 0.0, spots[:, 2])
    return Spots(there, bright, inverse, chi2, np.zeros((len(places), 2, 2)))


def fit_spots(
    picture: Picture, places: Array, half: int, own: Lit, profile: SpotProfile, noise: SensorNoise
) -> Spots:
    """Centre and brightness of every spot with one profile for all.

    Args:
        picture: DN, [row, col].
        places: where to start, px, shape (n, 2).
        half: half width of the windows round them, px.
        own: the micro-image of each.
        profile: of a spot.
        noise: of the sensor.
    """

    def sums(which: Whole, at: Array, now: Array) -> tuple[Array, Array, Array, Array]:
        return _sums(
            picture,
            at,
            half,
            now,
            own.centres[which],
            own.light[which],
            own.sizes[which],
            own.shares[which],
            own.step,
            profile.values,
            profile.step,
            profile.flat,
            noise.dark_variance,
            noise.dn_per_electron,
            noise.offset_dn,
            noise.full_scale_dn,
        )

    return gauss_newton(places, np.ones(len(places)), half, sums)
