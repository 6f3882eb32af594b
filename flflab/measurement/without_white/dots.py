"""The lattice of micro-images from a picture of dots, where there is no white one: within its edge
a dot is as white as a white target.
"""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.dots.find import Found, find_dots
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.profile import cone_of
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.without_white.plain import lattice_within
from flflab.optics.camera import Camera
from flflab.targets import FourDot

# standard uncertainty of radii beside the noise's: full frames with fall-off were off by as much
SURE = 10.0  # standard deviations of a spot's light: fainter ones are not looked at
RADII_PX = 0.15
WORST_PX = 1.0  # uncertainty of the origin
NOMINAL_PX = 4.0  # by which the nominal lattice may be off
WHOLE = 0.99  # of its light: such a spot no aperture cuts
EDGE_PX = 1.5  # of a spot that is not looked at, beside its blur


def lattice_from_dots(
    picture: npt.NDArray[np.generic],
    nominal: Lattice,
    camera: Camera,
    target: FourDot,
    distance: float,
    noise: SensorNoise,
) -> Lattice:
    """Measure the lattice in a picture of dots.

    Args:
        picture: DN, [row, col].
        nominal: the camera's lattice, right to a few pixels, its light to a factor of five: spots
            are at most ten times as bright.
        camera: nominal.
        target: what stood there.
        distance: main lens to target, mm, nominal.
        noise: of the sensor.

    Raises:
        MeasurementError: no dot found where the camera puts some, or too little of them where
            micro-images do not overlap.
    """
    values = np.ascontiguousarray(picture, dtype=np.float32)
    seen = find_dots(values, nominal, camera, target, distance, noise)
    whole = seen.seen.counted & (seen.stand.shown.light > WHOLE)
    # a dot's light over the area of its image
    level = seen.spots.light[whole] / (math.pi * seen.radius_px**2)
    light = float(np.median(level)) if whole.any() else float(nominal.light[0])
    found = lattice_within(
        _plain(values, seen, nominal, noise), nominal, light, noise, cone_of(camera)
    )
    if not np.max(found.origin_uncertainty_px) < WORST_PX:
        raise MeasurementError(
            f"{target.kind} picture: too little of the dots lies where no neighbour's light reaches"
            " to show the lattice"
        )
    inside, outside = (
        math.hypot(one, RADII_PX)
        for one in (found.inside_uncertainty_px, found.outside_uncertainty_px)
    )
    return replace(found, inside_uncertainty_px=inside, outside_uncertainty_px=outside)


def _plain(
    values: npt.NDArray[np.float32], seen: Found, nominal: Lattice, noise: SensorNoise
) -> npt.NDArray[np.float32]:
    """The picture within the spots, but for where a neighbour's total field reaches, in which it is
    not white; all else saturated.

    What is saturated the fit leaves out.
    """
    plain = np.full(values.shape, noise.saturated_dn, dtype=np.float32)
    radius = 2 * seen.radius_px - seen.reach_px - EDGE_PX
    sure = seen.spots.light > SURE * np.sqrt(seen.spots.light_variance)
    steps = (
        np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3) if (i, j) != (0, 0)])
        @ nominal.vectors_px.T
    )
    for (x, y), own in zip(
        seen.chief_px[sure], nominal.centres_px[seen.candidates.lens[sure]], strict=True
    ):
        top, left = max(0, math.ceil(y - radius)), max(0, math.ceil(x - radius))
        window = np.s_[
            top : max(0, math.floor(y + radius) + 1), left : max(0, math.floor(x + radius) + 1)
        ]  # none of it where outside
        rows, columns = np.ogrid[window]
        columns, rows = columns[:, : plain[window].shape[1]], rows[: plain[window].shape[0]]
        alone = np.hypot(columns - x, rows - y) <= radius
        for step in steps:
            alone &= (
                np.hypot(columns - own[0] - step[0], rows - own[1] - step[1])
                > nominal.outside_radius_px + NOMINAL_PX
            )
        plain[window] = np.where(alone, values[window], plain[window])
    return plain
