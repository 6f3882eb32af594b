"""What the report computes itself, against closed forms and brute force."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j1, jv

from flflab.bench import Bench
from flflab.measurement.lattice.registration import sensor_pixel
from flflab.optics.airy import airy_diameter, diffraction_contrast
from flflab.optics.focus import blur, magnification
from flflab.report import charts
from flflab.report.facts import (
    exact_counts,
    listed,
    pictured,
    z_statistics,
)
from flflab.report.frames import predicted_view_places, useful_outline
from flflab.report.quantities import quantity_of
from flflab.report.tables import comparison_tables, measured_number, to_decimals
from flflab.study import Study
from flflab.verdict.comparison import Row
from flflab.verdict.evaluation import JUDGED, Evaluation
from flflab.verdict.properties.predicted import predict
from flflab.verdict.sources import drawn_errors


def test_the_airy_diameter_of_the_worked_example_is_2_77_pixels_of_1_66_um(bench: Bench) -> None:
    camera = replace(bench.optics, sensor=replace(bench.optics.sensor, pixel=1.66e-3))
    assert airy_diameter(camera, 507.0) / 1.66e-3 == pytest.approx(2.77, abs=0.005)


def test_diffraction_leaves_the_contrast_of_two_discs_moved_apart(bench: Bench) -> None:
    # The transfer of a round pupil is the common area of two copies of it; w = 0.336 mm, b = 1.15
    # mm, 550 nm.
    x, y = np.meshgrid(np.linspace(-1, 1, 1501), np.linspace(-1, 1, 1501))
    pupil = np.hypot(x, y) <= 1
    for share in (0.0, 0.25, 0.5, 0.9):
        frequency = share * 0.336 / (550e-6 * 1.15) * bench.optics.sensor.pixel
        moved = np.hypot(x - 2 * share, y) <= 1
        common = np.count_nonzero(pupil & moved) / np.count_nonzero(pupil)
        assert float(diffraction_contrast(bench.optics, 507.0, frequency)) == pytest.approx(
            common, abs=2e-3
        )
    assert float(diffraction_contrast(bench.optics, 507.0, 100.0)) == 0


def test_the_predicted_contrast_has_the_fall_off_that_the_white_picture_shows(
    evaluation: Evaluation, bench: Bench, study: Study
) -> None:
    errors, first = drawn_errors(bench, 20, np.random.default_rng(0)), evaluation.measured[0]
    blurred = replace(first, worlds=first.worlds | {"target.z": -480.0})
    assert blurred.curve is not None
    camera = first.configuration.camera(bench.optics)
    middle = sensor_pixel(camera.sensor, np.zeros((1, 2)))  # where no tilt moves a lens
    on_axis = replace(first.lattice, centres_px=np.tile(middle, (len(first.lattice.indices), 1)))
    lattices = [replace(on_axis, fall_off=share) for share in (0.0, 1.0)]
    even, shaded = (
        predict(replace(blurred, lattice=lattice), study, bench, errors) for lattice in lattices
    )
    on_sensor = blurred.curve.cycles_per_mm / magnification(even.systems, even.vergences)[:, None]
    z = np.pi * blur(even.systems, even.vergences)[:, None] * on_sensor
    c = 1 - (1 + (even.systems.aperture / 2 / even.systems.gap) ** 2)[:, None] ** -2
    ratio = (1 - c + 2 * c * jv(2, z) / (z * j1(z))) / (1 - c / 2)
    assert np.abs(ratio - 1).max() > 1e-3
    assert shaded.contrast_draws / even.contrast_draws == pytest.approx(ratio, rel=1e-9)


def test_predicted_views_lie_where_straight_lines_through_the_microlenses_put_them(
    evaluation: Evaluation, study: Study
) -> None:
    one, model = evaluation.measured[0], evaluation.predicted[0]
    camera, distance = model.camera, model.distance
    image = 1 / (1 / camera.main_lens.focal_length - 1 / distance)
    point = study.dots.centres[1]
    indices, places = predicted_view_places(model, one.lattice, 1, point)
    assert len(indices) > 0
    crossing = -point * image / distance
    for index, place in zip(indices, places, strict=True):
        microlens = index * camera.array.pitch[0]
        landing = microlens + (microlens - crossing) * camera.gap / (camera.array.distance - image)
        # The lattice of these tests lies (1.5, -2) px off the middle.
        expected = (
            landing / camera.sensor.pixel + (np.array(camera.sensor.resolution) - 1) / 2 + [1.5, -2]
        )
        assert place == pytest.approx(expected, abs=1e-6)


def test_the_useful_outline_keeps_what_no_neighbour_lights(evaluation: Evaluation) -> None:
    one, model = evaluation.measured[0], evaluation.predicted[0]
    crowded = replace(
        one.lattice, vectors_px=one.lattice.vectors_px * 0.8, pitch_px=one.lattice.pitch_px * 0.8
    )
    reach = np.hypot(*np.array(useful_outline(crowded, model)).T)
    neighbours = crowded.pitch_px * np.array(
        [[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    )
    for angle, radius in zip(np.arange(len(reach)) * 2 * math.pi / len(reach), reach, strict=True):
        walk = np.linspace(0, crowded.outside_radius_px, 20001)[:, None] * [
            math.cos(angle),
            math.sin(angle),
        ]
        free = (
            np.hypot(*(walk[:, None, :] - neighbours[None]).transpose(2, 0, 1)).min(axis=1)
            >= crowded.outside_radius_px
        )
        clear = np.hypot(*walk[free.argmin()]) if not free.all() else math.inf
        assert radius <= clear + 0.01
    alone = np.hypot(
        *np.array(useful_outline(replace(crowded, vectors_px=crowded.vectors_px * 9), model)).T
    )
    assert np.ptp(alone) < 1e-9
    assert crowded.inside_radius_px < alone[0] < crowded.outside_radius_px
    assert reach.min() == pytest.approx(crowded.pitch_px - crowded.outside_radius_px)


def test_pooled_z_is_counted_over_all_rows_and_rows_without_uncertainty_are_told_apart(
    evaluation: Evaluation,
) -> None:
    template = next(row for row in evaluation.comparison.rows if row.quantity == "mtf")
    scores = [-3.0, 0.5, 1.0, 1.5, math.inf]
    rows: tuple[Row, ...] = tuple(replace(template, z=z) for z in scores)
    (found,) = z_statistics(rows)
    assert found.mean == 0
    assert found.deviation == pytest.approx(math.sqrt((9 + 0.25 + 1 + 2.25) / 3))
    assert found.beyond_two == 0.4
    assert found.unlimited == 1
    assert found.largest.z == math.inf


def test_only_equal_counts_are_exact(evaluation: Evaluation) -> None:
    rows = [row for row in evaluation.comparison.rows if row.quantity == "views"]
    assert exact_counts((*rows[:-1], replace(rows[-1], measured=rows[-1].measured + 1))) == (
        len(rows) - 1,
        len(rows),
    )


@pytest.mark.parametrize(
    ("value", "uncertainty", "shown"),
    [
        (245.581382, 0.000029, "245.581382(29)"),
        (79.3204, 0.00996, "79.320(10)"),
        (-0.28, 0.14, "-0.28(14)"),
        (1234.0, 56.0, "1234 ± 56"),
        (2.5, 0.0, "2.5"),
        (2.5, math.nan, "2.5"),
        (math.nan, 0.1, "-"),
    ],
)
def test_a_value_shows_its_uncertainty_in_its_last_two_digits(
    value: float, uncertainty: float, shown: str
) -> None:
    assert measured_number(value, uncertainty) == shown


@pytest.mark.parametrize(
    ("places", "words"),
    [
        ([3], "3"),
        ([0, 1], "0 and 1"),
        ([0, 2, 5, 6, 7, 9, 10], "0, 2, 5 to 7, 9 and 10"),
        ([4, 5, 6], "4 to 6"),
    ],
)
def test_configurations_in_a_row_are_told_as_a_range(places: list[int], words: str) -> None:
    assert listed(places) == words


def test_of_many_configurations_the_reference_the_ends_and_the_farthest_from_the_model_are_pictured(
    evaluation: Evaluation,
) -> None:
    one, line = evaluation.measured[0], evaluation.comparison.rows[0]
    many = tuple(
        replace(one, configuration=replace(one.configuration, index=index)) for index in range(30)
    )
    rows = tuple(
        replace(
            line,
            configuration=index,
            reference_configuration=None,
            z=-9.0 if index in (17, 21) else 0.1,
        )
        for index in range(30)
    )
    crowded = replace(
        evaluation, measured=many, comparison=replace(evaluation.comparison, rows=rows)
    )
    assert pictured(crowded, 4, most=5) == {4, 0, 29, 17, 21}
    assert pictured(evaluation, 0) == {one.configuration.index for one in evaluation.measured}


def test_a_table_rounds_to_the_uncertainty_in_the_unit_people_read(evaluation: Evaluation) -> None:
    line = evaluation.comparison.rows[0]
    field = replace(
        line,
        quantity="bright_field_mm",
        dot=None,
        measured=0.3185174,
        uncertainty=0.00022,
        predicted=0.31878,
        difference=-0.0002626,
        z=-1.19,
    )
    (table,) = comparison_tables((field,))
    assert table.caption == "bright field, \u00b5m: 1 row (bright_field_mm in comparison.csv)"
    assert table.rows == (("0", "318.52", "0.22", "318.78", "-0.26", "-1.19"),)
    (table,) = comparison_tables(
        (
            replace(
                line,
                quantity="views",
                measured=9,
                uncertainty=0.059,
                predicted=10,
                difference=-1,
                z=-17.0,
            ),
        )
    )
    assert table.rows == (("0", "0", "9", "0.059", "10", "-1", "-17.00"),)


def test_a_vanishing_mean_is_zero_without_a_sign_or_an_exponent() -> None:
    assert [to_decimals(value, 2) for value in (-1.1e-7, 0.0, -0.006, math.inf)] == [
        "0.00",
        "0.00",
        "-0.01",
        "infinity",
    ]


def test_every_quantity_of_a_comparison_has_words(evaluation: Evaluation) -> None:
    for name in {row.quantity for row in evaluation.comparison.rows} | {
        one.quantity for one in evaluation.values
    }:
        assert quantity_of(name).words != name
    assert quantity_of("difference_elr_row_px") == (
        "effective lateral resolution: difference",
        "px",
        1.0,
    )


def test_as_many_configurations_as_a_legend_holds_are_each_drawn_in_their_own_way() -> None:
    looks = [charts.look(place, charts.TELLABLE) for place in range(charts.TELLABLE)]
    assert len({look["marker"] for look in looks}) == charts.TELLABLE
    assert len({look["color"] for look in looks[:6]}) == 6


def test_every_quantity_that_is_judged_has_words() -> None:
    names = [name for quantities in JUDGED.values() for name in quantities]
    assert [name for name in names if quantity_of(name).words == name] == []
