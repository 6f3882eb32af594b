"""The lattice of chief rays through a measured white picture: straight but for the array's tilt,
with sizes, light and fall-off, and how sure all of them are.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.chief_rays import FallOff
from flflab.measurement.lattice.find import pitch_and_angle
from flflab.measurement.lattice.grid import Grid, by_vectors
from flflab.measurement.lattice.kernel import LIGHT, X, Y
from flflab.measurement.lattice.kinds import Kinds, kinds_of
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.profile import Cone, cone_of
from flflab.measurement.lattice.slopes import OF_MISFIT
from flflab.measurement.lattice.tilted import (
    RADII,
    TILT,
    Images,
    Tilted,
    tilted_lattice,
)
from flflab.measurement.lattice.white_picture import WhitePicture
from flflab.optics.camera import Camera
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

EDGE_PX = 0.015  # of a disc's radius: by its edge's form two frames' mean and each differed as much
CUT = 4.0  # robust deviations beyond which a micro-image's light does not count
BENT = 1.3  # times the mean square that the smooth lattice leaves: then a tilt is not all
BENT_BY_CHANCE = 20.0  # more, over the number of micro-images: of few noise leaves less


def lattice_of(
    camera: Camera,
    white: WhitePicture,
    whole: Images,
    kind: Whole,
    falling: FallOff,
    by_profile: Array,
) -> Lattice:
    """The lattice of chief rays.

    Args:
        camera: as described.
        white: its white picture.
        whole: whole micro-images where their chief rays land, with the radii of their discs.
        kind: of each of ``white``'s micro-images.
        falling: fall-off within micro-images.
        by_profile: covariance of both radii by how the profile was read, px^2, shape (2, 2).
    """
    shape = camera.sensor.resolution[1], camera.sensor.resolution[0]
    cone, kinds = cone_of(camera), kinds_of(camera)
    mine = _of_central_kind(camera, white, whole, kind)
    start = np.zeros(10)
    start[:2], start[2:6] = white.grid.origin_px, white.grid.vectors_px.T.ravel()
    start[RADII] = np.median(whole.radii_px[mine], axis=0)
    kinds = kinds and _as_seen(kinds, whole, start[RADII])
    one_look = kinds is not None or len(camera.array.focal_lengths) == 1
    tilted = tilted_lattice(whole, start, cone.tilting, kinds, one_look)
    places, doubts, shares = _places(white, falling, tilted, cone)
    outside = float(tilted.values[RADII].sum())
    shown = _shown(white, places, shape, outside)
    indices, centres = white.indices[shown], places[shown]
    middle = (np.array([shape[1], shape[0]]) - 1) / 2
    nearest = int(np.argmin(np.hypot(*(centres - middle).T)))
    origin = _origin(tilted, indices[nearest], cone)
    fitted, common = _covariances(tilted, white.grid, falling, indices[nearest], origin)
    covariance = fitted + common
    moved = by_vectors(white.grid.layout, tilted.vectors)
    pitch, angle = pitch_and_angle(white.grid.layout, tilted.vectors)
    pitch_variance = float((moved @ covariance @ moved.T)[0, 0])
    sizes = _sizes_covariance(tilted, white, by_profile, pitch_variance)
    light, doubt = _light(white, shape)
    large, small = tilted.values[RADII]
    return Lattice(
        layout=white.grid.layout,
        pitch_px=pitch,
        angle=angle,
        origin_px=origin,
        vectors_px=tilted.vectors,
        indices=indices - indices[nearest],
        centres_px=centres,
        inside_radius_px=abs(float(large - small)),
        outside_radius_px=outside,
        pitch_uncertainty_px=math.sqrt(float(sizes[2, 2])),
        angle_uncertainty=math.sqrt(float((moved @ covariance @ moved.T)[1, 1])),
        origin_uncertainty_px=np.sqrt(np.diag(covariance)[:2]),
        inside_uncertainty_px=math.sqrt(float(sizes[0, 0])),
        outside_uncertainty_px=math.sqrt(float(sizes[1, 1])),
        covariance_px=covariance,
        common_px=common,
        followed=shares[shown],
        doubts_px=doubts[shown],
        radii_apart_px=tilted.radii_apart,
        sizes_covariance_px=sizes,
        light=light,
        cone=cone,
        slants=np.array(
            [
                falling.share,
                *(falling.slant + falling.rate * (origin - falling.middle_px)),
                falling.rate,
            ]
        ),
        tilt=tilted.values[TILT],
        tilt_uncertainty=np.sqrt(np.diag(tilted.covariance)[TILT]),
        light_uncertainty_dn=doubt,
        kinds=kinds,
        misfit=white.misfit,
    )


def _of_central_kind(camera: Camera, white: WhitePicture, whole: Images, kind: Whole) -> Flags:
    """Which of the whole micro-images belong to the central microlens's kind; all where none
    does.
    """
    focal = np.asarray(camera.array.focal_lengths)
    central = int(np.argmin(np.abs(focal - float(central_smms(camera).focal))))
    at = {(int(i), int(j)): int(k) for (i, j), k in zip(white.indices, kind, strict=True)}
    mine = np.array([at[int(i), int(j)] == central for i, j in whole.indices])
    return mine if mine.any() else np.ones_like(mine)


def _as_seen(kinds: Kinds, whole: Images, radii: Array) -> Kinds:
    """The kinds with discs that differ as much as they are seen to."""
    due = kinds.wider_px[kinds.of(whole.centres_px)]
    seen = whole.radii_px[:, 1] - radii[1]
    square = float(np.sum(due**2))
    return kinds.widened(float(np.sum(due * seen)) / square) if square > 0 else kinds


def _places(
    white: WhitePicture, falling: FallOff, tilted: Tilted, cone: Cone
) -> tuple[Array, Array, Array]:
    """Where each micro-image's chief ray lands: by its own light, and by the lattice as far as that
    is less sure than microlenses keep to it. The lattice is the tilted one, or where it bends
    otherwise the smooth one. With it how unsure each is by itself, px, and by which share each
    follows the lattice, shapes (n,).
    """
    usual = white.whole.copy()
    usual[np.flatnonzero(white.whole)[white.grid.off]] = False
    light, smooth = white.values[:, [X, Y]], white.grid.centres(white.indices)
    own, smooth = light - falling.moved(light), smooth - falling.moved(smooth)
    straight = tilted.values[:2] + white.indices @ tilted.vectors.T
    due = cone.tilting.centres(straight, tilted.values[TILT])
    left = [float(np.mean((own - one)[usual] ** 2)) for one in (due, smooth)]
    count = max(np.count_nonzero(usual), 1)
    straight = left[0] < (BENT + BENT_BY_CHANCE / count) * left[1]
    lattice, total = (due, left[0]) if straight else (smooth, left[1])
    variance = np.trace(white.spread.covariance[:, :2, :2], axis1=1, axis2=2) / 2
    noise = float(np.mean(variance[usual]))
    apart = total - noise
    # less than half of a centre's own uncertainty is not told, nor what noise shows by chance
    if apart < noise * max(0.25, 3 / math.sqrt(count)):
        return lattice, np.zeros(len(own)), np.ones(len(own))
    known = usual | ~white.whole  # what the border cuts is as unsure as it says
    share = np.where(known, apart / (apart + variance), 0.0)
    doubt = np.sqrt(np.where(known, share * variance, np.mean((own - lattice) ** 2, axis=1)))
    places = share[:, None] * own + (1 - share[:, None]) * lattice
    return np.asarray(places, dtype=np.float64), doubt, 1 - share


def _shown(white: WhitePicture, places: Array, shape: tuple[int, ...], outside: float) -> Flags:
    """Which micro-images have a part on the picture, and light there if all of them is on it."""
    top = np.array([shape[1], shape[0]]) - 0.5
    off = places - np.clip(places, -0.5, top)
    inner = np.all((places > outside - 0.5) & (places < top - outside), axis=1)
    return (np.hypot(*off.T) < outside) & (white.found | ~inner)


def _origin(tilted: Tilted, index: Whole, cone: Cone) -> Array:
    straight = tilted.values[:2] + tilted.vectors @ index
    return np.asarray(cone.tilting.centres(straight[None], tilted.values[TILT])[0], np.float64)


def _covariances(
    tilted: Tilted, grid: Grid, falling: FallOff, index: Whole, origin: Array
) -> tuple[Array, Array]:
    """Of (origin, a, b) at an index: by the fit, grown to what blocks of neighbours show, and of
    what moves all centres together.
    """
    single = tilted.covariance[:6, :6]
    by_blocks = np.diag(grid.covariance_px)
    grown = np.sqrt(np.maximum(by_blocks / np.maximum(np.diag(single), 1e-300), 1.0))
    shift = np.eye(6)
    shift[:2, 2:4], shift[:2, 4:6] = np.eye(2) * index[0], np.eye(2) * index[1]
    along = np.concatenate([origin - falling.middle_px, tilted.values[2:6]]) * falling.uncertainty
    common = shift @ grid.common_px @ shift.T + np.outer(along, along)
    return shift @ (single * np.outer(grown, grown)) @ shift.T, common


def _sizes_covariance(
    tilted: Tilted, white: WhitePicture, by_profile: Array, pitch: float
) -> Array:
    """Of (inside radius, outside radius, pitch): as radii scatter, and by light that the discs do
    not explain.

    Args:
        tilted: with the radii.
        white: as measured.
        by_profile: see ``lattice_of``.
        pitch: variance of the pitch, px^2.
    """
    by = np.array([[1.0, -1.0], [1.0, 1.0]])
    common = math.hypot(EDGE_PX, OF_MISFIT * white.misfit * white.profile.softness)
    radii = tilted.covariance[RADII, RADII] + common**2 * np.eye(2) + by_profile
    sizes = np.zeros((3, 3))
    sizes[:2, :2], sizes[2, 2] = by @ radii @ by.T, pitch
    return sizes


def _light(white: WhitePicture, shape: tuple[int, ...]) -> tuple[Array, float]:
    """Terms of the light over the picture, and how sure the first is, by how lenses scatter."""
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
    return found, math.sqrt(float(variance[0, 0]))
