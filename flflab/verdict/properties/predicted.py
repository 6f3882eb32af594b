"""What the model says of one configuration where the stages stood, nominally and for benches built
as uncertainly as stated.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench
from flflab.lens_errors import FOCAL, LensErrors, numbers_of
from flflab.measurement.contrast.curve import ContrastCurve
from flflab.measurement.lattice.registration import sensor_position
from flflab.optics.camera import Camera, microlens_centres
from flflab.optics.contrast import cone_half_angle
from flflab.optics.focus import blur, magnification
from flflab.optics.light import Spectrum
from flflab.optics.resolution import central_smms
from flflab.optics.smms import Smms, image_offset
from flflab.study import Study
from flflab.verdict.prediction import (
    Errors,
    Placement,
    contrast_draws,
    drawn_systems,
    placements,
    predicted_view_indices,
    view_draws,
)
from flflab.verdict.properties.measured import Measured, as_placed

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Predicted:
    """What the model says of one configuration where the stages stood.

    Attributes:
        camera: the camera with the distances that the stages read.
        distance: main lens to target, mm.
        views: nominal number of views of each dot, shape (4,).
        view_draws: the same for each draw of the errors, shape (draws, 4); None where they were not
            counted.
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
        parallax_draws: share by which lenses of an array stretch each dot's parallax, shape (draws,
            4).
        nearer_draws: how much nearer than the target's middle each dot stands, mm, shape (draws,
            4).
        dot_scale_draws: image of the dots over the target as described, over the camera's, shape
            (draws,).
        bar_scale_draws: the same of the bars.
        roll_draws: of the target, rad, shape (draws,).
        contrast_y_draws: contrast of bars along y at the frequencies measured of them for each
            draw, shape (draws, K).
    """

    camera: Camera
    distance: float
    views: npt.NDArray[np.int64]
    view_draws: npt.NDArray[np.int64] | None
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
    parallax_draws: Array
    nearer_draws: Array
    dot_scale_draws: Array
    bar_scale_draws: Array
    roll_draws: Array
    contrast_y_draws: Array

    @property
    def contrasts(self) -> dict[str, Array]:
        """Draws of the contrasts, by the quantity that they are."""
        return {"mtf": self.contrast_draws, "mtf_y": self.contrast_y_draws}


def predict(measured: Measured, study: Study, bench: Bench, errors: Errors) -> Predicted:
    """What the model expects of a configuration, nominally and over draws of the errors of stages
    and optics.
    """
    uncounted = predict_uncounted(measured, study, bench, errors)
    placement = placements(bench, measured.worlds, errors)
    points, lenses = study.dots.centres, errors.lenses
    counts = view_draws(uncounted.camera, placement, errors.attitude, points, lenses)
    return replace(uncounted, view_draws=counts)


def predict_uncounted(measured: Measured, study: Study, bench: Bench, errors: Errors) -> Predicted:
    """The same without the number of views in each draw, which takes most of the time."""
    camera, distance = as_placed(measured.configuration, bench.optics, measured.worlds)
    placement = placements(bench, measured.worlds, errors)
    points = study.dots.centres
    systems, order = drawn_systems(central_smms(camera), camera, placement), errors.order
    as_read = 1 / placement.optics.pixel  # lengths on the sensor are read in described pixels
    image_scale = image_scales(systems, 1 / placement.distance, camera, distance) * as_read
    cycles_per_mm = measured.curve.cycles_per_mm if measured.curve else np.zeros(0)
    # as the white picture shows it: real cameras have it, pictures may be without
    falloff = measured.lattice.fall_off
    lenses, draws = errors.lenses, len(placement.distance)

    def longer(factor: float) -> Placement:
        return replace(
            placement, optics=replace(placement.optics, focal=placement.optics.focal * factor)
        )

    def radii(factor: float) -> Array:
        drawn = drawn_systems(central_smms(camera), camera, longer(factor))
        return np.stack([drawn.inside_radius, drawn.outside_radius], axis=1)

    light = bench.description.spectrum

    def contrast(curve: ContrastCurve | None) -> Array:
        at = np.zeros(0) if curve is None else curve.cycles_per_mm
        if curve is None:
            return contrast_draws(camera, placement, at, light, falloff)
        # each frequency is seen by a few lenses, each of a focal length and a place of its own
        view, seen = np.nonzero(curve.views_share)
        lens = curve.views[view]
        rise = _rises(measured.lattice.centres_px[lens], camera, errors)
        longer_by = lenses.drawn(numbers_of(measured.lattice.indices[lens]), draws)[..., FOCAL]
        alone = contrast_draws(camera, placement, at[seen], light, falloff, 1 + longer_by, rise)
        weight = np.zeros((len(seen), len(at)))
        weight[np.arange(len(seen)), seen] = curve.views_share[view, seen]
        return alone @ weight

    centres = _seen_whole(camera)
    inside, outside = lenses.mean_of(radii, len(centres), draws).T
    scale, _, roll = lenses.of_the_lattice(centres, draws, _decentre_shown(camera)).T
    indices = tuple(predicted_view_indices(camera, distance, points))
    return Predicted(
        camera=camera,
        distance=distance,
        views=np.array([len(seen) for seen in indices]),
        view_draws=None,
        view_indices=indices,
        contrast_draws=contrast(measured.curve) * order.contrast[:, None],
        waves_left=_waves_left(camera, distance, cycles_per_mm, light),
        blur_px=float(blur(central_smms(camera), 1 / distance)) / camera.sensor.pixel,
        systems=systems,
        vergences=1 / placement.distance,
        inside_radii=inside * order.widths * as_read,
        outside_radii=outside * order.widths * as_read,
        pitches=camera.array.pitch[0]
        * placement.optics.pitch
        * systems.image_scale
        * order.pitch
        * (1 + scale)
        * as_read,
        stretches=order.distance,
        attitude_draws=np.array([camera.array.roll, *np.arctan(camera.array.tilt)])
        + errors.attitude
        + roll[:, None] * [1.0, 0.0, 0.0],
        parallax_draws=_parallax_errors(camera, lenses, indices, draws),
        nearer_draws=np.tan(errors.target[:, 1:]) @ points.T,
        dot_scale_draws=image_scale * placement.dots,
        bar_scale_draws=image_scale * placement.bars,
        roll_draws=errors.target[:, 0],
        contrast_y_draws=contrast(measured.curve_y) * order.contrast[:, None],
    )


def image_scales(systems: Smms, vergences: Array, camera: Camera, distance: float) -> Array:
    """Image over target within a micro-image for each draw, over that of the nominal camera at the
    nominal distance (mm), shape (n,): b V/x where microlenses limit, else kappa L V.
    """
    nominal = central_smms(camera)
    limited = float(nominal.lens_width) >= float(nominal.microlens_width)

    def scale(smms: Smms, vergence: Array) -> Array:
        if not limited:
            return np.asarray(smms.kappa * smms.distance * vergence, dtype=np.float64)
        x = image_offset(smms, vergence)
        return np.asarray(smms.gap * vergence / x, dtype=np.float64)

    return scale(systems, vergences) / scale(nominal, np.array(1 / distance))


def _rises(centres_px: Array, camera: Camera, errors: Errors) -> Array:
    """How much nearer to the sensor than on the axis the tilted array has the lenses behind these
    micro-images in each draw, mm, shape (draws, n).
    """
    centres = sensor_position(camera.sensor, centres_px) / central_smms(camera).image_scale
    slopes = np.array(camera.array.tilt) + np.tan(errors.attitude[:, 1:])
    return slopes @ centres.T


def _seen_whole(camera: Camera) -> Array:
    """Centres of the microlenses whose micro-images have their centres on the sensor, of all where
    there is none; mm, shape (N, 2).
    """
    centres = microlens_centres(camera.array)
    middles = centres * float(central_smms(camera).image_scale)
    half = np.array(camera.sensor.resolution) * camera.sensor.pixel / 2
    on = (np.abs(middles - camera.sensor.offset) <= half).all(axis=1)
    return centres[on] if on.any() else centres


def _decentre_shown(camera: Camera) -> float:
    """Share of an aperture's decentre by which its micro-image seems to tell of the lens's place:
    kappa/(1 + b/L).
    """
    smms = central_smms(camera)
    return abs(float(smms.kappa / smms.image_scale))


def _parallax_errors(
    camera: Camera, lenses: LensErrors, seen_by: tuple[Whole, ...], draws: int
) -> Array:
    """Share by which decentred apertures stretch each dot's parallax, shape (draws, dots).

    A ray through an aperture d aside of its lens meets the sensor (kappa + p) d aside, p =
    -b/(L x) the parallax; the micro-image shows kappa d of it as a place of the lens. What is left
    is p d (b/f)/(1 + b/L).
    """
    smms = central_smms(camera)
    hidden = float(smms.gap / smms.focal / smms.image_scale)
    centres = microlens_centres(camera.array)
    return hidden * np.stack(
        [lenses.of_the_parallax(centres[seen], seen, draws) for seen in seen_by], axis=1
    )


def _waves_left(
    camera: Camera, distance: float, cycles_per_mm: Array, light: Spectrum | None
) -> Array:
    """Contrast that diffraction at the limiting stop leaves of what is sharp."""
    smms = central_smms(camera)
    if light is None:
        return np.ones(len(cycles_per_mm))
    from flflab.optics.diffraction import (
        pupil_transfer,
    )  # numba is loaded by those who ask for waves

    on_sensor = cycles_per_mm / float(magnification(smms, 1 / distance))
    half_angle, sharp = float(cone_half_angle(smms, 1 / distance)), np.zeros(len(on_sensor))
    return np.sum(
        [
            weight * pupil_transfer(on_sensor * wavelength / half_angle, sharp).real
            for wavelength, weight in zip(light.wavelengths, light.weights, strict=True)
        ],
        axis=0,
    )
