"""Depth: where the dots stand along the axis, from the parallax between their views, against where
the stage put them.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.lens_errors import numbers_of
from flflab.measurement.dots.views import DotViews
from flflab.optics.camera import Camera
from flflab.optics.focus import microlens_limits
from flflab.optics.resolution import central_smms
from flflab.optics.smms import image_offset
from flflab.verdict.properties.fields import useful_row
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Shared, Values, single

Array = npt.NDArray[np.float64]


def offset_read(model: Predicted) -> Array:
    """The x = L W that a triangulation with the nominal camera reads when the true camera is each
    draw's, shape (n,).

    The parallax a micro-image's distance apart is -b/((L + b) x). With the nominal L, b that is
    read as x' = x (L_d + b_d)/b_d b/(L + b) of the draw's L_d, b_d.
    """
    nominal, true = central_smms(model.camera), model.systems
    x = image_offset(true, model.vergences)
    return (
        x
        * (true.distance + true.gap)
        / true.gap
        * float(nominal.gap / (nominal.distance + nominal.gap))
    )


def distance_of(x: Array, camera: Camera) -> Array:
    """Main lens to target, mm, from x = L V + 1 - L/F with the nominal camera."""
    smms = central_smms(camera)
    return float(smms.distance) / (x - 1 + float(smms.distance / smms.lens_focal))


def dot_distances(one: Measured, model: Predicted) -> Values:
    """Distance of each dot from the main lens by triangulation over its views, mm; dots that it
    leaves open are left out.
    """
    seen = [
        dot for dot in one.dots if np.isfinite(dot.uncertainty_mm[2]) and dot.uncertainty_mm[2] > 0
    ]
    if not bool(microlens_limits(central_smms(model.camera), 1 / model.distance)):
        seen = []
    # a parallax that is stretched reads as an x that is shrunk
    x = offset_read(model)[:, None] / (1 + model.parallax_draws)
    stands = distance_of(x, model.camera) * model.stretches[:, None] - model.nearer_draws
    read = stands[:, [dot.dot for dot in seen]]
    common = (
        np.array([dot.common_mm[2] for dot in seen], dtype=np.float64) if seen else np.zeros((0, 1))
    )
    lenses = np.array([dot.by_lens_mm[2].reshape(-1) for dot in seen]) if seen else np.zeros((0, 0))
    alone = (
        np.array([dot.uncertainty_mm[2] for dot in seen], dtype=np.float64) ** 2
        - (common**2).sum(axis=1)
        - (lenses**2).sum(axis=1)
    )
    return Values(
        one.configuration.index,
        "dot_distance_mm",
        "four-dot",
        np.array([-dot.position_mm[2] for dot in seen], dtype=np.float64),
        np.diag(np.maximum(alone, 0.0)) + common @ common.T + lenses @ lenses.T,
        read.mean(axis=0),
        read,
        tuple(dot.dot for dot in seen),
        (None,) * len(seen),
        Shared("lenses of the dots", lenses, _numbers(seen)),
    )


def _numbers(seen: list[DotViews]) -> npt.NDArray[np.int64]:
    """Of the errors in ``by_lens_mm``: three a lens."""
    if not seen:
        return np.zeros(0, dtype=np.int64)
    return (3 * numbers_of(seen[0].lenses)[:, None] + np.arange(3)).reshape(-1)


def lateral_resolution(one: Measured, model: Predicted) -> list[Values]:
    """Effective lateral resolution along the row, eq. (3): useful pixels over the virtual depth
    |x/(1 - x)| L/b that the dots show.

    Returns:
        One number, or none where the dots show no depth or the micro-images have nothing useful.
    """
    distances = dot_distances(one, model)
    camera, smms = model.camera, central_smms(model.camera)
    if len(distances.measured) == 0:
        return []
    weights = 1 / np.diag(distances.noise)
    distance = float(weights @ distances.measured / weights.sum())
    doubt = float(np.sqrt(weights @ distances.noise @ weights) / weights.sum())

    def depth(x: Array) -> Array:
        return np.abs(x / (1 - x)) * float(smms.distance / smms.gap)

    def read(away: float) -> Array:
        return depth(np.array([float(image_offset(smms, 1 / away))]))

    lattice, pixel = one.lattice, camera.sensor.pixel
    i, h, p = (
        np.array([value * pixel])
        for value in (lattice.inside_radius_px, lattice.outside_radius_px, lattice.pitch_px)
    )
    useful = float(useful_row(camera, i, h, p)[0]) / pixel
    virtual = float(read(distance)[0])
    if useful <= 0 or virtual <= 0:
        return []
    slope = float(read(distance + doubt)[0] - read(distance - doubt)[0]) / 2
    count = np.ceil(camera.sensor.resolution[0] / lattice.pitch_px)
    edges = 2 * count * max(lattice.inside_uncertainty_px, lattice.outside_uncertainty_px)
    measured = useful / virtual
    uncertainty = measured * float(np.hypot(slope / virtual, edges / useful))
    drawn = useful_row(camera, model.inside_radii, model.outside_radii, model.pitches) / pixel
    stretched = 1 + model.parallax_draws[:, [dot.dot for dot in one.dots]].mean(axis=1)
    draws = drawn / depth(offset_read(model) / stretched)
    shared = distances.shared
    if shared is not None:
        by = -measured * slope / virtual / doubt * (weights / weights.sum()) @ shared.by
        shared = replace(shared, by=by[None])
    index = one.configuration.index
    return [single(index, "elr_row_px", "four-dot", measured, uncertainty, draws, shared)]
