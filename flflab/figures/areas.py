"""Figures 5 and 6: what the camera measures, in the plane of the row nearest the axis."""

import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from flflab.figures.paper import DARK, INSIDE, OUTSIDE, USEFUL, plain, sheet
from flflab.optics.area import MeasurementArea, measurement_area
from flflab.optics.boundary import useful_rays
from flflab.optics.camera import Camera
from flflab.optics.resolution import stereo as stereo_condition
from flflab.optics.solution import solve_camera
from flflab.optics.useful import row_fields

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]


def _fill(axes: "Axes", area: MeasurementArea, farthest: float, colour: str, label: str) -> None:
    """The polygons over the distance from the main lens, cut at ``farthest`` mm."""
    for polygon in area.polygons:
        cut = _beyond(polygon, 1 / farthest)
        if len(cut):
            axes.fill(
                1 / cut[:, 0],
                cut[:, 1] / cut[:, 0],
                facecolor=colour,
                edgecolor="none",
                label=label,
            )
            label = "_"


def _beyond(polygon: Array, least: float) -> Array:
    """The part of a polygon (V, w) at vergences of at least ``least``."""
    kept: list[Array] = []
    for here, after in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if here[0] >= least:
            kept.append(here)
        if (here[0] - least) * (after[0] - least) < 0:
            kept.append(here + (least - here[0]) / (after[0] - here[0]) * (after - here))
    return np.array(kept)


def stereo(camera: Camera) -> tuple["Figure", str]:
    """Figure 5: where at least two SMMSs see, bounded by useful chief rays."""
    row, found = row_fields(camera), stereo_condition(camera)
    limit = found.nearest if found.nearest else found.farthest
    sharp = solve_camera(camera).sharp_distance
    farthest = 2 * (
        sharp if sharp is not None and math.isfinite(sharp) else 10 * camera.main_lens.focal_length
    )
    if limit is not None and found.nearest:
        farthest = max(farthest, 1.5 * limit)
    says = {
        True: (
            f"On the axis of the row two chief rays meet from {limit:.1f} mm on (dashed)."
            if limit
            else ""
        ),
        False: (
            f"Two chief rays meet up to {limit:.1f} mm (dashed)."
            if limit
            else f"Here {found.reason}."
        ),
    }[bool(found.nearest)]
    caption = (
        f"The stereo condition at F/{camera.main_lens.f_number:g}, in the plane of the row: grey,"
        " what one SMMS at least sees by its useful chief rays, blue, what two or more see and"
        " depth can be reconstructed for. Orange, the outer useful chief rays of every third SMMS."
        f" {says} Round the array's own conjugate the area is toothed: points there are seen by one"
        " microlens each."
    )
    figure = sheet(caption, height=5.2)
    axes = figure.subplots()
    for views, colour, label in (
        (1, "#dddddd", "seen by one SMMS"),
        (2, "#9ecae1", "seen by two or more"),
    ):
        _fill(
            axes, measurement_area(camera, "total", views, anywhere=True), farthest, colour, label
        )
    rays = useful_rays(row.smms, row.useful)
    reach = np.array([0.0, farthest])
    for index in range(0, len(row.centre), 3):
        heights = rays.main_lens[index, :, None] + rays.object_slope[index, :, None] * reach
        heights = heights[rays.exists[index]]
        if len(heights):
            for chosen in (int(heights[:, 1].argmin()), int(heights[:, 1].argmax())):
                axes.plot(reach, heights[chosen], color=OUTSIDE, linewidth=0.6)
    if limit is not None:
        axes.axvline(limit, color=DARK, linestyle="--", linewidth=1)
    axes.set_xlim(0, farthest)
    visible = [
        _beyond(part, 1 / farthest)
        for part in measurement_area(camera, "total", 1, anywhere=True).polygons
    ]
    top = max(
        (float(np.abs(part[:, 1] / part[:, 0]).max()) for part in visible if len(part)),
        default=10.0,
    )
    axes.set_ylim(-1.05 * top, 1.05 * top)
    axes.legend(frameon=False, fontsize=9, loc="upper left")
    plain(axes, "", "distance in front of the main lens, mm", "y, mm")
    return figure, caption


def measurement(camera: Camera) -> tuple["Figure", str]:
    """Figure 6: the measurement area limited by useful chief rays, stereo condition and depth of
    field.
    """
    solution = solve_camera(camera)
    finite = [(near, far) for near, far in solution.depth_of_field if math.isfinite(far)]
    by_total, by_chief = measurement_area(camera, "total"), measurement_area(camera, "chief")
    size = by_total.reason or (
        f"{by_total.size():.0f} mm^2 in this plane"
        if math.isfinite(by_total.size())
        else "reaching infinity"
    )
    chief = by_chief.reason or (
        f"{by_chief.size():.0f} mm^2" if math.isfinite(by_chief.size()) else "reaching infinity"
    )
    caption = (
        f"The measurement area at F/{camera.main_lens.f_number:g}: {size}. Blue, points that two"
        " SMMSs or more see (as in Figure 5); green, those of them inside the depth of field of"
        " one pixel's blur (dashed): depth of field, not stereo vision, makes the area narrow. On"
        " the right the same piece enlarged, and outlined in it what two chief rays reach:"
        f" {chief}."
    )
    figure = sheet(caption, height=5.2)
    whole, close = figure.subplots(1, 2)
    ends = finite or [(5 * camera.main_lens.focal_length, 15 * camera.main_lens.focal_length)]
    near, far = ends[0][0], ends[-1][1]
    span = far - near
    for axes, low, high in ((whole, 0.0, 2 * far), (close, near - 0.6 * span, far + 0.6 * span)):
        _fill(
            axes,
            measurement_area(camera, "total", anywhere=True),
            high,
            "#c6dbef",
            "seen by two or more",
        )
        _fill(axes, by_total, high, USEFUL, "measurement area")
        for one in ends:
            for edge in one:
                axes.axvline(edge, color=DARK, linestyle="--", linewidth=1)
        axes.set_xlim(low, high)
    for polygon in by_chief.polygons:
        ring = np.concatenate([polygon, polygon[:1]])
        if np.all(ring[:, 0] > 0):
            close.plot(1 / ring[:, 0], ring[:, 1] / ring[:, 0], color=INSIDE, linewidth=1)
    tallest = max(
        (
            float(np.abs(part[:, 1] / part[:, 0]).max())
            for part in by_total.polygons
            if np.all(part[:, 0] > 0)
        ),
        default=0.0,
    )
    if tallest > 0:
        close.set_ylim(-1.25 * tallest, 1.25 * tallest)
        whole.set_ylim(-2.4 * tallest, 2.4 * tallest)
    whole.legend(frameon=False, fontsize=8, loc="upper left")
    plain(whole, "In front of the camera", "distance in front of the main lens, mm", "y, mm")
    plain(close, "Enlarged along the axis", "distance in front of the main lens, mm", "y, mm")
    return figure, caption
