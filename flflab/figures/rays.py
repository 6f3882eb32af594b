"""Figures 1 to 4 and 8: rays through the camera, drawn from the model's own crossings."""

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from flflab.figures.paper import (
    DARK,
    GREY,
    INSIDE,
    OUTSIDE,
    SMMS_COLOURS,
    USEFUL,
    overlapping_camera,
    plain,
    sheet,
)
from flflab.optics.boundary import Rays, boundary_rays, parallel_are_inside, useful_rays
from flflab.optics.brightness import limiting_half_width
from flflab.optics.camera import Camera
from flflab.optics.focus import limiting_aperture, marginal_angle
from flflab.optics.per_type import sharp_distance
from flflab.optics.resolution import central_smms
from flflab.optics.smms import Smms, image_offset, row_illumination
from flflab.optics.useful import RowFields, row_fields, select, sensor_edges

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]


def _target_distance(camera: Camera) -> float:
    """Where the camera is sharp; ten focal lengths where that is nowhere or at infinity."""
    found = sharp_distance(central_smms(camera))
    return (
        found if found is not None and math.isfinite(found) else 10 * camera.main_lens.focal_length
    )


def _elements(
    axes: "Axes", camera: Camera, row: RowFields, sensor: tuple[float, float], lens: bool = True
) -> None:
    """Main lens as a double arrow with its stop, microlenses as short ones, the sensor as a thick
    line.
    """
    length, end = camera.optical_distance, camera.optical_distance + camera.optical_gap
    if lens:
        half = camera.main_lens.aperture / 2
        axes.annotate(
            "",
            (0, half),
            (0, -half),
            arrowprops={"arrowstyle": "<->", "color": DARK, "linewidth": 1.4},
        )
    for centre in row.smms.centre_x:
        edges = float(centre) + np.array([-0.5, 0.5]) * camera.array.aperture
        axes.plot([length, length], edges, color=DARK, linewidth=2.0, solid_capstyle="butt")
    axes.plot([end, end], sensor, color=GREY, linewidth=3.0, solid_capstyle="butt")


def _draw(
    axes: "Axes", smms: Smms, rays: Rays, index: int, number: int, reach: float, **style: object
) -> None:
    """One ray of one SMMS from ``reach`` mm before the main lens (0: from it) to the sensor."""
    length, gap = float(smms.distance[index]), float(smms.gap[index])
    m, q, s = (float(part[index, number]) for part in (rays.main_lens, rays.microlens, rays.sensor))
    before = m + reach * float(rays.object_slope[index, number])
    axes.plot([-reach, 0, length, length + gap], [before, m, q, s], **style)  # pyright: ignore[reportArgumentType]


def _near(row: RowFields, number: int) -> npt.NDArray[np.int64]:
    """The ``number`` microlenses of the row nearest the axis, from the lowest up."""
    return np.sort(np.argsort(np.abs(row.centre), kind="stable")[:number])


def system(camera: Camera) -> tuple["Figure", str]:
    """Figure 1: main lens, microlens array and sensor with the light of two target points."""
    distance, row = _target_distance(camera), row_fields(camera)
    smms, vergence = row.smms, 1 / distance
    height = (
        0.25
        * camera.sensor.resolution[0]
        * camera.sensor.pixel
        / camera.optical_distance
        * distance
    )
    caption = (
        f"The camera at F/{camera.main_lens.f_number:g} with a target {distance:.4g} mm in front:"
        " each of two target points reaches several microlenses. See on the right how the main"
        " lens's image of a point (where its rays cross) is imaged once more by every microlens"
        " that its light meets, onto a spot of its own on the sensor. Vertical and horizontal"
        " scales differ."
    )
    figure = sheet(caption)
    whole, close = figure.subplots(1, 2, width_ratios=[1.25, 1])
    low, high = (float(edge[0]) for edge in sensor_edges(camera))
    for axes in (whole, close):
        _elements(axes, camera, row, (low, high), lens=axes is whole)
    base = image_offset(smms, vergence)
    for point, colour in ((0.0, INSIDE), (height, OUTSIDE)):
        shift = smms.centre_x + point * vergence * smms.distance
        for index in np.flatnonzero(
            np.abs(shift) <= (smms.lens_aperture * np.abs(base) + smms.aperture) / 2
        ):
            x, y = float(base[index]), float(smms.centre_x[index])
            half = float(limiting_aperture(smms, vergence)[index]) / 2
            middle = (
                float(shift[index]) / x
                if abs(x) * camera.main_lens.aperture > camera.array.aperture
                else 0.0
            )
            lens_half = camera.main_lens.aperture / 2
            for m in np.clip(np.array([middle - half, middle + half]), -lens_half, lens_half):
                q = x * m - point * vergence * float(smms.distance[index])
                s = float(
                    smms.kappa[index] * q
                    - smms.gap[index] / smms.distance[index] * m
                    + smms.gap[index] / smms.focal[index] * y
                )
                z = [
                    -distance,
                    0.0,
                    camera.optical_distance,
                    camera.optical_distance + camera.optical_gap,
                ]
                for axes in (whole, close):
                    axes.plot(z, [point, m, q, s], color=colour, linewidth=0.7)
    whole.plot([-distance, -distance], [-1.3 * height, 1.3 * height], color=DARK, linewidth=1.0)
    for x, name, up in (
        (-distance, "target", 1.33 * height),
        (0.0, "main lens", 0.5 * camera.main_lens.aperture),
    ):
        whole.text(x, up, name, ha="left" if x < 0 else "right", va="bottom", fontsize=9)
    foot = -1.12 * max(camera.main_lens.aperture / 2, float(np.abs(row.smms.centre_x).max()))
    whole.text(
        1.4 * camera.optical_distance, foot, "array, sensor", ha="right", va="top", fontsize=9
    )
    image = camera.optical_distance / (1 - float(base[len(base) // 2]))
    start = min(image, camera.optical_distance) - 0.5 * camera.optical_gap
    close.set_xlim(start, camera.optical_distance + 1.3 * camera.optical_gap)
    image_height = -height * image / distance
    close.set_ylim(
        min(image_height, 0) - 4 * camera.array.pitch[0],
        max(image_height, 0) + 4 * camera.array.pitch[0],
    )
    plain(whole, "From the target to the sensor", "z, mm from the main lens", "y, mm")
    plain(close, "Array (short lines) and sensor (grey)", "z, mm from the main lens", "y, mm")
    return figure, caption


def boundary(camera: Camera) -> tuple["Figure", str]:
    """Figure 2: parallel and diagonal boundary chief rays of one SMMS."""
    row = row_fields(camera)
    smms, rays, index = row.smms, boundary_rays(row.smms), int(_near(row, 1)[0])
    pupil = 1 / (1 / float(smms.focal[index]) - 1 / float(smms.distance[index]))
    parallel_inside = bool(parallel_are_inside(smms)[index])
    caption = (
        f"Boundary chief rays of the SMMS nearest the axis at F/{camera.main_lens.f_number:g}."
        " Parallel rays pass the same edges of main lens and microlens, diagonal ones opposite"
        " edges. On the sensor the inside pair bounds the bright field and the outside pair the"
        f" total field, with vignetting between. They cross in the exit pupil {pupil:.3f} mm behind"
        " the array (dotted), where nothing is vignetted; on this sensor the"
        f" {'parallel' if parallel_inside else 'diagonal'} rays are the inside ones."
    )
    figure = sheet(caption)
    whole, close, light = figure.subplots(1, 3, width_ratios=[1.2, 1.2, 0.7])
    half = 1.25 * float(smms.outside_radius[index])
    centre = float(row.centre[index])
    for axes in (whole, close):
        _elements(axes, camera, row, (centre - half, centre + half), lens=axes is whole)
        for number in range(4):
            colour = INSIDE if (number < 2) == parallel_inside else OUTSIDE
            name = ("parallel" if number < 2 else "diagonal") + (
                ", inside" if colour == INSIDE else ", outside"
            )
            _draw(
                axes,
                smms,
                rays,
                index,
                number,
                0.4 * camera.optical_distance,
                color=colour,
                linewidth=1.2,
                linestyle="-" if number < 2 else "--",
                label=name if number % 2 == 0 else None,
            )
    length, gap = camera.optical_distance, camera.optical_gap
    close.axvline(length + pupil, color=GREY, linestyle=":", linewidth=1.2)
    close.set_xlim(length - 0.35 * gap, length + 1.15 * max(gap, pupil))
    close.set_ylim(centre - 1.2 * half, centre + 1.2 * half)
    whole.legend(frameon=False, fontsize=8, loc="upper right")
    _profile(light, row, [index], [DARK], camera)
    light.set_ylim(close.get_ylim())
    plain(whole, "Main lens, one microlens, sensor", "z, mm from the main lens", "y, mm")
    plain(close, "Behind the array", "z, mm from the main lens", "y, mm")
    plain(light, "Light on the sensor", "illumination", "y, mm")
    return figure, caption


def _profile(
    axes: "Axes", row: RowFields, members: list[int], colours: list[str], camera: Camera
) -> None:
    """Relative illumination of some micro-images along the sensor, upwards."""
    for index, colour in zip(members, colours, strict=True):
        smms = select(row.smms, np.array([index]))
        edge = 1.02 * float(smms.outside_radius[0])
        offset = np.linspace(-edge, edge, 401)
        axes.plot(
            row_illumination(smms, offset), row.centre[index] + offset, color=colour, linewidth=1.2
        )
    if camera.useful.minimum_illumination > 0:
        axes.axvline(camera.useful.minimum_illumination, color=GREY, linestyle=":", linewidth=1.2)
    axes.set_xlim(0, 1.08)


def overlapping(camera: Camera) -> tuple["Figure", str]:
    """Figure 3: three SMMSs whose total fields overlap on the sensor."""
    opened = overlapping_camera(camera)
    row = row_fields(opened)
    members = _near(row, 3)
    smms, rays = row.smms, boundary_rays(row.smms)
    reach = float(smms.outside_radius[members[0]])
    overlap = 2 * reach - float(row.centre[members[1]] - row.centre[members[0]])
    what = (
        f"overlap by {overlap * 1e3:.0f} um"
        if overlap > 0
        else "do not overlap at any stop of this camera"
    )
    caption = (
        f"Three neighbouring SMMSs at F/{opened.main_lens.f_number:g}: the outside boundary rays of"
        f" neighbours land beyond one another, their total fields {what} (hatched). There a pixel"
        " gets light from two microlenses and serves no depth reconstruction; grey on the sensor,"
        " what remains useful."
    )
    figure = sheet(caption)
    close, light = figure.subplots(1, 2, width_ratios=[2, 1], sharey=True)
    low, high = (
        float(row.centre[members[0]]) - 1.1 * reach,
        float(row.centre[members[-1]]) + 1.1 * reach,
    )
    _elements(close, opened, row, (low, high), lens=False)
    outside = slice(2, 4) if bool(parallel_are_inside(smms)[members[1]]) else slice(0, 2)
    for index, colour in zip(members, SMMS_COLOURS, strict=False):
        for number in range(4)[outside]:
            _draw(close, smms, rays, int(index), number, 0.0, color=colour, linewidth=1.2)
    length, gap = opened.optical_distance, opened.optical_gap
    for index in members:
        if not np.isnan(row.useful[index, 0]):
            light.axhspan(
                float(row.useful[index, 0]), float(row.useful[index, 1]), color="#e8e8e8", zorder=0
            )
    for before, after in itertools.pairwise(members):
        edges = (float(row.centre[after]) - reach, float(row.centre[before]) + reach)
        if edges[1] > edges[0]:
            light.axhspan(
                edges[0], edges[1], facecolor="none", edgecolor=GREY, hatch="////", linewidth=0
            )
    _profile(light, row, [int(i) for i in members], list(SMMS_COLOURS[: len(members)]), opened)
    close.set_xlim(length - 0.3 * gap, length + 1.08 * gap)
    close.set_ylim(low, high)
    plain(close, "Outside boundary rays behind the array", "z, mm from the main lens", "y, mm")
    plain(light, "Light on the sensor", "illumination", "")
    return figure, caption


def useful(camera: Camera) -> tuple["Figure", str]:
    """Figure 4: boundary and useful chief rays of one SMMS where part of its sensor is
    inoperative.
    """
    opened = overlapping_camera(camera)
    row = row_fields(opened)
    index = int(_near(row, 1)[0])
    smms, edge_rays, rays = row.smms, boundary_rays(row.smms), useful_rays(row.smms, row.useful)
    caption = (
        f"One SMMS at F/{opened.main_lens.f_number:g}. Only the middle of its micro-image is useful"
        " (green on the sensor): the rest (black) is shared with neighbours or too dark. Useful"
        " chief rays (green) pass an edge of the useful part and an edge of the main lens or of"
        " the microlens; the outer ones bound what the SMMS measures, well inside the outside"
        " boundary rays (orange)."
    )
    figure = sheet(caption)
    whole, close = figure.subplots(1, 2)
    centre, reach = float(row.centre[index]), float(smms.outside_radius[index])
    for axes in (whole, close):
        _elements(axes, opened, row, (centre - reach, centre + reach), lens=axes is whole)
        end = opened.optical_distance + opened.optical_gap
        axes.plot(
            [end, end],
            [centre - reach, centre + reach],
            color="black",
            linewidth=5,
            solid_capstyle="butt",
        )
        axes.plot([end, end], row.useful[index], color=USEFUL, linewidth=5, solid_capstyle="butt")
        before = 0.4 * opened.optical_distance
        inside = 0 if bool(parallel_are_inside(smms)[index]) else 2
        for number in range(4):
            chosen = number in (inside, inside + 1)
            _draw(
                axes,
                smms,
                edge_rays,
                index,
                number,
                before,
                color=INSIDE if chosen else OUTSIDE,
                linewidth=1.0,
                linestyle="-" if number < 2 else "--",
                label=(
                    ("inside boundary" if chosen else "outside boundary")
                    if number % 2 == 0
                    else None
                ),
            )
        named = False
        for number in np.flatnonzero(rays.exists[index, 4:]) + 4:
            _draw(
                axes,
                smms,
                rays,
                index,
                int(number),
                before,
                color=USEFUL,
                linewidth=1.2,
                label=None if named else "useful chief",
            )
            named = True
    length, gap = opened.optical_distance, opened.optical_gap
    close.set_xlim(length - 0.35 * gap, length + 1.1 * gap)
    close.set_ylim(centre - 1.15 * reach, centre + 1.15 * reach)
    whole.legend(frameon=False, fontsize=8, loc="upper right")
    plain(whole, "From before the main lens to the sensor", "z, mm from the main lens", "y, mm")
    plain(close, "Behind the array", "z, mm from the main lens", "y, mm")
    return figure, caption


def marginal(camera: Camera) -> tuple["Figure", str]:
    """Figure 8: the cone of light onto the centre of the micro-image nearest the axis."""
    row = row_fields(camera)
    index = int(_near(row, 1)[0])
    smms = select(row.smms, np.array([index]))
    g, angle = float(limiting_half_width(smms)[0]), math.degrees(float(marginal_angle(smms)[0]))
    limited = "the microlens" if g * 2 >= camera.array.aperture * (1 - 1e-12) else "the main lens"
    caption = (
        f"Marginal rays at F/{camera.main_lens.f_number:g}: the cone onto the middle of the"
        f" micro-image nearest the axis opens by {angle:.2f} deg, and {limited} limits it. On the"
        " left its rays traced back to the main lens, whose aperture they"
        f" {'do not fill' if limited == 'the microlens' else 'fill'}; on the right the angle"
        " itself, to scale."
    )
    figure = sheet(caption)
    whole, close = figure.subplots(1, 2, width_ratios=[1.4, 1])
    length, gap, centre, y = (
        camera.optical_distance,
        camera.optical_gap,
        float(row.centre[index]),
        float(smms.centre_x[0]),
    )
    reach = 1.1 * float(smms.outside_radius[0])
    for axes in (whole, close):
        _elements(axes, camera, row, (centre - reach, centre + reach), lens=axes is whole)
        for side in (-1.0, 1.0):
            q = y + side * g
            m = (float(smms.kappa[0]) * q + gap / float(smms.focal[0]) * y - centre) * length / gap
            axes.plot([0, length, length + gap], [m, q, centre], color=INSIDE, linewidth=1.3)
    whole.set_ylim(-0.55 * camera.main_lens.aperture, 0.55 * camera.main_lens.aperture)
    close.set_aspect("equal")
    close.set_xlim(length - 0.15 * gap, length + 1.1 * gap)
    close.set_ylim(centre - 1.3 * max(g, reach / 1.3), centre + 1.3 * max(g, reach / 1.3))
    close.text(
        length + 0.62 * gap, centre, f"{angle:.1f} deg", fontsize=9, va="center", ha="center"
    )
    plain(whole, "Main lens to sensor", "z, mm from the main lens", "y, mm")
    plain(close, "Microlens to sensor, to scale", "z, mm from the main lens", "y, mm")
    return figure, caption
