"""The sources of uncertainty that a bench file states, and draws of their errors: all together, or
one at a time.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import stats

from flflab.bench import Bench, Element, Turn
from flflab.bench_uncertainty import RepeatabilityDescription
from flflab.lens_errors import EQUAL_LENSES, stated_lens_errors
from flflab.verdict.prediction import ELEMENTS, Errors, OpticsFactors, OrderFactors, as_described

Array = npt.NDArray[np.float64]
LEVELS = 51  # values of a source that varies alone
OWN_KEY = 1 << 64  # apart from every seed that draws what configurations share
LENS_DRAWS = 200  # arrays whose lenses alone differ: 5 % of their standard uncertainty
TURNS: tuple[Turn, ...] = ("array.roll", "array.yaw", "array.pitch")
TARGET_TURNS = ("roll of the target", "tilt of the target along x", "tilt of the target along y")
STAGES, OPTICS, ATTITUDE, ORDER, LENSES, TRACED = (
    "stages",
    "sizes of the optics",
    "turns of array and target",
    "model's order",
    "how lenses differ",
    "targets and temperature",
)


@dataclass(frozen=True)
class Source:
    """Something that a bench file states a standard uncertainty for (type B, normal), the same
    error in every configuration.

    Attributes:
        name: for people.
        group: of what it is one.
        uncertainty: standard uncertainty, in ``unit``.
        unit: ``mm`` or ``rad``; empty for a share.
    """

    name: str
    group: str
    uncertainty: float
    unit: str = ""


def stated_sources(bench: Bench) -> tuple[Source, ...]:
    """Every source of a bench whose error is one number; where nothing is stated it is 0."""
    found: list[Source] = []
    fixed = bench.description.fixed.stated()
    for element in ELEMENTS:
        axis = bench.description.axis_of(element)
        if axis:
            name, zero, scale = axis[0], axis[1].zero_uncertainty, axis[1].scale_uncertainty
        else:
            name, scale = element, 0.0
            zero = fixed[element].uncertainty if element in fixed else 0.0
        found += [Source(f"zero of {name}", STAGES, zero, "mm")]
        found += [Source(f"scale of {name}", STAGES, scale)]
    sizes, made = bench.description.optics_uncertainty, bench.description.workmanship
    found += [
        Source("focal length of the main lens", OPTICS, sizes.main_lens_focal_length),
        Source("f-number", OPTICS, sizes.f_number),
        Source("focal length of the microlenses", OPTICS, sizes.microlens_focal_length),
        Source("aperture of the microlenses", OPTICS, sizes.microlens_aperture),
        Source("pitch of the microlenses", OPTICS, sizes.pitch),
    ]
    found += [
        Source(turn.replace("array.", "array's "), ATTITUDE, float(doubt), "rad")
        for turn, doubt in zip(TURNS, attitude_uncertainty(bench), strict=True)
    ]
    order = bench.description.model_uncertainty
    found += [
        Source(f"first order: {what}", ORDER, share)
        for what, share in (
            ("contrast", order.contrast),
            ("widths", order.widths),
            ("pitch", order.pitch),
            ("distance", order.distance),
        )
    ]
    target = bench.description.target_uncertainty
    found += [
        Source(turn, ATTITUDE, doubt, "rad")
        for turn, doubt in zip(TARGET_TURNS, (target.roll, target.tilt, target.tilt), strict=True)
    ]
    return (
        *found,
        Source("workmanship: scale of the array", LENSES, made.scale),
        Source("spacing of the dots (certificate)", TRACED, target.dot_spacing),
        Source("frequencies of the bars (certificate)", TRACED, target.bar_frequency),
        Source("expansion by temperature", TRACED, bench.description.temperature.scale),
    )


def attitude_uncertainty(bench: Bench) -> Array:
    """Standard uncertainties of the array's roll, yaw and pitch, rad, shape (3,): how it was set,
    and of the axes that turn it.
    """
    doubt = bench.description.optics_uncertainty
    set_by = dict(zip(TURNS, (doubt.array_roll, doubt.array_tilt, doubt.array_tilt), strict=True))
    fixed = bench.description.fixed.stated()
    found: list[float] = []
    for turn, by_eye in set_by.items():
        axis = bench.description.axis_of(turn)
        other = fixed[turn].uncertainty if turn in fixed else by_eye
        found.append(math.hypot(axis[1].zero_uncertainty, other) if axis else other)
    return np.array(found)


def errors_of(bench: Bench, standard: Array) -> Errors:
    """Errors of equal lenses, from the error of each of ``stated_sources`` over its standard
    uncertainty, shape (n, sources).
    """
    sizes = [source.uncertainty for source in stated_sources(bench)]
    error = iter((standard * sizes).T)  # in the order of the sources
    stages: dict[Element, tuple[Array, Array]] = {
        element: (next(error), next(error)) for element in ELEMENTS
    }
    lens, f_number, focal, aperture, pitch = (1 + next(error) for _ in range(5))
    attitude = np.stack([next(error) for _ in TURNS], axis=1)
    order = OrderFactors(*(1 + next(error) for _ in range(4)))
    target = np.stack([next(error) for _ in TARGET_TURNS], axis=1)
    scale, dots, bars, expansion = (1 + one for one in error)
    pixel = np.ones(len(standard))  # lithography makes it
    optics = OpticsFactors(lens, lens / f_number, focal, aperture, pitch * scale, pixel)
    return Errors(
        stages,
        optics,
        attitude,
        target,
        order,
        EQUAL_LENSES,
        dots=dots,
        bars=bars,
        expansion=expansion,
    )


def drawn_errors(bench: Bench, draws: int, rng: np.random.Generator) -> Errors:
    """Draws of the errors of all sources together."""
    sources = len(stated_sources(bench))
    found = errors_of(bench, rng.standard_normal((sources, draws)).T)
    lenses = stated_lens_errors(bench.description.workmanship, 0)
    if not lenses.differ:
        return found
    return replace(found, lenses=replace(lenses, seed=int(rng.integers(2**31))))


def one_at_a_time(bench: Bench) -> tuple[tuple[Source, ...], Errors]:
    """Errors of a bench of which one source varies and the others are as described.

    Returns:
        The sources that have an uncertainty, and errors with 1 + ``LEVELS`` a source values: a
        bench as described first, then ``LEVELS`` of each source.
    """
    sources = stated_sources(bench)
    places = [k for k, source in enumerate(sources) if source.uncertainty > 0]
    standard = np.zeros((1 + LEVELS * len(places), len(sources)))
    for n, place in enumerate(places):
        standard[1 + n * LEVELS : 1 + (n + 1) * LEVELS, place] = normal_levels(LEVELS)
    return tuple(sources[place] for place in places), errors_of(bench, standard)


def approached(
    errors: Errors, repeats: RepeatabilityDescription, bench: Bench, index: int
) -> Errors:
    """Errors with those of one configuration of its own, by its index among all that are repeated:
    where stages and iris stopped.
    """
    rng = np.random.Generator(np.random.Philox(key=OWN_KEY + index))
    count = len(errors.optics.pitch)
    stages = {
        element: (
            zero + rng.standard_normal(count) * repeats.stages
            if bench.description.axis_of(element)
            else zero,
            scale,
        )
        for element, (zero, scale) in errors.stages.items()
    }
    wide = 1 + rng.standard_normal(count) * repeats.f_number
    aperture = errors.optics.lens_aperture / wide
    return replace(errors, stages=stages, optics=replace(errors.optics, lens_aperture=aperture))


def of_lenses(bench: Bench, errors: Errors) -> Errors:
    """Errors of a bench as described but for its lenses, which differ as those of ``errors``."""
    return replace(as_described(LENS_DRAWS), lenses=errors.lenses)


def normal_levels(count: int) -> Array:
    """Rising values that stand for a normal number, one for each of ``count`` equally probable
    intervals: the root mean square in it, so that their variance is 1.
    """
    ends = stats.norm.ppf(np.linspace(0, 1, count + 1))
    density = stats.norm.pdf(ends)
    moment = np.where(np.isfinite(ends), ends, 0.0) * density
    sign = np.sign(np.arange(count) - (count - 1) / 2)
    return sign * np.sqrt(1 + count * (moment[:-1] - moment[1:]))
