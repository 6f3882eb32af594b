"""How far from the centre of a micro-image a detector finds a point: what measured numbers of views
are numbers of.

Light reaches a view as far as the total field goes; a detector loses it on the way. One curve is
fitted to all frames, and says how many views it finds of every point.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from flflab.observations.points import Flags, SeenPoints
from flflab.observations.prediction import image_angles
from flflab.observations.reading import Array, Numbers
from flflab.optics.camera import Camera
from flflab.optics.smms import camera_smms
from flflab.optics.views import chief_crossings

SHARPEST = 0.05
"""Least softness that is fitted, in pixels: a detector that finds all within and none beyond has
none.
"""


@dataclass(frozen=True)
class PossibleViews:
    """Views whose chief ray lands on the sensor within the total field of its micro-image; M of
    them.

    Attributes:
        owner: point of each, shape (M,).
        from_centre: predicted distance from the centre of the micro-image, mm, shape (M,).
        found: whether the detector found it, shape (M,).
    """

    owner: Numbers
    from_centre: Array
    found: Flags


@dataclass(frozen=True)
class Detector:
    """The share of views found at distance d from the centre: 1 / (1 + exp((d - reach) /
    softness)).

    Attributes:
        reach: where half of the views are found, mm.
        softness: how slowly the share falls there, mm.
        expected: views to be found of each point, shape (P,).
        scatter: standard deviation of (found - expected) / sqrt(expected) of points about their
            frame's own ratio.
    """

    reach: float
    softness: float
    expected: Array
    scatter: float

    def share(self, from_centre: Array) -> Array:
        """Share of views found so far from the centre, mm."""
        return expit((self.reach - from_centre) / self.softness)

    def z(self, found: int, expected: float) -> float:
        """Found less expected views over the scatter of as many views."""
        return (found - expected) / (self.scatter * float(np.sqrt(expected)))


def possible_views(camera: Camera, seen: SeenPoints, position: Array) -> PossibleViews:
    """Every view that light can reach, of points at (x, y, D), shape (P, 3)."""
    smms = camera_smms(camera)
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1)
    middle, field = smms.image_scale[:, None] * centre, smms.outside_radius
    half = np.array(camera.sensor.resolution) * camera.sensor.pixel / 2
    angles = image_angles(camera, position)
    owner, far, found = [], [], []
    order = np.argsort(seen.owner, kind="stable")
    members = np.split(seen.microlens[order], np.cumsum(seen.views)[:-1])
    for number, (distance, angle) in enumerate(zip(position[:, 2], angles, strict=True)):
        landing = chief_crossings(smms, 1 / distance, angle, centre)[2]
        from_centre = np.linalg.norm(landing - middle, axis=1)
        on_sensor = (np.abs(landing - camera.sensor.offset) <= half).all(axis=1)
        possible = np.flatnonzero((from_centre <= field) & on_sensor)
        owner.append(np.full(len(possible), number))
        far.append(from_centre[possible])
        found.append(np.isin(possible, members[number]))
    return PossibleViews(np.concatenate(owner), np.concatenate(far), np.concatenate(found))


def fit_detector(possible: PossibleViews, seen: SeenPoints, pixel: float) -> Detector:
    """Reach and softness of greatest likelihood, one of each for all frames.

    Args:
        possible: views that light can reach.
        seen: the points they belong to.
        pixel: pixel size, mm.
    """
    distance = possible.from_centre / pixel
    sign = np.where(possible.found, 1.0, -1.0)

    def unlikelihood(p: Array) -> float:
        return float(np.sum(np.logaddexp(0.0, sign * (distance - p[0]) / p[1])))

    start = np.array([np.quantile(distance[possible.found], 0.9), 1.0])
    bounds = [(0.0, None), (SHARPEST, None)]
    reach, softness = minimize(unlikelihood, start, bounds=bounds, method="Nelder-Mead").x
    share = expit((reach - distance) / softness)
    points = len(seen.frame)
    expected = np.maximum(np.bincount(possible.owner, share, points), 1e-3)
    ratio = np.empty(points)
    for frame in np.unique(seen.frame):
        of = seen.frame == frame
        ratio[of] = seen.views[of].sum() / expected[of].sum()
    about = (seen.views - ratio * expected) / np.sqrt(expected)
    freedom = points - len(np.unique(seen.frame))
    scatter = float(np.sqrt(np.sum(about**2) / freedom)) if freedom > 0 else np.nan
    return Detector(reach * pixel, softness * pixel, expected, scatter)
