"""A million configurations in one call give what one camera at a time gives."""

import tracemalloc
from dataclasses import fields, replace

import numpy as np
import pytest

from flflab.errors import InputError
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful
from flflab.optics.configurations import (
    ARRANGEMENTS,
    Configurations,
    Properties,
    solve_configurations,
)
from flflab.optics.contrast import transfer
from flflab.optics.focus import depth_of_field
from flflab.optics.resolution import central_smms
from flflab.optics.solution import solve_camera, solve_distance
from flflab.optics.useful import sensor_fields


def stratified(number: int, seed: int = 7) -> Configurations:
    rng = np.random.Generator(np.random.Philox(key=seed))
    return Configurations(
        50.0, rng.uniform(1.6, 16, number), rng.uniform(54, 62, number),
        rng.uniform(0.6, 1.4, number), 0.917, 0.4,
        rng.uniform(0.1, 0.4, number), rng.uniform(250, 900, number), 1.66e-3, 25, 3664, 0.5, 2.0,
    )  # fmt: skip


def test_every_property_is_that_of_the_camera_solved_alone() -> None:
    given = stratified(60)
    found = solve_configurations(given)
    for i in range(60):
        f_number, length, gap, aperture, distance = (
            float(np.asarray(part)[i])
            for part in (
                given.f_number,
                given.array_distance,
                given.gap,
                given.aperture,
                given.distance,
            )
        )
        camera = Camera(
            MainLens(50.0, f_number),
            MicrolensArray("square", (25, 1), (0.4, 0.4), aperture, (0.917,), length),
            Sensor((3664, 2748), 1.66e-3, length + gap),
            useful=Useful(0.5, 0.0),
        )
        alone = solve_camera(camera)
        target = solve_distance(
            camera, distance, alone.useful_pixels, sensor_fields(camera), alone.row
        )
        smms = central_smms(camera)
        assert ARRANGEMENTS[int(found.arrangement[i])] == alone.arrangement
        if alone.sharp_distance is None:
            assert found.sharp_vergence[i] < 0
        else:
            assert 1 / found.sharp_vergence[i] == pytest.approx(alone.sharp_distance, rel=1e-9)
        middle = alone.row.useful[12]
        assert found.overlap[i] == pytest.approx(alone.overlap, rel=1e-9, abs=1e-12)
        assert found.useful_width[i] == pytest.approx(
            0.0 if np.isnan(middle[0]) else float(np.ptp(middle)), rel=1e-9, abs=1e-12
        )
        assert found.virtual_depth[i] == pytest.approx(target.virtual_depth, rel=1e-9)
        assert found.magnification[i] == pytest.approx(target.magnification, rel=1e-9)
        assert found.blur[i] == pytest.approx(target.blur, rel=1e-9, abs=1e-12)
        pieces = depth_of_field(smms, 1.66e-3)
        if alone.sharp_distance is not None:
            sharp = 1 / alone.sharp_distance
            low, high = next(piece for piece in pieces if piece[0] <= sharp <= piece[1])
            assert (found.far_vergence[i], found.near_vergence[i]) == pytest.approx(
                (low, high), rel=1e-9, abs=1e-15
            )
        assert found.useful_pixels[i] == alone.useful_pixels[0]
        assert found.elr[i] == pytest.approx(target.resolution[0], rel=1e-9)
        by_views = target.resolution_by_views[0]
        assert found.elr_by_views[i] == pytest.approx(
            np.inf if by_views is None else by_views, rel=1e-9
        )
        assert found.views[i] == target.row_views.chief
        expected = abs(float(transfer(smms, 1 / distance, 1.66e-3, np.asarray(2.0))))
        assert found.contrast[i] == pytest.approx(expected, abs=1e-12)
        nearest = alone.stereo.nearest
        if nearest is not None and nearest > 0:
            assert 1 / found.stereo_near[i] == pytest.approx(nearest, rel=1e-9)
        elif nearest is None:
            assert found.stereo_near[i] == 0
        if alone.stereo.farthest is not None:
            assert 1 / found.stereo_far[i] == pytest.approx(alone.stereo.farthest, rel=1e-9)


def test_nothing_is_nan_at_the_edges_of_the_range() -> None:
    in_pupil = 60 * 0.917 / (60 - 0.917)
    for distance in (np.inf, 50.0, 300.0, 1e-3, 49.0):
        for gap in (in_pupil, 0.917, 1e-9, 1.15):
            found = solve_configurations(
                Configurations(
                    50.0, np.array([1e-3, 4.0, 1e9]), 60.0, gap, 0.917, 0.4, 0.336, distance
                )
            )
            for field in fields(Properties):
                assert not np.isnan(getattr(found, field.name)).any(), (field.name, distance, gap)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("gap", -1.0),
        ("f_number", np.nan),
        ("pitch", 0.0),
        ("distance", -5.0),
        ("lens_focal", np.inf),
    ],
)
def test_an_impossible_configuration_is_refused_by_field_and_value(
    field: str, value: float
) -> None:
    with pytest.raises(InputError, match=rf"{field} is {value:g}"):
        solve_configurations(replace(stratified(3), **{field: np.array([1.0, value, 1.0])}))


@pytest.mark.ci
def test_a_million_configurations_take_little_memory() -> None:
    given = stratified(1_000_000)
    solve_configurations(stratified(1000))
    tracemalloc.start()
    solve_configurations(given, threads=2)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 2**29
