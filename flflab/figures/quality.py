"""Figures 7 and 9: contrast of bars, and the light that reaches each micro-image."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from flflab.figures.paper import INSIDE, OUTSIDE, USEFUL, plain, sheet
from flflab.optics.brightness import brightness, fall_exponents, fitted_exponent
from flflab.optics.camera import Camera
from flflab.optics.contrast import contrast_paper, mtf_pixel, transfer
from flflab.optics.focus import magnification
from flflab.optics.per_type import sharp_distance
from flflab.optics.resolution import central_smms
from flflab.optics.smms import camera_smms
from flflab.optics.useful import row_members, select

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]
HALF_FIELD = 15.0  # mm off the axis, where the fall-off can be seen
_FINE = 64


def bars_and_image(pixels: int) -> tuple[Array, Array]:
    """Square bars whose frequency rises linearly from 0 to 1 cycle a pixel, ``_FINE`` samples a
    pixel, and their means over pixels.
    """
    place = (np.arange(pixels * _FINE) + 0.5) / _FINE
    phase = place**2 / (2 * pixels)
    wave = (np.sin(2 * np.pi * phase) >= 0).astype(np.float64)
    return wave, wave.reshape(pixels, _FINE).mean(axis=1)


def _scaled(factor: float) -> Callable[[npt.ArrayLike], npt.ArrayLike]:
    return lambda values: np.asarray(values) * factor


def bars(camera: Camera) -> tuple["Figure", str]:
    """Figure 7: bars of rising frequency, their image on pixels, and the three contrast curves."""
    central = central_smms(camera)
    sharp = sharp_distance(central)
    vergence = 1 / sharp if sharp is not None else 0.1 / camera.main_lens.focal_length
    enlarged = float(magnification(central, vergence))
    u = np.linspace(0, 1, 401)
    to_target = enlarged / camera.sensor.pixel
    away = vergence * 0.97
    shift = float(magnification(central, away)) / camera.sensor.pixel
    caption = (
        f"Bars resized to the sensor (magnification {enlarged:.4f}), their frequency rising to one"
        f" cycle a pixel, here {to_target:.1f} cycles/mm on the target. Pixels keep full contrast"
        " somewhere up to half a cycle, which eq. (2) reports (blue, extremes over all phases);"
        " beyond, grey and false bars. A picture's fundamental follows sinc instead (orange); 3 %"
        " behind the focus the blur takes the fine bars long before the pixels do (green)."
    )
    figure = sheet(caption, height=5.4)
    grid = figure.add_gridspec(2, 2, height_ratios=[0.8, 2])
    original, image, curves = (
        figure.add_subplot(grid[0, 0]),
        figure.add_subplot(grid[0, 1]),
        figure.add_subplot(grid[1, :]),
    )
    wave, seen = bars_and_image(96)
    for axes, values, title in (
        (original, wave, "Bar pattern on the target"),
        (image, seen, "The same on the sensor's pixels"),
    ):
        axes.imshow(
            values[None, :],
            cmap="gray",
            vmin=0,
            vmax=1,
            aspect="auto",
            extent=(0, 1, 0, 1),
            interpolation="nearest",
        )
        axes.set_yticks([])
        axes.set_title(title, fontsize=10, loc="left")
        axes.set_xlabel("local frequency, cycles per pixel")
    curves.plot(u, contrast_paper(u), color=INSIDE, label="contrast_paper, eq. (2)")
    curves.plot(u, mtf_pixel(u), color=OUTSIDE, label="mtf_pixel: in focus, fundamental")
    curves.plot(
        u,
        np.abs(transfer(central, away, camera.sensor.pixel, u * shift)),
        color=USEFUL,
        label=f"mtf at {1 / away:.4g} mm",
    )
    curves.set_xlim(0, 1)
    curves.set_ylim(0, 1.03)
    curves.legend(frameon=False, fontsize=9)
    top = curves.secondary_xaxis("top", functions=(_scaled(to_target), _scaled(1 / to_target)))
    top.set_xlabel("cycles/mm on the target")
    plain(curves, "", "cycles per pixel", "contrast")
    curves.spines["top"].set_visible(True)
    return figure, caption


def wide_array(camera: Camera) -> Camera:
    """The camera with one long row of its microlenses, to ``HALF_FIELD`` mm either side of the
    axis.
    """
    number = 2 * math.floor(HALF_FIELD / camera.array.pitch[0]) + 1
    return replace(
        camera,
        array=replace(
            camera.array, count=(max(number, 3), 1), offset=(0.0, 0.0), roll=0.0, tilt=(0.0, 0.0)
        ),
    )


def marginal_angles(camera: Camera) -> tuple["Figure", str]:
    """Figure 9: marginal angle and irradiance of every microlens against the sensor's position."""
    wide = wide_array(camera)
    gap = camera.gap
    positions = camera.array.distance + np.linspace(0.7, 1.3, 25) * gap
    found = brightness(wide, positions)
    middle = len(found.centre) // 2
    here = brightness(wide, np.array([camera.sensor.distance]))
    phi = np.arctan(found.centre / camera.optical_distance)
    central = select(camera_smms(wide), row_members(wide)[middle : middle + 1])
    fits = [fitted_exponent(phi, here.marginal_angle[0]), fitted_exponent(phi, here.irradiance[0])]
    forms = [float(part[0]) for part in fall_exponents(central)]
    lost = [
        1 - float(part[0, 0] / part[0, middle]) for part in (here.marginal_angle, here.irradiance)
    ]
    caption = (
        "Left, marginal angle of every microlens for sensor positions round the camera's own"
        f" ({camera.sensor.distance:g} mm): it grows as the sensor nears the array. Right, both"
        f" figures at the camera's own position over their values on the axis: {HALF_FIELD:g} mm"
        f" off the axis the marginal angle loses {100 * lost[0]:.1f} %, the irradiance"
        f" {100 * lost[1]:.1f} %. Near the axis they fall as cos^{fits[0]:.3f} and"
        f" cos^{fits[1]:.3f} of the field angle (closed forms {forms[0]:.3f} and {forms[1]:.3f}):"
        " the classical cos^4 is the irradiance's."
    )
    figure = sheet(caption, height=5.4)
    solid = figure.add_subplot(1, 2, 1, projection="3d")
    flat = figure.add_subplot(1, 2, 2)
    number = np.arange(len(found.centre)) - middle
    across, along = np.meshgrid(number, positions)
    solid.plot_surface(
        across,
        along,
        np.degrees(found.marginal_angle),
        cmap="viridis",
        linewidth=0,
        rcount=40,
        ccount=40,
    )  # pyright: ignore[reportAttributeAccessIssue]
    solid.set_xlabel("microlens number")
    solid.set_ylabel("sensor at, mm")
    solid.set_zlabel("marginal angle, deg")  # pyright: ignore[reportAttributeAccessIssue]
    solid.set_yticks(np.linspace(positions[0], positions[-1], 4).round(1))
    solid.set_xticks([number[0] // 10 * 10, 0, -(number[0] // 10 * 10)])
    solid.view_init(elev=24, azim=-50)  # pyright: ignore[reportAttributeAccessIssue]
    solid.set_box_aspect(None, zoom=0.86)  # pyright: ignore[reportAttributeAccessIssue, reportArgumentType, reportCallIssue]
    for values, colour, name, power in (
        (here.marginal_angle[0], INSIDE, "marginal angle", fits[0]),
        (here.irradiance[0], OUTSIDE, "irradiance", fits[1]),
    ):  # fmt: skip
        flat.plot(number, values / values[middle], color=colour, label=f"{name}: cos^{power:.2f}")
        flat.plot(number, np.cos(phi) ** power, color=colour, linestyle=":", linewidth=1)
    flat.legend(frameon=False, fontsize=9, loc="lower center")
    plain(
        flat,
        "Normalised; dotted, the fitted powers of the cosine",
        "microlens number",
        "share of the value on the axis",
    )
    return figure, caption
