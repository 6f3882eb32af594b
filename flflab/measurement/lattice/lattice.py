"""Where the micro-images lie, as a camera with its file has them: the lattice of chief rays, the
circles of bright and total field, light, fall-off and tilt.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.kinds import Kinds
from flflab.measurement.lattice.profile import Cone
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
        cone: how rays land, as was taken; None where fall-off and tilt were left out.
        slants: share of the fall-off within a micro-image, slope (x, y) of the middle ray at the
            origin and how it grows per px.
        tilt: slope of the array's plane along (x, y).
        tilt_uncertainty: of both.
        kinds: of microlenses, as wide as seen, the radii being the central one's; None where there
            is one, or they were taken for one.
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
    cone: Cone | None = None
    slants: Array = field(default_factory=lambda: np.zeros(4))
    tilt: Array = field(default_factory=lambda: np.zeros(2))
    tilt_uncertainty: Array = field(default_factory=lambda: np.zeros(2))
    light_uncertainty_dn: float = 0.0
    kinds: Kinds | None = None
    common_px: Array | None = None
    followed: Array | None = None
    doubts_px: Array | None = None
    radii_apart_px: float = 0.0
    misfit: float = 0.0

    @property
    def sure_tilt(self) -> Array:
        """The tilt, or none where noise shows as much once in a hundred pictures: microlenses that
        do not rise are then the better guess.
        """
        doubt = np.maximum(self.tilt_uncertainty, 1e-12)
        return self.tilt if float(np.sum((self.tilt / doubt) ** 2)) > SURE else np.zeros(2)

    @property
    def rises(self) -> Array:
        """How much further each microlens lies from the main lens than the axis's, as a share of
        that distance; 0 without a tilt that is sure.
        """
        if self.cone is None:
            return np.zeros(len(self.centres_px))
        tilting, tilt = self.cone.tilting, self.sure_tilt
        return tilting.rises(tilting.straightened(self.centres_px, tilt), tilt)

    @property
    def discs_px(self) -> Array:
        """Radii of larger and smaller disc of every micro-image, shape (N, 2): sum and difference
        are outside and inside.
        """
        radii = (
            np.array(
                [
                    self.outside_radius_px + self.inside_radius_px,
                    self.outside_radius_px - self.inside_radius_px,
                ]
            )
            / 2
        )
        if self.cone is None:
            return np.tile(radii, (len(self.centres_px), 1))
        if self.kinds is None:
            return self.cone.tilting.discs(radii, self.rises)
        return self.kinds.discs(
            radii, self.kinds.of(self.centres_px), self.cone.tilting, self.rises
        )
