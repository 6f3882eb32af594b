"""What a white picture shows beside its lattice, in sentences for an operator."""

import math

import cv2
import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.find import stretch
from flflab.measurement.lattice.kernel import LIGHT, WIDER, draw
from flflab.measurement.lattice.mean_profile import soft_disc
from flflab.measurement.lattice.micro_images import extents_of
from flflab.measurement.lattice.white_picture import WhitePicture
from flflab.measurement.sensor.noise import SensorNoise
from flflab.remark import Remark

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

SATURATED = 1e-4  # of the pixels
# of the light: white pictures leave 1 or 2 %; and of a micro-image's pixels, left out as dust is
MISFIT, LEFT_OUT = 0.05, 0.05
PLATEAU = 0.6  # of the radius, within which light is even
ENOUGH = 4_000_000  # pixels: of twice as many every second row is looked at, and so on
WARM, LEAST_WARM, OFTEN = 8.0, 0.02, 1e-5  # standard deviations, of the light; share of the pixels
LINES = 3.0  # times as far as noise scatters the means of columns
STEP, LEAST_STEP = 8.0, 2e-3  # the same of a single one, and of the light
FEWEST, FEWEST_FLAT = 30, 300  # pixels
BENT_PX = 0.05
SHEARED = 1.0005  # stretch along one direction against that across it
SECOND_STOP = 0.02  # of their radius, by which micro-images narrow towards the corners
QUIETER = 0.7  # of the noise of dark pixels that bright ones have


def remarks_on_white(picture: Picture, noise: SensorNoise, white: WhitePicture) -> list[Remark]:
    """Remarks on the picture, its lenses and its lattice.

    Args:
        picture: DN, [row, col].
        noise: of the sensor.
        white: what was measured.
    """
    misfit = _on_misfit(white)
    every = [_on_saturation(picture, noise), misfit, _on_lost(white)]
    if misfit is None:  # else what follows is the scene
        light = float(np.median(white.values[white.whole, LIGHT]))
        left, flat = picture - _modelled(picture, white), _plateaus(picture, white)
        every += [
            _on_bend(white),
            _on_stop(white),
            _on_lines(left, flat, noise, light),
            _on_warm(picture, noise, light),
            _on_gamma(left, flat, noise),
        ]
    return [remark for remark in every if remark is not None]


def _plateaus(picture: Picture, white: WhitePicture) -> Mask:
    """Pixels in the even middle of micro-images."""
    drawn = np.zeros_like(picture)
    inner = white.values[white.found].copy()
    inner[:, LIGHT] = 1.0
    inner[:, WIDER:] = 0.0
    disc = soft_disc(PLATEAU * white.profile.radius, 0.05)
    draw(drawn, inner, extents_of(inner, disc), (disc.table, disc.radius, disc.step))
    return drawn > 0.5


def _on_saturation(picture: Picture, noise: SensorNoise) -> Remark | None:
    share = float(np.mean(picture >= noise.saturated_dn))
    if share < SATURATED:
        return None
    return Remark(
        "saturated",
        f"{100 * share:.2g} % of the pixels are saturated and were left out; from 2 % on radii,"
        " light and softness have larger errors than stated; expose it shorter",
    )


def _on_misfit(white: WhitePicture) -> Remark | None:
    pixels, left_out = white.spread.pixels[white.whole], white.spread.left_out[white.whole]
    lost = float(np.median(left_out / np.maximum(pixels + left_out, 1)))
    if white.misfit < MISFIT and lost < LEFT_OUT:
        return None
    return Remark(
        "misfit",
        f"light within micro-images departs by {100 * white.misfit:.0f} % from their common"
        f" profile, 1 or 2 % are usual, beside {100 * lost:.0f} % of their pixels that do not fit"
        " at all: was the target evenly lit and the picture left as it was read?",
    )


def _on_lost(white: WhitePicture) -> Remark | None:
    """Lenses that are dark or missing amid others, or stand aside."""
    centres = white.values[:, :2]
    aside = np.abs(centres - np.median(centres[white.whole], axis=0))
    inner = (aside <= np.quantile(aside[white.whole], 0.7, axis=0)).all(axis=1)
    lost = np.count_nonzero(~white.found & inner)
    off = np.count_nonzero(white.grid.off)
    if lost + off == 0:
        return None
    return Remark(
        "lenses-off",
        f"{lost} micro-images amid others are dark or missing, {off} stand off the lattice by more"
        " than the others scatter: dust or broken microlenses",
    )


def _modelled(picture: Picture, white: WhitePicture) -> Picture:
    """The light of micro-images as they were fitted, DN above their ground."""
    drawn = np.zeros_like(picture)
    profile = white.profile
    seen = white.values[white.found]
    draw(drawn, seen, extents_of(seen, profile), (profile.table, profile.radius, profile.step))
    return drawn


def _on_bend(white: WhitePicture) -> Remark | None:
    grid = white.grid
    grown = stretch(grid.layout, grid.vectors_px)
    parts = list[str]()
    if grid.bend_px > BENT_PX:
        parts.append(f"it bends by {grid.bend_px:.2g} px (rms, degree {grid.degree})")
    if grown > SHEARED:
        parts.append(f"it is {100 * (grown - 1):.2g} % longer along one direction than across it")
    if not parts:
        return None
    return Remark(
        "lattice-bent",
        f"the lattice is no exact one: {' and '.join(parts)}; pitch and angle are those of the"
        " nearest exact lattice",
    )


def _on_stop(white: WhitePicture) -> Remark | None:
    """Whether micro-images narrow towards the corners, as where a second stop cuts the cone."""
    whole = white.values[white.whole]
    away = whole[:, :2] - np.median(whole[:, :2], axis=0)
    far = np.sum(away**2, axis=1) / max(float(np.max(np.sum(away**2, axis=1))), 1e-9)
    if len(far) < 30:
        return None
    design = np.stack([np.ones(len(far)), far], axis=1)
    found, *_ = np.linalg.lstsq(design, whole[:, WIDER], rcond=None)
    rest = whole[:, WIDER] - design @ found
    doubt = float(np.std(rest) * math.sqrt(np.linalg.inv(design.T @ design)[1, 1]))
    narrower = -float(found[1]) / white.profile.radius
    if narrower < SECOND_STOP or -found[1] < 5 * doubt:
        return None
    return Remark(
        "second-stop",
        f"micro-images are {100 * narrower:.1f} % narrower in the corners: a second stop probably"
        " cuts them there, and what is called their centre lies aside of the lens's",
    )


def _on_lines(left: Picture, flat: Mask, noise: SensorNoise, light: float) -> Remark | None:
    """Whether columns or rows differ by more than noise, by second differences across them in what
    micro-images leave.
    """
    every = 1 + left.size // ENOUGH
    spread = math.sqrt(6 * float(noise.variance(light + noise.offset_dn)))
    for name, values, inside in (("columns", left, flat), ("rows", left.T, flat.T)):
        step, there = _second_differences(values[::every], inside[::every])
        usual = there & (np.abs(step) < 6 * spread)
        count = usual.sum(axis=0)
        enough = count > FEWEST
        if np.count_nonzero(enough) < FEWEST:
            continue
        means = np.where(usual, step, 0.0).sum(axis=0)[enough] / count[enough]
        means -= np.median(means)
        due, found = spread / np.sqrt(count[enough]), 1.48 * float(np.median(np.abs(means)))
        steps = np.abs(means) > np.maximum(STEP * np.maximum(due, found), LEAST_STEP * light)
        if found > LINES * float(np.median(due)) or steps.any():
            size = max(found / math.sqrt(6), float(np.abs(means[steps]).max(initial=0.0)) / 2)
            return Remark(
                "fixed-pattern",
                f"{name} differ by up to {100 * size / light:.2g} % of the light, more than noise"
                " makes them: a fixed pattern of the sensor, which no uncertainty counts; subtract"
                " a dark frame (--dark)",
            )
    return None


def _second_differences(values: Picture, inside: Mask) -> tuple[Picture, Mask]:
    """Along the rows, and where all three pixels are inside."""
    there = inside[:, 2:] & inside[:, 1:-1] & inside[:, :-2]
    return values[:, 2:] - 2 * values[:, 1:-1] + values[:, :-2], there


def _on_warm(picture: Picture, noise: SensorNoise, light: float) -> Remark | None:
    """Single pixels far brighter than all of their neighbours."""
    around = np.ones((3, 3), dtype=np.uint8)
    around[1, 1] = 0
    above = picture - cv2.dilate(picture, around)
    bright = above > LEAST_WARM * light
    far = above[bright] > WARM * np.sqrt(noise.variance(picture[bright])) + LEAST_WARM * light
    share = np.count_nonzero(far) / picture.size
    if share < OFTEN:
        return None
    return Remark(
        "warm-pixels",
        f"{100 * share:.2g} % of the pixels read far more than their neighbours (warm or hot ones);"
        " they were left out",
    )


def _on_gamma(left: Picture, flat: Mask, noise: SensorNoise) -> Remark | None:
    """Whether bright pixels are quieter than dark ones, which no sensor's are."""
    every = 1 + left.size // ENOUGH
    step, there = _second_differences(left[::every], flat[::every])
    if np.count_nonzero(there) < FEWEST_FLAT or noise.read_noise_dn < 1:
        return None
    quiet = 1.48 * float(np.median(np.abs(step[there]))) / math.sqrt(6)
    if quiet > QUIETER * math.sqrt(noise.dark_variance):
        return None
    return Remark(
        "gamma",
        "bright pixels are quieter than dark ones, as where a picture was developed (gamma) or"
        " smoothed: radii and light are not the sensor's; save the numbers as the sensor read them",
    )
