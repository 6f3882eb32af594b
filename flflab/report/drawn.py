"""What the simulated camera of a run drew, and why."""

from flflab.bench import Bench
from flflab.report.tables import Table
from flflab.simulated_light import chosen, drawing_tolerance, light_scenes
from flflab.study import Study
from flflab.targets import White
from flflab.verdict.properties.predicted import Predicted


def drawn_table(bench: Bench, study: Study, model: Predicted) -> Table:
    """Each effect, whether it is in the simulated pictures of a configuration, and why.

    Args:
        bench: the bench; its file decides what is simulated.
        study: which targets are shown.
        model: the configuration, as the model has it.
    """
    shown = [one for one in (study.dots, study.bars) if one.kind in study.shown]
    rows: list[tuple[str, ...]] = []
    for target in (White(), *shown):
        scene, _ = next(light_scenes(bench, model.camera, target, model.distance))
        tolerance = drawing_tolerance(bench, target)
        rows += [
            (
                f"{target.kind}, to {tolerance:.1g} of white",
                decision.name,
                "on" if decision.on else "off",
                f"{decision.size:.3g} {decision.unit}",
                f"{decision.bound:.1e}",
                decision.why,
            )
            for decision in chosen(bench, scene).decisions
            if decision.size is not None
        ]
    return Table(
        "What the simulated camera draws at the first configuration, and why",
        ("target", "effect", "", "size", "most it changes, of white", "why"),
        tuple(rows),
    )
