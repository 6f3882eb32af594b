"""What the model says of one configuration where the stages stood, nominally and for benches built
as uncertainly as stated.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench
from flflab.optics.camera import Camera
from flflab.optics.contrast import cone_half_angle
from flflab.optics.focus import blur, magnification
from flflab.optics.resolution import central_smms
from flflab.optics.smms import Smms
from flflab.prediction import (
    Errors,
    contrast_draws,
    drawn_systems,
    placements,
    predicted_view_indices,
    view_draws,
)
from flflab.properties.measured import Measured, as_placed
from flflab.study import Study

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Predicted:
    """What the model says of one configuration where the stages stood.

    Attributes:
        camera: the camera with the distances that the stages read.
        distance: main lens to target, mm.
        views: nominal number of views of each dot, shape (4,).
        view_draws: the same for each draw of the errors, shape (draws, 4).
        view_indices: positions of the microlenses that see each dot.
        contrast_draws: contrast at the measured frequencies for each draw, shape (draws, K).
        waves_left: what diffraction leaves of the contrast in focus at the measured frequencies,
            shape (K,); 1 without a wavelength.
        blur_px: diameter of the geometric blur, pixels.
        systems: the system nearest the axis for each draw, fields of shape (draws,).
        vergences: of the target for each draw, 1/mm, shape (draws,).
        inside_radii: of the bright field for each draw, mm, shape (draws,).
        outside_radii: the same of the total field.
        pitches: of the micro-images for each draw, mm, shape (draws,).
        stretches: distances that real lenses make of the model's, as factors, shape (draws,).
        attitude_draws: roll, yaw and pitch of the array for each draw, rad, shape (draws, 3).
    """

    camera: Camera
    distance: float
    views: npt.NDArray[np.int64]
    view_draws: npt.NDArray[np.int64]
    view_indices: tuple[npt.NDArray[np.int64], ...]
    contrast_draws: Array
    waves_left: Array
    blur_px: float
    systems: Smms
    vergences: Array
    inside_radii: Array
    outside_radii: Array
    pitches: Array
    stretches: Array
    attitude_draws: Array


def predict(measured: Measured, study: Study, bench: Bench, errors: Errors) -> Predicted:
    """What the model expects of a configuration, nominally and over draws of the errors of stages
    and optics.
    """
    camera, distance = as_placed(measured.configuration, bench.optics, measured.worlds)
    placement = placements(bench, measured.worlds, errors)
    points = study.dots.centres
    systems, order = drawn_systems(central_smms(camera), camera, placement), errors.order
    cycles_per_mm = measured.curve.cycles_per_mm if measured.curve else np.zeros(0)
    falloff = float(
        measured.lattice.slants[0]
    )  # as the white picture shows it: real cameras have it, pictures may be without
    contrast = contrast_draws(
        camera, placement, cycles_per_mm, bench.description.wavelength, falloff
    )
    indices = tuple(predicted_view_indices(camera, distance, points))
    return Predicted(
        camera=camera,
        distance=distance,
        views=np.array([len(seen) for seen in indices]),
        view_draws=view_draws(camera, placement, errors.attitude, points),
        view_indices=indices,
        contrast_draws=contrast * order.contrast[:, None],
        waves_left=_waves_left(camera, distance, cycles_per_mm, bench.description.wavelength),
        blur_px=float(blur(central_smms(camera), 1 / distance)) / camera.sensor.pixel,
        systems=systems,
        vergences=1 / placement.distance,
        inside_radii=systems.inside_radius * order.widths,
        outside_radii=systems.outside_radius * order.widths,
        pitches=camera.array.pitch[0] * placement.optics.pitch * systems.image_scale * order.pitch,
        stretches=order.distance,
        attitude_draws=np.array([camera.array.roll, *np.arctan(camera.array.tilt)])
        + errors.attitude,
    )


def _waves_left(
    camera: Camera, distance: float, cycles_per_mm: Array, wavelength: float | None
) -> Array:
    """Contrast that diffraction at the limiting stop leaves of what is sharp."""
    smms = central_smms(camera)
    if wavelength is None:
        return np.ones(len(cycles_per_mm))
    from flflab.optics.diffraction import (
        pupil_transfer,
    )  # numba is loaded by those who ask for waves

    on_sensor = cycles_per_mm / float(magnification(smms, 1 / distance))
    return pupil_transfer(
        on_sensor * wavelength / float(cone_half_angle(smms, 1 / distance)),
        np.zeros(len(on_sensor)),
    ).real
