"""A white picture measured blind: every micro-image by itself, and the lattice through them."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.errors import MeasurementError
from flflab.measurement.lattice.find import RoughLattice, find_lattice
from flflab.measurement.lattice.fitted import border_of, fitted_near, inside, require_enough
from flflab.measurement.lattice.grid import Grid, grid_through
from flflab.measurement.lattice.index import looks_right, unlike_most
from flflab.measurement.lattice.kernel import X, Y
from flflab.measurement.lattice.mean_profile import Profile
from flflab.measurement.lattice.spread import Spread
from flflab.measurement.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

NEXT = 1.2  # pitches: neighbours
RIM = 0.05  # of the light: where a micro-image ends
OF_MISFIT = 0.4  # of what the profile does not explain, which may move a rim
UNKNOWN_SLOPE = 0.02  # of the light over a radius, where slopes are not told from shifts
FINEST_PX = 0.003  # pixels do not answer alike over their area


@dataclass(frozen=True)
class WhitePicture:
    """A white picture as measured.

    Attributes:
        rough: what was found blind.
        indices: of every micro-image that any part of is seen, shape (n, 2).
        values: of each, as ``kernel`` names them, shape (n, VALUES).
        found: which were seen well enough to be measured.
        whole: which lie wholly on the picture.
        profile: the light across them.
        spread: how sure the values are.
        sloping: whether slopes of the light were told from shifts.
        grid: the lattice through the whole ones.
        definition_px: standard uncertainty of all centres' coordinates by what counts as the centre
            of light that is not as the profile has it.
        misfit: rms of what is left of the light, as a share of it.
    """

    rough: RoughLattice
    indices: Whole
    values: Array
    found: Flags
    whole: Flags
    profile: Profile
    spread: Spread
    sloping: bool
    grid: Grid
    definition_px: float
    misfit: float

    @property
    def usual(self) -> Flags:
        """Which of the whole ones keep to the lattice."""
        keeping = self.whole.copy()
        keeping[np.flatnonzero(self.whole)[self.grid.off]] = False
        return keeping


def measure_white(
    picture: npt.NDArray[np.float32], noise: SensorNoise, rough: RoughLattice | None = None
) -> WhitePicture:
    """Measure every micro-image of a white picture, of which nothing but the noise is known.

    Args:
        picture: DN, [row, col].
        noise: of the sensor.
        rough: lattice of the micro-images where it is known; None finds it.

    Raises:
        MeasurementError: no lattice of bright micro-images is in it, or fewer than six whole ones.
    """
    rough = find_lattice(picture) if rough is None else rough
    _require_contrast(rough, noise)
    fitted, shape = fitted_near(picture, noise, rough), picture.shape
    indices, values, profile, doubt = fitted.indices, fitted.values, fitted.profile, fitted.spread
    border = border_of(values, fitted.found, shape, profile, rough.pitch)
    there = inside(values, shape, min(border, profile.reaches(RIM) + 0.5))
    found = fitted.found & looks_right(values, doubt, profile, rough.pitch)
    whole = found & there
    require_enough(whole)
    whole &= ~unlike_most(values, doubt, profile, whole)
    definition = math.hypot(OF_MISFIT * fitted.misfit * profile.softness, FINEST_PX)
    if not fitted.sloping:
        shifted = float(np.median(np.abs(doubt.by_slope[whole])))
        definition = math.hypot(definition, UNKNOWN_SLOPE * shifted)
    own = np.sqrt(doubt.covariance[:, [X, Y], [X, Y]])
    # a bent lattice is not followed into unlit surrounds
    near, _ = KDTree(values[whole, :2]).query(values[:, :2], 3)
    beyond, amid = near[:, 0] < NEXT * rough.pitch, near[:, 2] < NEXT * rough.pitch
    grid = grid_through(
        rough.layout,
        indices[whole],
        values[whole, :2],
        own[whole],
        [indices[whole | there & amid], indices[inside(values, shape, 0.0) & beyond]],
        definition,
    )
    return WhitePicture(
        rough,
        indices,
        values,
        found,
        whole,
        profile,
        doubt,
        fitted.sloping,
        grid,
        definition,
        fitted.misfit,
    )


def _require_contrast(rough: RoughLattice, noise: SensorNoise) -> None:
    """Refuse what repeats less than the noise of a pixel."""
    spread = math.sqrt(float(noise.variance(rough.light + rough.background)))
    if rough.light < spread:
        raise MeasurementError(
            f"white picture: it is even; what repeats in it is {rough.light / spread:.1g} standard"
            " deviations of one pixel's noise, and more than 1 is due; is the microlens array in"
            " the camera?"
        )
