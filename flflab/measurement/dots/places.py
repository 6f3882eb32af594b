"""Where in space fitted dots stand, and what makes their places unsure: each dot's own spots, and
what all dots of the picture share.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.measurement.dots.find import Found
from flflab.measurement.dots.fit import moved_by
from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.camera import Camera
from flflab.optics.focus import microlens_limits
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]

# of all spots together, outwards: pictures by rays show as much, rms
MODEL_PX = 0.0005
# what waves make of cut spots beside another focus: of the width of diffraction, in light of this
# wavelength, mm, times the square of where it comes through the microlens over its radius
DIFFRACTED, LIGHT = 0.1, 550e-6
WIDEST = 0.05  # of the vergence: what is less sure is no depth
CAUSES = {
    "focus": 1,
    "lattice": 12,
    "tilt": 2,
    "model": 1,
    "diffraction": 1,
}  # how many columns each has


@dataclass(frozen=True)
class Place:
    """Of one dot.

    Attributes:
        position_mm: in the world, shape (3,); nan where its views leave it open.
        uncertainty_mm: its standard uncertainties, shape (3,).
        common_mm: how it moves with a standard uncertainty of each thing that all dots share, as
            ``CAUSES`` lists them, shape (3, 17).
        by_lens_mm: how it moves with a standard deviation of each microlens's own place (x, y) and
            focus, shape (3, lenses, 3); the lenses are the stand's.
    """

    position_mm: Array
    uncertainty_mm: Array
    common_mm: Array
    by_lens_mm: Array


def places_of(found: Found, lattice: Lattice, camera: Camera) -> tuple[Place, ...]:
    """Those of all dots. The camera counts as known."""
    common, stand = _common(found, lattice, camera), found.stand
    lenses = stand.by_lens
    rest = stand.covariance - lenses @ lenses.T
    focus = rest[:, -1] / np.sqrt(rest[-1, -1])
    own = rest - np.outer(focus, focus)
    common = np.concatenate([focus[:, None], common], axis=1)
    limited = bool(microlens_limits(central_smms(camera), 1 / found.distance))
    counted = found.candidates.dot[found.seen.counted]
    placed: list[Place] = []
    for dot, (x, y, vergence) in enumerate(stand.values):
        part = slice(3 * dot, 3 * dot + 3)
        alone = own[part, part] + lenses[part] @ lenses[part].T
        known = np.sqrt(alone[2, 2]) < WIDEST * abs(vergence)
        if not limited or np.count_nonzero(counted == dot) < 2 or not known:
            nowhere = np.full(3, np.nan)
            none = np.full((3, lenses.shape[1] // 3, 3), np.nan)
            placed.append(Place(nowhere, nowhere, np.full((3, common.shape[1]), np.nan), none))
            continue
        far = 1 / vergence
        # world: x = (o V)/V, y likewise, z = -1/V
        by = np.array([[far, 0.0, -x * far**2], [0.0, far, -y * far**2], [0.0, 0.0, far**2]])
        shared = by @ common[part]
        variance = np.diag(by @ alone @ by.T) + (shared**2).sum(axis=1)
        position = np.array([x * far, y * far, -far])
        by_lens = (by @ lenses[part]).reshape(3, -1, 3)
        placed.append(Place(position, np.sqrt(variance), shared, by_lens))
    return tuple(placed)


def _common(found: Found, lattice: Lattice, camera: Camera) -> Array:
    """How the dots' numbers move with a standard uncertainty of lattice, tilt, model and
    diffraction; shape (3 dots + 1, 16).
    """
    stand, lens, pixel = found.stand, found.candidates.lens, camera.sensor.pixel
    moves = np.zeros((len(lens), 2, 6))
    for n in range(2):
        moves[:, n, n], moves[:, n, 2 + n :: 2] = 1.0, lattice.indices[lens]
    by_lattice = pixel * stand.by_centre @ moves
    shared = np.zeros((len(lens), 2, 12))
    if np.isfinite(lattice.covariance_px).all():
        common = lattice.covariance_px if lattice.common_px is None else lattice.common_px
        followed = np.ones(len(lens)) if lattice.followed is None else lattice.followed[lens]
        shared[..., :6] = by_lattice @ root(common)
        shared[..., 6:] = followed[:, None, None] * (
            by_lattice @ root(lattice.covariance_px - common)
        )
    tilts = np.zeros((len(lens), 2, 2))
    if lattice.cone is not None:
        tilting, step = lattice.cone.tilting, 1e-5
        by_rise = moved_by(found.seen, stand, lambda old: replace(old, rise=old.rise + step)) / step
        slopes = tilting.per_px * (lattice.centres_px[lens] - tilting.axis_px)
        tilts = by_rise[:, :, None] * slopes[:, None] * lattice.tilt_uncertainty
    chief = stand.shown.chief
    outwards = chief / np.maximum(np.hypot(*chief.T), 1e-12)[:, None]
    model = MODEL_PX * pixel * outwards[..., None]
    lenses, pupil = found.seen.lenses, stand.shown.pupil
    width = LIGHT * lenses.gap / (2 * lenses.radius)
    waves = DIFFRACTED * width * pupil * np.hypot(*pupil.T)[:, None] / lenses.radius**2
    shared = np.concatenate([shared, tilts, model, waves[..., None]], axis=2)
    return stand.gains @ shared.reshape(-1, 16)


def root(covariance: Array) -> Array:
    """A standard deviation along each axis of a covariance, as columns."""
    variances, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(variances, 0.0)), dtype=np.float64)
