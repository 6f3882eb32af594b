"""A camera file begun from a white picture: what the picture gives, with its standard uncertainty;
what it cannot give is left to be filled in.
"""

import math

import numpy as np

from flflab.digits import plus_minus, two_digits
from flflab.measurement.lattice.kernel import WIDER
from flflab.measurement.white import MeasuredWhite
from flflab.measurement.white_json import figures_of

OPEN = "to be filled in"


def begun_camera(
    found: MeasuredWhite, picture: str, pixel: float | None, pitch: float | None
) -> str:
    """Text of a camera file.

    Args:
        found: the white picture, measured without a camera file.
        picture: its name.
        pixel: size of the sensor's pixels, mm; None where it is not known.
        pitch: of the microlens array, mm; None where it is not known.
    """
    rows, columns = found.picture.shape
    figures = figures_of(found.white, found.picture.shape)
    pitch_px, angle, *origin = (float(one) for one in figures.values)
    sure = np.hypot(figures.own, figures.common)
    turned = two_digits(math.degrees(float(sure[1])))
    across, down = _count(found)
    seen_mm = "" if pixel is None else f", {1e3 * pitch_px * pixel:.7g} um on the sensor"
    ratio = None if pixel is None or pitch is None else pitch_px * pixel / pitch
    lines = [
        f"# Begun from the white picture {picture}: what it shows stands here with its standard",
        f'# uncertainty; what it cannot show is "{OPEN}". flflab model FILE names these lines.',
        "# Distances are measured from the main lens along the axis.",
        "main_lens:",
        f"  focal_length: {OPEN}  # as engraved, such as 50 mm",
        f"  f_number: {OPEN}  # as the iris stood for this picture, such as 4",
        "microlens_array:",
        f"  layout: {found.white.grid.layout}  # as seen",
        f"  count: [{across}, {down}]  # as many as the picture shows: columns, rows",
        f"  # micro-images lie ({plus_minus(pitch_px, float(sure[0]))}) px apart{seen_mm}",
        f"  pitch: {_length(pitch)}" + (f"  # {_narrower(pixel)}" if pitch is None else ""),
        *_spots(found, pixel),
        f"  aperture: {OPEN}  # clear diameter of one microlens",
        *_kinds(found),
        f"  focal_length: {OPEN}  # of a microlens",
        f"  distance: {OPEN}  # from the main lens",
        *_offset(origin, sure, pitch_px, pitch, (rows, columns)),
        f"  roll: {math.degrees(angle):.5f} deg  # ± {turned} deg",
        "sensor:",
        f"  resolution: [{columns}, {rows}]  # columns, rows",
        f"  pixel: {_length(pixel)}",
        *_farther(ratio, float(sure[0]) / pitch_px),
        f"  distance: {OPEN}  # from the main lens",
        "aperture_shape: round",
    ]
    return "\n".join(lines) + "\n"


def _length(value: float | None) -> str:
    return OPEN if value is None else f"{1e3 * value:.10g} um"


def _narrower(pixel: float | None) -> str:
    return "the maker's" + ("" if pixel is None else "; a little less than on the sensor")


def _count(found: MeasuredWhite) -> tuple[int, int]:
    """Columns and rows of microlenses that are seen, odd so that one stands in the middle."""
    grid = found.white.grid
    places = found.white.indices[found.white.found] @ grid.vectors_px.T
    along = grid.vectors_px[:, 0] / np.hypot(*grid.vectors_px[:, 0])
    between = float(np.hypot(*grid.vectors_px[:, 0]))
    rows = abs(float(np.linalg.det(grid.vectors_px))) / between
    spans = np.ptp(places @ along) / between, np.ptp(places @ [-along[1], along[0]]) / rows
    across, down = (round(float(span)) + 1 for span in spans)
    return across + 1 - across % 2, down + 1 - down % 2


def _spots(found: MeasuredWhite, pixel: float | None) -> list[str]:
    """What is seen of the micro-images' size."""
    radius = found.white.profile.radius
    whole = found.white.values[found.white.whole, WIDER]
    there = "" if pixel is None else f" ({2e3 * radius * pixel:.5g} um)"
    return [
        f"  # micro-images are {2 * radius:.5g} px{there} wide at half of their light, and scatter"
        f" by {two_digits(2 * float(np.std(whole)))} px"
    ]


def _kinds(found: MeasuredWhite) -> list[str]:
    if found.types.count == 1:
        return []
    radius = found.white.profile.radius + found.white.values[:, WIDER]
    mine = found.types.of_each[found.white.whole]
    sizes = ", ".join(
        f"{float(np.median(radius[found.white.whole][mine == kind])):.4g}"
        for kind in range(found.types.count)
    )
    return [
        f"  # {found.types.count} kinds of microlens are seen, of radius {sizes} px: give a list of"
        " focal lengths, and a pattern"
    ]


def _offset(
    origin: list[float],
    sure: np.ndarray,
    pitch_px: float,
    pitch: float | None,
    shape: tuple[int, int],
) -> list[str]:
    """Where the middle microlens stands, taken from the middle of the picture as the axis."""
    away = [at - (size - 1) / 2 for at, size in zip(origin, shape[::-1], strict=True)]
    doubt = two_digits(float(sure[2]))
    seen = f"({away[0]:.5g}, {away[1]:.5g}) px from the picture's middle, ± {doubt} px"
    if pitch is None:
        return [f"  # the micro-image nearest to it lies {seen}"]
    x, y = (1e3 * one * pitch / pitch_px for one in away)
    return [f"  offset: [{x:.6g} um, {y:.6g} um]  # {seen}, where the axis is taken to be"]


def _farther(ratio: float | None, sure: float) -> list[str]:
    """How distances of array and sensor are related: pitches are as they are."""
    if ratio is None:
        return []
    return [f"  # {plus_minus(ratio, sure * ratio)} times the distance of the microlens array"]
