"""Numbers of other people's models: libpleno (and BLADE, PRISM), LFCamExplore, PlenoptiSign; each
test names its source.
"""

import math

import numpy as np
import pytest

from flflab.optics.focus import magnification, sharp_vergence, virtual_depth
from flflab.optics.smms import Smms, object_crossing, sensor_crossing


def r12a_as_initialised() -> Smms:
    """libpleno, plenoptic.cpp init (Galilean) with F = 50, h = 450, m = 0.1405955..., distances
    computed by its formulas.
    """
    focal, total, m = 50.0, 450.0, 0.14059554040431976
    hyperfocal = total / 2 * (1 - math.sqrt(1 - 4 * focal / total))
    gap = 2 * m * hyperfocal / (focal + 4 * m)
    length = hyperfocal - 2 * gap
    numbers = (focal, 12.5, length, gap, 0.55, 0.1275, 0.0, 0.0)
    return Smms(*(np.asarray(number) for number in numbers))


def test_the_initialised_distances_are_the_published_ones() -> None:
    smms = r12a_as_initialised()
    assert float(smms.gap) == pytest.approx(0.31863244257046275, rel=1e-12)
    assert float(smms.distance) == pytest.approx(56.65763680237485, rel=1e-12)
    pitch = 0.12822163189288707 / float(smms.image_scale)
    assert pitch == pytest.approx(0.12750456894191076, rel=1e-12)


# Object distance from the main lens, mm, and virtual depth by libpleno's definition.
VIRTUAL_DEPTHS = [
    (350, 5.259027), (360, 4.415367), (370, 3.624437), (380, 2.881442), (390, 2.182152),
    (395, 1.847709), (400, 1.522822),
    (392.705098, 2.0), (408.357728, 1.0), (378.362618, 3.0), (365.172403, 4.0), (341.734640, 6.0),
    (321.541485, 8.0), (303.962804, 10.0),
]  # fmt: skip


@pytest.mark.parametrize(("distance", "depth"), VIRTUAL_DEPTHS)
def test_virtual_depth_agrees_with_libpleno(distance: float, depth: float) -> None:
    assert float(virtual_depth(r12a_as_initialised(), 1 / distance)) == pytest.approx(
        depth, abs=6e-7
    )


def test_an_object_at_the_total_distance_has_virtual_depth_two() -> None:
    smms = r12a_as_initialised()
    focal, total = 50.0, 450.0
    hyperfocal = total / 2 * (1 - math.sqrt(1 - 4 * focal / total))
    assert float(virtual_depth(smms, 1 / (total - hyperfocal))) == pytest.approx(2.0, rel=1e-10)


@pytest.mark.parametrize(
    ("total", "m", "image_pitch", "scale", "lens_pitch"),
    [
        (450.0, 0.14059554040431976, 0.12822163189288707, 0.9944076288814097, 0.12750456894191076),
        (1000.0, 0.15859550120303031, 0.12828812917241653, 0.9936961703130269, 0.12747942265525322),
    ],
    ids=["libpleno examples/config/params.js (R12-A)", "BLADE examples/params.js (R12)"],
)
def test_libpleno_s_lens_pitch_follows_from_the_pitch_of_the_micro_images(
    total: float, m: float, image_pitch: float, scale: float, lens_pitch: float
) -> None:
    hyperfocal = total / 2 * (1 - math.sqrt(1 - 200.0 / total))
    gap = 2 * m * hyperfocal / (50.0 + 4 * m)
    smms = Smms(
        *(
            np.asarray(number)
            for number in (50.0, 12.5, hyperfocal - 2 * gap, gap, 0.55, 0.1275, 0.0, 0.0)
        )
    )
    assert 1 / float(smms.image_scale) == pytest.approx(scale, rel=1e-12)
    assert image_pitch / float(smms.image_scale) == pytest.approx(lens_pitch, rel=1e-12)


def test_prism_s_standard_camera_has_its_pitch_on_the_sensor() -> None:
    # PRISM examples/camera.js (UPC-S): lens pitch 0.02 mm, pixel 1.4 um; the file says 14.343866357
    # pixels.
    length, sensor = 9.847916429, 9.888003801
    smms = Smms(
        *(
            np.asarray(number)
            for number in (9.8, 5.0, length, sensor - length, sensor - length, 0.02, 0.0, 0.0)
        )
    )
    assert 0.02 * float(smms.image_scale) / 1.4e-3 == pytest.approx(14.343866357, rel=1e-10)
    assert float(smms.kappa) == pytest.approx(float(smms.gap) / length, rel=1e-9)


@pytest.mark.parametrize(
    ("f_number", "focal", "radius"),
    [
        (4.0, 0.5781538, 11.6590), (4.0, 0.5044562, 10.7257), (4.0, 0.5516665, 11.3523),
        (8.0, 0.5781538, 8.4636), (8.0, 0.5044562, 7.5304), (8.0, 0.5516665, 8.1569),
    ],
)  # fmt: skip
def test_the_total_field_is_libpleno_s_micro_image_radius(
    f_number: float, focal: float, radius: float
) -> None:
    # libpleno internals.h: R = (m/N + q_i)/scale, with pixels of 5.5 um; its sign is the other way
    # round.
    base = r12a_as_initialised()
    smms = Smms(base.lens_focal, np.asarray(50 / f_number), base.distance, base.gap,
    np.asarray(focal),
                np.asarray(0.12750456894191076), base.centre_x, base.centre_y)  # fmt: skip
    assert float(smms.outside_radius) / 5.5e-3 == pytest.approx(radius, abs=2e-4)


def test_lfcamexplore_s_keplerian_camera_comes_out() -> None:
    # LFCamExplore, ToyPlen2 (R = 4): SolveLensPositions.m and SolveCamPerformance.m, in mm.
    focal, small, ratio, total, pixel, pitch = 12.0, 0.070, 4.0, 1000.0, 4e-3, 0.020
    gap = small * (1 + ratio) / ratio
    image = (ratio + 1) * gap
    total_lens = (image + total - math.sqrt((total - image) ** 2 - 4 * focal * (total - image))) / 2
    assert (gap, image, total_lens) == pytest.approx((0.0875, 0.4375, 12.585129490), rel=1e-9)
    aperture = pitch / gap * (total_lens - gap)
    assert aperture == pytest.approx(2.856601026, rel=1e-9)
    smms = Smms(
        *(
            np.asarray(number)
            for number in (focal, aperture, total_lens - gap, gap, small, pitch, 0.0, 0.0)
        )
    )
    sharp = float(sharp_vergence(smms))
    assert 1 / sharp + total_lens == pytest.approx(total, rel=1e-9)
    assert float(virtual_depth(smms, sharp)) == pytest.approx(ratio, rel=1e-9)
    assert pixel / float(magnification(smms, sharp)) == pytest.approx(1.300553161, rel=1e-9)
    assert float(smms.lens_width) == pytest.approx(pitch, rel=1e-9)
    assert math.degrees(2 * math.atan(40 * pixel / 2 / float(smms.distance))) == pytest.approx(
        0.733515065, rel=1e-8
    )
    assert gap / pitch == pytest.approx(4.375, rel=1e-12)


# PlenoptiSign, tests/unit_test.py and its published camera: pixel 0.009, microlens 2.75, pitch
# 0.125, exit pupil 111.0324 before the array, main lens 193.2935, principal planes -65.5563 apart,
# 13 views.
PIXEL, SMALL, PITCH, PUPIL, LENS, PLANES = 0.009, 2.75, 0.125, 111.0324, 193.2935, -65.5563


def standard_camera(length: float, centre: float) -> Smms:
    return Smms(
        *(np.asarray(number) for number in (LENS, 72.0, length, SMALL, SMALL, PITCH, centre, 0.0))
    )


@pytest.mark.parametrize(
    ("view", "lenses", "baseline", "depth"),
    [
        (-6, 1, 3.7956, 5869.2898),
        (1, 0, 0.6326, math.inf),
        (-6, 2, 3.7956, 2934.6449),
        (-2, 1, 1.2652, 1956.4299),
    ],
)
def test_plenoptisign_s_baseline_and_triangulation_focused_at_infinity(
    view: int, lenses: int, baseline: float, depth: float
) -> None:
    def ray(centre: float, number: int) -> tuple[Smms, float]:
        """The ray through a microlens's centre onto the pixel ``number`` of its micro-image: where
        it crosses the main lens.
        """
        smms = standard_camera(LENS, centre)
        landing = centre * float(smms.image_scale) + number * PIXEL
        at_zero = float(
            sensor_crossing(smms, np.asarray(0.0), np.asarray(centre), np.asarray(centre))
        )
        return smms, (at_zero - landing) * LENS / SMALL

    here, m = ray(0.0, 0)
    there, other = ray(lenses * PITCH, view)
    assert abs(other - m) == pytest.approx(baseline, abs=5e-5)
    # Both rays at vergence V: equal where they meet; linear in V.
    gaps = [
        float(object_crossing(there, np.asarray(other), np.asarray(lenses * PITCH), np.asarray(v)))
        - float(object_crossing(here, np.asarray(m), np.asarray(0.0), np.asarray(v)))
        for v in (0.0, 1e-3)
    ]
    vergence = gaps[0] * 1e-3 / (gaps[0] - gaps[1])
    assert (1 / abs(vergence) if abs(vergence) > 1e-15 else math.inf) == pytest.approx(
        depth, abs=5e-4
    )


@pytest.mark.parametrize(("edge", "expected"), [(0, 962.7459), (1, 1110.0123), (-1, 838.1359)])
def test_plenoptisign_s_refocusing_distances_from_rays_of_the_standard_camera(
    edge: int, expected: float
) -> None:
    # a = 1: the outermost view's pixel (its border for the depth of field) under the 6th lens,
    # against the axis.
    views = 6
    smms = standard_camera(PUPIL, views * PITCH)
    q = views * PITCH - edge * PITCH / 2
    landing = views * PITCH * float(smms.image_scale) + (-views - edge / 2) * PIXEL
    at_zero = float(
        sensor_crossing(smms, np.asarray(0.0), np.asarray(q), np.asarray(views * PITCH))
    )
    m = (at_zero - landing) * PUPIL / SMALL
    slope = (q - m) / PUPIL
    image = LENS - q / slope  # where it crosses the axis, from the rear principal plane
    assert LENS + PLANES + 1 / (1 / LENS - 1 / image) == pytest.approx(expected, abs=6e-4)
