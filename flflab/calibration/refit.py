"""Fits of the model to measurements: the distances L (main lens to array) and b (array to sensor)
from parallax.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from flflab.calibration.least_squares import covariance as covariance_of
from flflab.calibration.least_squares import jacobian as derivatives
from flflab.digits import plus_minus, two_digits
from flflab.errors import MeasurementError
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Refit:
    """A camera whose distances L and b were fitted to parallax slopes.

    Attributes:
        camera: the camera with the fitted distances; everything else as it was.
        covariance: of (L, b), mm^2, scaled by ``scatter``; shape (2, 2).
        scatter: reduced chi-square; above 1 the points scatter more than their uncertainties allow.
        points: number of points fitted.
        loosened: standard uncertainties of (L, b) in mm if one more parameter were fitted with
            them: ``focal_length`` of the main lens, or a ``distance_offset`` common to all D.
        selection: change of (L, b) where only a part of the views is used, mm; 0 where no other
            part was tried.
        within: that part lies at most so far from the centres of the micro-images, mm.
    """

    camera: Camera
    covariance: Array
    scatter: float
    points: int
    loosened: dict[str, Array]
    selection: Array = field(default_factory=lambda: np.zeros(2))
    within: float = np.inf

    @property
    def own(self) -> Array:
        """Standard uncertainties of (L, b) from the scatter of the points, mm."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainties of (L, b), mm: own, and the change with the selection of views as
        the half width of a rectangular distribution (type B).
        """
        return np.sqrt(self.own**2 + self.selection**2 / 3)

    @property
    def correlation(self) -> float:
        """Correlation of L and b."""
        return float(self.covariance[0, 1] / np.prod(self.own))

    @property
    def directions(self) -> tuple[tuple[Array, float], tuple[Array, float]]:
        """Best and worst known direction in (L, b), unit vectors, each with its standard
        uncertainty in mm.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        return (vectors[:, 0], float(np.sqrt(values[0]))), (
            vectors[:, 1],
            float(np.sqrt(values[1])),
        )


def parallax_slope(L: Array | float, b: Array | float, F: float, D: Array) -> Array:
    """Slope of sensor position over microlens position of one object point: 1 - b / (D' - L), with
    1/D' = 1/F - 1/D.

    That is 1 - 1/v for a Galilean and 1 + 1/v for a Keplerian arrangement; x = L (1/D - 1/F + 1/L)
    keeps it finite for an object in the front focal plane. Source: similar triangles at the array,
    through the centres of the microlenses.
    """
    x = L * (1 / D - 1 / F) + 1
    return 1 - b / L * (1 - x) / x


def refit_distances(
    camera: Camera, distance: Array, array_position: Array, slope: Array, uncertainty: Array
) -> Refit:
    """Fit L and b by weighted least squares on the parallax slopes; pitch, tilt, pixel and main
    lens are kept.

    The slope is fitted, not the virtual depth 1 / |slope - 1|: it is linear in the measured
    positions, so its errors are normal.

    Args:
        camera: where the fit begins.
        distance: D of each point, shape (P,), mm.
        array_position: mean (x, y) of each point's microlenses, shape (P, 2), mm; a tilted array
            has its own L and b there.
        slope: measured, shape (P,).
        uncertainty: standard uncertainties of ``slope``, shape (P,).

    Raises:
        MeasurementError: fewer than three points, or points that leave L and b undetermined.
    """
    if len(slope) < 3:
        raise MeasurementError(
            f"refit of L and b: {len(slope)} points with parallax given; at least 3, at different"
            " distances, are due"
        )
    rise = array_position @ np.asarray(camera.array.tilt)

    def residuals(p: Array) -> Array:
        L, b, F, D0 = p
        return (parallax_slope(L + rise, b - rise, F, distance + D0) - slope) / uncertainty

    start = np.array([camera.array.distance, camera.gap, camera.main_lens.focal_length, 0.0])
    found = least_squares(
        lambda p: residuals(np.concatenate([p, start[2:]])),
        start[:2],
        x_scale=start[1],
        xtol=1e-14,
        ftol=1e-14,
    )
    best = np.concatenate([found.x, start[2:]])
    jacobian = derivatives(residuals, best, 1e-5 * start[1])
    scatter = float(np.sum(residuals(best) ** 2) / (len(slope) - 2))
    if (
        not np.all(np.isfinite(jacobian))
        or np.linalg.cond(jacobian[:, :2] / np.linalg.norm(jacobian[:, :2], axis=0)) > 1e7
    ):
        raise MeasurementError(
            "refit of L and b: these points leave L and b undetermined; points at different"
            " distances are due"
        )
    fitted = replace(
        camera,
        array=replace(camera.array, distance=float(best[0])),
        sensor=replace(camera.sensor, distance=float(best[0] + best[1])),
    )
    covariance = covariance_of(jacobian[:, :2]) * scatter
    loosened = {
        name: np.sqrt(np.diag(covariance_of(jacobian[:, [0, 1, column]]) * scatter))[:2]
        for column, name in ((2, "focal_length"), (3, "distance_offset"))
    }
    return Refit(fitted, covariance, scatter, len(slope), loosened)


def depend_on_selection(refit: Refit, other: Refit, within: float) -> Refit:
    """The refit, uncertain by how another one differs that uses only the views within so many mm of
    the centres of their micro-images.
    """
    (L, b), (other_L, other_b) = (
        (one.camera.array.distance, one.camera.gap) for one in (refit, other)
    )
    return replace(refit, selection=np.array([other_L - L, other_b - b]), within=within)


def state_refit(before: Camera, refit: Refit) -> list[str]:
    """What the refit found, and what the data do and do not determine, in sentences."""
    camera, (u_L, u_b), (own_L, own_b) = refit.camera, refit.uncertainty, refit.own
    (best, known), (worst, unknown) = refit.directions
    by_focal, by_offset = refit.loosened["focal_length"], refit.loosened["distance_offset"]
    said = [
        (
            f"Refit of L and b alone to the parallax of {refit.points} points: L ="
            f" ({plus_minus(camera.array.distance, u_L)}) mm (before:"
            f" {before.array.distance:.4f} mm); b = ({plus_minus(camera.gap, u_b)}) mm (before:"
            f" {before.gap:.5f} mm); correlation of what scatters {refit.correlation:+.3f}; reduced"
            f" chi-square {refit.scatter:.2f}, by which that part is scaled. The poses are taken as"
            " exact."
        ),
        (
            f"The data determine {_combination(best)} to {1e3 * known:.2g} um and"
            f" {_combination(worst)} to {1e3 * unknown:.2g} um. They do not separate L and b from"
            f" the main lens's focal length (with it free as well: {_both(by_focal)}), and hardly"
            f" from an error common to all distances D (with it free: {_both(by_offset)})."
        ),
    ]
    if np.isfinite(refit.within):
        move_L, move_b = refit.selection
        said.append(
            f"Which views are used decides: with those within {1e3 * refit.within:.1f} um of the"
            f" centres of their micro-images alone, L changes by {move_L:+.4f} mm and b by"
            f" {move_b:+.5f} mm; the scatter of the points alone would say u(L) ="
            f" {two_digits(own_L)} mm, u(b) = {two_digits(own_b)} mm."
        )
    return said


def _combination(direction: Array) -> str:
    L, b = direction * (np.sign(direction[0]) or 1)
    return f"{L:.2f} L {'+' if b >= 0 else '-'} {abs(b):.2f} b"


def _both(uncertainty: Array) -> str:
    if not np.all(np.isfinite(uncertainty)):
        return "neither is determined"
    return f"u(L) = {two_digits(uncertainty[0])} mm, u(b) = {two_digits(uncertainty[1])} mm"
