"""How large the square of dots is on the sensor, and how far a dot moves from one micro-image to
the next, beside what is described.

s - c = shift + m o + p c: a dot's image s in the micro-image of centre c, o the dot on the target
(``spot_law``). m and p are complex, scale and turn. In a camera as described m = -b V/x and p = m
D/(L + b), D = 1/V the target's distance, L the array's, b the gap, x the image offset, which the
gap does not change: the two together tell a wrong distance from a wrong gap.
"""

import math
from dataclasses import dataclass

import numpy as np

from flflab.measurement.dots.views import DotViews
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import sensor_position, target_scales
from flflab.optics.camera import Camera
from flflab.optics.focus import microlens_limits
from flflab.optics.resolution import central_smms
from flflab.targets import FourDot

TOLERANCE = 0.01  # of size and parallax, and in rad of turn: what differs less is not remarked on
SURE = 4.0  # standard uncertainties by which it must differ too
# so much may all spots lie farther out than they are placed, before cameras not quite as described
OUTWARDS_PX = 0.003
FEWEST = 4  # images of dots, for three complex numbers
# dots seen once each, in as many micro-images, do not tell size from parallax: least over largest
# singular value
APART = 0.03


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


def scale_of_dots(
    dots: tuple[DotViews, ...], lattice: Lattice, camera: Camera, target: FourDot, distance: float
) -> DotScale | None:
    """Size, turn and parallax by weighted least squares over all views; None where too few dots in
    too few micro-images tell them.

    Args:
        dots: as counted with the same lattice, camera, target and distance (mm).
        lattice: the micro-images.
        camera: nominal.
        target: what stood there.
        distance: main lens to target, mm, nominal.
    """
    at = {(int(i), int(j)): n for n, (i, j) in enumerate(lattice.indices)}
    lens = np.array([at[int(i), int(j)] for dot in dots for i, j in dot.indices], dtype=np.int64)
    number = np.repeat([dot.dot for dot in dots], [len(dot.indices) for dot in dots])
    if len(lens) < FEWEST or len(np.unique(lens)) < 2 or len(np.unique(number)) < 2:
        return None
    images = sensor_position(camera.sensor, np.concatenate([dot.centres_px for dot in dots])) @ [
        1,
        1j,
    ]
    centres = sensor_position(camera.sensor, lattice.centres_px)[lens] @ [1, 1j]
    lags = camera.sensor.pixel * np.concatenate([dot.lag_px for dot in dots])
    both = camera.sensor.pixel * np.concatenate([dot.centre_uncertainty_px for dot in dots])
    doubts = np.sqrt(((both**2) - (lags**2).sum(axis=2)).mean(axis=1))
    across, along = target_scales(camera, distance)
    # in units of what the camera makes of them
    design = (
        np.stack(
            [
                np.ones(len(lens)),
                target.centres[number] @ [1, 1j] / across,
                -along / across * centres,
            ],
            axis=1,
        )
        / doubts[:, None]
    )
    size = np.sqrt((np.abs(design) ** 2).sum(axis=0))
    inverse, _, rank, _ = np.linalg.lstsq(design / size, np.eye(len(lens)), rcond=APART)
    if rank < design.shape[1]:
        return None
    values = (images - centres) / doubts
    found = inverse @ values / size
    left = values - design @ found
    excess = max(1.0, float((np.abs(left) ** 2).sum()) / max(2 * len(left) - 6, 1))
    spread = np.sqrt((np.abs(inverse) ** 2).sum(axis=1) * excess) / size
    common = inverse @ (np.einsum("nam,a->nm", lags, [1, 1j]) / doubts[:, None]) / size[:, None]
    spread = np.hypot(spread, np.sqrt((np.abs(common) ** 2).sum(axis=1)))
    outwards = OUTWARDS_PX * camera.sensor.pixel / float(np.std(images - centres))
    spread = np.hypot(spread, outwards)
    return DotScale(
        float(abs(found[1])),
        float(spread[1]),
        float(abs(found[2])),
        float(spread[2]),
        float(np.angle(found[1])),
    )


def unlike_the_description(scale: DotScale, camera: Camera, distance: float) -> list[str]:
    """Sentences on what of size, parallax and turn is not as the camera's description and the
    distance (mm) make it.
    """
    smms = central_smms(camera)
    across, _ = target_scales(camera, distance)
    step = (
        camera.array.pitch[0]
        * float(smms.image_scale)
        * distance
        / float(smms.distance + smms.gap)
        / abs(across)
    )
    pairs = [
        ("1 mm between dots", 1 / abs(across), scale.size, scale.size_uncertainty),
        (
            "a dot's shift from one micro-image to the next",
            step,
            scale.parallax,
            scale.parallax_uncertainty,
        ),
    ]
    remarks = [
        f"{name} is {ratio * due / camera.sensor.pixel:.3f} +-"
        f" {doubt * due / camera.sensor.pixel:.3f} px on the sensor, the camera's description makes"
        f" it {due / camera.sensor.pixel:.3f} px at {distance:.2f} mm"
        for name, due, ratio, doubt in pairs
        if abs(ratio - 1) > max(TOLERANCE, SURE * doubt)
    ]
    if remarks:
        # p/m = D/(L + b), and m goes with the gap at any one distance; the dots' places suffer
        # where the blur is far from the described
        there = distance * scale.parallax / scale.size
        fits = f"a target about {there:.4g} mm away"
        if bool(microlens_limits(smms, 1 / distance)):
            gap = float(smms.gap) * scale.size * abs(target_scales(camera, there)[0] / across)
            fits += (
                f" and a gap of about {gap:.4g} mm between microlenses and sensor (described:"
                f" {float(smms.gap):.4g} mm)"
            )
        remarks.append(
            f"{fits} would make both what they are; check the target's distance, the gap, and the"
            " spacing of the dots"
        )
    if abs(scale.turn) > max(TOLERANCE, SURE * scale.size_uncertainty):
        remarks.append(
            f"the dots are turned by {math.degrees(scale.turn):.2f} deg on the sensor; check the"
            " turn of the target and of the sensor"
        )
    return remarks
