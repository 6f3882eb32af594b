# longer than 450 lines because one curve of contrast is one reading downwards
"""Contrast against frequency from a picture of bars or of a sine chirp, by a fit of the known
chirp; max and min as a baseline.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.contrast.blur import with_blur_unsure
from flflab.measurement.contrast.data import (
    MARGIN_PX,
    MOST_ROWS,
    ChirpData,
    classic_reading,
    field_of,
    gather,
)
from flflab.measurement.contrast.falloff import drawn_aside
from flflab.measurement.contrast.fit import (
    CURVE,
    GEOMETRY,
    ChirpFit,
    ChirpModel,
    Prior,
    expected,
    noise_covariance,
)
from flflab.measurement.contrast.readings import fitted_extremes, transfer_rows, views_contrast
from flflab.measurement.contrast.search import (
    KNOTS,
    Frame,
    as_sharp_as_the_axis,
    model_of,
    prior_of,
    scattered,
    search,
    settle,
    with_fitted_blur,
    with_fitted_gains,
)
from flflab.measurement.contrast.views import (
    as_strong,
    jackknife,
    unsure_blurs,
    views_of,
    with_views,
)
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import (
    defocus_apart,
    microlens_type_of,
    require_picture,
    require_shape,
    scales_of,
    sensor_position,
    tilted_levels,
    tilted_scales,
)
from flflab.measurement.quarter_turn import (
    turned_camera,
    turned_gains,
    turned_lattice,
    turned_picture,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.contrast import cone_half_angle, far_light, lost_over_edges
from flflab.optics.focus import blur, magnification
from flflab.optics.per_type import type_smms
from flflab.optics.resolution import central_smms
from flflab.optics.smms import Smms
from flflab.targets import Bars, BarsAlongY, Chirp

Array = npt.NDArray[np.float64]

FEWEST_PIXELS = 300
NARROWEST = 7.0  # pixels, radius of what counts of a bright field
HIGHEST = 1.3  # contrast above it no target has, whatever lights it
MOST_RUNS_WHILE_SEARCHING = 6000
WORST_UNCERTAINTY = 0.25
WORST_CHI2 = 50.0
# of the light: with less noise than that a lattice known to a pixel leaves many times the noise's
# variance
WORST_MISFIT = 0.02
NO_BARS = 0.3  # of the light, left by views that are all alike
MOST_LARGER = 3.0  # times larger or smaller than described
HOPELESS = 0.1  # of the light, whatever the noise
CLEARLY = 2.0  # standard deviations that misfit must lie above the noise's
LEAST_CLEAR = 5.0  # standard uncertainties of the contrast where it is clearest
MOST_SATURATED = 0.2
# cycles that bars may drift along a run of pixels: it takes 7e-5 of the highest frequency's
# contrast
MOST_SMEAR = 0.02
GAIN_ROUNDS = 4
WAVES_ERROR = (
    2e-4  # of contrast: what the fit leaves of bars in light of a wavelength, without noise
)
# of contrast, frequency by frequency, where views have their own places and blurs: what is left
# beside the true focal lengths and tilt
PHASE_ERROR = 5e-4
MOST_LOST = 0.007  # of the light over one edge: nearer to it, what is lost follows the bars
# of the light that diffraction takes over a target's edges: how dark it is beyond them is not known
# better
SURROUNDINGS = 0.3
AS_SHARP_PX = 0.4  # of blur, by which views through a tilted array may differ from that on the axis
SHIFTED = np.array([1.0, 0.0, 0.0, 0.0, 0.0])  # of the geometry: the shift alone
FIRST_RUN = 16  # pixels of a run while the bars' slant is not known


@dataclass(frozen=True)
class ContrastCurve:
    """Contrast of the image over that of the target at K frequencies, of the views through one kind
    of microlens.

    Attributes:
        focal_length: of these microlenses, mm.
        cycles_per_mm: frequencies on the target, shape (K,).
        cycles_per_px: the same on the sensor by the camera's nominal magnification, shape (K,).
        contrast: modulation of the image's fundamental over the target's, signed (negative: bars
            look reversed), the mean over the views that see each frequency, shape (K,).
        covariance: of ``contrast``, from noise and registration together, shape (K, K).
        extremes: (max - min)/(max + min) of the fitted noise-free bars over all phases (eq. 2's
            quantity), shape (K,).
        extremes_uncertainty: standard uncertainties, shape (K,).
        classic: (max - min)/(max + min) read off the noisy pixels, a baseline with bias; nan where
            no view holds 4 pixels of it.
        classic_uncertainty: scatter of the views' readings over the root of their number, shape
            (K,).
        views: positions of the views in the lattice, shape (V,).
        views_contrast: each view's own contrast near each frequency, shape (V, K), nan where it
            does not see it.
        views_uncertainty: standard uncertainties from noise, shape (V, K).
        geometry: shift mm, across x and y, along x and y (see
            ``flflab.measurement.lattice.registration``), for bars along y after a quarter turn;
            shape (5,).
        geometry_uncertainty: standard uncertainties, shape (5,).
        chi2_per_pixel: about 1 where the model holds; the covariances are already scaled up by it
            where clearly above 1.
        pixels: number of pixels used.
        views_share: by how much each view counts in ``contrast``, shape (V, K).
        apart: whether views differ, each as sharp as it is; else all are as sharp as on the axis.
        misfit: rms of what is left of the light beyond noise, as a share of it.
    """

    focal_length: float
    cycles_per_mm: Array
    cycles_per_px: Array
    contrast: Array
    covariance: Array
    extremes: Array
    extremes_uncertainty: Array
    classic: Array
    classic_uncertainty: Array
    views: npt.NDArray[np.int64]
    views_contrast: Array
    views_uncertainty: Array
    geometry: Array
    geometry_uncertainty: Array
    chi2_per_pixel: float
    pixels: int
    views_share: Array = field(default_factory=lambda: np.zeros((0, 0)))
    apart: bool = False
    misfit: float = 0.0

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainties of ``contrast``, shape (K,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def freedom(self) -> Array:
        """Degrees of freedom of ``contrast``: effective number of views less one, shape (K,)."""
        return 1 / np.maximum(np.sum(self.views_share**2, axis=0), 1e-9) - 1

    @property
    def classic_bias(self) -> Array:
        """How much more the classic reading says than the fitted bars' own extremes, shape (K,)."""
        return self.classic - self.extremes


def fit_contrast(
    picture: npt.NDArray[np.generic],
    lattice: Lattice,
    camera: Camera,
    target: Bars | Chirp,
    distance: float,
    noise: SensorNoise,
    gains: Array | None = None,
    wavelength: float | None = None,
) -> ContrastCurve:
    """Measure contrast against frequency in every bright field of the central microlens's kind that
    sees the target as sharply as it.

    The target's place is found within 6 % of its width, its magnification within a few per cent;
    both are fitted together with the curve. Runs of pixels that are mostly saturated are left
    out; where few are, what noise lifted above full scale is added.

    Args:
        picture: DN, [row, col], in the camera's resolution.
        lattice: measured from a white picture of the same configuration.
        camera: nominal.
        target: what stood there; bars along y are measured after a quarter turn of it all.
        distance: main lens to target, mm, nominal.
        noise: of the sensor.
        gains: of a colour filter's four sub-lattices, as from ``flflab.measurement.sensor.mosaic``;
            None without filters.
        wavelength: of the light, mm: contrast is told against the light of a target without end, of
            which diffraction takes some over the target's dark border. None leaves that out.

    Raises:
        MeasurementError: wrong shape, target at infinity, too few pixels in bright fields on the
            target, or no bars in them.
    """
    if isinstance(target, BarsAlongY):
        require_shape(picture, camera, target.kind)
        turned = _turned(picture, lattice, camera, target)
        across = turned_gains(gains, picture.shape[1])
        return fit_contrast(*turned, distance, noise, across, wavelength)
    values = _checked(picture, camera, target)
    central = float(central_smms(camera).focal)
    (one,) = (smms for smms in type_smms(camera) if float(smms.focal) == central)
    return _fit_type(values, lattice, camera, one, target, distance, noise, gains, wavelength)


def fit_contrasts(
    picture: npt.NDArray[np.generic],
    lattice: Lattice,
    camera: Camera,
    target: Bars | Chirp,
    distance: float,
    noise: SensorNoise,
    gains: Array | None = None,
) -> tuple[tuple[ContrastCurve, ...], tuple[str, ...]]:
    """One curve for each kind of microlens; arguments and errors as ``fit_contrast``.

    Returns:
        The curves, and why a kind gave none; an error only where no kind gives one.
    """
    if isinstance(target, BarsAlongY):
        require_shape(picture, camera, target.kind)
        turned = _turned(picture, lattice, camera, target)
        return fit_contrasts(*turned, distance, noise, turned_gains(gains, picture.shape[1]))
    values = _checked(picture, camera, target)
    curves, reasons = list[ContrastCurve](), list[MeasurementError]()
    for smms in type_smms(camera):
        try:
            curves.append(
                _fit_type(values, lattice, camera, smms, target, distance, noise, gains, None)
            )
        except MeasurementError as error:
            reasons.append(error)
    if not curves:
        raise reasons[0]
    return tuple(curves), tuple(str(reason) for reason in reasons)


def _turned(
    picture: npt.NDArray[np.generic], lattice: Lattice, camera: Camera, target: BarsAlongY
) -> tuple[npt.NDArray[np.generic], Lattice, Camera, Bars]:
    """The same after a quarter turn, which makes bars along y bars along x."""
    there = turned_lattice(lattice, picture.shape[1])
    return turned_picture(picture), there, turned_camera(camera), target.unturned


def _checked(
    picture: npt.NDArray[np.generic], camera: Camera, target: Bars
) -> npt.NDArray[np.generic]:
    """The picture in its own kind of numbers: a copy of ten million pixels would cost as much as
    the fit.
    """
    if picture.dtype.kind == "u":
        require_shape(picture, camera, target.kind)
        return picture
    return require_picture(picture, camera, target.kind)


def _fit_type(
    values: npt.NDArray[np.generic],
    lattice: Lattice,
    camera: Camera,
    smms: Smms,
    target: Bars,
    distance: float,
    noise: SensorNoise,
    gains: Array | None,
    wavelength: float | None,
) -> ContrastCurve:
    across, along = scales_of(smms, distance)
    kinds = len(camera.array.focal_lengths)
    chosen = (
        np.ones(len(lattice.centres_px), dtype=np.bool_)
        if kinds == 1
        else microlens_type_of(lattice, camera) == float(smms.focal)
    )
    nominal = float(smms.inside_radius) / camera.sensor.pixel
    # a lattice of several kinds has the central one's measured radius
    radius = lattice.inside_radius_px if kinds == 1 else min(lattice.inside_radius_px, nominal)
    start = np.array([0.0, across, 0.0, along, 0.0])
    looks_at = np.abs(
        sensor_position(camera.sensor, lattice.centres_px) * along
    ) - radius * camera.sensor.pixel * abs(across)
    chosen &= _blurred_alike(lattice, smms, distance, camera.sensor.pixel)
    bright = field_of(
        lattice, radius, chosen & (looks_at < [target.width / 2, target.height / 2]).all(axis=1)
    )
    frame = Frame(
        values, lattice, bright, camera, smms, target, distance, noise, gains, start, wavelength
    )
    data = _on_target(frame, FIRST_RUN)
    model = model_of(frame, data)
    few = scattered(data, MOST_RUNS_WHILE_SEARCHING)
    first = search(frame, few, model)
    begun, fit = model, settle(frame, few, first, model)
    smear = abs(float(fit.geometry[2])) * camera.sensor.pixel * max(target.cycles_per_mm)
    rows = int(np.clip(MOST_SMEAR / max(smear, 1e-9), 1, MOST_ROWS))
    if rows != FIRST_RUN:
        data = _on_target(frame, rows)
    fit = settle(frame, data, fit, model)
    for _ in range(0 if gains is None else GAIN_ROUNDS):
        data = with_fitted_gains(data, fit, model)
        fit = settle(frame, data, fit, model)
    lost = _lost_light(frame, data, fit)
    if lost.any():
        data = replace(data, read=data.read + data.light @ fit.brightness * lost / (1 - lost))
        fit = settle(frame, data, fit, model)
    by_tilt, plain = np.zeros((0, CURVE + len(fit.curve))), (data, model, fit)
    if target.kind == "bars":
        # the stages' errors blur differently from what is nominal, and the highest harmonics are
        # seen through the template alone
        before = fit
        model, fit = with_fitted_blur(frame, data, before, model)
        drawn = drawn_aside(frame, data, model, fit)
        if drawn.any():
            data = replace(data, read=data.read - drawn)
            fit = settle(frame, data, fit, model)
        plain = data, model, fit
        data, model, fit, by_tilt = as_sharp_as_the_axis(frame, data, fit, model, before)
    prior, unsure = prior_of(frame, data, model.knots), np.zeros(0)
    by_views, views = np.zeros((len(prior.mean),) * 2), views_of(data, model, fit)
    if views.differ and _is_bars(frame, data, model, fit):  # more than a tilt explains
        alike = data, model, fit, prior
        data, model, fit = plain
        upright = first.geometry * [1.0, 1.0, 0.0, 1.0, 0.0]
        starts = (begun, first.geometry), (begun, upright), (begun, start + upright * SHIFTED)
        views, model, fit = with_views(views, data, model, fit, prior, starts)
        prior = as_strong(prior, model, fit)
        by_views = jackknife(data, views, model, fit, prior)
        unsure = unsure_blurs(data, views, model, fit)
        data = views.seen_in(data)
        if noise_covariance(data, model, fit, prior)[1] > noise_covariance(*alike)[1]:
            data, model, fit, prior = alike  # views by themselves went astray
            by_views = np.zeros_like(by_views)
    return _curve(frame, fit, data, model, prior, by_tilt, float(lost.mean()), by_views, unsure)


def _is_bars(frame: Frame, data: ChirpData, model: ChirpModel, fit: ChirpFit) -> bool:
    """Whether a picture shows the target at all, so that views of it may differ."""
    left = data.read - expected(data, model, fit)
    light = abs(float(np.mean(data.light @ fit.brightness)))
    larger = abs(float(fit.geometry[1] / frame.start[1]))
    near = 1 / MOST_LARGER < larger < MOST_LARGER
    return bool(near and np.sqrt(np.mean(left**2)) < NO_BARS * light)


def _blurred_alike(
    lattice: Lattice, smms: Smms, distance: float, pixel: float
) -> npt.NDArray[np.bool_]:
    """Which micro-images are as blurred as those on the axis, so that one transfer is theirs: of a
    tilted array a band across the tilt.
    """
    return np.abs(defocus_apart(lattice, smms, distance)) < AS_SHARP_PX * pixel


def _on_target(frame: Frame, rows: int) -> ChirpData:
    """Runs of unsaturated pixels that look at the target well within its edges."""
    target, start = frame.target, frame.start
    if frame.field.radius_px <= 0:
        raise MeasurementError(
            f"{target.kind} picture: the micro-images have no bright field; a larger f-number"
            " gives one"
        )
    if frame.field.radius_px < NARROWEST:
        raise MeasurementError(
            f"{target.kind} picture: the bright fields are"
            f" {2 * (frame.field.radius_px + MARGIN_PX):.0f} px wide and"
            f" {2 * (NARROWEST + MARGIN_PX):.0f} are due, in fewer one bar is easily taken for the"
            " next; choose another f-number"
        )
    tilt = (
        tilted_scales(frame.lattice, frame.smms, frame.distance),
        tilted_levels(frame.lattice, frame.smms),
    )
    ends = _ends(frame)
    data, saturated = gather(
        frame.values,
        frame.lattice,
        frame.field,
        frame.camera.sensor,
        frame.noise,
        ends,
        rows,
        frame.gains,
        *tilt,
    )
    seen = data.places[:, 1] * start[1] + data.places[:, 3] * start[3]
    kept = data.part(np.abs(seen) < target.width / 2 - _margin(frame))
    pixels = int(kept.pixels.sum())
    if pixels < FEWEST_PIXELS:
        raise MeasurementError(
            f"{target.kind} picture: only {pixels} unsaturated pixels of bright fields look at the"
            f" target, {FEWEST_PIXELS} are due; check exposure, f-number and the target's distance"
        )
    if saturated > MOST_SATURATED * (saturated + data.pixels.sum()):
        raise MeasurementError(
            f"{target.kind} picture: {saturated} pixels of bright fields are saturated; expose it"
            " shorter"
        )
    return kept


def _lost_light(frame: Frame, data: ChirpData, fit: ChirpFit) -> Array:
    """Share of the mean light that diffraction takes from each run over the target's edges, beyond
    which it is dark, shape (n,).
    """
    if frame.wavelength is None:
        return np.zeros(len(data.read))
    vergence, ends = 1 / frame.distance, np.array([frame.target.width, frame.target.height]) / 2
    seen = np.stack(
        [
            data.seen_at(fit.geometry),
            data.places[:, 2] * fit.geometry[1] + data.places[:, 4] * fit.geometry[3],
        ],
        axis=1,
    )
    away = np.stack([ends - seen, ends + seen], axis=2).reshape(-1, 4) * float(
        magnification(frame.smms, vergence)
    )
    return lost_over_edges(away, float(cone_half_angle(frame.smms, vergence)), frame.wavelength)


def _margin(frame: Frame) -> float:
    """How far within the target's edges a pixel must look, mm."""
    scale, half_angle = (
        float(of(frame.smms, 1 / frame.distance)) for of in (magnification, cone_half_angle)
    )
    waves = float(far_light(half_angle, frame.wavelength)) / MOST_LOST if frame.wavelength else 0.0
    return (
        float(blur(frame.smms, 1 / frame.distance)) / 2 + 3 * frame.camera.sensor.pixel + waves
    ) / scale + 0.01 * frame.target.width


def _ends(frame: Frame) -> Array:
    """First and last row of each micro-image that look at the target well within its edges, px from
    its centre, shape (n, 2).
    """
    sensor = frame.camera.sensor
    centres = sensor_position(sensor, frame.lattice.centres_px)[frame.field.lenses]
    up = np.array([[-1.0, 1.0]]) * (frame.target.height / 2 - _margin(frame))
    return np.sort((up - centres[:, 1:] * frame.start[3]) / (frame.start[1] * sensor.pixel), axis=1)


def _over_views(
    data: ChirpData, model: ChirpModel, fit: ChirpFit, nu: Array, unsure: Array
) -> tuple[Array, Array, Array]:
    """Share of each view in each frequency, by its pixels near it, shape (V, K); how much more of
    it the views pass in that mean than one blurred as all are together, shape (K,); and how much
    less where each one's blur is more by its uncertainty (mm^2), shape (V, K).
    """
    lenses, first, view = np.unique(data.lens, return_index=True, return_inverse=True)
    own = model.template.through(data.wider[first], nu)
    less = own - model.template.through(data.wider[first] + unsure, nu) if unsure.size else 0 * own
    frequency, share = model.frequency(data.seen_at(fit.geometry)), np.zeros(own.shape)
    for k, one in enumerate(nu):
        near = np.abs(frequency - one) <= model.knots.step / 2
        # a view that departs from the model has more noise than its pixels
        share[:, k] = np.bincount(view[near], 1 / data.shot[near], minlength=len(lenses))
    share /= np.maximum(share.sum(axis=0), 1e-300)
    seen = share.any(axis=0)
    sharper = np.where(seen, np.sum(share * own, axis=0) - model.template.transfer(nu), 0.0)
    return share, sharper, share * less


def _curve(
    frame: Frame,
    fit: ChirpFit,
    data: ChirpData,
    model: ChirpModel,
    prior: Prior,
    by_tilt: Array,
    lost: float,
    by_views: Array,
    unsure: Array,
) -> ContrastCurve:
    target, sensor = frame.target, frame.camera.sensor
    covariance, chi2 = noise_covariance(data, model, fit, prior)
    misfit = float(
        np.sqrt(np.mean((data.read - expected(data, model, fit)) ** 2))
        / abs(np.mean(data.light @ fit.brightness))
    )
    beyond_noise = misfit * math.sqrt(max(1 - 1 / chi2, 0.0)) if chi2 > 0 else 0.0
    if (chi2 > WORST_CHI2 and misfit > WORST_MISFIT) or beyond_noise > HOPELESS:
        raise MeasurementError(
            f"{target.kind} picture: the fit leaves {100 * misfit:.2g} % of the light, {chi2:.0f}"
            f" times the noise's variance, and {100 * WORST_MISFIT:g} % is allowed; check target"
            " and distance"
        )
    grown = (
        chi2 if chi2 > 1 + CLEARLY * math.sqrt(2 / len(data.read)) else 1.0
    )  # noise alone scatters it about 1
    if by_views.any():  # each view has its own blur, whatever the tilt
        covariance = np.pad(covariance, (0, 1)) * grown
    else:
        covariance = with_blur_unsure(data, model, fit, prior, covariance) * grown
        covariance[:-1, :-1] += by_tilt.T @ by_tilt
    spline = covariance[CURVE:, CURVE:]
    # The target's own grid, not the picture's, so that two pictures of one target can be compared
    # frequency by frequency.
    nu = np.linspace(*target.cycles_per_mm, KNOTS + 2)[1:-1]
    nu = nu[(nu >= model.span[0]) & (nu <= model.span[1])]
    design = transfer_rows(model, fit.curve, nu)
    share, sharper, less = _over_views(data, model, fit, nu, unsure)
    design[:, 0] += sharper
    dimmed = SURROUNDINGS * lost * (design[:, :-1] @ fit.curve)
    waves = 0.0 if frame.wavelength is None else WAVES_ERROR**2
    spread = design @ spline @ design.T + np.outer(dimmed, dimmed) + waves * np.eye(len(nu))
    scatter = np.einsum("ki,ij,kj->k", design[:, :-1], by_views[CURVE:, CURVE:], design[:, :-1])
    more = np.sqrt(np.maximum(scatter / np.diag(spread), 1.0))
    # views of one column share the pixels' phase, which their scatter cannot show
    floor = PHASE_ERROR**2 if by_views.any() else 0.0
    spread = spread * np.outer(more, more) + floor * np.eye(len(nu)) + less.T @ less
    frequency = target.frequency(data.seen_at(fit.geometry))
    near = np.array(
        [data.pixels[np.abs(frequency - one) <= model.knots.step / 2].sum() for one in nu]
    )
    keep = (near >= FEWEST_PIXELS / KNOTS) & (np.sqrt(np.diag(spread)) < WORST_UNCERTAINTY)
    if not keep.any() or not np.isfinite(fit.geometry).all():
        raise MeasurementError(
            f"{target.kind} picture: the fit of the bars did not settle; check exposure, focus,"
            " target and distance"
        )
    nu, contrast = nu[keep], design[keep, :-1] @ fit.curve
    clearest = float(np.max(contrast / np.sqrt(np.diag(spread)[keep])))
    if clearest < LEAST_CLEAR:
        raise MeasurementError(
            f"{target.kind} picture: no bars of the target's law were found, their contrast is at"
            f" most {clearest:.1f} of its standard uncertainty and {LEAST_CLEAR:g} is due; check"
            " target and distance"
        )
    if float(np.max(np.abs(contrast) - 3 * np.sqrt(np.diag(spread)[keep]))) > HIGHEST:
        raise MeasurementError(
            f"{target.kind} picture: the fit of the bars gives a contrast of"
            f" {np.abs(contrast).max():.2g}, which no target has; check target, distance and the"
            " lattice"
        )
    extremes, extremes_spread = fitted_extremes(model, fit.curve, spline, nu)
    growth = model.law[1] * sensor.pixel * fit.geometry
    centres = sensor_position(sensor, frame.lattice.centres_px)[frame.field.lenses]
    middle = float(model.frequency(fit.geometry[:1])[0])
    law = (middle, (float(growth[1]), float(growth[2])), centres @ fit.geometry[3:] * model.law[1])
    classic, classic_spread = classic_reading(
        frame.values, frame.lattice, frame.field, frame.noise, frame.gains, law, _ends(frame), nu
    )
    views, each, doubts = views_contrast(data, model, fit, nu)
    doubts *= math.sqrt(grown)
    # where even all views together are less sure than a view's noise, their place on the target is
    # what is unknown
    each[doubts < np.sqrt(np.diag(spread)[keep])] = np.nan
    doubts[np.isnan(each)] = np.nan
    scale = float(magnification(frame.smms, 1 / frame.distance))
    return ContrastCurve(
        focal_length=float(frame.smms.focal),
        cycles_per_mm=nu,
        cycles_per_px=nu * sensor.pixel / scale,
        contrast=contrast,
        covariance=spread[np.ix_(keep, keep)],
        extremes=extremes,
        extremes_uncertainty=extremes_spread,
        classic=classic,
        classic_uncertainty=classic_spread,
        views=views,
        views_contrast=each,
        views_uncertainty=doubts,
        geometry=fit.geometry,
        geometry_uncertainty=np.sqrt(np.diag(covariance)[:GEOMETRY]),
        chi2_per_pixel=chi2,
        pixels=int(data.pixels.sum()),
        views_share=share[:, keep],
        apart=bool(by_views.any()),
        misfit=beyond_noise,
    )
