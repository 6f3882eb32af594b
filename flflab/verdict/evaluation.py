"""From a run's frames to a comparison: measure every configuration, predict it, set both side by
side.

Reads a record, never a bench: the same function serves a run that just ended and one from years
ago.
"""

import contextlib
import math
import os
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from flflab.bench import Bench
from flflab.bench_uncertainty import RepeatabilityDescription
from flflab.record import Run
from flflab.study import Study
from flflab.verdict.budget import Apart, Budget, budgets
from flflab.verdict.comparison import Comparison, Row
from flflab.verdict.diagnosis import Suspect, diagnose
from flflab.verdict.disturbances import disturbances
from flflab.verdict.geometry import geometry
from flflab.verdict.prediction import Errors, as_described
from flflab.verdict.properties.attitude import attitude
from flflab.verdict.properties.contrast import contrasts
from flflab.verdict.properties.depth import dot_distances, lateral_resolution
from flflab.verdict.properties.depth_maps import map_distance, with_map
from flflab.verdict.properties.fields import fields, overlap
from flflab.verdict.properties.floor import with_floor
from flflab.verdict.properties.focus import depth_of_field
from flflab.verdict.properties.light import light
from flflab.verdict.properties.measured import Measured, measure_configuration, recorded
from flflab.verdict.properties.noise import noise
from flflab.verdict.properties.predicted import Predicted, predict, predict_uncounted
from flflab.verdict.properties.target import target
from flflab.verdict.properties.values import (
    Values,
    differences,
    positions,
    ratios,
    rows,
    taken,
    verdict,
)
from flflab.verdict.properties.views import views
from flflab.verdict.repeats import (
    Repeatability,
    averaged,
    mean_draws,
    reference_of,
    repeatability,
    repetitions,
)
from flflab.verdict.sources import (
    approached,
    drawn_errors,
    of_lenses,
    one_at_a_time,
)
from flflab.verdict.visible import Visible, visible

JUDGED = {  # the verdicts, and the quantities that each is about
    "mtf": ("mtf", "mtf_y"),
    "views": ("views",),
    "micro_images_mm": ("bright_field_mm", "total_field_mm", "image_pitch_mm"),
    "overlap_mm": ("overlap_mm",),
    "depth_of_field_mm": ("depth_of_field_near_mm", "depth_of_field_far_mm"),
    "light": ("light",),
    "elr_row_px": ("elr_row_px",),
    "dot_distance_mm": ("dot_distance_mm",),
    "map_distance_mm": ("map_distance_mm",),
    "target_image": ("dot_scale", "bar_scale", "target_roll_mrad"),
    "array_attitude_mrad": ("array_roll_mrad", "array_yaw_mrad", "array_pitch_mrad"),
    "noise": ("noise",),
}
OWN_DRAWS = 200  # of what each configuration has of its own, for its part of a budget
EXPLAINED_BY_OTHERS = (
    "views",
    "contrast_paper",
    "overlap_mm",
    "elr_row_px",
    "depth_of_field_near_mm",
    "depth_of_field_far_mm",
)


@dataclass(frozen=True)
class Evaluation:
    """A run, measured and predicted and compared.

    Attributes:
        measured: what the frames of each configuration show.
        predicted: what the model says of each.
        comparison: both side by side, and the verdicts.
        values: the numbers behind the comparison.
        budgets: where the uncertainty of each of these numbers, and of each difference and ratio
            between configurations, comes from.
        suspects: where the model is rejected: single changes of the bench that would explain it,
            the best first.
        visible: how large every single change must be to be seen in this run.
        repeats: how well settings repeat that were taken several times, and whose means are then
            judged; ``measured`` and ``predicted`` are of the first time.
    """

    measured: tuple[Measured, ...]
    predicted: tuple[Predicted, ...]
    comparison: Comparison
    values: tuple[Values, ...]
    budgets: tuple[Budget, ...]
    suspects: tuple[Suspect, ...]
    visible: tuple[Visible, ...]
    repeats: Repeatability | None = None


Tell = Callable[[int, int], object]


def tell_nobody(done: int, total: int) -> None:
    """Keep progress to oneself."""


def evaluate(
    run: Run, study: Study, bench: Bench, seed: int = 0, tell: Tell = tell_nobody
) -> Evaluation:
    """Measure and predict every configuration of a run that was recorded, and compare.

    Args:
        run: the record.
        study: the study as recorded with it.
        bench: the bench as recorded with it.
        seed: of the draws behind uncertainties and verdicts.
        tell: called with how many configurations are measured, of how many, before the first and
            after each.

    Raises:
        MeasurementError: no configuration's frames are complete, or they do not show what they
            should.
    """
    # The measurement's kernels let other threads run, so every core measures a configuration of its
    # own.
    measured: list[Measured] = []
    configurations = recorded(run, study)
    tell(0, len(configurations))
    with measuring_threads() as pool:
        for one in pool.map(
            lambda one: with_map(measure_configuration(run, one, study, bench), run, study, bench),
            configurations,
        ):
            measured.append(one)
            tell(len(measured), len(configurations))
    return evaluate_measured(tuple(measured), study, bench, seed)


@contextlib.contextmanager
def measuring_threads() -> Generator[ThreadPoolExecutor]:
    """One a core; whoever interrupts does not wait for what they are measuring."""
    pool, patient = ThreadPoolExecutor(os.cpu_count() or 1), True
    try:
        yield pool
    except KeyboardInterrupt:
        patient = False
        raise
    finally:
        pool.shutdown(wait=patient, cancel_futures=True)


def evaluate_measured(
    measured: tuple[Measured, ...], study: Study, bench: Bench, seed: int = 0
) -> Evaluation:
    """Predict and compare what was measured before.

    Raises:
        MeasurementError: something could not be measured, and the rest does not say that the camera
            is to blame.
    """
    rng = np.random.Generator(np.random.Philox(key=seed))
    failures = [failure for one in measured for failure in one.failures]
    times = repetitions(measured, study.settings)
    bare, floor = times[0], bench.description.measurement_floor
    once = as_described(1)
    quiet = [
        properties(time, tuple(predict(one, study, bench, once) for one in time), steady(bench))
        for time in times
    ]
    repeats = None
    if len(times) > 1:
        moved = anew(bare, study, bench, as_described(OWN_DRAWS), reference_of(bench))
        repeats = repeatability(quiet, properties(bare, moved, bench), bench)
        bench = repeats.of_bench(bench)
    errors = drawn_errors(bench, study.description.draws, rng)
    measured = tuple(with_floor(one, floor, bench.optics) for one in bare)
    again = bench.description.repeatability
    every = [anew(measured, study, bench, errors, again, time) for time in range(len(times))]
    predicted = every[0]
    values = mean_draws([properties(measured, one, bench) for one in every])
    if repeats is not None:
        values = averaged(values, quiet, repeats.pictures_used)
        quiet = [averaged(quiet[0], quiet, repeats.pictures_used)]
    comparison = compare(values, measured, predicted, study, rng)
    if failures and comparison.accepted:
        raise failures[0]

    suspects, seen = causes(values, measured, predicted, study, bench, errors, comparison.accepted)
    judged = frozenset(quantity for quantities in JUDGED.values() for quantity in quantities)
    return Evaluation(
        measured,
        predicted,
        comparison,
        values,
        budgets=budgets(
            values,
            between(values, study.description.reference),
            apart(measured, quiet[0], study, bench, errors, len(times), repeats),
            measured,
            judged,
        ),
        suspects=suspects,
        visible=seen,
        repeats=repeats,
    )


def steady(bench: Bench) -> Bench:
    """The bench in a light that never changes."""
    update = {"light_uncertainty": 0.0}
    return replace(bench, description=bench.description.model_copy(update=update))


def anew(
    measured: tuple[Measured, ...],
    study: Study,
    bench: Bench,
    errors: Errors,
    repeats: RepeatabilityDescription,
    time: int = 0,
) -> tuple[Predicted, ...]:
    """What the model says of every configuration at one of the times, each approached by itself."""
    if repeats.stages == 0 and repeats.f_number == 0:
        return tuple(predict(one, study, bench, errors) for one in measured)
    return tuple(
        predict(
            one,
            study,
            bench,
            approached(
                errors, repeats, bench, one.configuration.index + time * len(study.configurations)
            ),
        )
        for one in measured
    )


def causes(
    values: tuple[Values, ...],
    measured: tuple[Measured, ...],
    predicted: tuple[Predicted, ...],
    study: Study,
    bench: Bench,
    errors: Errors,
    accepted: bool,
) -> tuple[tuple[Suspect, ...], tuple[Visible, ...]]:
    """Where the model is rejected, every single change of the bench that could be the reason, the
    best first; and how large each must be to be seen.

    Args:
        values: the numbers behind the comparison.
        measured: every configuration.
        predicted: the same.
        study: the study.
        bench: the bench as described.
        errors: the draws behind the predictions.
        accepted: the verdict.
    """
    explained = [one for one in values if one.quantity not in EXPLAINED_BY_OTHERS]

    def numbers(errors: Errors) -> list[Values]:
        models = tuple(predict_uncounted(one, study, bench, errors) for one in measured)
        every = properties(measured, models, bench)
        found = {(one.quantity, one.configuration): one for one in every}
        same = [(one, found[one.quantity, one.configuration]) for one in explained]
        return [taken(other, positions(one, other)) for one, other in same]

    seen = visible(explained, bench, numbers)
    if accepted:
        return (), seen
    others = disturbances(explained, measured, predicted, bench)
    return diagnose(explained, geometry(bench, errors, numbers) + others), seen


def properties(
    measured: tuple[Measured, ...], predicted: tuple[Predicted, ...], bench: Bench
) -> tuple[Values, ...]:
    """Every property of every configuration, measured and predicted."""
    found: list[Values] = []
    for one, model in zip(measured, predicted, strict=True):
        found += [
            *views(one, model),
            *contrasts(one, model),
            *fields(one, model),
            overlap(one, model),
            *attitude(one, model),
            *noise(one, model),
        ]
        found += [dot_distances(one, model), *lateral_resolution(one, model)]
        found += map_distance(one, model)
        found += target(one, model, bench.description.repeatability.stages)
    found += depth_of_field(measured, predicted) + light(
        measured, predicted, bench.description.light_uncertainty
    )
    return tuple(values for values in found if len(values.measured))


def between(found: tuple[Values, ...], reference: int) -> tuple[tuple[Values, int], ...]:
    """Differences, of contrast ratios, of every configuration against the reference, with that;
    those without a number are left out.
    """
    before = {values.quantity: values for values in found if values.configuration == reference}
    others = [
        (values, other)
        for values in found
        if (other := before.get(values.quantity)) is not None
        and other is not values
        and values.quantity not in ("light", "contrast_paper")
    ]
    pairs = [
        (ratios if values.quantity in JUDGED["mtf"] else differences)(values, other)
        for values, other in others
    ]
    return tuple((pair, reference) for pair in pairs if len(pair.measured))


def apart(
    measured: tuple[Measured, ...],
    quiet: tuple[Values, ...],
    study: Study,
    bench: Bench,
    errors: Errors,
    times: int,
    repeats: Repeatability | None,
) -> Apart:
    """Every property with one source of uncertainty at a time.

    Args:
        measured: every configuration, with the floor of the measurement.
        quiet: every property with the noise of the pictures alone.
        study: the study.
        bench: the bench as described, with what was found of how it repeats.
        errors: all sources drawn together; how lenses differ is taken from there.
        times: how often every configuration was measured.
        repeats: how well it repeats, where that was measured.
    """

    def with_errors(drawn: Errors) -> tuple[Predicted, ...]:
        return tuple(predict(one, study, bench, drawn) for one in measured)

    sources, alone = one_at_a_time(bench)
    again = bench.description.repeatability
    described = as_described(OWN_DRAWS)
    repeated = [anew(measured, study, bench, described, again, time) for time in range(times)]
    surely = repeats is not None and repeats.stages_used > repeats.stages_stated
    lenses = (
        properties(measured, with_errors(of_lenses(bench, errors)), bench)
        if errors.lenses.differ
        else None
    )
    return Apart(
        sources,
        properties(measured, with_errors(alone), bench),
        lenses,
        mean_draws([properties(measured, one, bench) for one in repeated])
        if again.stages or again.f_number
        else None,
        repeats.stages_dof if repeats is not None and surely else math.inf,
        quiet,
    )


def compare(
    found: tuple[Values, ...],
    measured: tuple[Measured, ...],
    predicted: tuple[Predicted, ...],
    study: Study,
    rng: np.random.Generator,
) -> Comparison:
    """Rows of every configuration and between each and the reference, and a verdict for every
    property.

    The verdicts share the study's significance equally, so that an honest bench is rejected no more
    often than it says.
    """
    lines: list[Row] = []
    where = {
        one.configuration.index: (one, model)
        for one, model in zip(measured, predicted, strict=True)
    }
    for values in found:
        lines += rows(values, *where[values.configuration])
    for values, reference in between(found, study.description.reference):
        lines += rows(values, *where[values.configuration], reference)
    judged = {
        name: [values for values in found if values.quantity in quantities]
        for name, quantities in JUDGED.items()
    }
    present = {name: members for name, members in judged.items() if members}
    threshold = study.description.significance / len(present)
    return Comparison(
        tuple(lines),
        tuple(verdict(name, members, threshold, rng) for name, members in present.items()),
    )
