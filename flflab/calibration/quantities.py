"""What white and dot pictures of one setting of the bench say, as seven numbers with their
covariance.

- ``pitch``: of the micro-images, P = p (1 + b/L), mm
- ``outside``, ``inside``: radii of total and bright field, mm
- ``centre_x``, ``centre_y``: the micro-image nearest the sensor's middle, from that middle, mm
- ``parallax``: how far a dot's image moves from one microlens to the next over how far the
  microlenses are apart
- ``magnification``: how far the images of two dots are apart in one micro-image over how far the
  dots are
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.dots.views import DotViews
from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.camera import Camera
from flflab.optics.focus import blur, magnification
from flflab.optics.resolution import central_smms
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]

NAMES = ("pitch", "outside", "inside", "centre_x", "centre_y", "parallax", "magnification")
# how far all dots at the bright fields' edges may be off together, outwards; found with exact
# pictures of dots of 2 px
EDGE_PX = 0.008
OF_WHITE, OF_DOTS = slice(0, 5), slice(5, 7)
# standard uncertainty of the magnification, as a share, that its phase bears: each dot seen once
# tells hardly more
LEAST_KNOWN = 0.1
# how far fitted radii may be off together; 0.005 was found with pictures formed to 0.002 of the
# white level
RADIUS_PX = 0.01


@dataclass(frozen=True)
class Quantities:
    """The seven numbers of one setting.

    Attributes:
        values: in the order of ``NAMES``, shape (7,); nan where no dots were seen.
        covariance: shape (7, 7); infinite there.
        angle: of the lattice against the sensor's rows, rad.
    """

    values: Array
    covariance: Array
    angle: float


def measured_quantities(
    lattice: Lattice,
    dots: tuple[DotViews, ...] | None,
    camera: Camera,
    target: FourDot,
    distance: float,
) -> Quantities:
    """The numbers of one setting from its lattice and its dots.

    Args:
        lattice: of the white picture.
        dots: views of each dot; None where there is no such picture.
        camera: whose pixel and pitch are the rulers; the rest says only how large the dots' images
            are.
        target: the dots.
        distance: main lens to target, mm.
    """
    pixel, middle = camera.sensor.pixel, (np.asarray(camera.sensor.resolution) - 1) / 2
    values, covariance = np.full(7, np.nan), np.diag(np.full(7, np.inf))
    centre = (lattice.origin_px - middle) * pixel
    values[OF_WHITE] = (
        lattice.pitch_px * pixel,
        lattice.outside_radius_px * pixel,
        lattice.inside_radius_px * pixel,
        *centre,
    )
    radii = np.hypot([lattice.outside_uncertainty_px, lattice.inside_uncertainty_px], RADIUS_PX)
    covariance[OF_WHITE, OF_WHITE] = np.diag(
        np.square([lattice.pitch_uncertainty_px, *radii, *lattice.origin_uncertainty_px]) * pixel**2
    )
    if dots is not None:
        smms = central_smms(camera)
        radius = (
            target.diameter / 2 * float(magnification(smms, 1 / distance))
            + float(blur(smms, 1 / distance)) / 2
        )
        values[OF_DOTS], covariance[OF_DOTS, OF_DOTS] = _parallax_and_magnification(
            dots, lattice, camera, target, radius / pixel
        )
    return Quantities(values, covariance, lattice.angle)


def _parallax_and_magnification(
    dots: tuple[DotViews, ...], lattice: Lattice, camera: Camera, target: FourDot, radius_px: float
) -> tuple[Array, Array]:
    """Regress the images' places, as complex numbers, on those of microlenses and dots: z = shift +
    parallax q + magnification o.

    Only images that their micro-image does not cut count. A turn of the target is the phase of its
    factor, and counts for nothing. Both are nan with infinite covariance where there are too few:
    one dot must be seen twice, and two dots at all. Where each is seen once, noise in the lattice
    seems to tell microlenses from dots, and magnification and phase are anything.
    """
    own = (
        lattice.vectors_px / lattice.pitch_px * camera.array.pitch[0]
    )  # as the array lies, rolled with its lattice
    centres = np.concatenate([dot.centres_px for dot in dots])
    indices = np.concatenate([dot.indices for dot in dots])
    o = np.repeat(target.centres @ [1, 1j], [len(dot.indices) for dot in dots])
    u = (
        np.concatenate([dot.centre_uncertainty_px.max(axis=1) for dot in dots])
        * camera.sensor.pixel
    )
    from_middle = np.hypot(*(centres - lattice.origin_px - indices @ lattice.vectors_px.T).T)
    whole = from_middle + radius_px < lattice.inside_radius_px
    z, q, o, u = (
        centres[whole] @ [1, 1j] * camera.sensor.pixel,
        indices[whole] @ own.T @ [1, 1j],
        o[whole],
        u[whole],
    )
    design = np.stack([np.ones_like(q), q, o], axis=1) / u[:, None]
    if (
        len(z) < 4
        or np.linalg.cond(design / np.maximum(np.linalg.norm(design, axis=0), 1e-300)) > 1e6
    ):
        return np.full(2, np.nan), np.diag([np.inf, np.inf])
    inverse = np.linalg.inv(design.conj().T @ design)
    found = inverse @ (design.conj().T @ (z / u))
    chi2 = float(np.sum(np.abs(design @ found - z / u) ** 2)) / max(2 * len(z) - 6, 1)
    values = np.array([found[1].real, np.copysign(abs(found[2]), found[2].real)], dtype=np.float64)
    covariance = np.asarray(inverse[1:, 1:].real * max(1.0, chi2), dtype=np.float64)
    if covariance[1, 1] > (LEAST_KNOWN * values[1]) ** 2:
        return np.full(2, np.nan), np.diag([np.inf, np.inf])
    within = values - [lattice.pitch_px * camera.sensor.pixel / camera.array.pitch[0], 0.0]
    return values, covariance + np.outer(within, within) * (EDGE_PX / lattice.inside_radius_px) ** 2
