"""Contrast against frequency from a picture of bars or of a sine chirp, by a fit of the known
chirp; max and min as a baseline.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.contrast.fit import GEOMETRY, Equations, Fit, Model
from flflab.measurement.contrast.frame import Frame, frame_of, on_target, places_of
from flflab.measurement.contrast.readings import (
    classic_reading,
    extremes_of,
    frequencies_of,
    lost_light,
    misfit_of_all,
    views_of,
)
from flflab.measurement.contrast.runs import Runs
from flflab.measurement.contrast.search import fit_of
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import PixelSet
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.per_type import type_smms
from flflab.targets import Bars, Chirp

Array = npt.NDArray[np.float64]

EVEN = 1e-3  # of contrast: views surer than that count by their pixels alone
WORST_VIEW = 0.05
WORST_UNCERTAINTY = 0.25
HOPELESS = 0.1  # of the light, left beyond noise
LEAST_CLEAR = 5.0  # standard uncertainties of the contrast where it is clearest
FLOOR = 1e-4  # of contrast: what all views share, their noise does not show
OF_MISFIT = 0.3  # of what the fit leaves of the light beyond noise, all views may have alike
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
        views: positions of the views in the lattice, shape (V,).
        views_contrast: each view's own contrast near each frequency, shape (V, K), nan where it
            does not see it.
        views_uncertainty: standard uncertainties, shape (V, K).
        views_share: by how much each view counts in ``contrast``, shape (V, K).
        geometry: shift mm, across x and y, along x and y (see
            ``flflab.measurement.lattice.registration``), of bars along y with x and y exchanged;
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
        target: what stood there; bars along y are measured with x and y exchanged.
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
    given = frame_of(picture, lattice, camera, target, distance, noise, gains, wavelength)
    return _fit_type(given)


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
    given = frame_of(picture, lattice, camera, target, distance, noise, gains, None)
    curves, reasons = list[ContrastCurve](), list[MeasurementError]()
    for smms in type_smms(camera):
        try:
            curves.append(_fit_type(replace(given, smms=smms)))
        except MeasurementError as error:
            reasons.append(error)
    if not curves:
        raise reasons[0]
    return tuple(curves), tuple(str(reason) for reason in reasons)


def _fit_type(frame: Frame) -> ContrastCurve:
    pixels = on_target(frame)
    return _curve(frame, pixels, fit_of(frame, pixels))


def _curve(
    frame: Frame, pixels: PixelSet, found: tuple[Runs, Model, Fit, Equations]
) -> ContrastCurve:
    target, sensor, (runs, model, fit, equations) = frame.target, frame.sensor, found
    chi2, misfit = misfit_of_all(runs, model, fit)
    if not misfit < HOPELESS:
        raise MeasurementError(
            f"{target.kind} picture: the fit leaves {100 * misfit:.2g} % of the light, {chi2:.0f}"
            " times the noise's variance; check target and distance"
        )
    nu = frequencies_of(runs, model)
    views = views_of(runs, model, fit, equations, nu)
    share = views.pixels / (views.variance + EVEN**2)
    share = share / np.maximum(share.sum(axis=0), 1e-300)
    contrast, covariance = views.mean(share)
    keep = (share > 0).any(axis=0) & (np.diag(covariance) < WORST_UNCERTAINTY**2)
    nu, share, contrast = nu[keep], share[:, keep], contrast[keep]
    alike = math.hypot(FLOOR, OF_MISFIT * misfit)
    each, doubts = views.contrast[:, keep], np.sqrt(views.variance[:, keep] + alike**2)
    lost = lost_light(frame, runs, fit, nu)
    contrast = contrast * (1 - lost)
    dimmed = SURROUNDINGS * lost * contrast
    covariance = covariance[np.ix_(keep, keep)] + np.outer(dimmed, dimmed)
    covariance += alike**2 * np.eye(len(nu))
    doubt = np.sqrt(np.diag(covariance))
    _require_bars(target, contrast, doubt)
    ratio = extremes_of(model, fit, nu)
    looks_at = np.concatenate(places_of(frame, pixels), axis=1) @ fit.common[1:5] + fit.common[0]
    return ContrastCurve(
        focal_length=float(frame.smms.focal),
        cycles_per_mm=nu,
        cycles_per_px=nu * sensor.pixel / frame.scale,
        contrast=contrast,
        covariance=covariance,
        extremes=ratio * np.abs(contrast),
        extremes_uncertainty=ratio * doubt,
        classic=classic_reading(frame, pixels, target.frequency(looks_at), nu),
        views=runs.lenses,
        views_contrast=np.where(doubts < WORST_VIEW, each, np.nan),
        views_uncertainty=doubts,
        views_share=share,
        geometry=fit.common[GEOMETRY],
        geometry_uncertainty=np.sqrt(np.diag(views.common))[GEOMETRY],
        chi2_per_pixel=chi2,
        pixels=int(runs.pixels.sum()),
        misfit=misfit,
    )


def _require_bars(target: Bars, contrast: Array, doubt: Array) -> None:
    """Refuse contrasts that no bars have.

    Raises:
        MeasurementError: see there.
    """
    clearest = float(np.max(np.abs(contrast) / doubt, initial=0.0))
    if clearest < LEAST_CLEAR:
        raise MeasurementError(
            f"{target.kind} picture: no bars of the target's law were found, their contrast is at"
            f" most {clearest:.1f} of its standard uncertainty and {LEAST_CLEAR:g} is due; check"
            " exposure, focus, target and distance"
        )
