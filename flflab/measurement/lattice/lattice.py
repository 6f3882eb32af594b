"""Where the micro-images lie, as a camera with its file has them: the lattice of chief rays, the
circles of bright and total field, light, fall-off and tilt.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.tilting import Axis
from flflab.optics.camera import Layout

Array = npt.NDArray[np.float64]

SURE = 9.2  # square of a tilt over its variance that noise alone exceeds in 1 % of pictures


@dataclass(frozen=True)
class Lattice:
    """Where the micro-images lie; pixels, (x, y), the top-left pixel's centre is (0, 0).

    Attributes:
        layout: square or hexagonal.
        pitch_px: distance between nearest neighbours, of chief rays.
        angle: from the columns' axis towards +y, modulo 90 degrees (hexagonal 60), nearest zero;
            rad.
        origin_px: the centre nearest the sensor's, shape (2,).
        vectors_px: lattice vectors a, b as columns, of a tilted array on the axis, shape (2, 2).
        indices: (i, j) of every micro-image of which any part is seen: centre = origin + i a + j b
            but for a tilt, a bend and where its microlens stands; shape (N, 2).
        centres_px: where their chief rays through the main lens's middle land, shape (N, 2).
        inside_radius_px: radius of the bright field, of a tilted array on the axis.
        outside_radius_px: radius of the total field, the same.
        pitch_uncertainty_px: standard uncertainties of the above follow.
        angle_uncertainty: rad.
        origin_uncertainty_px: shape (2,).
        inside_uncertainty_px: of the inside radius.
        outside_uncertainty_px: of the outside radius.
        covariance_px: of (origin x, y, a x, y, b x, y), shape (6, 6).
        sizes_covariance_px: of (inside radius, outside radius, pitch), shape (3, 3).
        light: polynomial of the light over the picture (1, x, y, x^2, x y, y^2), DN; x and y in
            half the longer side.
        axis: of the camera; None where a tilt was left out.
        fall_off: share of natural fall-off within micro-images.
        tilt: slope of the array's plane along (x, y).
        tilt_uncertainty: of both.
        light_uncertainty_dn: of the light in the middle of the picture.
        common_px: what of ``covariance_px`` moves the lattice and all centres alike, shape (6, 6);
            None: all of it.
        followed: share by which each centre follows the lattice, not its own light, shape (N,);
            None: 1.
        doubts_px: standard uncertainty of each centre by itself, shape (N,); None: 0.
        radii_apart_px: standard deviation from lens to lens of the radius of that disc which
            scatters more: half of by what their blurs differ.
        misfit: rms of what the two discs leave of the light, as a share of it.
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
    light: Array
    axis: Axis | None = None
    fall_off: float = 0.0
    tilt: Array = field(default_factory=lambda: np.zeros(2))
    tilt_uncertainty: Array = field(default_factory=lambda: np.zeros(2))
    light_uncertainty_dn: float = 0.0
    common_px: Array | None = None
    followed: Array | None = None
    doubts_px: Array | None = None
    radii_apart_px: float = 0.0
    misfit: float = 0.0

    @property
    def rises(self) -> Array:
        """How much further each microlens lies from the main lens than the axis's, as a share of
        that distance, shape (N,); 0 where noise shows as much tilt once in a hundred pictures:
        microlenses that do not rise are then the better guess.
        """
        doubt = np.maximum(self.tilt_uncertainty, 1e-12)
        sure = float(np.sum((self.tilt / doubt) ** 2)) > SURE
        if self.axis is None or not sure:
            return np.zeros(len(self.centres_px))
        straight = self.axis.straightened(self.centres_px, self.tilt)
        return np.asarray(self.axis.away(straight) @ self.tilt, dtype=np.float64)
