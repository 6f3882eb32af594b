"""What is said where a white picture does not show what the bench file describes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flflab.bench import Element, read_bench
from flflab.errors import MeasurementError
from flflab.measurement.sensor.noise import SensorNoise
from flflab.study import read_study
from flflab.verdict.properties.measured import measure_pictures

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(
    ("factor", "named"),
    [(1 / 10, "were centimetres and millimetres mixed up?"), (0.7, "1.43 times")],
)
def test_a_pitch_in_another_unit_is_named(factor: float, named: str) -> None:
    bench = read_bench(EXAMPLES / "benches" / "simulated.yaml")
    study = read_study(EXAMPLES / "studies" / "first.yaml", bench.optics)
    array = bench.optics.array
    mistaken = replace(
        bench.optics,
        array=replace(
            array,
            pitch=(array.pitch[0] * factor, array.pitch[1] * factor),
            aperture=array.aperture * factor,
        ),
        sensor=replace(bench.optics.sensor, resolution=(760, 560)),
    )
    rows, columns = np.indices((560, 760)) % 245.58
    white = 64.0 + 2000 * (np.hypot(rows - 122, columns - 122) < 90)
    worlds: dict[Element, float] = {
        "main_lens.z": 0.0,
        "array.z": 60.0,
        "sensor.z": 61.15,
        "target.z": -507.0,
    }
    noise = SensorNoise(0.34, 1.0, 64.0, 4095.0)
    with pytest.raises(MeasurementError, match=named) as refused:
        measure_pictures(
            {"white": white},
            {"white": noise},
            study.configurations[0],
            worlds,  # pyright: ignore[reportArgumentType]
            study,
            mistaken,
        )
    assert "its micro-images lie about 24" in str(refused.value)
