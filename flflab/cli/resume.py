"""``flflab resume RUN``: go on with a run that was interrupted, failed or was cut off."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from flflab.record import Run


def resume(
    run: Annotated[Path, typer.Argument(help="folder of the run")],
    bench: Annotated[
        Path | None,
        typer.Option(help="the same bench at other addresses (YAML); the recorded one without it"),
    ] = None,
) -> None:
    """Continue an interrupted run: re-home axes if needed, check that the bench is unchanged, take
    the missing frames, finish as before.
    """
    from flflab.cli.run import progress_shown, resume_run  # help waits for none of it
    from flflab.record import read_run

    found = read_run(run)
    if not _lacks_its_fit_alone(found):
        with progress_shown() as tell:
            found = resume_run(run, bench, tell)
    if found.start["plan_name"] == "validate":
        from flflab.cli.verdict import conclude

        conclude(found)
    elif found.start["plan_name"] == "calibrate":
        from flflab.cli.calibrated import conclude as conclude_calibration

        conclude_calibration(found)
    else:
        from flflab.cli.sweep import tell_of

        tell_of(found)


def _lacks_its_fit_alone(run: "Run") -> bool:
    """Whether a calibration was taken to its end and interrupted while its pictures were
    measured.
    """
    return (
        run.complete
        and run.start.get("plan_name") == "calibrate"
        and not (run.folder / "calibration.json").exists()
    )
