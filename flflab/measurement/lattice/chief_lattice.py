"""The lattice of chief rays through a measured white picture: straight but for the array's tilt,
with sizes, light and fall-off, and how sure all of them are.

Natural fall-off across the cone of a micro-image moves its light, in proportion to how steeply its
middle ray lands. The fourth power of the cosine is itself of first order (coma of the microlenses
and distortion of the pupil are as large), so half of what it moves is a standard uncertainty.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.find import pitch_and_angle
from flflab.measurement.lattice.grid import by_vectors
from flflab.measurement.lattice.kernel import LIGHT
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.mean_profile import MIDDLE, PROFILED
from flflab.measurement.lattice.straight import TILT, VECTORS, Images, Straight, straight_lattice
from flflab.measurement.lattice.tilting import axis_of
from flflab.measurement.lattice.white_picture import WhitePicture
from flflab.optics.camera import Camera
from flflab.optics.smms import Smms

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

EDGE_PX = 0.015  # of a disc's radius: by its edge's form two frames' mean and each differed as much
OF_MISFIT = 0.3  # of what the discs do not explain, which may move a rim
UNSURE = 0.5  # of the fall-off: standard uncertainty
KNOWN_SLOPE = 0.3  # of what is unsure of a blob's slope, where fall-off tells it
LEAST_SHARE = 0.05  # of the fall-off: what noise may show of it
LEAST_TILT = 2e-5  # by which pictures by rays without noise differ from their tilt, rad
CUT = 4.0  # robust deviations beyond which a micro-image's light does not count


@dataclass(frozen=True)
class DiscLight:
    """What the light of two discs says of all micro-images.

    Attributes:
        share: of natural fall-off that there is.
        shift_px: how far all of it moves the light of each, px per unit of the slope of its middle
            ray, shape (n,).
        radii_covariance: of both radii by how the profile was read, px^2, shape (2, 2).
    """

    share: float
    shift_px: Array
    radii_covariance: Array


def lattice_of(
    camera: Camera,
    white: WhitePicture,
    kinds: list[Smms],
    light: DiscLight,
    each: Images,
) -> Lattice:
    """The lattice of chief rays.

    Args:
        camera: as described.
        white: its white picture.
        kinds: of microlenses; the sizes of the first are those of the lattice.
        light: of all micro-images.
        each: all micro-images where their light is, with the radii of their discs.
    """
    shape = camera.sensor.resolution[1], camera.sensor.resolution[0]
    axis, moved = axis_of(camera), light.share * light.shift_px[:, None]
    chief = each.centres_px - moved * axis.away(each.centres_px)
    usual = white.usual
    seen = Images(
        each.indices[usual],
        chief[usual],
        each.radii_px[usual],
        each.covariance_px[usual],
        each.kind[usual],
    )
    straight = straight_lattice(seen, kinds, axis, camera.sensor.pixel)
    places, doubts, shares = _places(white)
    places = places - moved * axis.away(places)
    large, small = (float(one) for one in straight.values[8:10])
    shown = _shown(white, places, shape, large + small)
    indices, centres = white.indices[shown], places[shown]
    middle = (np.array([shape[1], shape[0]]) - 1) / 2
    nearest = indices[int(np.argmin(np.hypot(*(centres - middle).T)))]
    on_axis = straight.values[:2] + straight.vectors @ nearest
    origin = axis.centres(on_axis[None], straight.values[TILT])[0]
    # what (origin, a, b) at index 0 make of those at another
    shift = np.kron([[1, *nearest], [0, 1, 0], [0, 0, 1]], np.eye(2)).astype(np.float64)
    fitted = shift @ straight.covariance[VECTORS, VECTORS] @ shift.T
    moving = float(np.median(np.abs(light.shift_px[usual])))
    growing = moving * max(light.share, LEAST_SHARE) * UNSURE
    along = growing * np.concatenate([axis.away(origin), axis.per_px * straight.values[2:6]])
    definition = white.grid.common_px * (1.0 if white.sloping else KNOWN_SLOPE**2)
    common = shift @ definition @ shift.T + np.outer(along, along)
    moves = by_vectors(white.grid.layout, straight.vectors)
    pitch, angle = pitch_and_angle(white.grid.layout, straight.vectors)
    variances = np.diag(moves @ (fitted + common) @ moves.T)
    sizes = _sizes_covariance(straight, white, light.radii_covariance, float(variances[0]))
    terms, doubt = _light(white, shape)
    return Lattice(
        layout=white.grid.layout,
        pitch_px=pitch,
        angle=angle,
        origin_px=np.asarray(origin, dtype=np.float64),
        vectors_px=straight.vectors,
        indices=indices - nearest,
        centres_px=centres,
        inside_radius_px=large - small,
        outside_radius_px=large + small,
        pitch_uncertainty_px=math.sqrt(float(variances[0])),
        angle_uncertainty=math.sqrt(float(variances[1])),
        origin_uncertainty_px=np.sqrt(np.diag(fitted + common)[:2]),
        inside_uncertainty_px=math.sqrt(float(sizes[0, 0])),
        outside_uncertainty_px=math.sqrt(float(sizes[1, 1])),
        covariance_px=fitted + common,
        common_px=common,
        followed=1 - shares[shown],
        doubts_px=doubts[shown],
        radii_apart_px=straight.radii_apart,
        sizes_covariance_px=sizes,
        light=terms,
        axis=axis,
        fall_off=light.share,
        tilt=straight.values[TILT],
        tilt_uncertainty=np.hypot(np.sqrt(np.diag(straight.covariance)[TILT]), LEAST_TILT),
        light_uncertainty_dn=doubt,
        misfit=white.misfit,
    )


def _places(white: WhitePicture) -> tuple[Array, Array, Array]:
    """Where each micro-image's light is, by itself and by the smooth lattice, each as sure as it is
    and as microlenses keep to it; how unsure that is by itself, px, and the share of its own.
    """
    own = np.trace(white.spread.covariance[:, :2, :2], axis1=1, axis2=2) / 2
    light, smooth = white.values[:, :2], white.grid.centres(white.indices)
    apart = white.grid.scatter_px**2
    share = np.where(white.found, apart / (apart + own), 0.0)
    doubt = np.sqrt(np.where(white.found, share * own, apart))
    return share[:, None] * light + (1 - share[:, None]) * smooth, doubt, share


def _shown(white: WhitePicture, places: Array, shape: tuple[int, ...], outside: float) -> Flags:
    """Which micro-images have a part on the picture, and light there if all of them is on it."""
    top = np.array([shape[1], shape[0]]) - 0.5
    off = places - np.clip(places, -0.5, top)
    inner = np.all((places > outside - 0.5) & (places < top - outside), axis=1)
    return (np.hypot(*off.T) < outside) & (white.found | ~inner)


def _sizes_covariance(
    straight: Straight, white: WhitePicture, by_profile: Array, pitch: float
) -> Array:
    """Of (inside radius, outside radius, pitch): as radii scatter, and by light that the discs do
    not explain.

    Args:
        straight: with the radii.
        white: as measured.
        by_profile: covariance of both radii by how the profile was read, px^2, shape (2, 2).
        pitch: variance of the pitch, px^2.
    """
    by = np.array([[1.0, -1.0], [1.0, 1.0]])
    common = math.hypot(EDGE_PX, OF_MISFIT * white.misfit * white.profile.softness)
    radii = straight.covariance[8:10, 8:10] + common**2 * np.eye(2) + by_profile
    sizes = np.zeros((3, 3))
    sizes[:2, :2], sizes[2, 2] = by @ radii @ by.T, pitch
    return sizes


def _light(white: WhitePicture, shape: tuple[int, ...]) -> tuple[Array, float]:
    """Terms of the light over the picture, and how sure the first is: by how lenses scatter, and by
    the noise in the middle of the profile that all share.
    """
    seen = white.values[white.whole]
    x, y = ((seen[:, :2] - (np.array([shape[1], shape[0]]) - 1) / 2) * 2 / max(shape)).T
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    terms = 6 if len(seen) > 12 else 3
    good, found, variance = np.ones(len(seen), dtype=np.bool_), np.zeros(6), np.zeros((6, 6))
    for _ in range(4):
        rows = design[good, :terms]
        found[:terms] = np.linalg.lstsq(rows, seen[good, LIGHT], rcond=None)[0]
        rest = seen[:, LIGHT] - design @ found
        spread = 1.48 * float(np.median(np.abs(rest[good]))) + 1e-9 * abs(float(found[0]))
        freedom = max(np.count_nonzero(good) - terms, 1)
        total = float(np.sum(rest[good] ** 2)) / freedom
        variance[:terms, :terms] = np.linalg.pinv(rows.T @ rows) * total
        good = np.abs(rest) < CUT * spread
    own = float(np.mean(white.spread.covariance[white.whole, LIGHT, LIGHT]))
    of_profile = own / MIDDLE**2 / min(len(seen), PROFILED)
    return found, math.sqrt(float(variance[0, 0]) + of_profile)
