"""A picture of a scene at a stated accuracy, with what is in it, why, how far it can be from the
reference, and the time it took.
"""

import math
import time
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.accuracy import TOLERANCE
from flflab.image.budget import affordable_tolerance
from flflab.image.choose import LEVELS, NOISE, Choice, Decision, choose, decided, named
from flflab.image.path import Light
from flflab.image.regime import Regime
from flflab.image.render import render_light
from flflab.image.scene import Scene
from flflab.image.sensor.random_numbers import noise_key
from flflab.image.sensor.response import SensorResponse, digitise, read_out

Array = npt.NDArray[np.float64]

BRIGHTEST = 0.7  # of saturation: the exposure rule of the bench


@dataclass(frozen=True)
class Report:
    """A picture, and what is in it.

    Attributes:
        image: in units of the white level, [row, column].
        effects: every effect, with the time measured.
        error_estimate: root mean square of the error over lit pixels, noise aside, of white.
        percentile_99: of the error's size over lit pixels, measured where rays formed the picture;
            else None.
        path: closed forms, rays or waves.
        why_path: what decided that.
        time_ms: all that it took.
        tolerance: what was asked for or could be afforded.
        choice: of the effects of the light.
    """

    image: Array
    effects: tuple[Decision, ...]
    error_estimate: float
    percentile_99: float | None
    path: str
    why_path: str
    time_ms: float
    tolerance: float
    choice: Choice


def take_picture(
    scene: Scene,
    *,
    tolerance: float = TOLERANCE,
    effects: str = "auto",
    seed: int | None = None,
    response: SensorResponse | None = None,
    electrons_at_white: float | None = None,
    budget: float | None = None,
) -> Report:
    """Form a picture and say what is in it.

    Args:
        scene: what is pictured.
        tolerance: root mean square of the error over lit pixels, of white.
        effects: ``auto``, ``fast``, ``reference``, or names joined by commas.
        seed: of the noise; without one the picture has none.
        response: the sensor; by default one of 12 bits.
        electrons_at_white: mean electrons in a pixel at the white level; None: the brightest light
            fills 70 % of what saturates.
        budget: time to take, s: the finest tolerance that fits instead of ``tolerance``.

    Raises:
        InputError: an unknown effect, noise without a seed, a tolerance or budget that cannot be
            kept; and as ``render``.
    """
    started = time.perf_counter()
    noise = _noise(effects, seed)
    if budget is not None:
        tolerance = affordable_tolerance(scene, budget, effects)
    choice = choose(scene, tolerance, effects)
    forming = time.perf_counter()
    light = render_light(scene, choice.tolerance, choice.formed)
    reading = time.perf_counter()
    image, sensor, electrons = light.image, response or SensorResponse(), electrons_at_white
    if electrons is None:
        electrons = BRIGHTEST * sensor.saturation_e / max(1.0, float(image.max()))
    reported = _reported(choice.decisions, 1e3 * (reading - forming))
    if noise:
        image = _read(image, electrons, sensor, noise, seed)
    ended = time.perf_counter()
    decisions = _noise_decisions(sensor, noise, replace(choice.regime, electrons=electrons), seed)
    reported += _reported(decisions, 1e3 * (ended - reading))
    return Report(
        image=image,
        effects=reported,
        error_estimate=estimate(choice, light),
        percentile_99=None if light.pilot is None else light.pilot.percentile_99,
        path=light.path,
        why_path=light.why,
        time_ms=1e3 * (ended - started),
        tolerance=tolerance,
        choice=choice,
    )


def estimate(choice: Choice, light: Light) -> float:
    """Root mean square of a picture's error, of white: what its path was formed to or a pilot
    measured, and the bounds of what was left out.
    """
    formed = choice.tolerance if light.pilot is None else light.pilot.rms
    return formed + choice.left_out


def _noise(effects: str, seed: int | None) -> frozenset[str]:
    """The effects of the noise that are asked for."""
    if effects in LEVELS:
        return frozenset(NOISE if seed is not None else ())
    noise = named(effects) & set(NOISE)
    if noise and seed is None:
        raise InputError(f"effects: {', '.join(sorted(noise))} need a seed; give one with --seed")
    return noise


def _read(
    image: Array, electrons: float, sensor: SensorResponse, noise: frozenset[str], seed: int | None
) -> Array:
    """What the sensor reads, in units of the white level again."""
    kept = {
        name.replace("-", "_"): None
        for name in NOISE
        if name not in noise and name != "quantisation"
    }
    response = replace(sensor, **kept)
    numbers = response.quantisation
    read = digitise if "quantisation" in noise else read_out
    read_numbers = read(np.maximum(image, 0.0), electrons, response, noise_key("picture", seed))
    return (read_numbers.astype(np.float64) - numbers.offset_dn) / (
        numbers.dn_per_electron * electrons
    )


def _noise_decisions(
    response: SensorResponse, noise: frozenset[str], regime: Regime, seed: int | None
) -> tuple[Decision, ...]:
    absent = ": no seed was given" if seed is None else ": not requested"
    found: list[Decision] = []
    for name in NOISE:
        effect, remark = getattr(response, name.replace("-", "_")), "" if name in noise else absent
        found.append(decided(name, effect, regime, name in noise, remark, of="sensor"))
    return tuple(found)


def _reported(decisions: tuple[Decision, ...], ms: float) -> tuple[Decision, ...]:
    """The decisions with the time measured shared out by what effects cost; what is off is reported
    at the same rate.
    """
    total = sum(decision.ms for decision in decisions if decision.on)
    rate = ms / total if total > 0 else 1.0
    sizes = [None if one.size is None or math.isinf(one.size) else one.size for one in decisions]
    shared = zip(decisions, sizes, strict=True)
    return tuple(replace(one, size=size, ms=rate * one.ms) for one, size in shared)
