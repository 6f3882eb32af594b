"""Which effects a picture holds, why, and how far it can be from the truth: what ``flflab image --json`` says."""

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.pupil import Pupils
from flflab.image.random_numbers import noise_key
from flflab.image.render import LEAST_TOLERANCE, TOLERANCE, render
from flflab.image.scene import one_plane
from flflab.image.sensor_response import SensorResponse, digitise
from flflab.image.setup import Setup, make_setup
from flflab.optics.camera import Camera
from flflab.optics.discs import two_disc_areas
from flflab.targets import Target

Array = npt.NDArray[np.float64]

OPTICAL = ("defocus", "vignetting", "overlap", "pixel")
DESCRIBED = "misalignment"  # held exactly when the camera file describes one
NOISE = ("shot-noise", "read-noise", "saturation", "quantisation")
NOT_SIMULATED = (
    "diffraction",
    "falloff",
    "distortion",
    "scatter",
    "stray-light",
    "colour-filter",
    "motion",
    "dark-current",
    "fixed-pattern",
)
LEVELS = {"auto": 1.0, "fast": 5.0, "reference": 0.1}  # what each level makes of the tolerance
BRIGHTEST = 0.7  # of saturation: the exposure rule of the bench
CROP = 48
CROPS = 6


@dataclass(frozen=True)
class Effect:
    """One effect: whether the picture holds it, why, its size in its own unit, and what leaving it out could change, of white."""

    name: str
    on: bool
    size: float | None
    bound: float | None
    why: str
    ms: float


@dataclass(frozen=True)
class ImageReport:
    """A picture in units of the white level, its effects, an estimate of its largest error without noise, and the time it took."""

    image: Array
    effects: tuple[Effect, ...]
    error_estimate: float
    time_ms: float


def image_report(
    camera: Camera,
    target: Target,
    distance: float,
    *,
    tolerance: float = TOLERANCE,
    seed: int | None = None,
    effects: str = "auto",
    response: SensorResponse | None = None,
) -> ImageReport:
    """Form an image and say what is in it.

    Args:
        camera: the camera, with round apertures.
        target: what stands in front of it.
        distance: main lens to target, mm.
        tolerance: largest error asked for, of white.
        seed: of the noise; without one the picture has none.
        effects: ``auto``, ``fast`` (five times the tolerance), ``reference`` (a tenth of it), or names joined by commas.
        response: the sensor; by default one of 12 bits.

    Raises:
        InputError: an unknown effect, one that cannot be chosen, or noise without a seed; and as ``render``.
    """
    started = time.perf_counter()
    level, chosen = _choose(effects, seed)
    allowed = min(max(tolerance * LEVELS.get(level, 1.0), LEAST_TOLERANCE), 0.5)
    scene = one_plane(camera, target, distance)
    image = render(scene, tolerance=allowed)
    formed = time.perf_counter()
    estimate = _estimate_error(camera, target, distance, image, allowed)
    sensor = response or SensorResponse()
    electrons = BRIGHTEST * sensor.saturation_e / max(1.0, float(image.max()))
    noisy = time.perf_counter()
    found = _optical(make_setup(scene, scene.planes[0], allowed), 1e3 * (formed - started))
    found += _noise(sensor, electrons, float(image.max()), chosen)
    if chosen:
        shot = sensor.shot_noise if "shot-noise" in chosen else None
        read = sensor.read_noise if "read-noise" in chosen else None
        numbers = digitise(image, electrons, replace(sensor, shot_noise=shot, read_noise=read), noise_key(seed))
        scale = sensor.quantisation
        image = (numbers.astype(np.float64) - scale.offset_dn) / (scale.dn_per_electron * electrons)
        share = 1e3 * (time.perf_counter() - noisy)
        found = [replace(effect, ms=share) if effect.name == chosen[0] else effect for effect in found]
    found.append(_misalignment(camera))
    found += [Effect(name, False, None, None, "not simulated by this version", 0.0) for name in NOT_SIMULATED]
    return ImageReport(image, tuple(found), estimate, 1e3 * (time.perf_counter() - started))


def _choose(effects: str, seed: int | None) -> tuple[str, tuple[str, ...]]:
    """The level asked for, and the noise effects of the picture."""
    if effects in LEVELS:
        return effects, NOISE if seed is not None else ()
    names = [name.strip() for name in effects.split(",") if name.strip()]
    for name in names:
        if name == DESCRIBED:
            raise InputError(f"effects: '{name}' is in the picture when the camera file gives offset, roll or tilt; leave it out here")
        if name in NOT_SIMULATED:
            raise InputError(f"effects: '{name}' is not simulated by this version; allowed: {_listed(LEVELS, OPTICAL, NOISE)}")
        if name not in OPTICAL and name not in NOISE:
            raise InputError(f"effects: there is no '{name}'; allowed: {_listed(LEVELS, OPTICAL, NOISE)}")
    missing = [name for name in OPTICAL if name not in names]
    if missing:
        raise InputError(f"effects: {', '.join(OPTICAL)} are formed together, by one exact formula; add {', '.join(missing)}")
    noise = tuple(name for name in NOISE if name in names)
    if noise and seed is None:
        raise InputError(f"effects: {', '.join(noise)} need a seed; give one with --seed")
    if noise and not {"saturation", "quantisation"} <= set(noise):
        raise InputError("effects: noise is read in whole numbers of a finite range; add saturation and quantisation")
    return "auto", noise


def _listed(*groups: Iterable[str]) -> str:
    return ", ".join(name for group in groups for name in group)


def _optical(setup: Setup, ms: float) -> list[Effect]:
    pupils, pixel = setup.pupils, setup.sensor.pixel
    blur = float(np.max(setup.blur))
    rim = float(np.max(setup.rims.width))
    together = "formed in one pass with defocus"
    spacing = _nearest(pupils)
    overlap = float(2 * pupils.outside.max() - spacing)
    focus = "sharp within the tolerance" if math.sqrt(0.5) * blur < setup.tolerance else "out of focus"
    return [
        Effect("defocus", True, blur, min(1.0, math.sqrt(0.5) * blur), f"the target is {focus}: blur {blur:.3g} px", ms),
        Effect("vignetting", True, rim, 1.0, f"both apertures clip: a rim {rim:.3g} px wide; {together}", 0.0),
        Effect(
            "overlap",
            overlap > 0,
            overlap / pixel,
            _crosstalk(pupils, spacing) if overlap > 0 else 0.0,
            f"neighbouring micro-images overlap by {overlap / pixel:.3g} px; {together}"
            if overlap > 0
            else f"neighbouring micro-images are {-overlap / pixel:.3g} px apart",
            0.0,
        ),
        Effect("pixel", True, 1.0, 1.0, f"radiance is averaged over the pixel, exactly; {together}", 0.0),
    ]


def _misalignment(camera: Camera) -> Effect:
    array = camera.array
    given = any((*array.offset, array.roll, *array.tilt, *camera.sensor.offset))
    why = "offset, roll and tilt as the camera file gives them" if given else "the camera file gives no offset, roll or tilt"
    return Effect(DESCRIBED, given, None, None, why, 0.0)


def _nearest(pupils: Pupils) -> float:
    """Distance of the nearest neighbours among micro-images, mm; infinite for a single one."""
    places = np.stack([pupils.centre_x, pupils.centre_y], axis=1)
    middle = places[np.argmin(np.hypot(*(places - places.mean(axis=0)).T))]
    apart = np.hypot(*(places - middle).T)
    return float(apart[apart > 0].min()) if len(places) > 1 else math.inf


def _crosstalk(pupils: Pupils, spacing: float) -> float:
    """Largest share of a neighbour's light inside a micro-image."""
    slope = np.maximum(np.abs(pupils.slope), 1e-9)
    area = two_disc_areas(1.0, pupils.reach / slope, np.maximum(spacing - pupils.outside, 0.0) / slope)
    return float(np.max(area) / math.pi)


def _noise(sensor: SensorResponse, electrons: float, brightest: float, chosen: tuple[str, ...]) -> list[Effect]:
    step = 1 / (sensor.quantisation.dn_per_electron * electrons)
    read = sensor.read_noise.electrons if sensor.read_noise else 0.0
    reason = f"white makes {electrons:.4g} electrons" if chosen else "no seed was given: the picture is without noise"
    sizes = {
        "shot-noise": (1 / math.sqrt(electrons), 3 * math.sqrt(brightest / electrons)),
        "read-noise": (read / electrons, 3 * read / electrons),
        "saturation": (sensor.saturation_e / electrons, max(0.0, brightest - sensor.saturation_e / electrons)),
        "quantisation": (step, step / 2),
    }
    return [
        Effect(name, name in chosen, size, bound, reason if name in chosen or not chosen else "not asked for", 0.0)
        for name, (size, bound) in sizes.items()
    ]


def _estimate_error(camera: Camera, target: Target, distance: float, image: Array, tolerance: float) -> float:
    """Largest difference from a finer image on a few crops, the steepest place among them, plus the finer image's own tolerance."""
    finer = max(tolerance / 8, LEAST_TOLERANCE)
    rows, columns = image.shape
    height, width = min(CROP, rows), min(CROP, columns)
    lit = np.flatnonzero(image.max(axis=1) > 0)
    if not len(lit):
        return finer
    worst = 0.0
    sensor = camera.sensor
    for place in np.linspace(0, len(lit) - 1, CROPS).astype(int):
        line = image[lit[place]]
        column = int(np.argmax(np.abs(np.diff(line)))) if columns > 1 else 0
        top = int(np.clip(lit[place] - height // 2, 0, rows - height))
        left = int(np.clip(column - width // 2, 0, columns - width))
        offset = (
            sensor.offset[0] + (left + (width - 1) / 2 - (columns - 1) / 2) * sensor.pixel,
            sensor.offset[1] + (top + (height - 1) / 2 - (rows - 1) / 2) * sensor.pixel,
        )
        crop = replace(camera, sensor=replace(sensor, resolution=(width, height), offset=offset))
        better = render(one_plane(crop, target, distance), tolerance=finer)
        worst = max(worst, float(np.abs(better - image[top : top + height, left : left + width]).max()))
    return worst + finer
