"""Contrast over the field: every view of the bars against the mean of all of them."""

import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.curve import ContrastCurve
from flflab.measurement.lattice.registration import sensor_position
from flflab.optics.camera import Camera
from flflab.report.charts import as_svg, new_figure, styled
from flflab.verdict.properties.measured import Measured

Array = npt.NDArray[np.float64]
LEAST_SPAN = 0.01  # of the colours: less is not worth a colour
DIRECTIONS = {"mtf": "bars along x", "mtf_y": "bars along y"}


def contrast_of_views(curve: ContrastCurve) -> tuple[Array, Array]:
    """Contrast of every view over the mean of all at the same frequencies, by least squares, and
    its standard uncertainty by noise; nan where a view sees none of them. Shapes (V,).
    """
    seen = np.isfinite(curve.views_contrast) & (curve.views_uncertainty > 0)
    weight = np.where(seen, 1 / np.where(seen, curve.views_uncertainty, 1.0) ** 2, 0.0)
    of_mean = (weight * curve.contrast**2).sum(axis=1)
    product = (weight * np.where(seen, curve.views_contrast, 0.0) * curve.contrast).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(of_mean > 0, product / of_mean, np.nan), of_mean**-0.5


def field_chart(one: Measured, camera: Camera, title: str) -> str | None:
    """A map of the sensor for each direction of the bars; a view is a disc at the centre of its
    micro-image, coloured by its contrast over the mean of all views. None where no view shows one.
    """
    every = {name: contrast_of_views(curve) for name, curve in one.curves.items()}
    found = {name: view for name, view in every.items() if np.isfinite(view[0]).any()}
    if not found:
        return None
    apart = np.concatenate([np.abs(ratio - 1) for ratio, _ in found.values()])
    span = max(float(np.nanmax(apart, initial=0.0)), LEAST_SPAN)
    half = np.array(camera.sensor.resolution) * camera.sensor.pixel / 2
    with styled():
        figure = new_figure(3.9, 0.4 + 2.7 * len(found))
        for place, (name, (ratio, unsure)) in enumerate(found.items()):
            curve = one.curves[name]
            x, y = sensor_position(camera.sensor, one.lattice.centres_px[curve.views]).T
            axes = figure.add_subplot(len(found), 1, place + 1)
            drawn = axes.scatter(
                x, y, c=ratio, cmap="RdBu", vmin=1 - span, vmax=1 + span, s=60,
                edgecolors="black", linewidths=0.3,
            )  # fmt: skip
            axes.set(
                xlabel="x on the sensor, mm", ylabel="y, mm", aspect="equal",
                xlim=(-half[0], half[0]), ylim=(half[1], -half[1]),
            )  # fmt: skip
            noise = float(np.median(unsure[np.isfinite(ratio)]))
            said = f"{DIRECTIONS[name]}; noise of a view {noise:.1g}"
            axes.set_title(said if place else f"{title}\n{said}", fontsize=8)
            bar = figure.colorbar(drawn, ax=axes, shrink=0.8)
            bar.set_label("contrast over the mean", fontsize=7)
        return as_svg(figure)
