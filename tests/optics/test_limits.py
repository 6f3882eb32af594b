# longer than 450 lines because hard cases stand together
"""The hard cases by name, against 50-digit arithmetic on the same doubles, with floating-point
errors raised; and properties of all.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flflab.errors import InputError
from flflab.optics.boundary import object_fields
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Substrate, Useful
from flflab.optics.contrast import contrast_paper, mtf_pixel, transfer
from flflab.optics.focus import (
    blur,
    depth_of_field,
    image_distance,
    magnification,
    marginal_angle,
    vergence_of,
    virtual_depth,
)
from flflab.optics.overlap import common_area
from flflab.optics.resolution import central_smms
from flflab.optics.smms import Smms, camera_smms, row_illumination
from flflab.optics.solution import (
    array_arrangement,
    distance_arrangement,
    solve_camera,
    solve_distance,
)
from flflab.optics.useful import in_useful, row_fields, sensor_fields
from flflab.optics.views import Views, row_views, sensor_views

Array = npt.NDArray[np.float64]
Build = Callable[..., Camera]
mp: Any = mpmath
UNIT = 2.0**-53


@pytest.fixture(autouse=True)
def floating_point_errors_raise() -> Iterator[None]:
    with np.errstate(all="raise", under="ignore"):
        yield


def smms_of(
    F: float = 50.0,
    A: float = 12.5,
    L: float = 60.0,
    b: float = 1.15,
    f: float = 0.917,
    d: float = 0.336,
    y: float = 0.0,
) -> Smms:
    return Smms(*(np.asarray(value, dtype=np.float64) for value in (F, A, L, b, f, d, y, 0.0)))


def exact(smms: Smms, vergence: float) -> dict[str, Any]:
    """The model in 50 digits, and with each result the sum of |terms| that its doubles round."""
    F, A, L, b, f, d, y = (
        mp.mpf(float(part))
        for part in (
            smms.lens_focal,
            smms.lens_aperture,
            smms.distance,
            smms.gap,
            smms.focal,
            smms.aperture,
            smms.centre_x,
        )
    )
    V = mp.mpf(vergence)
    kappa, x = 1 + b / L - b / f, L * (V - 1 / F + 1 / L)
    terms_kappa, terms_x = 1 + b / L + b / abs(f), L * (abs(V) + 1 / F + 1 / L)
    limiting = min(A, d / abs(x)) if x else A
    spread = abs(kappa) * terms_x + abs(x) * terms_kappa + b / L
    return {
        "kappa": (kappa, terms_kappa),
        "outside_radius": ((A * b / L + d * abs(kappa)) / 2, A * b / L + d * terms_kappa),
        "inside_radius": (abs(A * b / L - d * abs(kappa)) / 2, A * b / L + d * terms_kappa),
        "virtual_depth": (
            abs(x / (1 - x)) * L / b if x != 1 else mp.inf,
            (terms_x / abs(1 - x) + abs(x) * terms_x / (1 - x) ** 2) * L / b if x != 1 else 1,
        ),
        "blur": (
            abs(kappa * x - b / L) * limiting,
            spread * limiting + abs(kappa * x - b / L) * limiting * (terms_x / abs(x) if x else 1),
        ),
        "centre": (y * (1 + b / L), abs(y) * (1 + b / L)),
    }


def check(smms: Smms, vergence: float, *, near: float = 16) -> None:
    """Every value within ``near`` units of roundoff of the sum of its terms."""
    found = {
        "kappa": smms.kappa, "outside_radius": smms.outside_radius,
        "inside_radius": smms.inside_radius,
        "virtual_depth": virtual_depth(smms, vergence), "blur": blur(smms, vergence),
        "centre": smms.centre_x * smms.image_scale,
    }  # fmt: skip
    with mpmath.workdps(50):
        for name, (expected, terms) in exact(smms, vergence).items():
            value = float(found[name])
            assert not math.isnan(value), name
            if mp.isinf(expected):
                assert value > 1e14, name
            else:
                assert abs(mp.mpf(value) - expected) <= near * UNIT * terms, (
                    name,
                    value,
                    float(expected),
                )


IN_PUPIL = 60 * 0.917 / (60 - 0.917)


@pytest.mark.parametrize("off", [0.0, 1e-16, -1e-16, 1e-12, -1e-9, 1e-6])
def test_kappa_at_and_near_zero(off: float) -> None:
    for vergence in (0.0, 1 / 506.7, 1 / 300):
        check(smms_of(b=IN_PUPIL * (1 + off)), vergence)


@pytest.mark.parametrize("off", [0.0, 1e-16, -1e-12, 1e-8])
def test_w_zero_the_target_s_image_on_the_array(off: float) -> None:
    check(smms_of(), (1 / 50 - 1 / 60) * (1 + off))
    assert distance_arrangement(0.0) == "on the array"


def test_v_zero_the_target_at_infinity() -> None:
    check(smms_of(), 0.0)
    assert vergence_of(math.inf) == 0.0
    assert float(magnification(smms_of(), 0.0)) == 0.0


def test_a_target_in_the_front_focal_plane_is_imaged_to_infinity() -> None:
    smms = smms_of()
    assert float(image_distance(smms, 1 / 50)) > 1e15
    assert distance_arrangement(1.0) == "object in or inside the front focus"
    assert np.isfinite(blur(smms, 1 / 50))
    check(smms, 1 / 40)


def test_the_main_lens_s_image_one_microlens_focal_length_before_the_array() -> None:
    # a = f: the microlens makes its light parallel; the blur is the full width of the beam.
    image = 60 - 0.917
    vergence = 1 / 50 - 1 / image
    check(smms_of(), vergence)
    beam = min(12.5 * 0.917 / image, 0.336)
    assert float(blur(smms_of(), vergence)) == pytest.approx(beam, rel=1e-9)


def test_an_afocal_array_of_gap_one_focal_length() -> None:
    smms = smms_of(b=0.917)
    assert float(smms.kappa) == pytest.approx(0.917 / 60, rel=1e-13)
    check(smms, 1 / 506.7)


@pytest.mark.parametrize("gap", [1e-3, 1e-9, 1e-200])
def test_a_gap_towards_zero(gap: float) -> None:
    smms = smms_of(b=gap)
    check(smms, 1 / 506.7)
    assert float(blur(smms, 1 / 506.7)) == pytest.approx(0.336, rel=0.01)


@pytest.mark.parametrize(
    ("lens", "microlens"),
    [(1e-12, 0.336), (12.5, 1e-12), (1e-200, 0.336), (12.5, 1e-200), (1e-9, 1e-9)],
)
def test_pinholes_blur_nothing_and_are_counted_by_their_limits(
    lens: float, microlens: float
) -> None:
    smms = smms_of(A=lens, d=microlens)
    check(smms, 1 / 450)
    assert float(blur(smms, 1 / 450)) <= 2e-9
    pieces = depth_of_field(smms, 1.66e-3)
    assert pieces[0][0] == 0.0
    assert pieces[-1][1] > 1 / 50
    # A pinhole microlens blurs nothing but a target imaged onto the array itself.
    assert sum(after[0] - before[1] for before, after in itertools.pairwise(pieces)) < 1e-11
    camera = Camera(
        MainLens(50.0, 50.0 / lens),
        MicrolensArray("square", (25, 25), (0.4, 0.4), microlens, (0.917,), 60.0),
        Sensor((3664, 2748), 1.66e-3, 61.15), useful=Useful(0.5, 0.0),
    )  # fmt: skip
    seen = row_views(row_fields(camera), 1 / 506.7, 0.0)
    assert seen.chief == seen.total >= 1


@pytest.mark.parametrize("ulps", [-1, 0, 1])
def test_f_number_matching_to_the_last_bit(ulps: int) -> None:
    # A/L = d/b: both shadows on a sensor at b of a pinhole array are as wide.
    aperture = 0.336 / 1.15 * 60
    for _ in range(abs(ulps)):
        aperture = math.nextafter(aperture, math.inf * ulps)
    check(smms_of(A=aperture), 1 / 506.7)


@pytest.mark.parametrize("pitches", [1e3, 1e6])
def test_a_microlens_a_million_pitches_off_the_axis(pitches: float) -> None:
    smms = smms_of(y=0.4 * pitches)
    check(smms, 1 / 506.7)
    assert 0 < float(marginal_angle(smms)) < 1
    with mpmath.workdps(60):
        t, g = mp.mpf(float(smms.centre_x)) * mp.mpf(float(smms.gap)) / 60, mp.mpf(0.336) / 2
        expected = mp.atan((t + g) / mp.mpf(1.15)) - mp.atan((t - g) / mp.mpf(1.15))
        assert float(marginal_angle(smms)) == pytest.approx(float(expected), rel=1e-14, abs=0)


@pytest.mark.parametrize(
    ("radius1", "radius2", "distance", "area"),
    [
        (1.0, 2.0, 3.0, 0.0), (1.0, 2.0, 1.0, math.pi), (1.0, 2.0, 0.0, math.pi),
        (1.0, 1.0, 0.0, math.pi), (0.0, 1.0, 0.5, 0.0),
        (1.0, 1e9, 1e9 - 1, math.pi), (1.0, 1e9, 1e9 + 1, 0.0), (1.0, 1e9, 1e9, math.pi / 2),
    ],
)  # fmt: skip
def test_tangent_nested_and_unlike_discs(
    radius1: float, radius2: float, distance: float, area: float
) -> None:
    assert float(common_area(radius1, radius2, distance)) == pytest.approx(area, rel=1e-9)


def test_a_dot_on_a_view_s_edge_counts_as_inside(laboratory: Build) -> None:
    camera = laboratory(4.0)
    fields, row = sensor_fields(camera), row_fields(camera)
    edge = fields.centre[312] + np.array([fields.radius[312], 0.0])
    owner = np.array([312, 312])
    inside = in_useful(fields, owner, np.stack([edge, edge * (1 + 4e-16) + 1e-15]))
    assert inside.tolist() == [True, False]
    # The point whose chief ray lands on the edge of the useful interval of the microlens on the
    # axis.
    smms = central_smms(camera)
    vergence = 1 / 506.7
    m = -float(row.useful[12, 1]) * 60 / 1.15
    angle = m * (vergence - 1 / 50 + 1 / 60)
    exactly, beyond = row_views(row, vergence, angle), row_views(row, vergence, angle * (1 + 1e-9))
    assert exactly.chief == beyond.chief + 1
    assert float(smms.kappa) < 0


def test_bars_at_and_beyond_nyquist() -> None:
    u = np.array([0.5, np.nextafter(0.5, 1), 1.0, 1.5, 2.0, 1e6])
    found = contrast_paper(u)
    assert found[:4] == pytest.approx([1.0, 1.0, 0.0, 1 / 3], abs=1e-15)
    assert found[4:].tolist() == [0.0, 0.0]
    assert np.all(mtf_pixel(u) <= 2 / np.pi + 1e-15)
    smms = smms_of()
    assert np.all(np.isfinite(transfer(smms, 1 / 506.7, 1.66e-3, np.array([0.0, 10.0, 1e3, 1e6]))))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -1.0, 0.0])
@pytest.mark.parametrize(
    ("part", "field"),
    [
        ("main_lens", "focal_length"), ("main_lens", "f_number"), ("array", "aperture"),
        ("array", "distance"), ("sensor", "pixel"),
        ("sensor", "distance"),
    ],
)  # fmt: skip
def test_every_impossible_number_is_refused_with_its_field_and_value(
    part: str, field: str, value: float, laboratory: Build
) -> None:
    camera = laboratory()
    name = {"array": "microlens_array"}.get(part, part)
    with pytest.raises(InputError) as error:
        replace(camera, **{part: replace(getattr(camera, part), **{field: value})})
    assert f"{field} is {value:g}" in str(error.value)
    assert field in str(error.value)
    assert name in str(error.value) or part in str(error.value)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"pitch": (0.4, -0.4)}, "pitch y is -0.4"),
        ({"aperture": 0.5}, "aperture is 0.5 mm, wider than the 0.4 mm between neighbours"),
        (
            {"layout": "hexagonal", "pitch": (0.4, 0.3)},
            "aperture is 0.336 mm, wider than the 0.327872",
        ),
        ({"focal_lengths": (0.917, 0.0)}, "none of them 0"),
        ({"focal_lengths": (0.917, math.nan)}, "focal_lengths"),
        ({"count": (0, 25)}, "count is 0"),
        ({"pattern": ((0, 3),)}, "pattern must be rows of indices from 0 to 0"),
        ({"substrate": Substrate(-1.0, 1.5)}, "substrate.thickness is -1"),
        ({"substrate": Substrate(1.0, 0.5)}, "substrate.refractive_index is 0.5"),
        ({"roll": math.nan}, "roll is nan"),
        ({"offset": (math.inf, 0.0)}, "offset"),
    ],
)
def test_a_contradictory_array_is_refused(
    changes: dict[str, Any], says: str, laboratory: Build
) -> None:
    camera = laboratory()
    with pytest.raises(InputError, match=says.replace(".", r"\.")):
        replace(camera, array=replace(camera.array, **changes))


def test_an_array_tilted_into_the_sensor_is_refused(laboratory: Build) -> None:
    camera = laboratory()
    with pytest.raises(InputError, match="tilt"):
        camera_smms(replace(camera, array=replace(camera.array, tilt=(0.3, 0.0))))


@pytest.mark.parametrize(
    ("part", "changes", "meant"),
    [
        ("array", {"focal_lengths": (0.000917,)}, "focal_length is 0.000917 mm; was 0.917 mm"),
        ("array", {"focal_lengths": (0.9, 0.00095)}, "focal_length is 0.00095 mm; was 0.95 mm"),
        ("array", {"distance": 0.06}, "microlens_array.distance is 0.06 mm; was 60 mm"),
        (
            "array",
            {"pitch": (4e-4, 4e-4), "aperture": 3.36e-4},
            "microlens_array.pitch is 0.0004 mm; was 0.4 mm",
        ),
        ("sensor", {"distance": 61150.0}, "sensor.distance is 61150 mm; was 61.15 mm"),
        ("main_lens", {"focal_length": 50e3}, "main_lens.focal_length is 50000 mm; was 50 mm"),
        ("sensor", {"distance": 0.06115}, "lies behind the array; check the units of both"),
        ("array", {"pitch": (4e-4, 4e-4)}, "is allowed; check the units of both"),
    ],
)
def test_a_length_in_the_wrong_unit_is_refused_with_what_was_meant(
    part: str, changes: dict[str, Any], meant: str, laboratory: Build
) -> None:
    camera = laboratory()
    with pytest.raises(InputError) as error:
        replace(camera, **{part: replace(getattr(camera, part), **changes)})
    assert meant in str(error.value)


def test_a_camera_of_one_pixel_and_one_microlens_is_answered(laboratory: Build) -> None:
    camera = laboratory()
    tiny = replace(
        camera,
        array=replace(camera.array, count=(1, 1)),
        sensor=replace(camera.sensor, resolution=(1, 1)),
    )
    solution = solve_camera(tiny)
    assert solution.useful_pixels == (1, 1)
    target = solve_distance(tiny, 506.7, solution.useful_pixels, sensor_fields(tiny), solution.row)
    assert target.row_views == Views(1, 1, 1)
    assert array_arrangement(tiny) == "keplerian"


# Properties that hold for every camera.
CAMERAS = st.builds(
    lambda f_number, length, gap, aperture, minimum: Camera(
        MainLens(50.0, f_number),
        MicrolensArray("square", (25, 25), (0.4, 0.4), aperture, (0.917,), length),
        Sensor((3664, 2748), 1.66e-3, length + gap),
        useful=Useful(minimum, 0.0),
    ),
    st.floats(1.0, 32.0), st.floats(53.0, 70.0), st.floats(0.5, 1.6), st.floats(0.05, 0.4),
    st.floats(0.0, 0.9),
)  # fmt: skip


@settings(max_examples=40, deadline=None)
@given(CAMERAS, st.floats(200.0, 2000.0), st.floats(0.0, 8.0))
def test_mirrored_points_have_mirrored_views(
    camera: Camera, distance: float, height: float
) -> None:
    row, angle = row_fields(camera), height / distance
    assert row_views(row, 1 / distance, angle) == row_views(row, 1 / distance, -angle)


@pytest.mark.ci
@settings(max_examples=25, deadline=None)
@given(CAMERAS, st.floats(250.0, 1500.0), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
def test_the_lattice_s_symmetries_are_the_views_(
    camera: Camera, distance: float, x: float, y: float
) -> None:
    # A sensor wider than high shows more columns of micro-images than rows.
    fields = sensor_fields(replace(camera, sensor=replace(camera.sensor, resolution=(3664, 3664))))
    point = np.array([x, y]) / distance
    turned = [
        sensor_views(fields, 1 / distance, one)
        for part in (point, point[::-1])
        for one in (part, -part, part * [1, -1], part * [-1, 1])
    ]
    assert {(views.bright, views.chief) for views in turned} == {
        (turned[0].bright, turned[0].chief)
    }


@settings(max_examples=40, deadline=None)
@given(CAMERAS, st.floats(250.0, 1500.0), st.floats(-1.0, 1.0))
def test_a_shift_by_one_pitch_s_angle_shifts_the_views(
    camera: Camera, distance: float, height: float
) -> None:
    # A boundless array and sensor: the point p D/L further along is seen as often.
    wide = replace(
        camera,
        array=replace(camera.array, count=(201, 1)),
        sensor=replace(camera.sensor, resolution=(60000, 100)),
    )
    row, length = row_fields(wide), camera.array.distance
    angle = height / distance
    nearby = {row_views(row, 1 / distance, angle + step).chief for step in (0.0, 1e-12, -1e-12)}
    assert row_views(row, 1 / distance, angle + 0.4 / length).chief in nearby


@settings(max_examples=40, deadline=None)
@given(CAMERAS, st.floats(1.01, 4.0), st.floats(200.0, 2000.0))
def test_stopping_down_never_widens_fields_or_blur_nor_shortens_depth_of_field(
    camera: Camera, stop: float, distance: float
) -> None:
    closed = replace(
        camera, main_lens=replace(camera.main_lens, f_number=camera.main_lens.f_number * stop)
    )
    before, after = central_smms(camera), central_smms(closed)
    assert float(after.outside_radius) <= float(before.outside_radius)
    assert float(blur(after, 1 / distance)) <= float(blur(before, 1 / distance)) * (1 + 1e-15)
    offset = np.linspace(0, float(before.outside_radius), 50)
    lens_limits = float(before.lens_width) <= float(before.microlens_width)
    if not lens_limits and float(after.lens_width) >= float(after.microlens_width):
        assert np.all(row_illumination(after, offset) <= row_illumination(before, offset) + 1e-12)
    sharp = [
        vergence
        for vergence in np.linspace(0, 0.01, 200)
        if float(blur(before, vergence)) <= 1.66e-3
    ]
    pieces = depth_of_field(after, 1.66e-3 * (1 + 1e-9))
    assert all(any(low <= vergence <= high for low, high in pieces) for vergence in sharp)


@settings(max_examples=40, deadline=None)
@given(st.floats(1e-15, 1e-6), st.floats(0.0, 0.004))
def test_everything_is_continuous_through_kappa_w_and_v_of_zero(
    step: float, vergence: float
) -> None:
    steepest = 1e5 * step + 1e-11
    for low, high, at in (
        (smms_of(b=IN_PUPIL * (1 - step)), smms_of(b=IN_PUPIL * (1 + step)), (vergence, vergence)),
        (smms_of(), smms_of(), ((1 / 50 - 1 / 60) * (1 - step), (1 / 50 - 1 / 60) * (1 + step))),
        (smms_of(), smms_of(), (-step * 1e-3, step * 1e-3)),
    ):
        for property_of in (blur, virtual_depth):
            assert float(property_of(low, at[0])) == pytest.approx(
                float(property_of(high, at[1])), abs=steepest
            )
        assert float(low.outside_radius) == pytest.approx(float(high.outside_radius), abs=steepest)
        none = np.array([-0.1, 0.1])
        for name in ("bright", "total"):
            one, other = (
                getattr(object_fields(smms, none, v), name)
                for smms, v in ((low, at[0]), (high, at[1]))
            )
            assert one == pytest.approx(other, abs=steepest)
