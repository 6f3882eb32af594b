"""Sensitivities against differences of the model, yields against closed forms."""

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from flflab.design.dual import Dual, dimensions
from flflab.design.figures import half_seen
from flflab.design.grid import Candidates, candidates, make_grid
from flflab.design.requirements import Requirements
from flflab.design.search import chosen, search
from flflab.design.tolerances import DIMENSIONS, built_yield, sensitivities
from flflab.optics.configurations import Configurations, solve_configurations

Wanted = Callable[..., Requirements]
ALL: dict[str, str] = {
    "gap": "10 um", "tilt": "0.2 deg", "array_distance": "50 um", "focal_length": "1 %",
    "aperture": "1 %", "pitch": "0.1 %",
    "main_lens_focal_length": "0.5 %", "f_number": "3 %",
}  # fmt: skip


@pytest.fixture
def found(wanted: Wanted) -> tuple[Requirements, Candidates]:
    asked = wanted(tolerances=ALL)
    grid = make_grid(asked)
    lens, focus, place = (
        3,
        2,
        len(grid.places) // 2,
    )  # not in focus in the middle of the depth, where the blur has a corner
    number = int(np.ravel_multi_index((0, 0, lens, focus, place), grid.shape))
    return asked, candidates(grid, number, number + 1)[0]


def test_derivatives_of_numpys_functions_are_those_of_the_textbook() -> None:
    given: list[Any] = list(dimensions([0.7, 1.9]))
    x, y = given
    cases: list[tuple[Any, tuple[float, float]]] = [
        (x * y + x / y - y, (1.9 + 1 / 1.9, 0.7 - 0.7 / 1.9**2 - 1)),
        (np.abs(x - y), (-1, 1)),
        (np.minimum(x, y) + 3 * np.maximum(x, y), (1, 3)),
        (np.sqrt(y) + np.arctan(x), (1 / 1.49, 0.5 / math.sqrt(1.9))),
        (np.cos(x) * np.sin(y), (-math.sin(0.7) * math.sin(1.9), math.cos(0.7) * math.cos(1.9))),
        (np.exp(x) + np.log(y) + x**3, (math.exp(0.7) + 3 * 0.49, 1 / 1.9)),
        (np.sinc(x),
        (math.cos(0.7 * math.pi) / 0.7 - math.sin(0.7 * math.pi) / (math.pi * 0.49), 0)),
        (np.where(x < y, x, y), (1, 0)),
    ]  # fmt: skip
    for result, slope in cases:
        assert isinstance(result, Dual)
        assert result.slope[0].tolist() == pytest.approx(slope, rel=1e-12, abs=1e-15)


def test_every_sensitivity_is_the_difference_of_the_model(
    found: tuple[Requirements, Candidates],
) -> None:
    asked, given = found
    near, far = asked.measure.depth
    base: dict[str, Any] = {
        "gap": given.gap[0], "array_distance": given.place[0], "focal_length": given.focal[0],
        "aperture": given.aperture[0],
        "pitch": given.pitch[0], "main_lens_focal_length": given.lens_focal[0],
        "f_number": given.f_number[0],
    }  # fmt: skip

    def model(numbers: dict[str, float]) -> dict[str, float]:
        solved = solve_configurations(
            Configurations(
                numbers["main_lens_focal_length"], numbers["f_number"], numbers["array_distance"],
                numbers["gap"], numbers["focal_length"],
                numbers["pitch"], numbers["aperture"], 2 * near * far / (near + far),
                cycles_per_mm=4.0,
            )
        )  # fmt: skip
        names = {field.name for field in fields(solved)}
        found = {
            name: float(getattr(solved, name))
            for name in ("virtual_depth", "magnification", "contrast")
            if name in names
        }
        blur, width = 1e3 * float(solved.blur), 1e3 * float(solved.useful_width)
        return found | {
            "blur": blur,
            "useful_width": width,
            "sharp_distance": 1 / float(solved.sharp_vergence),
        }

    steps = {"gap": 0.01, "array_distance": 0.05} | {
        name: float(ALL[name].split()[0]) / 100 * base[name]
        for name in base
        if name not in ("gap", "array_distance")
    }
    for row in sensitivities(given, asked):
        if row.name not in model(base):
            continue
        by: dict[str, float] = dict(zip(DIMENSIONS, row.per_tolerance, strict=True))
        for name, value in base.items():
            h = 1e-5 * value
            slope = (
                model(base | {name: value + h})[row.name]
                - model(base | {name: value - h})[row.name]
            ) / (2 * h)
            assert by[name] == pytest.approx(slope * steps[name], rel=1e-4, abs=1e-7), (
                row.name,
                name,
            )
        lifted = math.radians(0.2) * float(half_seen(given)[0])
        assert by["tilt"] == pytest.approx(
            lifted * (by["array_distance"] / 0.05 - by["gap"] / 0.01), rel=1e-9, abs=1e-12
        )


def test_without_tolerances_every_camera_built_is_good(wanted: Wanted) -> None:
    asked = wanted(tolerances={})
    given = chosen(make_grid(asked), search(asked).front.numbers)[0]
    built = built_yield(given, asked, 500)
    assert (built.share, built.halved, built.buys_most) == (1.0, {}, None)


def test_the_yield_of_one_tolerance_is_the_share_of_its_range_that_passes(wanted: Wanted) -> None:
    asked = wanted(
        require={"views": 1, "blur_px": 40, "marginal_angle": "1 deg"},
        maximise=["light"],
        measure={"depth": ["280 mm", "320 mm"]},
        tolerances={},
    )
    given = chosen(make_grid(asked), search(asked).front.numbers)[0]
    light = 2 * math.atan(
        given.aperture[0] / 2 / given.gap[0]
    )  # the microlens limits: the angle falls as the gap grows
    strict = asked.model_copy(
        update={
            "require": asked.require.model_copy(update={"marginal_angle": light * 0.998}),
            "tolerances": asked.tolerances.model_copy(update={"gap": 0.01}),
        }
    )
    passes = given.aperture[0] / 2 / math.tan(light * 0.998 / 2) - given.gap[0]
    share = 0.5 + passes / 0.02
    built = built_yield(given, strict)
    assert 0.5 < share < 1
    assert built.share == pytest.approx(share, abs=4 * built.uncertainty)
    assert built.halved["gap"] == pytest.approx(0.5 + passes / 0.01, abs=5 * built.uncertainty)
    assert built.buys_most == "gap"


def test_both_edges_of_a_tilted_array_count(wanted: Wanted) -> None:
    asked = wanted(tolerances=ALL)
    given = chosen(make_grid(asked), search(asked).front.numbers)[0]
    only = asked.tolerances.model_copy(update={name: 0.0 for name in DIMENSIONS if name != "tilt"})
    shares = [
        built_yield(
            given,
            asked.model_copy(update={"tolerances": only.model_copy(update={"tilt": tilt})}),
            4000,
        ).share
        for tilt in (1e-5, 1e-3, 1e-2)
    ]
    assert shares[0] >= shares[1] >= shares[2]
    assert shares[2] < shares[0] == 1
