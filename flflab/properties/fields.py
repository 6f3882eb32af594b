"""The micro-images themselves: widths of bright and total field, pitch, and how far neighbours overlap."""

import math

import numpy as np

from flflab.optics.camera import Camera
from flflab.properties.measured import Measured
from flflab.properties.predicted import Predicted
from flflab.properties.values import Values, single


def fields(one: Measured, model: Predicted) -> list[Values]:
    """Bright and total field (full widths w_m -+ w_q) and the pitch p (1 + b/L) of the micro-images, mm on the sensor."""
    lattice, pixel = one.lattice, model.camera.sensor.pixel
    where = one.configuration.index
    inside, outside, pitch = lattice.inside_uncertainty_px, lattice.outside_uncertainty_px, lattice.pitch_uncertainty_px
    return [
        single(where, "bright_field_mm", "white", 2 * lattice.inside_radius_px * pixel, 2 * inside * pixel, 2 * model.inside_radii),
        single(where, "total_field_mm", "white", 2 * lattice.outside_radius_px * pixel, 2 * outside * pixel, 2 * model.outside_radii),
        single(where, "image_pitch_mm", "white", lattice.pitch_px * pixel, pitch * pixel, model.pitches),
    ]


def overlap(one: Measured, model: Predicted) -> Values:
    """By how much neighbouring micro-images overlap, mm; negative: the gap between them."""
    lattice, pixel = one.lattice, model.camera.sensor.pixel
    doubt = math.hypot(2 * lattice.outside_uncertainty_px, lattice.pitch_uncertainty_px)
    draws = 2 * model.outside_radii - model.pitches
    measured = (2 * lattice.outside_radius_px - lattice.pitch_px) * pixel
    return single(one.configuration.index, "overlap_mm", "white", measured, doubt * pixel, draws)


def useful_row(camera: Camera, inside: np.ndarray, outside: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Length of the useful intervals along the row nearest the axis, mm, for a uniform array in the middle of the sensor.

    Half width u = min(h - tau (h - i), P - h) about every centre k P, cut by the sensor's edges (physics' useful interval); as a length
    and not as a number of pixels, so that it has derivatives.

    Args:
        camera: whose sensor and useful region count.
        inside: half width i of the bright field, mm, shape (n,).
        outside: half width h of the total field, mm, shape (n,).
        pitch: of the micro-images P, mm, shape (n,).
    """
    half = np.minimum(outside - camera.useful.minimum_illumination * (outside - inside), pitch - outside)
    sensor = camera.sensor.resolution[0] * camera.sensor.pixel / 2
    first = -(camera.array.count[0] - 1) / 2
    centres = (first + np.arange(camera.array.count[0])) * pitch[:, None]
    low, high = np.clip(centres - half[:, None], -sensor, sensor), np.clip(centres + half[:, None], -sensor, sensor)
    return np.maximum(high - low, 0.0).sum(axis=1)
