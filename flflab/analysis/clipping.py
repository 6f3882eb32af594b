"""How far the fit of a spot is off the chief ray where main lens and microlens cut the cone of a defocused point.

At e from the micro-image's centre the pupil points v with |v| <= microlens disc and |v - e| <= main lens disc see the dot where
|(e - spot) + beta v| <= radius, beta = b / (L x kappa) - 1: an area common to three discs, whose share of the microlens's disc is the
light. The fit takes it for a spot times the micro-image's illumination; what that does to a spot is found by fitting its own exact
picture. From s = kappa q - (b/L) m + (b/f) y and o V = m W - q/L (physics.md, "One SMMS") with v = kappa (q - y).
"""

import math
from dataclasses import replace

import numba
import numpy as np
import numpy.typing as npt

from flflab.analysis.lattice import Lattice
from flflab.analysis.noise import SensorNoise
from flflab.analysis.spot_profile import SpotProfile
from flflab.analysis.spots import Lit, Spots, fit_spots
from flflab.optics.camera import Camera
from flflab.optics.discs import arc_share, disc_rectangle_area, two_disc_area
from flflab.optics.focus import blur, microlens_limits
from flflab.optics.resolution import central_smms
from flflab.optics.smms import image_offset

Array = npt.NDArray[np.float64]

LEAST_BRIGHTNESS = 0.05  # of a spot that is worth a picture
_MOST_NODES = 12  # across the pupil; a px of blur takes two
_DARKEST = 0.04  # share of the light below which the fit does not look


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _pixel_light(
    x: float,
    y: float,
    spot: Array,
    radius: float,
    main: float,
    small: float,
    beta: float,
    along: tuple[Array, Array],
    across: tuple[Array, Array],
) -> float:  # pragma: no cover - compiled
    """Light in the pixel at (x, y): the share of it, closed form, that sees the dot through v, integrated over the pupil of its middle.

    A pixel on the spot's edge is lit on its inner side only, and there the main lens's disc lies a little elsewhere: share by share, an
    integral along that disc's rim. Nodes and weights of Gauss ``along`` the line from the micro-image's centre, on either side of the
    pupil's corners, and ``across`` it.
    """
    r = math.hypot(x, y)
    area = two_disc_area(small, main, r)
    if area <= _DARKEST * math.pi * small * small:
        return 0.0
    low, high = max(-small, r - main), min(small, r + main)
    middle = low
    if abs(main - small) < r:
        middle = min(max((r * r + small * small - main * main) / (2 * r), low), high)
    to_x, to_y = (x / r, y / r) if r > 0 else (1.0, 0.0)
    total, seen = 0.0, 0.0
    for part in range(2):
        start, length = (low, middle - low) if part == 0 else (middle, high - middle)
        if length <= 0.0:
            continue
        for n in range(len(along[0])):
            angle = 0.5 * math.pi * (1 + along[0][n])
            u = start + length * 0.5 * (1 - math.cos(angle))
            half = math.sqrt(max(min(small * small - u * u, main * main - (u - r) ** 2), 0.0))
            for m in range(len(across[0])):
                w = half * across[0][m]
                weight = along[1][n] * across[1][m] * math.sin(angle) * length * half
                cx, cy = x - spot[0] + beta * (u * to_x - w * to_y), y - spot[1] + beta * (u * to_y + w * to_x)
                total += weight
                seen += weight * disc_rectangle_area(radius, cx - 0.5, cx + 0.5, cy - 0.5, cy + 0.5)
    light = area * seen / max(total, 1e-300)
    turn, opening = arc_share(x, y, main, 0.0, 0.0, small)
    if opening > 0.0:
        for n in range(len(along[0])):
            angle = turn + opening * along[0][n]
            out_x, out_y = math.cos(angle), math.sin(angle)
            cx, cy = x - spot[0] + beta * (x + main * out_x), y - spot[1] + beta * (y + main * out_y)
            share = disc_rectangle_area(radius, cx - 0.5, cx + 0.5, cy - 0.5, cy + 0.5)
            inwards = -(cx * out_x + cy * out_y) / max(math.hypot(cx, cy), 1e-9)
            light += along[1][n] * opening * main * share * (1 - share) / 2 * inwards
    return light / (math.pi * small * small)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _pictures(
    spots: Array,
    corners: Array,
    width: int,
    radius: float,
    main: float,
    small: float,
    beta: float,
    along: tuple[Array, Array],
    across: tuple[Array, Array],
) -> Array:  # pragma: no cover - compiled
    """Windows of ``width`` px square, one above the other, of spots at ``spots`` px from their micro-images' centres.

    ``corners``: each window's first pixel from the micro-image's centre. 1 is the light of a white target in the bright field.
    """
    picture = np.zeros((len(spots) * width, width))
    blurred = abs(beta) * small + 0.71
    for n in range(len(spots)):
        for row in range(width):
            for column in range(width):
                x, y = corners[n, 0] + column, corners[n, 1] + row
                away = math.hypot(x - spots[n, 0], y - spots[n, 1])
                if away < radius - blurred:
                    picture[n * width + row, column] = two_disc_area(small, main, math.hypot(x, y)) / (math.pi * small * small)
                elif away < radius + blurred:
                    picture[n * width + row, column] = _pixel_light(x, y, spots[n], radius, main, small, beta, along, across)
    return picture


def without_clipping(
    spots: Spots,
    seeming: Array,
    own: Lit,
    lattice: Lattice,
    camera: Camera,
    distance: float,
    radius: float,
    profile: SpotProfile,
    noise: SensorNoise,
) -> Spots:
    """Spots with what the cut did to their fits taken off centres and chi squared; those that no aperture cuts stay as they are.

    Args:
        spots: as fitted.
        seeming: where they are thought to be, px: what the pictures are of, shape (n, 2).
        own: their micro-images.
        lattice: measured.
        camera: nominal.
        distance: to the dots, mm, nominal.
        radius: of a spot in focus, px.
        profile: the spot that the fit assumed.
        noise: by which it weighted.
    """
    smms = central_smms(camera)
    x, kappa = float(image_offset(smms, 1 / distance)), float(smms.kappa)
    spread = float(blur(smms, 1 / distance)) / camera.sensor.pixel
    away = np.hypot(*(seeming - own.centres).T)
    cut = (away + radius + spread / 2 + 1 > lattice.inside_radius_px) & (away < lattice.outside_radius_px)
    cut &= np.isfinite(spots.covariance[:, 0, 0]) & (spots.brightness > LEAST_BRIGHTNESS)
    if x == 0 or kappa == 0 or not cut.any():
        return spots
    beta = float(smms.gap / smms.distance) / (x * kappa) - 1
    large, small = (lattice.outside_radius_px + lattice.inside_radius_px) / 2, (lattice.outside_radius_px - lattice.inside_radius_px) / 2
    main, microlens = (large, small) if smms.lens_width >= smms.microlens_width else (small, large)
    # where the main lens limits, the chief ray goes through its middle, and the disc is seen smaller by as much
    by_chief = 1.0 if bool(microlens_limits(smms, 1 / distance)) else 1 + beta
    along, across = (np.polynomial.legendre.leggauss(min(least + math.ceil(2 * spread), _MOST_NODES)) for least in (4, 2))
    half = math.ceil(radius + spread / 2 + 3)
    size, width = half + 2, 2 * half + 5
    down = np.stack([np.zeros(np.count_nonzero(cut)), np.arange(np.count_nonzero(cut)) * float(width)], axis=1)
    places, light = seeming[cut] - own.centres[cut], own.light[cut] * spots.brightness[cut]
    corners = np.rint(seeming[cut]) - size - own.centres[cut]
    picture = _pictures(places * by_chief, corners, width, radius * abs(by_chief), main, max(microlens, 1e-3), beta, along, across)
    picture = picture * np.repeat(light, width)[:, None] + noise.offset_dn
    there = places - corners + down
    again = fit_spots(picture, there, half, Lit(there - places, light, own.table), profile, noise)
    centres, chi2 = spots.centres.copy(), spots.chi2_per_pixel.copy()
    centres[cut] -= again.centres - there
    chi2[cut] -= again.chi2_per_pixel
    return replace(spots, centres=centres, chi2_per_pixel=chi2)
