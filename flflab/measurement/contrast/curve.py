"""Contrast against frequency from a picture of bars or of a sine chirp, by a fit of the known
chirp; max and min as a baseline.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.contrast.fit import each_alone, fitted
from flflab.measurement.contrast.frame import (
    FEWEST_PIXELS,
    Frame,
    lost_light,
    on_target,
    places_of,
    runs_of,
)
from flflab.measurement.contrast.model import DISC, GEOMETRY, Fit, Model, look_at, weights
from flflab.measurement.contrast.readings import (
    classic_reading,
    contrast_of,
    extremes_of,
    shares_of,
    views_contrast,
)
from flflab.measurement.contrast.runs import Runs
from flflab.measurement.contrast.search import KNOTS, MOST_RUNS, model_of, scattered, search
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import (
    PixelSet,
    require_picture,
    require_shape,
)
from flflab.measurement.quarter_turn import (
    turned_camera,
    turned_gains,
    turned_lattice,
    turned_picture,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.focus import blur
from flflab.optics.per_type import type_smms
from flflab.optics.resolution import central_smms
from flflab.targets import Bars, BarsAlongY, Chirp

Array = npt.NDArray[np.float64]

HIGHEST = 1.3  # contrast above it no target has, whatever lights it
WORST_UNCERTAINTY = 0.25
HOPELESS = 0.1  # of the light, left beyond noise
LEAST_CLEAR = 5.0  # standard uncertainties of the contrast where it is clearest
# cycles that bars may drift along a run of pixels: it takes 7e-5 of the highest frequency's
# contrast
MOST_SMEAR = 0.02
FIRST_RUN, MOST_ROWS = 16, 128  # pixels of a run while the bars' slant is not known, and after
CLOSE = 0.03  # fall of chi squared that ends a part of the fit
# of contrast: views of one column share the pixels' phase, which their scatter cannot show; out of
# focus what falls off over the cone besides
FLOOR, FLOOR_A_BLUR_PX = 3e-4, 5e-5
# of the light that diffraction takes over a target's edges: how dark it is beyond them is not known
# better
SURROUNDINGS = 0.3


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
        covariance: of ``contrast``, from noise, scatter of the views and registration together,
            shape (K, K).
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
        views_share: by how much each view counts in ``contrast``, shape (V, K).
        geometry: shift mm, across x and y, along x and y (see
            ``flflab.measurement.lattice.registration``), for bars along y after a quarter turn;
            shape (5,).
        geometry_uncertainty: standard uncertainties, shape (5,).
        chi2_per_pixel: about 1 where the model holds; the covariances already count what is more.
        pixels: number of pixels used.
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
    views_share: Array
    geometry: Array
    geometry_uncertainty: Array
    chi2_per_pixel: float
    pixels: int
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
    """Measure contrast against frequency in every bright field of the central microlens's kind.

    The target's place is found within 6 % of its width, its magnification within a few per cent;
    both are fitted together with the curve. Runs of pixels some of which are saturated are left
    out.

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
    return _fit_type(
        Frame(values, lattice, camera, one, target, distance, noise, gains, wavelength)
    )


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
        frame = Frame(values, lattice, camera, smms, target, distance, noise, gains, None)
        try:
            curves.append(_fit_type(frame))
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


def _fit_type(frame: Frame) -> ContrastCurve:
    pixels = on_target(frame)
    runs = runs_of(frame, pixels, FIRST_RUN)
    diameter = float(blur(frame.smms, 1 / frame.distance)) / frame.scale
    model = model_of(runs, frame.target, frame.camera.sensor.pixel, frame.start, diameter)
    fit = search(scattered(runs, MOST_RUNS), model, frame.target)
    smear = abs(float(fit.common[2])) * model.pixel * max(frame.target.cycles_per_mm)
    runs = runs_of(frame, pixels, int(np.clip(MOST_SMEAR / max(smear, 1e-9), 1, MOST_ROWS)))
    fit, model, weight = fitted(runs, model, each_alone(runs, model, fit), 2, CLOSE)
    if frame.gains is not None:
        runs = _with_fitted_gains(runs, model, fit)
        fit, model, weight = fitted(runs, model, fit, 2, CLOSE)
    return _curve(frame, pixels, runs, model, fit, weight)


def _with_fitted_gains(runs: Runs, model: Model, fit: Fit) -> Runs:
    """The runs with the gains of their sub-lattices that suit the fit best: bars may lie on one
    filter's columns more than on another's.
    """
    seen = look_at(runs, model, fit)
    weight = seen.due / weights(runs, seen)[0]
    read, due = (
        np.bincount(runs.sublattice, weight * part, minlength=4) for part in (runs.read, seen.due)
    )
    ratio = (read / np.maximum(due, 1e-300))[runs.sublattice]
    return replace(runs, read=runs.read / ratio, dark=runs.dark / ratio**2, shot=runs.shot / ratio)


def _curve(
    frame: Frame, pixels: PixelSet, runs: Runs, model: Model, fit: Fit, weight: Array
) -> ContrastCurve:
    target, sensor = frame.target, frame.camera.sensor
    seen = look_at(runs, model, fit)
    chi2, misfit = _misfit(runs, model, fit)
    if not misfit < HOPELESS:
        raise MeasurementError(
            f"{target.kind} picture: the fit leaves {100 * misfit:.2g} % of the light, {chi2:.0f}"
            " times the noise's variance; check target and distance"
        )
    # the target's own grid, not the picture's, so that two pictures of one target can be compared
    # frequency by frequency
    frequency, step = model.pattern.frequency(seen.x), model.knots[1] - model.knots[0]
    nu = np.linspace(*target.cycles_per_mm, KNOTS + 2)[1:-1]
    near = np.array([runs.pixels[np.abs(frequency - one) <= step / 2].sum() for one in nu])
    nu = nu[(near >= FEWEST_PIXELS / KNOTS) & (nu >= model.knots[3]) & (nu <= model.knots[-4])]
    share = shares_of(runs, frequency, nu, step)
    contrast, spread, by_views, where = contrast_of(runs, model, fit, weight, nu, share)
    lost = np.array(
        [
            np.mean(lost_light(frame, runs, fit, seen.x)[np.abs(frequency - one) <= step / 2])
            for one in nu
        ]
    )
    contrast = contrast * (1 - lost)
    more = np.sqrt(np.maximum(np.diag(by_views) / np.diag(spread), 1.0))
    blurred = math.sqrt(max(float(fit.common[DISC]), 0.0)) / model.pixel_seen
    floor = FLOOR + FLOOR_A_BLUR_PX * blurred
    dimmed = SURROUNDINGS * lost * contrast
    spread = spread * np.outer(more, more) + np.outer(dimmed, dimmed) + floor**2 * np.eye(len(nu))
    keep = np.sqrt(np.diag(spread)) < WORST_UNCERTAINTY
    nu, contrast, share = nu[keep], contrast[keep], share[:, keep]
    covariance = spread[np.ix_(keep, keep)]
    doubt = np.sqrt(np.diag(covariance))
    _require_bars(target, contrast, doubt)
    extremes, extremes_doubt = extremes_of(model, fit, nu, doubt)
    looks_at = np.concatenate(places_of(frame, pixels), axis=1) @ fit.common[1:5] + fit.common[0]
    classic, classic_doubt = classic_reading(
        frame.values, pixels, model.pattern.frequency(looks_at), frame.noise, frame.gains, nu
    )
    each, doubts = views_contrast(runs, model, fit, nu)
    doubts *= math.sqrt(max(chi2, 1.0))
    return ContrastCurve(
        focal_length=float(frame.smms.focal),
        cycles_per_mm=nu,
        cycles_per_px=nu * sensor.pixel / frame.scale,
        contrast=contrast,
        covariance=covariance,
        extremes=extremes,
        extremes_uncertainty=extremes_doubt,
        classic=classic,
        classic_uncertainty=classic_doubt,
        views=runs.lenses,
        views_contrast=each,
        views_uncertainty=doubts,
        views_share=share,
        geometry=fit.common[GEOMETRY],
        geometry_uncertainty=where,
        chi2_per_pixel=chi2,
        pixels=int(runs.pixels.sum()),
        misfit=misfit,
    )


def _misfit(runs: Runs, model: Model, fit: Fit) -> tuple[float, float]:
    """Chi squared over what noise makes of it, and the rms of what is left beyond noise, as a
    share of the light.
    """
    seen = look_at(runs, model, fit)
    variance, weight = weights(runs, seen)
    left = (runs.read - seen.due) ** 2
    free = max(1 - (fit.own.size + len(fit.common)) / len(left), 0.1)
    chi2 = float(weight @ left) / (float(weight @ variance) * free)
    light = abs(float(np.mean(seen.level)))
    return chi2, math.sqrt(float(np.mean(left)) * max(1 - 1 / max(chi2, 1e-9), 0.0)) / light


def _require_bars(target: Bars, contrast: Array, doubt: Array) -> None:
    """Refuse contrasts that no bars have.

    Raises:
        MeasurementError: see there.
    """
    if len(contrast) == 0:
        raise MeasurementError(
            f"{target.kind} picture: the fit of the bars did not settle; check exposure, focus,"
            " target and distance"
        )
    clearest = float(np.max(contrast / doubt))
    if clearest < LEAST_CLEAR:
        raise MeasurementError(
            f"{target.kind} picture: no bars of the target's law were found, their contrast is at"
            f" most {clearest:.1f} of its standard uncertainty and {LEAST_CLEAR:g} is due; check"
            " target and distance"
        )
    if float(np.max(np.abs(contrast) - 3 * doubt)) > HIGHEST:
        raise MeasurementError(
            f"{target.kind} picture: the fit of the bars gives a contrast of"
            f" {np.abs(contrast).max():.2g}, which no target has; check target, distance and the"
            " lattice"
        )
