"""What ``flflab compare`` finds: measured, predicted, refitted, as JSON, a table and files."""

import json as json_text
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from flflab.calibration.refit import Refit, depend_on_selection, refit_distances, state_refit
from flflab.errors import MeasurementError
from flflab.observations.agreement import (
    Findings,
    FrameAgreement,
    compare_frames,
    depth_deviation,
    state_depths,
    state_positions,
    state_views,
)
from flflab.observations.detector import PossibleViews, fit_detector, possible_views
from flflab.observations.points import Parallax, SeenPoints, measure_parallax, measure_points
from flflab.observations.prediction import align, predict_depth, predict_points
from flflab.observations.reading import Array, Observations, read_observations
from flflab.optics.camera import Camera
from flflab.whole_file import make_folder, write_csv, write_whole


@dataclass(frozen=True)
class Comparison:
    """Everything that one run of the command found; no refit where the points allow none, with the
    reason.
    """

    observations: Observations
    found: Findings
    possible: PossibleViews
    refit: Refit | None
    frames: tuple[FrameAgreement, ...]
    sentences: tuple[str, ...]


def run_comparison(folder: Path, camera: Camera) -> Comparison:
    """Read, measure, predict, refit and state; raises what these raise."""
    observations = read_observations(folder)
    seen = measure_points(observations, camera)
    parallax = measure_parallax(seen, camera)
    alignment = align(camera, seen)
    straight = replace(camera, main_lens=replace(camera.main_lens, distortion=None))
    undistorted = None if camera.main_lens.distortion is None else align(straight, seen)
    possible = possible_views(camera, seen, alignment.position)
    predicted = predict_points(camera, seen, alignment.position)
    refit, after, refit_said = None, None, list[str]()
    try:
        refit = refit_camera(camera, seen, alignment.position[:, 2], parallax)
    except MeasurementError as error:
        refit_said = [f"There is no refit: {error}."]
    else:
        after = predict_depth(refit.camera, seen, alignment.position)
        refit_said = state_refit(camera, refit)
    pixel = camera.sensor.pixel
    detector = fit_detector(possible, seen, pixel)
    found = Findings(seen, parallax, alignment, detector, predicted, after, pixel)
    frames = compare_frames(observations, found)
    before_v = depth_deviation(parallax, predicted.virtual_depth)
    after_v = None if after is None else depth_deviation(parallax, after)
    said = [
        *state_positions(frames, found, undistorted),
        *state_views(frames, found),
        *state_depths(frames, before_v, after_v),
        *refit_said,
    ]
    if observations.empty_frames:
        said.append(
            f"Without observations: frame {', '.join(map(str, observations.empty_frames))}."
        )
    return Comparison(observations, found, possible, refit, frames, tuple(said))


def refit_camera(camera: Camera, seen: SeenPoints, distance: Array, parallax: Parallax) -> Refit:
    """Refit L and b with all views, and once more with the inner half of them for how the result
    depends on which views a detector finds.

    Raises:
        MeasurementError: the points leave L and b undetermined.
    """

    def fit(one: Parallax) -> Refit:
        known = one.known
        return refit_distances(
            camera,
            distance[known],
            one.array_position[known],
            one.slope[known],
            one.uncertainty[known],
        )

    refit, within = fit(parallax), float(np.median(seen.from_centre))
    try:
        inner = fit(measure_parallax(seen, camera, within))
    except MeasurementError:
        return refit
    return depend_on_selection(refit, inner, within)


def as_json(compared: Comparison) -> dict[str, Any]:
    """The contract of ``compare --json``; null where a quantity is absent."""
    refit, found = compared.refit, compared.found
    pixel, detector, alignment = found.pixel, found.detector, found.alignment
    return {
        "frames": [asdict(frame) for frame in compared.frames],
        "frames_without_observations": list(compared.observations.empty_frames),
        "positions": {
            "rms_px": alignment.rms / pixel,
            "rotation_mrad": (1e3 * alignment.rotation).tolist(),
            "uncertainty_mrad": (1e3 * alignment.uncertainty).tolist(),
        },
        "detector": {
            "reach_px": detector.reach / pixel,
            "softness_px": detector.softness / pixel,
            "scatter": detector.scatter if np.isfinite(detector.scatter) else None,
            "views_beyond_total_field": int(found.seen.beyond_field.sum()),
        },
        "virtual_depth_deviation": {
            "described": depth_deviation(found.parallax, found.predicted.virtual_depth),
            "refit": (
                None
                if found.refit_depth is None
                else depth_deviation(found.parallax, found.refit_depth)
            ),
        },
        "refit": (
            None
            if refit is None
            else {
                "parameters": ["array_distance_mm", "gap_mm"],
                "values": [refit.camera.array.distance, refit.camera.gap],
                "uncertainties": refit.uncertainty.tolist(),
                "u_own": refit.own.tolist(),
                "u_common": {"selection of views": (np.abs(refit.selection) / 3**0.5).tolist()},
                "covariance_own": refit.covariance.tolist(),
                "correlation_own": refit.correlation,
                "reduced_chi_square": refit.scatter,
                "points": refit.points,
            }
        ),
        "sentences": list(compared.sentences),
    }


def frame_table(frames: tuple[FrameAgreement, ...]) -> Table:
    """One row a frame; total of the model: as many as the fitted detector finds; ``rms`` is of the
    predicted positions on the sensor.
    """
    table = Table(
        title="Views of a point, and virtual depth v: medians over a frame's points",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    views = ("views\nseen", "views\nchief", "total\nseen", "total\nmodel", "z")
    for name in (
        "frame",
        "tilt\ndeg",
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
            f"{frame.measured_median:g}",
            f"{frame.predicted_median:g}",
            str(frame.measured_total),
            f"{frame.expected_total:.0f}",
            "-" if frame.z is None else f"{round(frame.z, 1) + 0.0:+.1f}",
            *("-" if depth is None else f"{depth:.2f}" for depth in depths),
            f"{frame.residual_px:.2f}",
        )
    return table


def write_files(out: Path, compared: Comparison, result: dict[str, Any]) -> None:
    """Leave ``compare.json``, ``compare.csv`` (one row a point) and ``compare.png`` in a folder.

    Raises:
        InputError: the folder cannot be written.
    """
    from flflab.plots import (
        plot_compare,
    )  # matplotlib takes half a second that the other uses of the command line need not wait for

    found = compared.found
    seen, parallax = found.seen, found.parallax
    columns = {
        "frame": seen.frame,
        "point": seen.point,
        "distance_mm": found.alignment.position[:, 2],
        "views_measured": seen.views,
        "views_predicted": found.predicted.views,
        "views_expected": found.detector.expected,
        "parallax_slope": parallax.slope,
        "parallax_slope_uncertainty": parallax.uncertainty,
        "virtual_depth_measured": parallax.virtual_depth,
        "virtual_depth_predicted": found.predicted.virtual_depth,
    }
    if found.refit_depth is not None:
        columns["virtual_depth_refit"] = found.refit_depth
    make_folder(out, f"--out {out}")
    write_whole(out / "compare.json", json_text.dumps(result, indent=2, allow_nan=False) + "\n")
    write_csv(
        out / "compare.csv",
        [columns, *zip(*(column.tolist() for column in columns.values()), strict=True)],
    )
    plot_compare(out / "compare.png", compared.frames, found, compared.possible)
