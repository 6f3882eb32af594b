"""The search against single cameras solved one by one, and against enumeration."""

import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from flflab.design.camera_text import camera_text
from flflab.design.chunk_log import ChunkLog, fingerprint
from flflab.design.figures import objectives, solve_figures
from flflab.design.grid import candidates, make_grid
from flflab.design.judgement import demands
from flflab.design.refine import refine
from flflab.design.requirements import Requirements
from flflab.design.search import chosen, hindrance, search
from flflab.errors import InputError
from flflab.files.camera import read_camera
from flflab.optics.camera import Camera
from flflab.optics.solution import CameraSolution, DistanceSolution, solve_camera, solve_distance
from flflab.optics.useful import sensor_fields

Wanted = Callable[..., Requirements]


def solved(camera: Camera, *distances: float) -> tuple[CameraSolution, list[DistanceSolution]]:
    """One camera by the model that looks at each microlens and pixel."""
    fields = sensor_fields(camera)
    whole = solve_camera(camera, fields)
    return whole, [
        solve_distance(camera, distance, whole.useful_pixels, fields, whole.row)
        for distance in distances
    ]


def undominated(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> set[int]:
    found: set[int] = set()
    for index, point in enumerate(values):
        if not ((values >= point).all(axis=1) & (values > point).any(axis=1)).any():
            found.add(index)
    return found


@pytest.mark.ci
def test_every_configuration_is_sharp_where_it_says_and_has_the_figures_of_its_camera(
    wanted: Wanted, tmp_path: Path
) -> None:
    asked = wanted()
    grid = make_grid(asked)
    near, far = asked.measure.depth
    for number in np.random.default_rng(0).integers(0, grid.size, 60):
        found = candidates(grid, int(number), int(number) + 1)
        if not found:
            continue
        file = tmp_path / "camera.yaml"
        file.write_text(
            camera_text(found[0], grid.lenses[int(found[0].lens[0])][0], asked, "a test"),
            encoding="utf-8",
        )
        camera = read_camera(file)
        whole, ends = solved(camera, near, far)
        focus = grid.focus[(int(number) // len(grid.places)) % len(grid.focus)]
        assert whole.sharp_distance == pytest.approx(focus, rel=2e-4)  # the file's nanometres
        figures = solve_figures(found[0], asked)
        assert figures.blur_px[0] == pytest.approx(
            max(end.blur for end in ends) / camera.sensor.pixel, rel=2e-3, abs=1e-3
        )
        assert figures.resolution[0] == pytest.approx(
            camera.sensor.pixel / min(end.magnification for end in ends), rel=1e-4
        )
        assert figures.views[0] in (min(end.row_views.chief for end in ends), 0)


def test_the_front_of_a_hundred_thousand_is_exact_every_point_of_it(wanted: Wanted) -> None:
    asked = wanted(search={"configurations": 100_000, "focus_steps": 25, "epsilon": 0})
    grid = make_grid(asked)
    found = search(asked)
    numbers, values = list[int](), list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]]()
    for given in candidates(grid, 0, grid.size):
        figures = solve_figures(given, asked)
        good = (
            (figures.views >= 2)
            & (figures.blur_px <= 5)
            & (figures.width >= 15)
            & (figures.resolution <= 0.065)
            & (figures.contrast >= 0.2)
            & (figures.light >= math.radians(8))
        )
        numbers += given.number_in_grid[good].tolist()
        values += list(objectives(given.kept(good), asked, figures.kept(good)))
    assert found.met == len(numbers) > 0
    assert found.front.numbers.tolist() == sorted(
        numbers[index] for index in undominated(np.array(values))
    )
    assert found.tried == grid.size


def test_the_objectives_are_those_of_the_camera(wanted: Wanted, tmp_path: Path) -> None:
    asked = wanted()
    grid = make_grid(asked)
    given = chosen(grid, search(asked).front.numbers)[0]
    file = tmp_path / "camera.yaml"
    file.write_text(
        camera_text(given, grid.lenses[int(given.lens[0])][0], asked, "a test"), encoding="utf-8"
    )
    camera = read_camera(file)
    near, far = asked.measure.depth
    whole, (middle,) = solved(camera, 2 * near * far / (near + far))
    area, elr, contrast, light = objectives(given, asked, solve_figures(given, asked))[0]
    assert elr == pytest.approx(middle.resolution[0], rel=2e-3)
    assert light == pytest.approx(whole.marginal_angles[len(whole.marginal_angles) // 2], rel=1e-5)
    assert 0.2 <= contrast <= 1
    depth = next(
        high - low for low, high in whole.depth_of_field if low < near * 1.1 and high > near
    )
    assert area == pytest.approx(
        depth * 17.5, rel=0.5
    )  # as wide as what is seen with all views there


def test_what_hinders_is_what_enumeration_finds(wanted: Wanted) -> None:
    asked = wanted(
        require={"views": 2, "blur_px": 4, "resolution": "60 um"}, maximise=["area", "elr"]
    )
    grid = make_grid(asked)
    assert search(asked).met == 0
    why = hindrance(asked)
    blurs, resolutions, worst = list[float](), list[float](), list[float]()
    for given in candidates(grid, 0, grid.size):
        figures = solve_figures(given, asked)
        enough, sharp, fine, wide = (
            figures.views >= 2,
            figures.blur_px <= 4,
            figures.resolution <= 0.06,
            figures.width >= 15,
        )
        blurs += figures.blur_px[enough & fine & wide].tolist()
        resolutions += figures.resolution[enough & sharp & wide].tolist()
        short = [
            figures.views / 2 - 1,
            1 - figures.blur_px / 4,
            1 - figures.resolution / 0.06,
            figures.width / 15 - 1,
        ]
        worst += np.min(short, axis=0).tolist()
    alone = {demand.name: value for demand, value in why.alone}
    assert alone["blur"] == pytest.approx(min(blurs))
    assert alone["resolution"] == pytest.approx(min(resolutions))
    missed = min(
        (1 if demand.least else -1) * (value / demand.limit - 1) for demand, value in why.misses
    )
    assert missed == pytest.approx(max(worst))


@pytest.mark.ci
def test_refinement_gains_and_still_meets_every_demand(wanted: Wanted) -> None:
    asked = wanted()
    grid = make_grid(asked)
    found = search(asked)
    weights = np.array([1.0, 0, 0, 0])
    start = chosen(grid, found.front.numbers[[int(np.argmax(found.front.values[:, 0]))]])[0]
    better = refine(start, grid, asked, weights)
    assert better.gain >= 0
    assert better.values[0] >= found.front.values[:, 0].max() * (1 - 1e-12)
    figures = solve_figures(better.given, asked)
    for demand in demands(asked):
        value = float(getattr(figures, demand.figure)[0])
        assert (
            value >= demand.limit * (1 - 1e-6)
            if demand.least
            else value <= demand.limit * (1 + 1e-6)
        )


def test_an_interrupted_search_goes_on_where_it_was(
    wanted: Wanted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flflab.design.search.CHUNK", 3000)
    asked, log = wanted(), tmp_path / "search.jsonl"
    whole = search(asked)

    def stop(done: int, total: int) -> None:
        if done >= total / 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search(asked, log, stop)
    lines = log.read_text(encoding="utf-8")
    log.write_text(lines + lines[:40], encoding="utf-8")  # the power went while a line was written
    done_before = len(ChunkLog(log, fingerprint(asked)).done)
    seen = list[int]()
    again = search(asked, log, lambda done, total: seen.append(done))
    assert done_before > 0
    assert len(seen) + done_before == math.ceil(make_grid(asked).size / 3000)
    assert again.front.numbers.tolist() == whole.front.numbers.tolist()
    assert (again.tried, again.built, again.met) == (whole.tried, whole.built, whole.met)


@pytest.mark.skipif(sys.platform == "win32", reason="limits the size of files the POSIX way")
def test_a_log_that_the_disk_does_not_take_is_told_in_a_sentence_and_gone_on_with(
    wanted: Wanted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import resource

    monkeypatch.setattr("flflab.design.search.CHUNK", 3000)
    asked, log = wanted(), tmp_path / "search.jsonl"
    whole = search(asked, log)
    size = log.stat().st_size
    log.unlink()
    limit, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size // 2, hard))
    try:
        with pytest.raises(
            InputError,
            match=(
                r"search\.jsonl: the log of the search cannot be written \(File too large\); make"
                r" room"
            ),
        ):
            search(asked, log)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    assert len(ChunkLog(log, fingerprint(asked)).done) > 0
    assert search(asked, log).front.numbers.tolist() == whole.front.numbers.tolist()


def test_the_log_of_another_search_is_refused(wanted: Wanted, tmp_path: Path) -> None:
    log = tmp_path / "search.jsonl"
    search(wanted(), log)
    with pytest.raises(InputError, match="other requirements"):
        search(wanted(maximise=["elr"]), log)
    log.write_text("no log\n", encoding="utf-8")
    with pytest.raises(InputError, match="no log of a search"):
        search(wanted(), log)
