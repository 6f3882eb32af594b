"""How large the square of dots is on the sensor, and how far a dot moves from one micro-image to
the next, beside what is described.

A dot o on the target is shown at m o + p c + shift in the micro-image of centre c, from there. In a
camera as described m = -b V/x and p = m D/(L + b), D = 1/V the target's distance, L the array's, b
the gap, x the image offset, which the gap does not change: the two together tell a wrong distance
from a wrong gap.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.dots.find import Found
from flflab.measurement.lattice.registration import target_scales
from flflab.optics.camera import Camera
from flflab.optics.focus import microlens_limits
from flflab.optics.resolution import central_smms
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]

TOLERANCE = 0.01  # of size and parallax, and in rad of turn: what differs less is not remarked on
SURE = 4.0  # standard uncertainties by which it must differ too
# so much may all spots lie farther out than they are placed, before cameras not quite as described
OUTWARDS_PX = 0.003
WIDEST = 0.1  # uncertainty of the parallax: less sure ones are none
STEP = 1e-5  # of the vergence, by which slopes are told


@dataclass(frozen=True)
class DotScale:
    """Images of dots over what the camera makes of them at the distance given; standard
    uncertainties beside.

    Attributes:
        size: of the square of dots, over the camera's.
        size_uncertainty: of it.
        parallax: from one micro-image to the next, over the camera's.
        parallax_uncertainty: of it.
        turn: of the square on the sensor, rad; as uncertain as the size.
    """

    size: float
    size_uncertainty: float
    parallax: float
    parallax_uncertainty: float
    turn: float


def scale_of(found: Found, shared: Array, target: FourDot, distance: float) -> DotScale | None:
    """Size, turn and parallax of one square that faces the camera, by weighted least squares
    through the places of its dots; None where too few dots in too few micro-images tell them.

    Args:
        found: the dots.
        shared: how their numbers move with a standard uncertainty of what all share, shape
            (3 dots + 1, k).
        target: what stood there.
        distance: main lens to target, mm, nominal.
    """
    seen = np.unique(found.seen.dot[found.seen.counted])
    if len(seen) < 2:
        return None
    which = (3 * seen[:, None] + np.arange(3)).ravel()
    weights = np.linalg.inv(found.stand.covariance[np.ix_(which, which)])
    x, y = target.centres[seen].T
    design = np.zeros((len(seen), 3, 5))  # by shift (x, y), m (real, imaginary) and vergence
    design[:, :2, :2] = np.eye(2)
    design[:, 0, 2:4], design[:, 1, 2:4] = np.stack([x, -y], axis=1), np.stack([y, x], axis=1)
    design[:, 2, 4] = 1.0
    design = design.reshape(-1, 5)
    inverse = np.linalg.inv(design.T @ weights @ design)
    gains, values = inverse @ design.T @ weights, found.stand.values[seen].ravel()
    *_, real, imaginary, vergence = square = gains @ values
    left = values - design @ square
    excess = max(1.0, float(left @ weights @ left) / max(len(left) - len(square), 1))
    moved = gains @ shared[which]
    covariance = excess * inverse + moved @ moved.T
    camera, wide = found.seen.lenses.camera, math.hypot(real, imaginary)
    per_angle, described = (_per_angle(camera, at) for at in (vergence, 1 / distance))
    slope = (_per_angle(camera, vergence * (1 + STEP)) / per_angle - 1) / (vergence * STEP)
    by = np.array([[0, 0, real / wide**2, imaginary / wide**2, slope], [0, 0, 0, 0, slope]])
    doubts = np.sqrt(np.diag(by @ covariance @ by.T))
    outwards = OUTWARDS_PX * camera.sensor.pixel / float(np.std(found.stand.shown.chief @ [1, 1j]))
    doubts = np.hypot(doubts, outwards)
    if not doubts[1] < WIDEST:
        return None
    parallax = per_angle / described
    size = wide * distance * parallax
    return DotScale(
        size, size * doubts[0], parallax, parallax * doubts[1], math.atan2(imaginary, real)
    )


def _per_angle(camera: Camera, vergence: float) -> float:
    """mm on the sensor per rad between dots as the main lens sees them."""
    return 1 / (target_scales(camera, 1 / vergence)[0] * vergence)


def unlike_the_description(scale: DotScale, camera: Camera, distance: float) -> list[str]:
    """Sentences on what of size, parallax and turn is not as the camera's description and the
    distance (mm) make it.
    """
    smms, remarks = central_smms(camera), list[str]()
    pairs = (scale.size, scale.size_uncertainty), (scale.parallax, scale.parallax_uncertainty)
    if any(abs(ratio - 1) > max(TOLERANCE, SURE * doubt) for ratio, doubt in pairs):
        # p/m = D/(L + b), and m goes with the gap at any one distance; the dots' places suffer
        # where the blur is far from the described
        there = distance * scale.parallax / scale.size
        fits = f"a target about {there:.4g} mm away"
        if bool(microlens_limits(smms, 1 / distance)):
            across = [target_scales(camera, at)[0] for at in (there, distance)]
            gap = float(smms.gap) * scale.size * abs(across[0] / across[1])
            fits += (
                f" and a gap of about {gap:.4g} mm between microlenses and sensor (described:"
                f" {float(smms.gap):.4g} mm)"
            )
        larger, farther = (f"{ratio:.4f} +- {doubt:.4f} times" for ratio, doubt in pairs)
        remarks.append(
            f"the image of the dots is {larger} as large, and each shifts {farther} as far from one"
            f" micro-image to the next, as the camera's description makes it at {distance:.2f} mm;"
            f" {fits} would make both what they are; check the target's distance, the gap, and the"
            " spacing of the dots"
        )
    if abs(scale.turn) > max(TOLERANCE, SURE * scale.size_uncertainty):
        remarks.append(
            f"the dots are turned by {math.degrees(scale.turn):.2f} deg on the sensor; check the"
            " turn of the target and of the sensor"
        )
    return remarks
