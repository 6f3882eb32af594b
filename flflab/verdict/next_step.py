"""What to do after a verdict, with the command to copy."""

from dataclasses import dataclass
from pathlib import Path

from flflab.verdict.diagnosis import Suspect


@dataclass(frozen=True)
class NextStep:
    """What to do next.

    Attributes:
        what: in a sentence.
        command: to copy.
    """

    what: str
    command: str


def next_step(
    accepted: bool, suspects: tuple[Suspect, ...], folder: Path, *, simulated: bool
) -> NextStep:
    """What to do after a run was judged.

    Args:
        accepted: the verdict.
        suspects: that explain a rejection equally well, the best first.
        folder: of the run.
        simulated: whether instruments were simulated.
    """
    bench = folder / "bench.yaml"
    if accepted and simulated:
        return NextStep(
            "Describe your own bench, and run the same study on it.",
            "flflab new bench my-bench.yaml",
        )
    if accepted:
        return NextStep(
            "Sign the report and archive the run as one file.", f"flflab export {folder} --nexus"
        )
    remedy = suspects[0].remedy if suspects else ""
    steps = {
        "calibrate": NextStep(
            "Find zeros and sizes from white and dot pictures, then validate with the calibrated"
            " files.",
            f"flflab calibrate --bench {bench}",
        ),
        "align": NextStep(
            "Turn the array straight, or state how it is turned.", f"flflab align --bench {bench}"
        ),
        "light": NextStep(
            "Copy the bench file, add `light: {wavelength: 550 nm}` (your light's) and judge the"
            " same frames again.",
            f"flflab report {folder} --bench my-bench.yaml",
        ),
        "lenses": NextStep(
            "See how far lenses like these are from the model; if more, state it as"
            " `model_uncertainty` and judge again.",
            f"flflab accuracy model --camera {folder / 'camera.yaml'}",
        ),
        "lamp": NextStep(
            "Let the lamp warm up for half an hour, shut out other light, take the frames again.",
            f"flflab validate {folder / 'study.yaml'} --bench {bench}",
        ),
    }
    return steps.get(
        remedy,
        NextStep(
            "Look at the marked frames: a mirrored or turned picture, exchanged targets or"
            " saturation show there. Then ask every device whether it is the one described.",
            f"flflab bench check --bench {bench}",
        ),
    )
