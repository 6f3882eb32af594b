"""What stages with iris, lamp and pictures repeat to, from settings that were taken several times:
the type A of a bench, compared with what the bench file states.

White pictures show stages and iris by the micro-images, pictures of dots by their depths. In units
of the pictures' noise, the direction in which stages and iris move these numbers most says how far
they repeat; directions that they hardly move say how far the pictures' noise does.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import stats

from flflab.bench import Bench
from flflab.bench_uncertainty import RepeatabilityDescription
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.values import Values, common, joined, positions, taken

Array = npt.NDArray[np.float64]
SEEN_IN = (("bright_field_mm", "total_field_mm", "image_pitch_mm"), ("dot_distance_mm",))
REFERENCE_MM = 1e-3  # what stages are compared with where the bench file states nothing
HARDLY = 0.05  # variance by stages over the pictures': directions below it are the pictures' own
SURE = 0.99  # of honest benches scatter less than what is stated to be exceeded


@dataclass(frozen=True)
class Repeatability:
    """What was repeated, and how well.

    Attributes:
        stages: measured standard deviation of a place that is approached anew, mm.
        stages_dof: degrees of freedom of it.
        stages_stated: as the bench file has it, mm.
        stages_used: the larger of both where the scatter is surely larger, widened by what few
            degrees of freedom leave open; else as stated.
        light: measured standard deviation of the light, as a share; nan with one setting.
        light_stated: as the bench file has it.
        light_used: as ``stages_used``.
        pictures: scatter of the pictures' numbers over what their noise makes.
        pictures_used: the same where it is surely above 1; else 1.
    """

    stages: float
    stages_dof: float
    stages_stated: float
    stages_used: float
    light: float
    light_stated: float
    light_used: float
    pictures: float
    pictures_used: float

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was found, for people."""
        larger = self.stages_used > self.stages_stated
        said = [
            f"Stages and iris repeat to {1e3 * self.stages:.2g} um ({self.stages_dof:.0f} degrees"
            f" of freedom), {1e3 * self.stages_stated:.2g} um is stated:"
            f" {f'{1e3 * self.stages_used:.2g} um' if larger else 'what is stated'} is used."
        ]
        if self.light == 0:
            said.append("The scatter of the stages hides that of the light: as stated.")
        elif math.isfinite(self.light):
            larger = self.light_used > self.light_stated
            said.append(
                f"The light repeats to {100 * self.light:.2g} %, {100 * self.light_stated:.2g} %"
                f" is stated: {f'{100 * self.light_used:.2g} %' if larger else 'what is stated'}"
                " is used."
            )
        if self.pictures_used > 1:
            said.append(
                f"Numbers of the pictures scatter {self.pictures:.2g} times as much as their noise"
                " says: that is used."
            )
        return tuple(said)

    def of_bench(self, bench: Bench) -> Bench:
        """The bench with what is used in place of what its file states."""
        stated = bench.description.repeatability
        more = self.stages_used / self.stages_stated if self.stages_stated > 0 else 1.0
        used = stated.model_copy(
            update={"stages": self.stages_used, "f_number": stated.f_number * more}
        )
        update = {"repeatability": used, "light_uncertainty": self.light_used}
        return replace(bench, description=bench.description.model_copy(update=update))


def repetitions(measured: tuple[Measured, ...], settings: int) -> list[tuple[Measured, ...]]:
    """The settings that were measured every time, once for each time, numbered as the first."""
    times: dict[int, dict[int, Measured]] = {}
    for one in measured:
        index = one.configuration.index - one.configuration.repetition * settings
        first = replace(one, configuration=replace(one.configuration, index=index))
        times.setdefault(one.configuration.repetition, {})[index] = first
    always = set[int].intersection(*(set(found) for found in times.values()))
    return [tuple(found[index] for index in sorted(always)) for _, found in sorted(times.items())]


def reference_of(bench: Bench) -> RepeatabilityDescription:
    """What scatter is compared with: as stated, or 1 um where nothing is."""
    stated = bench.description.repeatability
    return stated.model_copy(update={"stages": stated.stages or REFERENCE_MM})


def repeatability(
    times: list[tuple[Values, ...]], moved: tuple[Values, ...], bench: Bench
) -> Repeatability:
    """How well settings repeat.

    Args:
        times: the numbers with the noise of their pictures alone, once for each time.
        moved: the same numbers, draws of stages and iris that repeat as ``reference_of`` says.
        bench: as described.
    """
    stated, reference = bench.description.repeatability.stages, reference_of(bench).stages
    known = (stated / reference) ** 2
    tops, powers, quiet = list[float](), list[float](), list[float]()
    degrees = len(times) - 1
    seen = [common(one, others) for one in moved if (others := _each(one, times))]
    for index in {one.configuration for one in seen}:
        for quantities in SEEN_IN:
            here = [
                one
                for one in seen
                if one.configuration == index and one.quantity in quantities and len(one.measured)
            ]
            if not here:
                continue
            matching = [[taken(o, positions(v, o)) for o in _each(v, times)] for v in here]
            each = [joined(list(time)) for time in zip(*matching, strict=True)]
            power, scatter = _directions(each, np.cov(joined(here)[2], rowvar=False))
            tops.append(scatter[-1])
            powers.append(power[-1])
            quiet += [s for p, s in zip(power[:-1], scatter[:-1], strict=True) if p < HARDLY]
    freedom = degrees * len(tops)
    # directions in which stages are seen well count alike, others by how well
    excess = sum((s - 1) / (1 + p) for s, p in zip(tops, powers, strict=True))
    weight = sum(p / (1 + p) for p in powers)
    factor = math.sqrt(max(excess, 0.0) / weight) if tops else 0.0
    expected = sum(s / (1 + known * p) for s, p in zip(tops, powers, strict=True))
    surely = freedom > 2 and expected * degrees > stats.chi2.ppf(SURE, freedom)
    pictures = math.sqrt(sum(quiet) / len(quiet)) if quiet else 1.0
    worse = bool(quiet) and sum(quiet) * degrees > stats.chi2.ppf(SURE, len(quiet) * degrees)
    stages = max(stated, factor * reference * _few(freedom)) if surely else stated
    by_stages = _light_by_stages(moved) * max(stated, factor * reference) / reference
    light, used = _light(times, bench.description.light_uncertainty, by_stages)
    return Repeatability(
        stages=factor * reference,
        stages_dof=freedom,
        stages_stated=stated,
        stages_used=stages,
        light=light,
        light_stated=bench.description.light_uncertainty,
        light_used=used,
        pictures=pictures,
        pictures_used=max(1.0, pictures) if worse else 1.0,
    )


def _few(freedom: float) -> float:
    """By which the standard deviation of a t distribution exceeds the measured one."""
    return math.sqrt(freedom / (freedom - 2)) if freedom > 2 else math.inf


def _each(one: Values, times: list[tuple[Values, ...]]) -> list[Values]:
    """The same quantity of the same setting at each time; none where a time lacks it."""
    found = [
        other
        for time in times
        for other in time
        if (other.quantity, other.configuration) == (one.quantity, one.configuration)
    ]
    return found if len(found) == len(times) else []


def _directions(
    each: list[tuple[Array, Array, Array]], by_stages: Array
) -> tuple[list[float], list[float]]:
    """Of directions in units of the pictures' noise: variance by the stages, rising, and variance
    over the times.
    """
    noise = np.mean([one[1] for one in each], axis=0)
    numbers = np.stack([one[0] for one in each])
    root = np.linalg.inv(np.linalg.cholesky(noise + 1e-9 * np.diag(np.diag(noise))))
    power, axes = np.linalg.eigh(root @ np.atleast_2d(by_stages) @ root.T)
    scatter = ((numbers - numbers.mean(axis=0)) @ root.T @ axes).var(axis=0, ddof=1)
    return power.tolist(), scatter.tolist()


def _light_by_stages(moved: tuple[Values, ...]) -> float:
    """Standard deviation of the light by stages that repeat as the reference, before it is taken
    over the mean of all settings.
    """
    found = [float(one.draws.var()) for one in moved if one.quantity == "light"]
    return math.sqrt(sum(found) / (len(found) - 1)) if len(found) > 1 else 0.0


def _light(times: list[tuple[Values, ...]], stated: float, by_stages: float) -> tuple[float, float]:
    """Standard deviation of the light from time to time beside what stages make of it, and what is
    used of it and what is stated.
    """
    read = np.array(
        [[float(v.measured[0]) for v in time if v.quantity == "light"] for time in times]
    )
    count, settings = read.shape
    freedom = (count - 1) * (settings - 1)
    if freedom < 1:
        return math.nan, stated
    squares = float(np.sum((read - read.mean(axis=0)) ** 2))
    found = math.sqrt(max(squares / freedom - by_stages**2, 0.0))
    honest = (stated**2 + by_stages**2) * float(stats.chi2.ppf(SURE, freedom))
    surely = freedom > 2 and squares > honest
    return found, max(stated, found * _few(freedom)) if surely else stated


def mean_draws(each: list[tuple[Values, ...]]) -> tuple[Values, ...]:
    """What the model says of means over several times, from what it says of each time: the mean of
    contrasts that all fall lies below the contrast in the mean place.
    """
    found: list[Values] = []
    for one, *others in zip(*each, strict=True):
        if not others:
            found.append(one)
            continue
        draws = np.mean([other.draws for other in (one, *others)], axis=0)
        counted = one.draws.dtype.kind == "i"
        expected = one.expected if counted else draws.mean(axis=0)
        found.append(replace(one, draws=draws, expected=expected))
    return tuple(found)


def averaged(
    whole: tuple[Values, ...], times: list[tuple[Values, ...]], scatter: float
) -> tuple[Values, ...]:
    """The means over the times, of the numbers that were measured every time.

    Args:
        whole: of the first time, with the model's draws and the floor of the measurement, which no
            repetition takes away.
        times: the same with the noise of the pictures alone, once for each time.
        scatter: the pictures' scatter over that noise.
    """
    found: list[Values] = []
    for one in whole:
        others = _each(one, times)
        first = common(one, others)
        if not others or not len(first.measured):
            continue
        same = [taken(other, positions(first, other)) for other in others]
        floor = first.noise - same[0].noise
        # the fits' own errors are the same every time: a mean is no surer than one picture
        pictures = scatter**2 * np.mean([other.noise for other in same], axis=0)
        mean = np.mean([other.measured for other in same], axis=0)
        shared = first.shared
        if shared is not None:
            ratio = np.sqrt(np.diag(floor + pictures) / np.diag(first.noise))
            shared = replace(shared, by=shared.by * ratio[:, None])
        found.append(replace(first, measured=mean, noise=floor + pictures, shared=shared))
    return tuple(found)
