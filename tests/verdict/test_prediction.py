"""Draws of the errors of stages and optics change the predicted camera as one would build them, one
camera at a time.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flflab.bench import Element, read_bench
from flflab.bench_uncertainty import OpticsUncertaintyDescription
from flflab.optics.camera import MainLens, Substrate
from flflab.verdict.prediction import (
    as_described,
    contrast_draws,
    placements,
    predicted_view_indices,
    view_draws,
)
from flflab.verdict.sources import drawn_errors

UNCERTAIN = OpticsUncertaintyDescription(
    main_lens_focal_length=1e-3,
    f_number=0.02,
    microlens_focal_length=0.01,
    microlens_aperture=0.02,
    pitch=2e-3,
)
UNTURNED = np.zeros((1, 3))
BENCH = Path(__file__).parents[2] / "examples" / "benches" / "simulated.yaml"
POINTS = 4.0 * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1.0]])


@pytest.mark.parametrize(
    "substrate", [None, Substrate(0.3, 1.5, "sensor"), Substrate(0.3, 1.5, "main lens")], ids=str
)
@pytest.mark.parametrize("f_number", [1.6, 2.8, 4.0, 5.6])
def test_counts_of_all_draws_equal_those_of_cameras_built_one_by_one(
    f_number: float, substrate: Substrate | None
) -> None:
    bench = read_bench(BENCH)
    rng = np.random.Generator(np.random.Philox(key=5))
    drawn = drawn_errors(
        replace(
            bench,
            description=bench.description.model_copy(update={"optics_uncertainty": UNCERTAIN}),
        ),
        12,
        rng,
    )
    # Many times the real errors, so that counts do change between draws.
    errors = replace(
        drawn,
        stages={element: (20 * zero, scale) for element, (zero, scale) in drawn.stages.items()},
    )
    worlds: dict[Element, float] = {
        "main_lens.z": 0.0,
        "array.z": 60.0,
        "sensor.z": 61.15,
        "target.z": -507.0,
    }
    where = placements(bench, worlds, errors)  # pyright: ignore[reportArgumentType]
    camera = replace(bench.optics, main_lens=replace(bench.optics.main_lens, f_number=f_number))
    camera = replace(camera, array=replace(camera.array, tilt=(1e-3, 0.0), substrate=substrate))
    attitude = 4 * drawn.attitude
    counted = view_draws(camera, where, attitude, POINTS)
    for draw in range(12):
        focal, aperture, pitch = (
            float(factor[draw])
            for factor in (drawn.optics.focal, drawn.optics.aperture, drawn.optics.pitch)
        )
        lens, wide = float(drawn.optics.lens_focal[draw]), float(drawn.optics.lens_aperture[draw])
        moved = replace(
            camera,
            main_lens=MainLens(lens * camera.main_lens.focal_length, f_number * lens / wide),
            array=replace(
                camera.array,
                distance=float(where.array[draw]),
                focal_lengths=(camera.array.focal_lengths[0] * focal,),
                aperture=camera.array.aperture * aperture,
                pitch=(camera.array.pitch[0] * pitch, camera.array.pitch[1] * pitch),
                roll=float(attitude[draw, 0]),
                tilt=(1e-3 + math.tan(attitude[draw, 1]), math.tan(attitude[draw, 2])),
            ),
            sensor=replace(camera.sensor, distance=float(where.array[draw] + where.gap[draw])),
        )
        alone = [
            len(seen) for seen in predicted_view_indices(moved, float(where.distance[draw]), POINTS)
        ]
        assert counted[draw].tolist() == alone


def test_a_stage_s_errors_move_its_element_along_the_axis() -> None:
    bench = read_bench(BENCH)
    exact = as_described(1)
    worlds: dict[Element, float] = {
        "main_lens.z": 0.0,
        "array.z": 60.0,
        "sensor.z": 61.15,
        "target.z": -507.0,
    }
    off: tuple[Element, ...] = ("sensor.z",)
    moved = exact.stages | dict.fromkeys(off, (np.array([0.002]), np.array([1e-4])))
    before = placements(bench, worlds, exact)
    after = placements(bench, worlds, replace(exact, stages=moved))
    # The sensor's stage reads 18.85 mm there and counts against z.
    assert (after.gap - before.gap)[0] == pytest.approx(0.002 - 1e-4 * 18.85)
    assert before.distance[0] == pytest.approx(507.0)


def test_in_focus_the_contrast_falls_whichever_way_the_sensor_is_off() -> None:
    bench = read_bench(BENCH)
    exact = as_described(3)
    off: tuple[Element, ...] = ("sensor.z",)
    moved = exact.stages | dict.fromkeys(off, (np.array([-0.003, 0.0, 0.003]), np.zeros(3)))
    sharp: dict[Element, float] = {
        "main_lens.z": 0.0,
        "array.z": 60.0,
        "sensor.z": 61.15,
        "target.z": -506.701556,
    }
    errors = replace(exact, stages=moved)
    contrast = contrast_draws(bench.optics, placements(bench, sharp, errors), np.array([5.0]))[:, 0]
    assert contrast[0] < contrast[1]
    assert contrast[2] < contrast[1]
