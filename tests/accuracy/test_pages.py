"""The pages' words follow the figures: made from rows and sweeps whose answers are known."""

from dataclasses import replace

import numpy as np

from flflab.accuracy.image import GRID, RANDOM, RENDER
from flflab.accuracy.image_page import image_page, image_summary
from flflab.accuracy.lenses import DOUBLE_GAUSS
from flflab.accuracy.model import F_NUMBERS, FIELDS, LINES, QUANTITIES, TYPICAL, Comparison, Sweep
from flflab.accuracy.model_page import model_page, model_table
from flflab.accuracy.thick_camera import Setting
from flflab.accuracy.work_precision import Row

PLAIN = Row("dim", RENDER, 0.003, None, 0.002, 0.001, None, 1e-6, 0.01, 0.01, 3, 0.1, 100_000, 10.0)


def rows() -> list[Row]:
    rays = [
        replace(
            PLAIN,
            method=method,
            requested=None,
            work=float(n),
            rms_error=n**-0.5,
            largest_error=3 * n**-0.5,
            processor_s=1e-5 * n,
            pixels=10,
        )
        for method in (RANDOM, GRID)
        for n in (100, 10_000)
    ]
    return [PLAIN, replace(PLAIN, requested=0.001, rms_error=0.0005), *rays]


def test_the_image_page_says_how_many_tolerances_were_kept_and_what_random_rays_would_take() -> (
    None
):
    page = image_page(rows(), "made here")
    assert page.answers[0] == "Render kept 2 of the 2 tolerances requested."
    # 0.1 s for a million pixels; random rays: 1 s n for a million pixels, n = 1e6 for an error of
    # 0.001
    assert "a million lit pixels take 0.1 s and have an rms error of 0.001" in page.answers[1]
    assert "10,000,000 times as long" in page.answers[1]
    assert "power -0.50" in page.sections[0].pictures[0].says
    assert len(image_summary(rows()).rows) == len(rows())


def test_the_image_page_names_the_scene_and_the_tolerance_that_was_exceeded() -> None:
    page = image_page([*rows(), replace(PLAIN, requested=1e-4, rms_error=0.0004)], "made here")
    assert page.answers[0] == "Render kept 2 of the 3 tolerances requested; dim exceeds 0.0001."
    asked, estimated = page.sections[1].pictures
    assert "one picture is further off than requested, at most 4 times as far" in asked.says
    assert estimated.says == "Nothing was estimated."


def sweeps() -> tuple[Sweep, ...]:
    """Every quantity leaves first order in proportion to the field height and reaches its limit at
    5 mm; along lines it never does.
    """

    def compared(excess: np.ndarray) -> dict[str, Comparison]:
        return {
            one.name: Comparison(0 * excess, 0.01 * excess, np.full_like(excess, 0.01))
            for one in QUANTITIES
        }

    over = Setting(DOUBLE_GAUSS, F_NUMBERS[:, None], FIELDS[None, :])
    maps = Sweep(
        "one",
        ("f_number", "field"),
        over,
        compared(np.broadcast_to(FIELDS / 5, (len(F_NUMBERS), len(FIELDS)))),
    )
    lines = [
        Sweep(
            "one",
            (varied,),
            replace(TYPICAL, **{varied: values}),
            compared(np.full(len(values), 0.5)),
        )
        for varied, values in LINES.items()
    ]
    return (maps, *lines)


def test_the_model_page_says_how_far_first_order_holds() -> None:
    for row in model_table(sweeps()).rows:
        assert row[2:6] == ("5.0",) * 4
    page = model_page(sweeps(), "made here")
    assert (
        "at F/4 first order holds up to this field height in mm: one 5.0. The largest difference on"
        " the maps is 2 %" in (page.sections[0].pictures[0].says)
    )
    assert (
        "holds over the whole range for micro-image centre, outside radius"
        in page.sections[1].pictures[0].says
    )
    assert f"{100 * np.mean(FIELDS <= 5):.0f} %" in page.answers[2]
