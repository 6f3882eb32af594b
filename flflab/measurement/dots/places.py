"""Where in space fitted dots stand, and what makes their places unsure: each dot's own spots, and
what all dots of the picture share.
"""

import numpy as np
import numpy.typing as npt

from flflab.measurement.dots.find import Found
from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.focus import microlens_limits
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]

# of all spots together, outwards: pictures by rays show as much, rms
MODEL_PX = 0.0005
# what waves make of cut spots beside another focus: of the width of diffraction, in light of this
# wavelength, mm, times the square of where it comes through the microlens over its radius
DIFFRACTED, LIGHT = 0.1, 550e-6
WIDEST = 0.05  # of the vergence: what is less sure is no depth
# how many columns each has
CAUSES = {"focus": 1, "lattice": 12, "tilt": 2, "model": 1, "diffraction": 1}


def places_of(found: Found, shared: Array) -> list[tuple[Array, Array, Array, Array]]:
    """Those of all dots. The camera counts as known.

    Args:
        found: the dots.
        shared: as ``shared_by_all`` gives it.

    Returns:
        ``position_mm``, ``uncertainty_mm``, ``common_mm`` and ``by_lens_mm`` of ``DotViews`` for
        each; all nan where its views leave it open.
    """
    stand, lenses = found.stand, found.stand.by_lens
    rest = stand.covariance - lenses @ lenses.T
    focus = rest[:, -1] / np.sqrt(rest[-1, -1])
    own = rest - np.outer(focus, focus)
    shared = np.concatenate([focus[:, None], shared], axis=1)
    camera = found.seen.lenses.camera
    limited = bool(microlens_limits(central_smms(camera), 1 / found.distance))
    views = np.bincount(found.seen.dot[found.seen.counted], minlength=len(stand.values))
    placed: list[tuple[Array, Array, Array, Array]] = []
    for dot, (x, y, vergence) in enumerate(stand.values):
        part, far = slice(3 * dot, 3 * dot + 3), 1 / vergence
        alone = own[part, part] + lenses[part] @ lenses[part].T
        known = limited and views[dot] > 1 and np.sqrt(alone[2, 2]) < WIDEST * abs(vergence)
        # world: x = (o V)/V, y likewise, z = -1/V
        by = np.array([[far, 0.0, -x * far**2], [0.0, far, -y * far**2], [0.0, 0.0, far**2]])
        by = by if known else np.full((3, 3), np.nan)
        common = by @ shared[part]
        variance = np.diag(by @ alone @ by.T) + (common**2).sum(axis=1)
        position = np.array([x, y, -1.0]) * (far if known else np.nan)
        by_lens = (by @ lenses[part]).reshape(3, -1, 3)
        placed.append((position, np.sqrt(variance), common, by_lens))
    return placed


def shared_by_all(found: Found, lattice: Lattice) -> Array:
    """How the dots' numbers move with a standard uncertainty of lattice, tilt, model and
    diffraction; shape (3 dots + 1, 16).
    """
    stand, lens, lenses = found.stand, found.seen.lens, found.seen.lenses
    pixel = lenses.camera.sensor.pixel
    moves = np.zeros((len(lens), 2, 6))
    for n in range(2):
        moves[:, n, n], moves[:, n, 2 + n :: 2] = 1.0, lattice.indices[lens]
    by_lattice = pixel * stand.by_centre @ moves
    shared = np.zeros((len(lens), 2, 16))
    if np.isfinite(lattice.covariance_px).all():
        common = lattice.covariance_px if lattice.common_px is None else lattice.common_px
        followed = np.ones(len(lens)) if lattice.followed is None else lattice.followed[lens]
        alone = by_lattice @ root(lattice.covariance_px - common)
        shared[..., :6], shared[..., 6:12] = by_lattice @ root(common), alone
        shared[..., 6:12] *= followed[:, None, None]
    if lattice.axis is not None:
        by_tilt = lattice.axis.away(lattice.centres_px[lens]) * lattice.tilt_uncertainty
        shared[..., 12:14] = stand.by_rise[:, :, None] * by_tilt[:, None]
    chief, pupil = stand.shown.chief, stand.shown.pupil
    shared[..., 14] = MODEL_PX * pixel * chief / np.maximum(np.hypot(*chief.T), 1e-12)[:, None]
    smms = central_smms(lenses.camera)
    width = LIGHT * float(smms.gap / smms.aperture)
    aside = pupil / float(smms.aperture / 2)
    shared[..., 15] = DIFFRACTED * width * aside * np.hypot(*aside.T)[:, None]
    return stand.gains @ shared.reshape(-1, 16)


def root(covariance: Array) -> Array:
    """A standard deviation along each axis of a covariance, as columns."""
    variances, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(variances, 0.0)), dtype=np.float64)
