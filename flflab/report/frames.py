"""Recorded frames for the report: cropped to what is lit, stretched, with the lattice and the views
of every dot marked.
"""

import base64
import math
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from flflab.measurement.dots.views import DotViews
from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.focus import magnification
from flflab.optics.illumination import illumination_radius
from flflab.optics.resolution import central_smms
from flflab.optics.smms import camera_smms
from flflab.optics.useful import select
from flflab.optics.views import chief_crossings
from flflab.targets import FourDot
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint16]
Place = tuple[float, float]
Agreement = Literal["agreed", "missed", "extra"]
WIDEST = 1000  # pixels of a picture in the page
DIRECTIONS = 96  # corners of the outline of a useful region


@dataclass(frozen=True)
class Mark:
    """A view of a dot at (x, y) sensor pixels: seen and predicted, missed (predicted only) or extra
    (seen only).
    """

    dot: int
    x: float
    y: float
    agreement: Agreement


@dataclass(frozen=True)
class MarkedFrame:
    """A part of a frame with what is drawn over it; all in sensor pixels.

    Attributes:
        image: the picture as a data URI.
        left: column of the part's first pixel.
        top: row of the part's first pixel.
        width: columns.
        height: rows.
        centres: of the micro-images in it.
        inside: radius of the bright field.
        outside: radius of the total field.
        useful: outline of the useful region round a centre.
        marks: views.
        mark_radius: how large to draw them.
        scale: length of the scale bar.
        scale_words: the same on the sensor, ``0.5 mm``.
    """

    image: str
    left: int
    top: int
    width: int
    height: int
    centres: list[Place]
    inside: float
    outside: float
    useful: list[Place]
    marks: tuple[Mark, ...]
    mark_radius: float
    scale: float
    scale_words: str


def predicted_view_places(
    model: Predicted, lattice: Lattice, dot: int, point: Array
) -> tuple[npt.NDArray[np.int64], Array]:
    """Where the predicted views of a dot should lie in the measured lattice.

    Args:
        model: prediction of the configuration.
        lattice: measured.
        dot: its number.
        point: its place on the target, (x, y) mm.

    Returns:
        Measured lattice indices (n, 2) and positions (n, 2) in pixels: the predicted offset from
        the micro-image's centre, laid on the measured centre, so that the array's unknown place
        sideways does not matter.
    """
    members = model.view_indices[dot]
    smms = select(camera_smms(model.camera), members)
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1)
    _, _, landing = chief_crossings(smms, 1 / model.distance, point / model.distance, centre)
    image_centre = centre * smms.image_scale[:, None]
    sensor = model.camera.sensor
    nominal = (image_centre - np.asarray(sensor.offset)) / sensor.pixel + (
        np.asarray(sensor.resolution) - 1
    ) / 2
    nearest = np.array(
        [int(np.argmin(np.hypot(*(lattice.centres_px - one).T))) for one in nominal], dtype=np.int64
    )
    return (
        lattice.indices[nearest],
        lattice.centres_px[nearest] + (landing - image_centre) / sensor.pixel,
    )


def view_marks(seen: DotViews, lattice_indices: npt.NDArray[np.int64], places: Array) -> list[Mark]:
    """Seen and predicted views of one dot, paired by micro-image."""
    expected = {
        (int(i), int(j)): place for (i, j), place in zip(lattice_indices, places, strict=True)
    }
    marks: list[Mark] = []
    for (i, j), (x, y) in zip(seen.indices, seen.centres_px, strict=True):
        agreed = expected.pop((int(i), int(j)), None) is not None
        marks.append(Mark(seen.dot, float(x), float(y), "agreed" if agreed else "extra"))
    return marks + [Mark(seen.dot, float(x), float(y), "missed") for x, y in expected.values()]


def useful_outline(lattice: Lattice, model: Predicted) -> list[Place]:
    """Useful region round a micro-image's centre by the measured circles: lit enough, and free of
    the neighbours' light.

    The radius of the least illumination lies between the inside and the outside circle; its share
    of the way is the model's.
    """
    rules, smms = model.camera.useful, central_smms(model.camera)
    ramp = max(float(smms.outside_radius - smms.inside_radius), 1e-12)

    def radius(share: float) -> float:
        part = float((illumination_radius(smms, share) - smms.inside_radius) / ramp)
        return lattice.inside_radius_px + part * (
            lattice.outside_radius_px - lattice.inside_radius_px
        )

    angle = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    rays = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    reach, blocked = (
        np.full(DIRECTIONS, radius(rules.minimum_illumination)),
        radius(rules.maximum_crosstalk),
    )
    for i in (-2, -1, 0, 1, 2):
        for j in (-2, -1, 0, 1, 2):
            step = lattice.vectors_px @ np.array([i, j], dtype=np.float64)
            along, aside = rays @ step, np.abs(rays @ np.array([-step[1], step[0]]))
            met = (along > 0) & (aside < blocked)
            reach[met] = np.minimum(
                reach[met], np.maximum(along[met] - np.sqrt(blocked**2 - aside[met] ** 2), 0)
            )
    return [(float(x), float(y)) for x, y in rays * reach[:, None]]


def dots_frame(picture: Picture, one: Measured, model: Predicted, target: FourDot) -> MarkedFrame:
    """The dots' frame round all views, seen or predicted."""
    marks: list[Mark] = []
    for seen in one.dots:
        indices, places = predicted_view_places(
            model, one.lattice, seen.dot, target.centres[seen.dot]
        )
        marks += view_marks(seen, indices, places)
    height, width = picture.shape
    margin = one.lattice.outside_radius_px + 8
    if marks:
        x, y = np.array([mark.x for mark in marks]), np.array([mark.y for mark in marks])
        low, high = np.array([x.min(), y.min()]) - margin, np.array([x.max(), y.max()]) + margin
    else:
        low, high = np.zeros(2), np.array([width, height], dtype=np.float64)
    size = (
        target.diameter
        * float(magnification(central_smms(model.camera), 1 / model.distance))
        / model.camera.sensor.pixel
    )
    radius = max(size, model.blur_px) / 2 + 0.02 * one.lattice.pitch_px
    pixel = model.camera.sensor.pixel
    useful = useful_outline(one.lattice, model)
    return _frame(picture, one.lattice, low, high, useful, tuple(marks), radius, pixel)


def bars_frame(picture: Picture, one: Measured, model: Predicted) -> MarkedFrame:
    """Three by three micro-images of the bars' frame round the middle, every pixel shown."""
    reach = np.full(2, 1.5 * one.lattice.pitch_px)
    low, high = one.lattice.origin_px - reach, one.lattice.origin_px + reach
    pixel = model.camera.sensor.pixel
    return _frame(picture, one.lattice, low, high, useful_outline(one.lattice, model), (), 0, pixel)


def _frame(
    picture: Picture,
    lattice: Lattice,
    low: Array,
    high: Array,
    useful: list[Place],
    marks: tuple[Mark, ...],
    mark_radius: float,
    pixel: float,
) -> MarkedFrame:
    height, width = picture.shape
    left, top = (int(edge) for edge in np.maximum(np.floor(low), 0))
    right, bottom = int(min(np.ceil(high[0]), width)), int(min(np.ceil(high[1]), height))
    near = lattice.outside_radius_px
    away = lattice.centres_px - np.clip(lattice.centres_px, [left, top], [right, bottom])
    shown = lattice.centres_px[np.hypot(*away.T) < near]
    scale_mm = scale_length((right - left) * pixel)
    return MarkedFrame(
        image=as_jpeg(picture[top:bottom, left:right]), left=left, top=top, width=right - left,
        height=bottom - top,
        centres=[(float(x), float(y)) for x, y in shown], inside=lattice.inside_radius_px,
        outside=near, useful=useful,
        marks=marks, mark_radius=mark_radius, scale=scale_mm / pixel,
        scale_words=f"{scale_mm:g} mm" if scale_mm >= 0.1 else f"{1e3 * scale_mm:g} µm",
    )  # fmt: skip


def scale_length(width: float) -> float:
    """The longest of 1, 2, 5, 10 ... that is at most a quarter of a width."""
    power = 10.0 ** math.floor(math.log10(width / 4))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= width / 4)


def as_jpeg(part: Picture) -> str:
    """A part of a frame as a data URI, black to the brightest thousandth, square root of
    brightness, at most 1000 pixels wide.
    """
    black, white = float(part.min()), float(np.percentile(part, 99.9))
    shown = (
        np.sqrt(np.clip((part.astype(np.float32) - black) / max(white - black, 1.0), 0, 1)) * 255
    )
    shrink = min(1.0, WIDEST / max(part.shape))
    if shrink < 1:
        size = (max(1, round(part.shape[1] * shrink)), max(1, round(part.shape[0] * shrink)))
        shown = cv2.resize(shown, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", np.rint(shown).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 82])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")
