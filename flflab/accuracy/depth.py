"""How wrong the triangulated depth of a dot is against its distance: by the model in closed form,
and measured on simulated frames.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.accuracy.measure import NOISE, WHITE_DN
from flflab.errors import InputError, MeasurementError
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.dots.spots import BESIDE_PX
from flflab.measurement.dots.views import DotViews, count_views
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.focus import blur, magnification, microlens_limits, sharp_vergence
from flflab.optics.neighbours import neighbours_of
from flflab.optics.resolution import central_smms
from flflab.optics.smms import camera_smms, image_offset
from flflab.optics.useful import fields_of
from flflab.optics.views import chief_crossings, seen_by
from flflab.targets import FourDot, White

Array = npt.NDArray[np.float64]

STEPS = 4  # distances on either side of focus
PLACES = (
    (0.1, 0.2),
    (0.4, 0.3),
    (0.3, 0.05),
    (0.2, 0.45),
)  # of the target sideways; 1 moves its views by a microlens
DOT_PX, APART = 16.0, 8.0  # width of a dot's image in focus; spacing of the dots in diameters
FARTHEST = 10.0  # times the distance in focus
TOLERANCE = 2e-4  # of the pictures; finer ones change errors by a fiftieth of what is stated


@dataclass(frozen=True)
class Row:
    """The depth of dots at one distance; errors in mm along the axis.

    Attributes:
        distance_mm: main lens to target.
        blur_px: width of the geometric blur on the sensor.
        model_views: of a dot, by the model, mean of all.
        views: measured, mean of all dots and frames.
        model_mm: standard uncertainty by the model: noise in the centroids of the dot's images,
            parallax over their views.
        stated_mm: standard uncertainty that the measurement states, root mean square; None where no
            depth was found.
        rms_error_mm: achieved.
        bias_mm: mean error, towards the camera positive.
        gap_mm_per_um: by how much the depth is wrong for each micrometre by which the camera file's
            gap is.
        depths: how many were measured.
    """

    distance_mm: float
    blur_px: float
    model_views: float
    views: float
    model_mm: float | None
    stated_mm: float | None
    rms_error_mm: float | None
    bias_mm: float | None
    gap_mm_per_um: float
    depths: int


def depth_rows(camera: Camera, tell: Callable[[str], None]) -> tuple[Row, ...]:
    """From where the blur is as wide as a dot's image on the near side to where it is so on the far
    side.

    Args:
        camera: whose depth is asked for; its array of one kind of microlenses.
        tell: is told what is being done.

    Raises:
        InputError: the camera is sharp at no real distance.
        MeasurementError: its white picture cannot be measured.
    """
    distances, target = _distances(camera)
    tell("white picture")
    white = _exposed(camera, White(), distances[0])
    rng = np.random.default_rng(1)
    lattice = lattice_behind(camera, _noisy(white, rng), NOISE)
    rows: list[Row] = []
    for distance in distances:
        tell(f"dots at {distance:.0f} mm")
        places = np.array(PLACES) * camera.array.pitch * distance / camera.array.distance
        seen: list[DotViews] = []
        for place in places:
            picture = _noisy(
                _exposed(camera, target, distance, (float(place[0]), float(place[1]))), rng
            )
            try:
                seen += count_views(picture, lattice, camera, target, distance, NOISE)
            except MeasurementError:
                continue  # no dot to be found: no depth
        dots = (places[:, None] + target.centres).reshape(-1, 2)
        rows.append(
            _row(
                camera,
                distance,
                [depth_by_model(camera, target, dot, distance, NOISE) for dot in dots],
                seen,
            )
        )
    return tuple(rows)


def _distances(camera: Camera) -> tuple[list[float], FourDot]:
    """Distances spaced evenly in vergence, that in focus among them, and dots that suit them."""
    smms = central_smms(camera)
    sharp = float(sharp_vergence(smms))
    if not (math.isfinite(sharp) and sharp > 0):
        raise InputError(
            "depth: this camera is sharp at no real distance; change the sensor's or the array's"
            " distance"
        )
    diameter = DOT_PX * camera.sensor.pixel / float(magnification(smms, sharp))
    ends: list[float] = []
    for factors in (np.geomspace(1.0, FARTHEST, 800), np.geomspace(1.0, 1 / FARTHEST, 800)):
        tried = sharp * factors
        good = (blur(smms, tried) <= diameter * magnification(smms, tried)) & microlens_limits(
            smms, tried
        )
        ends.append(
            float(tried[max(0, int(np.argmin(good)) - 1)]) if not good.all() else float(tried[-1])
        )
    near, far = ends
    vergences = np.concatenate(
        [np.linspace(near, sharp, STEPS + 1)[:-1], np.linspace(sharp, far, STEPS + 1)]
    )
    return (1 / np.unique(vergences)[::-1]).tolist(), FourDot(diameter, APART * diameter)


def _exposed(
    camera: Camera,
    target: FourDot | White,
    distance: float,
    place: tuple[float, float] = (0.0, 0.0),
) -> Array:
    return NOISE.offset_dn + WHITE_DN * render(
        one_plane(camera, target, distance, place), tolerance=TOLERANCE
    )


def _noisy(picture: Array, rng: np.random.Generator) -> npt.NDArray[np.float32]:
    noise = rng.standard_normal(picture.shape, dtype=np.float32)
    return (picture + noise * np.sqrt(NOISE.variance(picture))).astype(np.float32)


def _row(
    camera: Camera, distance: float, expected: Sequence[tuple[int, float]], seen: Sequence[DotViews]
) -> Row:
    smms, vergence = central_smms(camera), 1 / distance
    known = [dot for dot in seen if math.isfinite(dot.uncertainty_mm[2])]
    errors = np.array([dot.position_mm[2] + distance for dot in known])
    stated = np.array([dot.uncertainty_mm[2] for dot in known])
    spreads = np.array([spread for _, spread in expected if math.isfinite(spread)])
    by_gap = (
        distance**2
        * abs(float(image_offset(smms, vergence)))
        / float(smms.gap * (smms.distance + smms.gap))
    )
    return Row(
        distance_mm=distance,
        blur_px=float(blur(smms, vergence)) / camera.sensor.pixel,
        model_views=float(np.mean([views for views, _ in expected])),
        views=float(np.mean([dot.views for dot in seen])) if seen else 0.0,
        model_mm=_rms(spreads),
        stated_mm=_rms(stated),
        rms_error_mm=_rms(errors),
        bias_mm=float(errors.mean()) if len(errors) else None,
        gap_mm_per_um=1e-3 * by_gap,
        depths=len(known),
    )


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def depth_by_model(
    camera: Camera, target: FourDot, place: Array, distance: float, noise: SensorNoise
) -> tuple[int, float]:
    """Views of a dot and the standard uncertainty of its depth, mm, before any picture is taken;
    nan with fewer than two views.

    The dot is seen in the micro-image centred at c at s; by (s - c) L V + b (o V) = -(b/L) Q - (s -
    c)(1 - L/F) the parallax s - c gives V with the uncertainty u |x| / (L sqrt(sum |(s - c) -
    mean|^2)), u that of each s in one coordinate and x = L V + 1 - L/F.

    Args:
        camera: nominal, of one kind of microlenses.
        target: whose dot it is.
        place: of the dot, mm, shape (2,).
        distance: main lens to target, mm.
        noise: of the sensor; white is ``WHITE_DN``.
    """
    every, vergence, smms = camera_smms(camera), 1 / distance, central_smms(camera)
    members = np.arange(len(every.gap))
    angle = np.broadcast_to(place * vergence, (len(members), 2))
    views = seen_by(
        fields_of(every, neighbours_of(every, camera), camera), members, vergence, angle
    )[2]
    centres = np.stack([every.centre_x, every.centre_y], axis=1)
    landing = chief_crossings(every, vergence, angle, centres, camera.aperture_shape)[2]
    away = (landing - centres * every.image_scale[:, None])[views]
    if len(away) < 2:
        return len(away), math.nan
    radius = target.diameter / 2 * float(magnification(smms, vergence)) / camera.sensor.pixel
    each = (
        centroid_noise(radius, float(blur(smms, vergence)) / camera.sensor.pixel, noise)
        * camera.sensor.pixel
    )
    lever = float(smms.distance) * math.sqrt(float(((away - away.mean(axis=0)) ** 2).sum()))
    return len(away), distance**2 * each * abs(float(image_offset(smms, vergence))) / lever


def centroid_noise(radius: float, width: float, noise: SensorNoise) -> float:
    """Standard deviation of one coordinate of the centroid of a dot's light within its window, px.

    Args:
        radius: of the dot's image, px.
        width: of its blur, px.
        noise: of the sensor; white is ``WHITE_DN``.
    """
    light = WHITE_DN * math.pi * radius**2
    by_light = noise.dn_per_electron * light * (radius**2 + (width / 2) ** 2) / 4
    window = radius + width / 2 + BESIDE_PX
    return math.sqrt(by_light + noise.dark_variance * math.pi * window**4 / 4) / light
