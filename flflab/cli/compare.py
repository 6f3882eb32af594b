"""``flflab compare OBSERVATIONS --camera CAMERA``: views and virtual depths measured elsewhere
against the model.
"""

import json as json_text
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.table import Table

from flflab.calibration.refit import Refit, refit_distances, state_refit
from flflab.camera_file import read_camera
from flflab.cli.ending import print_json
from flflab.cli.terminal import Terminal
from flflab.errors import MeasurementError
from flflab.observations.agreement import (
    FrameAgreement,
    compare_frames,
    depth_deviation,
    state_depths,
    state_views,
)
from flflab.observations.points import PredictedPoints, SeenPoints, measure_points, predict_points
from flflab.observations.reading import Observations, read_observations
from flflab.optics.camera import Camera
from flflab.whole_file import make_folder, write_csv, write_whole


@dataclass(frozen=True)
class Comparison:
    """Everything that one run of the command found; no refit where the points allow none, with the
    reason.
    """

    observations: Observations
    seen: SeenPoints
    predicted: PredictedPoints
    refit: Refit | None
    refit_predicted: PredictedPoints | None
    frames: tuple[FrameAgreement, ...]
    sentences: tuple[str, ...]


def compare(
    observations: Annotated[
        Path, typer.Argument(help="folder with observations.csv, poses.json and camera.json")
    ],
    camera: Annotated[
        Path, typer.Option(help="camera file (YAML) of the camera that took the pictures")
    ],
    json: Annotated[
        bool, typer.Option("--json", help="one JSON object on standard output (mm, degrees)")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="folder for compare.json, compare.csv and compare.png")
    ] = None,
) -> None:
    """Hold view counts and virtual depths measured elsewhere against the model, and refit L and
    b.
    """
    found = run_comparison(observations, read_camera(camera))
    result = as_json(found)
    if out is not None:
        write_files(out, found, result)
    if json:
        print_json(result)
        return
    console = Terminal()
    console.print(frame_table(found.frames))
    for sentence in found.sentences:
        console.print(sentence, highlight=False)
    if out is not None:
        console.print(
            "Written:"
            f" {', '.join(str(out / name) for name in ('compare.json', 'compare.csv', 'compare.png'))}",  # noqa: E501
            highlight=False,
        )


def run_comparison(folder: Path, camera: Camera) -> Comparison:
    """Read, measure, predict, refit and state; raises what these raise."""
    observations = read_observations(folder)
    seen = measure_points(observations, camera)
    predicted = predict_points(camera, seen)
    known = seen.with_parallax
    refit, after, refit_said = None, None, list[str]()
    try:
        refit = refit_distances(
            camera,
            seen.position[known, 2],
            seen.array_position[known],
            seen.slope[known],
            seen.slope_uncertainty[known],
        )
    except MeasurementError as error:
        refit_said = [f"There is no refit: {error}."]
    else:
        after = predict_points(refit.camera, seen)
        refit_said = state_refit(camera, refit)
    frames = compare_frames(observations, seen, predicted, after, camera.sensor.pixel)
    before_v, after_v = (
        depth_deviation(seen, predicted),
        None if after is None else depth_deviation(seen, after),
    )
    said = [*state_views(frames), *state_depths(frames, before_v, after_v), *refit_said]
    if observations.empty_frames:
        said.append(
            f"Without observations: frame {', '.join(map(str, observations.empty_frames))}."
        )
    return Comparison(observations, seen, predicted, refit, after, frames, tuple(said))


def as_json(found: Comparison) -> dict[str, Any]:
    """The contract of ``compare --json``; null where a quantity is absent."""
    refit = found.refit
    return {
        "frames": [asdict(frame) for frame in found.frames],
        "frames_without_observations": list(found.observations.empty_frames),
        "virtual_depth_deviation": {
            "described": depth_deviation(found.seen, found.predicted),
            "refit": (
                None
                if found.refit_predicted is None
                else depth_deviation(found.seen, found.refit_predicted)
            ),
        },
        "refit": (
            None
            if refit is None
            else {
                "parameters": ["array_distance_mm", "gap_mm"],
                "values": [refit.camera.array.distance, refit.camera.gap],
                "uncertainties": refit.uncertainty.tolist(),
                "covariance": refit.covariance.tolist(),
                "correlation": refit.correlation,
                "reduced_chi_square": refit.scatter,
                "points": refit.points,
            }
        ),
        "sentences": list(found.sentences),
    }


def frame_table(frames: tuple[FrameAgreement, ...]) -> Table:
    """One row a frame; ``rms`` is of the predicted positions on the sensor."""
    table = Table(
        title="Views of a point, and virtual depth v: medians over a frame's points",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    views = ("views\nseen", "views\nmodel", "total\nseen", "total\nmodel")
    for name in (
        "frame",
        "tilt\ndeg",
        "points",
        *views,
        "v\nseen",
        "v\nmodel",
        "v\nrefit",
        "rms\npx",
    ):
        table.add_column(name, justify="right", no_wrap=True)
    for frame in frames:
        depths = (
            frame.virtual_depth_measured,
            frame.virtual_depth_predicted,
            frame.virtual_depth_refit,
        )
        table.add_row(
            str(frame.frame),
            f"{frame.tilt_deg:.1f}",
            str(frame.points),
            f"{frame.measured_median:g}",
            f"{frame.predicted_median:g}",
            str(frame.measured_total),
            str(frame.predicted_total),
            *("-" if depth is None else f"{depth:.2f}" for depth in depths),
            f"{frame.residual_px:.2f}",
        )
    return table


def write_files(out: Path, found: Comparison, result: dict[str, Any]) -> None:
    """Leave ``compare.json``, ``compare.csv`` (one row a point) and ``compare.png`` in a folder.

    Raises:
        InputError: the folder cannot be written.
    """
    from flflab.plots import (
        plot_compare,
    )  # matplotlib takes half a second that the other uses of the command line need not wait for

    seen = found.seen
    columns = {
        "frame": seen.frame,
        "point": seen.point,
        "distance_mm": seen.position[:, 2],
        "views_measured": seen.views,
        "views_predicted": found.predicted.views,
        "parallax_slope": seen.slope,
        "parallax_slope_uncertainty": seen.slope_uncertainty,
        "virtual_depth_measured": seen.virtual_depth,
        "virtual_depth_predicted": found.predicted.virtual_depth,
    }
    if found.refit_predicted is not None:
        columns |= {
            "views_refit": found.refit_predicted.views,
            "virtual_depth_refit": found.refit_predicted.virtual_depth,
        }
    make_folder(out, f"--out {out}")
    write_whole(out / "compare.json", json_text.dumps(result, indent=2, allow_nan=False) + "\n")
    write_csv(
        out / "compare.csv",
        [columns, *zip(*(column.tolist() for column in columns.values()), strict=True)],
    )
    plot_compare(out / "compare.png", found.frames, seen, found.predicted, found.refit_predicted)
