"""How far a frame is out of focus, as all spots that an aperture cuts show it together, and what
that leaves open of their centres.

A cut spot is seen through one side of the cone: blur shifts it outwards or inwards, by the side of
the focus on which the sensor stands, and its inner and outer edge by different amounts, which
shows. How soft edges are says nothing of the side, and diffraction softens them as well: softness
is fitted beside the focus, does not decide it, and by noise may be less. Where blur is broad, the
dots' radius shifts cut spots too: with the square that they make it would grow or shrink without
end, but the spots' own look tells it. Every spot's (x, y, brightness) and the three numbers for all
of them are solved at once: those first, from what the spots' own parameters cannot explain (Schur's
complement).
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.spots.fit import inverted
from flflab.measurement.spots.law import Square

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

FOCUS_PX = 5.0  # of blur: so far, as a standard uncertainty, may the focus be off the nominal one
MOST_PX = 1.0  # of blur, in a step
# of blur, in a step from sharp edges, whose slopes say nothing of how soft they become; half the
# softness more
MOST_SHARP_PX = 0.25
SOUND = 1.1  # chi squared a pixel that noise may make of all spots together
STRANGE = (
    20.0  # times the typical misfit, beyond which a spot has no say: a neighbour's light, dust
)
# of blur: near focus the misfit has several least places so far apart, and edges no sharper than it
# bend it
SURE_PX = 0.01
# of blur: edges softer than by rays and noise show diffraction or aberrations, which shift cut
# spots too
SOFTER_PX = 0.3
# of that, as a standard uncertainty of the focus: unexplained, 550 nm lead it astray by 0.2 to 0.6
# at F/2.8 to F/5.6
SHARE_OF_SOFTER = 0.5
# chi squared a pixel below which the blur is so nearly right that edges can be no sharper than it
NEAR = 2.0
BY_NOISE = 2.0  # standard uncertainties by which noise may make edges seem sharper than the blur
BROAD_PX = 2.0  # of blur, from which that is less than what is left of fall-off makes of them
SHARPEST_PX = 0.03  # of blur: softer edges cannot be told from sharp ones


@dataclass(frozen=True)
class Focus:
    """The focus that cut spots show.

    Attributes:
        nominal_px: diameter of the blur by the nominal camera, signed as its defocus b/(L x kappa)
            - 1.
        blur_px: the same as the spots show it.
        softness_px: diameter of the disc that softens edges as they are seen.
        uncertainty_px: standard uncertainty of ``blur_px``; 0: the nominal focus counts as known.
    """

    nominal_px: float
    blur_px: float
    softness_px: float
    uncertainty_px: float


@dataclass(frozen=True)
class CommonStep:
    """A step of Gauss-Newton for spots and focus together.

    Attributes:
        steps: of (x, y, brightness), shape (n, 3).
        covariance: of the same for a known focus, shape (n, 3, 3); infinite where the pixels say
            nothing.
        together: as in ``Spots``.
        focus: as it is known now.
        radius: of a spot in focus, px, as it is known now.
    """

    steps: Array
    covariance: Array
    together: Array
    focus: Focus
    radius: float


def nominal_focus(blur_px: float, known: bool) -> Focus:
    """Where to start: what the camera says, known or to be fitted."""
    return Focus(
        blur_px,
        blur_px,
        max(abs(blur_px), 0.0 if known else SHARPEST_PX),
        0.0 if known else FOCUS_PX,
    )


def by_common_focus(
    normal: Array, right: Array, signed: Array, soft: Array, focus: Focus
) -> tuple[Array, Array]:
    """Normal matrices and right sides by the frame's blur and softness in place of each spot's own,
    shapes (n, 6, 6) and (n, 6).

    A spot's softness S goes with its blur B as with the frame's s and b, S^2 = s^2 + B^2 - b^2 and
    B - b fixed: dS = (B - b)/S db + s/S ds.
    """
    own = np.tile(np.eye(6), (len(right), 1, 1))
    own[:, 4, 3], own[:, 4, 4] = (signed - focus.blur_px) / soft, focus.softness_px / soft
    turned = own.transpose(0, 2, 1)
    return turned @ normal @ own, (turned @ right[:, :, None])[:, :, 0]


def common_step(
    normal: Array,
    right: Array,
    chi2_per_pixel: Array,
    usable: Flags,
    lit: Flags,
    focus: Focus,
    radius: float,
    square: Square,
    first: bool,
    astray: float = SHARE_OF_SOFTER,
) -> CommonStep:
    """Solve for spots and what they share: focus and radius.

    Args:
        normal: matrices of (x, y, brightness, blur, softness, radius), shape (n, 6, 6).
        right: right sides, shape (n, 6).
        chi2_per_pixel: of each spot.
        usable: spots bright enough to be solved for.
        lit: those with so much light that they say something of the focus: the places of others are
            not known well enough.
        focus: where this step starts.
        radius: the same of the radius of a spot in focus, px.
        square: what the law says of the radius, by the places of these spots.
        first: spots are not where they belong yet, and show how soft edges are but neither the side
            of the focus nor the radius.
        astray: share of what softens edges beyond their blur that leads the focus astray, as a
            standard uncertainty, where noise explains the misfit; ``SHARE_OF_SOFTER`` where it does
            not.
    """
    covariance = inverted(normal[:, :3, :3], usable)
    good = np.isfinite(covariance[:, 0, 0])
    known = np.where(good[:, None, None], covariance, 0.0)
    steps, gains = (known @ right[:, :3, None])[:, :, 0], -known @ normal[:, :3, 3:]
    # the square makes spots as large as its own size, which their places show, which move with what
    # they share
    moved = square.radius_px + float((square.by_places * steps[:, :2]).sum()) - radius
    if focus.uncertainty_px == 0:
        return CommonStep(steps, covariance, np.zeros((len(steps), 2, 2)), focus, radius + moved)
    typical = max(float(np.median(chi2_per_pixel[good & lit])), 1.0) if (good & lit).any() else 1.0
    heard = good & lit & (chi2_per_pixel < STRANGE * typical)
    says = (normal[:, 3:, 3:] + normal[:, 3:, :3] @ gains)[heard].sum(axis=0)
    pulls = (right[:, 3:] + np.einsum("nik,ni->nk", gains, right[:, :3]))[heard].sum(axis=0)
    misfit = float(chi2_per_pixel[heard].mean()) if heard.any() else 1.0
    by_square = (
        np.einsum("nk,nkq->q", square.by_places, gains[:, :2]) - [0.0, 0.0, 1.0]
    ) / square.uncertainty_px
    here, prior = (
        np.array([focus.blur_px, focus.softness_px, radius]),
        np.diag([FOCUS_PX**-2, 1e-6, 0.0]),
    )
    bend = prior + says + np.outer(by_square, by_square)
    pull = (
        pulls
        - prior @ (here - [focus.nominal_px, 0.0, 0.0])
        - by_square * moved / square.uncertainty_px
    )
    unsure = BY_NOISE if abs(focus.blur_px) < BROAD_PX else 0.0
    there, spread, by_noise = _lowest(bend, bend @ here + pull, misfit < NEAR, unsure)
    # what pictures have and spots here have not is alike in all of them and averages out in none
    excess = max(misfit, 1.0) * (
        1
        + max(0.0, 1 - SOUND / misfit if misfit > 0 else 0.0) * max(np.count_nonzero(heard) - 1, 0)
    )
    most = min(MOST_PX, MOST_SHARP_PX + focus.softness_px / 2)
    there = here + np.clip(there - here, -most, most) * (
        [0.0, 1.0, 0.0] if first else [1.0, 1.0, 1.0]
    )
    there[1] = max(there[1], abs(there[0]) - by_noise, SHARPEST_PX)
    softer = max(0.0, float(there[1] ** 2 - there[0] ** 2) - SOFTER_PX**2)
    share = astray if misfit < SOUND else SHARE_OF_SOFTER
    shared = excess * spread[::2, ::2] + np.diag([SURE_PX**2 + share**2 * softer, 0.0])
    found = Focus(focus.nominal_px, float(there[0]), float(there[1]), math.sqrt(shared[0, 0]))
    together = gains[:, :2, ::2] @ np.linalg.cholesky(shared)
    return CommonStep(steps + gains @ (there - here), covariance, together, found, float(there[2]))


def _lowest(bend: Array, pull: Array, bound: bool, unsure: float) -> tuple[Array, Array, float]:
    """Blur, softness and radius where x . bend . x / 2 - pull . x is least, covariance, and by how
    much noise may make edges seem sharper.

    ``bound``: edges no sharper than the blur, but for ``unsure`` standard uncertainties. A bound at
    the blur itself draws it after every noise that sharpens edges and after none that softens them.
    """
    inverse: Array = np.asarray(np.linalg.inv(bend), dtype=np.float64)
    free = inverse @ pull
    if not bound:
        return free, inverse, 0.0
    sharper = np.array([math.copysign(1.0, free[0]), -1.0, 0.0])
    along = inverse @ sharper
    variance = float(sharper @ along)
    by_noise = unsure * math.sqrt(variance)
    beyond = float(sharper @ free) - by_noise
    if beyond <= 0:
        return free, inverse, by_noise
    return free - along * (beyond / variance), inverse - np.outer(along, along) / variance, by_noise
