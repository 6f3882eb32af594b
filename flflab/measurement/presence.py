"""Whether a picture shows what is to be measured at all: light, how much, not too much of it, and
dots where dots were found.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.dots.views import DotViews
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import blur_px
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.focus import magnification
from flflab.optics.resolution import central_smms
from flflab.targets import FourDot, Target

LIT = 5.0  # standard deviations of a dark pixel
MOST_SATURATED = 0.5  # of all pixels; more leaves nothing between dark and full
LEAST_STEP = 0.5  # of a dot's light: how much darker its surroundings are


def require_light(values: npt.NDArray[np.floating], noise: SensorNoise, target: Target) -> None:
    """Refuse a picture without light or without anything else.

    Raises:
        MeasurementError: see there.
    """
    high = float(np.quantile(values, 0.9999) - noise.offset_dn) / math.sqrt(noise.dark_variance)
    if high <= LIT:
        raise MeasurementError(
            f"{target.kind} picture: it is dark, its light rises to {max(high, 0.0):.2g} standard"
            f" deviations of the noise between its pixels, and more than {LIT:g} are due; expose it"
            " longer"
        )
    saturated = float(np.mean(noise.saturated(values)))
    if saturated > MOST_SATURATED:
        raise MeasurementError(
            f"{target.kind} picture: {100 * saturated:.0f} % of its pixels are saturated,"
            f" {100 * MOST_SATURATED:.0f} % are allowed; expose it shorter"
        )


def brightest_light(values: npt.NDArray[np.floating], noise: SensorNoise) -> float:
    """Light of the brightest thing larger than two pixels, DN above the offset, 1 at least.

    No share of all pixels tells it: four dots may cover a few in ten thousand. A single hot pixel
    does not count.
    """
    among_neighbours = cv2.medianBlur(np.ascontiguousarray(values, dtype=np.float32), 3)
    return max(float(among_neighbours.max()) - noise.offset_dn, 1.0)


def require_dots(
    values: npt.NDArray[np.floating],
    dots: Sequence[DotViews],
    camera: Camera,
    target: FourDot,
    distance: float,
    noise: SensorNoise,
) -> None:
    """Refuse views that are no brighter than what surrounds them.

    Args:
        values: DN, [row, col].
        dots: as found in it.
        camera: nominal.
        target: the dots.
        distance: main lens to target, mm.
        noise: of a pixel.

    Raises:
        MeasurementError: no view, or half of them or more are no spots of light.
    """
    smms, pixel = central_smms(camera), camera.sensor.pixel
    radius = target.diameter / 2 * float(magnification(smms, 1 / distance)) / pixel
    soft = blur_px(camera, distance) / 2 + 1
    centres = np.concatenate([dot.centres_px for dot in dots])
    if len(centres) == 0:
        raise MeasurementError(
            "four-dot picture: no view of any dot was found; check target, distance and exposure"
        )
    far = math.ceil(radius + soft + 3)
    y, x = np.mgrid[-far : far + 1, -far : far + 1]
    spots = 0
    for column, row in np.rint(centres).astype(np.int64):
        rows, columns = (
            np.clip(row + y, 0, values.shape[0] - 1),
            np.clip(column + x, 0, values.shape[1] - 1),
        )
        light, away = values[rows, columns] - noise.offset_dn, np.hypot(x, y)
        inside, outside = light[away <= max(radius - soft, 1.0)], light[away >= radius + soft]
        spread = math.sqrt(noise.dark_variance * (1 / len(inside) + 1 / len(outside)))
        spots += bool(
            inside.mean() - outside.mean() > max(LEAST_STEP * inside.mean(), LIT * spread)
        )
    if spots <= len(centres) / 2:
        raise MeasurementError(
            f"four-dot picture: where dots are due, {len(centres) - spots} of {len(centres)} places"
            " are no spots of light on a darker ground; check target, distance and exposure"
        )


def require_blur_within(lattice: Lattice, camera: Camera, distance: float) -> None:
    """Refuse dots of whose blur no bright field holds any, on a lattice that does not show how
    light falls off: it draws all spots aside.

    Raises:
        MeasurementError: see there.
    """
    blur = blur_px(camera, distance) / 2
    if blur > lattice.inside_radius_px:
        raise MeasurementError(
            f"four-dot picture: no bright field, {lattice.inside_radius_px:.1f} px in radius, holds"
            f" the dots' blur, {blur:.1f} px, and such dots do not show how light falls off in"
            " micro-images, which would change their distance by 2 %; name a picture of a white"
            " target taken alike (--white)"
        )
