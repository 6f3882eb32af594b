"""The microlenses behind a picture: where the white picture has their micro-images, and where they
stand on the array by that.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.depth_map.chief_places import edge_width, predicted_white
from flflab.depth_map.geometry import KAPPA_STEPS
from flflab.errors import MeasurementError
from flflab.measurement.lattice.kernel import LIGHT, SOFTER, X, Y
from flflab.measurement.lattice.plausible import require_white
from flflab.measurement.lattice.registration import sensor_pixel, sensor_position
from flflab.measurement.lattice.white_picture import measure_white
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, microlens_centres, microlens_types

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

KNOWN_PX = 0.5  # a centre less certain than this tells nothing of its own
LEAST_SCATTER_PX = 0.005  # of microlenses about their lattice, px
FEWEST = 8  # microlenses of a type, for a median
MOST_SCATTER = 0.15  # robust, of the edges' widths of one type
MEDIAN_OVER_MEAN = 1.25  # of their standard errors
# relative: how well the width of edges tells kappa without comparison, in pictures by plain rays
EDGES_ALONE = 0.005
AT_ODDS = 3.0  # standard uncertainties from which on something else softens the edges
UNLIKE = 0.02  # of the pitch: more is another camera's white picture


@dataclass(frozen=True)
class WhiteLenses:
    """What a white picture says about every microlens; one entry each.

    Attributes:
        index: (i, j) in the lattice, shape (n, 2).
        place: where its chief ray through the main lens's centre meets the sensor, (x, y) in px,
            shape (n, 2).
        place_uncertainty: standard uncertainty of each coordinate, px, shape (n,).
        softness: width of its vignetting edge over that of the predicted white picture, shape
            (n,); NaN where not known.
        light: white level, DN, shape (n,).
        type: index into the camera's focal lengths, shape (n,).
    """

    index: Whole
    place: Array
    place_uncertainty: Array
    softness: Array
    light: Array
    type: Whole


def lenses_of_white(
    white: npt.NDArray[np.floating], noise: SensorNoise, camera: Camera
) -> WhiteLenses:
    """Every micro-image of a white picture: the one place that knows how a lattice is found.

    Args:
        white: DN, [row, col].
        noise: of the sensor.
        camera: which type stands where, and how fall-off moves the light, are taken from it.

    Raises:
        MeasurementError: there is no lattice in the picture, or that of another camera.
    """
    numbers = np.ascontiguousarray(white, dtype=np.float32)
    saturated = float(np.mean(numbers >= noise.saturated_dn))
    found = measure_white(numbers, noise)
    require_white(found, saturated)
    _require_pitch(found.grid.vectors_px, camera)
    spread = np.sqrt(np.trace(found.spread.covariance[:, :2, :2], axis1=1, axis2=2) / 2)
    known = found.found & np.isfinite(spread) & (spread < KNOWN_PX)
    # each centre as sure as its light makes it, beside the lattice as sure as lenses keep to it
    own = np.where(known, spread, KNOWN_PX) ** 2
    apart = max(found.grid.scatter_px, LEAST_SCATTER_PX) ** 2
    share = (apart / (apart + own))[:, None]
    seen = share * found.values[:, [X, Y]] + (1 - share) * found.grid.centres(found.indices)
    due = predicted_white(camera)
    middle = sensor_position(camera.sensor, seen) / camera.sensor.pixel
    return WhiteLenses(
        index=found.indices,
        place=seen - due.excess * middle,
        place_uncertainty=np.sqrt(apart * own / (apart + own)),
        softness=np.where(
            known, np.exp(found.values[:, SOFTER]) * edge_width(found.profile) / due.edge_px, np.nan
        ),
        light=found.values[:, LIGHT],
        type=_types(seen, camera),
    )


def _require_pitch(vectors_px: Array, camera: Camera) -> None:
    array = camera.array
    cell = math.sqrt(abs(float(np.linalg.det(vectors_px))))
    shape = math.sqrt(math.sqrt(3) / 2) if array.layout == "hexagonal" else 1.0
    scale = 1 + camera.optical_gap / camera.optical_distance
    due = shape * math.sqrt(array.pitch[0] * array.pitch[1]) * scale / camera.sensor.pixel
    if abs(cell / due - 1) > UNLIKE:
        raise MeasurementError(
            f"white picture: its micro-images lie {cell / shape:.2f} px apart, the camera file"
            f" makes it {due / shape:.2f} px; take the white picture of this camera, or check"
            " pitch, pixel and distances in the file"
        )


def _types(seen: Array, camera: Camera) -> Whole:
    """Type of the microlens that the camera's description has nearest to each micro-image."""
    if len(camera.array.focal_lengths) == 1:
        return np.zeros(len(seen), dtype=np.int64)
    scale = 1 + camera.optical_gap / camera.optical_distance
    nominal = sensor_pixel(camera.sensor, microlens_centres(camera.array) * scale)
    _, nearest = KDTree(nominal).query(seen)
    return microlens_types(camera.array)[nearest]


@dataclass(frozen=True)
class Lenses:
    """Microlenses as the kernels take them, in order of ``y``; lengths in pixels of the sensor.

    Attributes:
        x: centre on the array, from the axis, shape (n,).
        y: the same.
        column: of the micro-image's centre on the sensor, px.
        row: the same.
        kind: index into ``kinds_of_microlens``.
        kappa_factor: its kappa over that of its type.
        rise: how much further from the main lens than the array's middle.
        variance: of the micro-image's centre along each axis, px^2.
        kappa_doubt: standard uncertainty, relative, of kappa that all microlenses of a type share.
    """

    x: Array
    y: Array
    column: Array
    row: Array
    kind: Whole
    kappa_factor: Array
    rise: Array
    variance: Array
    kappa_doubt: float


def lenses_on_array(white: WhiteLenses, camera: Camera) -> Lenses:
    """Where microlenses stand by their micro-images, y = c/(1 + b/L), each with its own L and b
    where the array is tilted.
    """
    on_sensor = sensor_position(camera.sensor, white.place)
    rise = np.zeros(len(on_sensor))
    stand = on_sensor
    for _ in range(3):
        distance = camera.optical_distance + rise
        stand = on_sensor / (1 + (camera.optical_gap - rise) / distance)[:, None]
        rise = stand @ np.asarray(camera.array.tilt)
    kind, factor, doubt = _kinds(white)
    order = np.argsort(stand[:, 1], kind="stable")
    pixel = camera.sensor.pixel
    return Lenses(
        x=stand[order, 0] / pixel,
        y=stand[order, 1] / pixel,
        column=white.place[order, 0].copy(),
        row=white.place[order, 1].copy(),
        kind=kind[order],
        kappa_factor=factor[order],
        rise=rise[order] / pixel,
        variance=white.place_uncertainty[order] ** 2,
        kappa_doubt=doubt,
    )


def _kinds(white: WhiteLenses) -> tuple[Whole, Array, float]:
    """Kind of every microlens, its kappa over that of its type, and how uncertain, relative, what
    all of a type share is.

    A vignetting edge is as wide as d |kappa|, so one that is 2 % wider than its type's has a kappa
    2 % larger. Where the edges scatter more than lenses can, they are not known well enough and
    every lens gets its type's kappa. The median kappa is that of the camera file but for chance,
    and as wide as the edges are: both count by how sure they are. Where they are at odds, something
    else softens the edges, and only their ratios count.
    """
    steps = np.asarray(KAPPA_STEPS)
    kind = white.type * len(steps) + len(steps) // 2
    factor = np.ones(len(kind))
    doubt = 0.0
    for one in np.unique(white.type):
        own = (white.type == one) & np.isfinite(white.softness)
        count = np.count_nonzero(own)
        if count < FEWEST:
            continue
        width = white.softness[own]
        median = float(np.median(width))
        spread = 1.48 * float(np.median(np.abs(width / median - 1)))
        chance = MEDIAN_OVER_MEAN * spread / count**0.5
        if spread > MOST_SCATTER:
            doubt = max(doubt, chance)
            continue
        shared, unsure = _middle(median, chance)
        relative = np.clip(shared * width / median - 1, steps[0], steps[-1])
        kind[own] = one * len(steps) + np.argmin(np.abs(relative[:, None] - steps), axis=1)
        factor[own] = 1 + relative
        doubt = max(doubt, unsure)
    return kind, factor, doubt


def _middle(median: float, chance: float) -> tuple[float, float]:
    """Median kappa over its type's and its standard uncertainty, by the median width of edges."""
    if abs(median - 1) > AT_ODDS * math.hypot(chance, EDGES_ALONE):
        return 1.0, chance
    share = chance**2 / (chance**2 + EDGES_ALONE**2)
    return 1 + share * (median - 1), math.sqrt(share) * EDGES_ALONE
