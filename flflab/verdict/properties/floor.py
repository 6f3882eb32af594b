"""The floor of a measurement: what the bench file states that no frame and no pixel averages away.

Each is one error a frame and quantity, the same for all numbers of it: every contrast of a curve is
off together, every position along the frame in proportion to where it lies (what would shift them
all alike moves no property), every radius by the same. A fifth of it may differ from one contrast,
and from one dot, to the next: what shading and a halo leave is no exact scale.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.alignment import Attitude
from flflab.bench_uncertainty import MeasurementFloorDescription
from flflab.measurement.contrast.curve import ContrastCurve
from flflab.measurement.dots.scale import DotScale
from flflab.measurement.dots.views import DotViews
from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.camera import Camera
from flflab.optics.resolution import central_smms
from flflab.optics.smms import image_offset
from flflab.verdict.properties.measured import Measured, as_placed

Array = npt.NDArray[np.float64]

APART = 0.2  # of a floor: by how much single numbers of a frame may be off otherwise


def with_floor(one: Measured, floor: MeasurementFloorDescription, optics: Camera) -> Measured:
    """What was measured, with the floor in all uncertainties.

    Args:
        one: as measured.
        floor: as the bench file states it.
        optics: the bench's camera.
    """
    camera, distance = as_placed(one.configuration, optics, one.worlds)
    position = floor.position
    return replace(
        one,
        lattice=_lattice(one.lattice, position, floor.radius),
        attitude=None if one.attitude is None else _attitude(one.attitude, one.lattice, position),
        dots=tuple(_dot(dot, camera, distance, position) for dot in one.dots),
        curve=None if one.curve is None else _curve(one.curve, one.lattice, floor),
        curve_y=None if one.curve_y is None else _curve(one.curve_y, one.lattice, floor),
        dot_scale=_scale(one, position),
    )


def _curve(
    curve: ContrastCurve, lattice: Lattice, floor: MeasurementFloorDescription
) -> ContrastCurve:
    """A curve whose bars may lie ``position`` px off, rms, in proportion to where they lie in a
    view; half a radius is the rms place in a disc along one coordinate.
    """
    share = floor.position / max(lattice.inside_radius_px / 2, 1.0)
    moved = np.array([0.0, share, 0.0, share, 0.0]) * curve.geometry
    apart = APART**2 * np.eye(len(curve.covariance))
    return replace(
        curve,
        covariance=curve.covariance + floor.contrast**2 * (1 + apart),
        extremes_uncertainty=np.hypot(curve.extremes_uncertainty, floor.contrast),
        geometry_uncertainty=np.hypot(curve.geometry_uncertainty, moved),
    )


def _scale(one: Measured, position: float) -> DotScale | None:
    """The square of dots, whose images may lie ``position`` px off, rms, in proportion to how far
    they lie from their micro-images' centres.
    """
    if one.dot_scale is None or position == 0:
        return one.dot_scale
    at = {(int(i), int(j)): n for n, (i, j) in enumerate(one.lattice.indices)}
    away = np.concatenate(
        [
            dot.centres_px - one.lattice.centres_px[[at[int(i), int(j)] for i, j in dot.indices]]
            for dot in one.dots
            if len(dot.indices)
        ]
    )
    share = position / _spread(away)
    return replace(one.dot_scale, size_uncertainty=np.hypot(one.dot_scale.size_uncertainty, share))


def _spread(places: Array) -> float:
    """Root mean square distance of places from their middle along one coordinate."""
    if len(places) < 2:
        return np.inf
    return float(np.sqrt(np.mean((places - places.mean(axis=0)) ** 2)))


def _lattice(lattice: Lattice, position: float, radius: float) -> Lattice:
    turn = position / _spread(lattice.centres_px)
    pitch = turn * lattice.pitch_px
    sizes = np.zeros((3, 3))
    sizes[:2, :2], sizes[2, 2] = radius**2, pitch**2
    return replace(
        lattice,
        pitch_uncertainty_px=float(np.hypot(lattice.pitch_uncertainty_px, pitch)),
        angle_uncertainty=float(np.hypot(lattice.angle_uncertainty, turn)),
        origin_uncertainty_px=np.hypot(lattice.origin_uncertainty_px, position),
        inside_uncertainty_px=float(np.hypot(lattice.inside_uncertainty_px, radius)),
        outside_uncertainty_px=float(np.hypot(lattice.outside_uncertainty_px, radius)),
        sizes_covariance_px=lattice.sizes_covariance_px + sizes,
    )


def _attitude(attitude: Attitude, lattice: Lattice, position: float) -> Attitude:
    turned = np.diag([(position / _spread(lattice.centres_px)) ** 2, 0.0, 0.0])
    return replace(attitude, covariance=attitude.covariance + turned)


def _dot(dot: DotViews, camera: Camera, distance: float, position: float) -> DotViews:
    """A dot whose views may lie ``position`` px off, rms, in proportion to where they lie.

    The views of a dot lie b/((L + b) |x|) of their micro-images' distances aside of the centres,
    and D = L/(x - 1 + L/F). One view counted is a neighbour of those too dark to count, by which
    its depth is known.
    """
    if position == 0:
        return dot
    smms = central_smms(camera)
    step = camera.array.pitch[0] * float(smms.image_scale) / camera.sensor.pixel
    seen = dot.centres_px if len(dot.centres_px) > 1 else np.array([[0.0, 0.0], [step, 0.0]])
    x = float(image_offset(smms, 1 / distance))
    whole, gap = float(smms.distance + smms.gap), float(smms.gap)
    share = position / _spread(seen) * whole * abs(x) / gap
    depth = distance**2 / float(smms.distance) * abs(x) * share
    aside = np.abs(dot.position_mm[:2]) * depth / distance
    moved = np.array([*aside, depth])
    return replace(
        dot,
        uncertainty_mm=np.hypot(dot.uncertainty_mm, np.hypot(1, APART) * moved),
        common_mm=np.concatenate([dot.common_mm, moved[:, None]], axis=1),
    )
