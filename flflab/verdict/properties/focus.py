"""Depth of field by through-focus: from the blur in pictures of one camera at several distances to
the distances of one pixel of blur.
"""

import itertools

import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.curve import ContrastCurve
from flflab.optics.camera import Camera
from flflab.optics.focus import microlens_limits
from flflab.optics.resolution import central_smms
from flflab.optics.smms import image_offset
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Values

Array = npt.NDArray[np.float64]
STEPS, TERMS = 12, 40
LEAST_LEFT = (
    0.05  # of the contrast by diffraction; where it leaves less, nothing can be said of the blur
)
FEWEST = 3  # distances: the blur's line has two unknowns, and one more says whether it is one


def depth_of_field(
    measured: tuple[Measured, ...], predicted: tuple[Predicted, ...]
) -> list[Values]:
    """Nearest and farthest distance with a blur of at most one pixel, mm, for every camera that was
    shown at three distances.

    The square of the blur is fitted to each contrast curve, over what diffraction leaves of a sharp
    one; with w = 1/x it is (d kappa - d b/L w)^2 where the microlens limits, a parabola whose two
    coefficients are fitted over the distances. What the model says goes through the same fits, draw
    by draw.
    """

    def camera(k: int) -> tuple[float, ...]:
        one = predicted[k].camera
        return (
            measured[k].configuration.f_number,
            round(one.array.distance, 6),
            round(one.sensor.distance, 6),
        )

    found: list[Values] = []
    for _, group in itertools.groupby(sorted(range(len(measured)), key=camera), camera):
        members = [k for k in group if _microlens_limits(predicted[k])]
        seen = [
            (measured[k].configuration.index, curve, predicted[k])
            for k in members
            if (curve := measured[k].curve)
        ]
        if len({round(model.distance, 3) for _, _, model in seen}) >= FEWEST:
            found += _of_one_camera(seen)
    return found


def _microlens_limits(model: Predicted) -> bool:
    return bool(microlens_limits(central_smms(model.camera), 1 / model.distance))


def _of_one_camera(seen: list[tuple[int, ContrastCurve, Predicted]]) -> list[Values]:
    """Of configurations, each with its number, its curve and what the model says."""
    camera = seen[0][2].camera
    pixel = camera.sensor.pixel
    smms = central_smms(camera)
    w = np.array([1 / float(image_offset(smms, 1 / model.distance)) for _, _, model in seen])
    squares, doubts, drawn = list[float](), list[float](), list[Array]()
    for _, curve, model in seen:
        start, kept = np.array([model.blur_px**2]), model.waves_left > LEAST_LEFT
        left, frequency = model.waves_left[kept], curve.cycles_per_px[kept]
        covariance = curve.covariance[np.ix_(kept, kept)] / np.outer(left, left)
        value, doubt = blur_squared(curve.contrast[None, kept] / left, frequency, covariance, start)
        squares.append(float(value[0]))
        doubts.append(doubt)
        drawn.append(
            blur_squared(model.contrast_draws[:, kept] / left, frequency, covariance, start)[0]
        )
    nominal = (
        np.array(
            [float(smms.aperture * smms.kappa), -float(smms.aperture * smms.gap / smms.distance)]
        )
        / pixel
    )
    weights = 1 / np.maximum(np.array(doubts), 1e-3)
    ends, slopes = line_ends(np.array([squares]), w, weights, nominal, camera)
    draws = line_ends(np.stack(drawn, axis=1), w, weights, nominal, camera)[0]
    noise = slopes[0] @ np.diag(np.array(doubts) ** 2) @ slopes[0].T
    sharpest = min(seen, key=lambda one: one[2].blur_px)[0]
    return [
        Values(
            sharpest, f"depth_of_field_{end}_mm", "bars", ends[0, k : k + 1],
            noise[k : k + 1, k : k + 1],
            draws[:, k].mean(keepdims=True), draws[:, k : k + 1], (None,), (None,),
        )
        for k, end in enumerate(("near", "far"))
    ]  # fmt: skip


def blur_squared(
    contrast: Array, cycles_per_px: Array, covariance: Array, start: Array
) -> tuple[Array, float]:
    """Square of the blur's diameter in a contrast curve, px^2, and its standard uncertainty.

    Least squares with the curve's covariance of sinc(u) 2 J1(z)/z, z^2 = (pi u)^2 s: entire in s,
    so that noise in focus may make it negative and biases nothing.

    Args:
        contrast: curves, shape (n, K).
        cycles_per_px: u, shape (K,).
        covariance: of a curve, shape (K, K).
        start: where to begin, px^2, shape (1,).
    """
    inverse = np.linalg.pinv(covariance, hermitian=True)
    factor = (np.pi * cycles_per_px) ** 2 / 4
    s = np.repeat(start, len(contrast))
    curvature = 1.0
    for _ in range(STEPS):
        value, slope = _jinc_of_square(s[:, None] * factor)
        value, slope = np.sinc(cycles_per_px) * value, np.sinc(cycles_per_px) * slope * factor
        weighted = slope @ inverse
        curvature = np.sum(weighted * slope, axis=1)
        s = s + np.clip(np.sum(weighted * (contrast - value), axis=1) / curvature, -2.0, 2.0)
    return s, float(np.mean(curvature) ** -0.5)


def _jinc_of_square(y: Array) -> tuple[Array, Array]:
    """2 J1(z)/z with y = z^2/4, and its derivative by y: the series of (-y)^k / (k! (k + 1)!)."""
    total, slope, term = np.zeros_like(y), np.zeros_like(y), np.ones_like(y)
    for k in range(TERMS):
        total = total + term
        slope = slope - term / (k + 2)
        term = term * -y / ((k + 1) * (k + 2))
    return total, slope


def line_ends(
    squares: Array, w: Array, weights: Array, nominal: Array, camera: Camera
) -> tuple[Array, Array]:
    """Distances of one pixel of blur on both sides, shape (n, 2), mm, and their derivatives by the
    squares, shape (n, 2, len(w)).
    """
    line = np.repeat(nominal[None, :], len(squares), axis=0)
    design = np.stack([np.ones_like(w), w], axis=1)
    solution = np.zeros((len(squares), 2, len(w)))
    for _ in range(STEPS):
        blur = line @ design.T
        jacobian = 2 * blur[:, :, None] * design * weights[:, None]
        solution = np.linalg.pinv(jacobian) * weights
        line = line + np.einsum("nij,nj->ni", solution, squares - blur**2)
    smms = central_smms(camera)
    length, focal = float(smms.distance), float(smms.lens_focal)
    ends, slopes = np.zeros((len(squares), 2)), np.zeros((len(squares), 2, len(w)))
    for k, sign in enumerate((-1.0, 1.0)):
        at = (sign - line[:, 0]) / line[:, 1]
        vergence = (1 / at - 1 + length / focal) / length
        by_line = np.stack([-1 / line[:, 1], -at / line[:, 1]], axis=1)
        by_end = (1 / (at**2 * length * vergence**2))[
            :, None
        ] * by_line  # D = 1/V, V = (1/w - 1 + L/F)/L
        ends[:, k] = 1 / vergence
        slopes[:, k] = np.einsum("ni,nij->nj", by_end, solution)
    order = np.argsort(ends.mean(axis=0))
    return ends[:, order], slopes[:, order]
