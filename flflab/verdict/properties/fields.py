"""The micro-images themselves: widths of bright and total field, pitch, and how far neighbours
overlap.
"""

import numpy as np

from flflab.optics.camera import Camera
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Shared, Values, single


def fields(one: Measured, model: Predicted) -> list[Values]:
    """Bright and total field (full widths w_m -+ w_q) and the pitch p (1 + b/L) of the
    micro-images, mm on the sensor.
    """
    lattice, pixel = one.lattice, model.camera.sensor.pixel
    where = one.configuration.index
    found = [
        ("bright_field_mm", 2 * lattice.inside_radius_px, 2 * model.inside_radii),
        ("total_field_mm", 2 * lattice.outside_radius_px, 2 * model.outside_radii),
        ("image_pitch_mm", lattice.pitch_px, model.pitches),
    ]
    # all three are of one fit: light at the rim may mean a wider total field or a narrower bright
    # one
    variances, axes = np.linalg.eigh(
        lattice.sizes_covariance_px * np.outer([2, 2, 1], [2, 2, 1]) * pixel**2
    )
    by = axes * np.sqrt(np.maximum(variances, 0.0))
    return [
        single(
            where,
            name,
            "white",
            size * pixel,
            float(np.hypot.reduce(by[k])),
            draws,
            Shared(f"lattice {where}", by[k : k + 1]),
        )
        for k, (name, size, draws) in enumerate(found)
    ]


def overlap(one: Measured, model: Predicted) -> Values:
    """By how much neighbouring micro-images overlap, mm; negative: the gap between them."""
    lattice, pixel = one.lattice, model.camera.sensor.pixel
    by_sizes = np.array([0.0, 2.0, -1.0])
    doubt = float(np.sqrt(by_sizes @ lattice.sizes_covariance_px @ by_sizes))
    draws = 2 * model.outside_radii - model.pitches
    measured = (2 * lattice.outside_radius_px - lattice.pitch_px) * pixel
    return single(one.configuration.index, "overlap_mm", "white", measured, doubt * pixel, draws)


def useful_row(
    camera: Camera, inside: np.ndarray, outside: np.ndarray, pitch: np.ndarray
) -> np.ndarray:
    """Length of the useful intervals along the row nearest the axis, mm, for a uniform array in the
    middle of the sensor.

    Half width u = min(h - tau (h - i), P - h) about every centre k P, cut by the sensor's edges
    (physics' useful interval); as a length and not as a number of pixels, so that it has
    derivatives.

    Args:
        camera: whose sensor and useful region count.
        inside: half width i of the bright field, mm, shape (n,).
        outside: half width h of the total field, mm, shape (n,).
        pitch: of the micro-images P, mm, shape (n,).
    """
    half = np.minimum(
        outside - camera.useful.minimum_illumination * (outside - inside), pitch - outside
    )
    sensor = camera.sensor.resolution[0] * camera.sensor.pixel / 2
    first = -(camera.array.count[0] - 1) / 2
    centres = (first + np.arange(camera.array.count[0])) * pitch[:, None]
    low, high = (
        np.clip(centres - half[:, None], -sensor, sensor),
        np.clip(centres + half[:, None], -sensor, sensor),
    )
    return np.maximum(high - low, 0.0).sum(axis=1)
