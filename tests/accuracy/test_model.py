"""The first-order model against exact rays: what must agree in the limit, and rays that are traced
a second way.
"""

from typing import Any

import mpmath
import numpy as np
import pytest

from flflab.accuracy.lenses import MAIN_LENSES, PLANO_CONVEX
from flflab.accuracy.model import PIXEL, QUANTITIES, compare
from flflab.accuracy.thick import first_order, scaled
from flflab.accuracy.thick_camera import Setting, aim, build

mp: Any = mpmath
SINGLET = scaled(PLANO_CONVEX, 50.0)


def test_first_order_is_left_by_the_square_of_all_angles() -> None:
    shrink = np.array([1.0, 0.5, 0.25])
    compared = compare(
        Setting(SINGLET, 50 / shrink, 0.6 * shrink, aperture=0.02 * shrink, distance=480.0)
    )
    for quantity in QUANTITIES:
        one = compared[quantity.name]
        share = np.abs(one.exact - one.model) / np.abs(one.model)
        assert share[-1] < 0.01, quantity.name
        assert np.log2(share[:-1] / share[1:]) == pytest.approx([2.0, 2.0], abs=0.1), quantity.name


@pytest.mark.parametrize("name", MAIN_LENSES)
def test_aimed_rays_go_where_they_were_aimed(name: str) -> None:
    camera = build(
        Setting(
            scaled(MAIN_LENSES[name], 50.0), np.array([[2.0], [8.0]]), np.array([0.0, 4.0, 9.0])
        )
    )
    y, stop = camera.smms.centre_x, camera.smms.lens_aperture / 2
    cases = (
        {"q": y + 0.168, "m": -stop},
        {"o": -8.0 * y, "q": y - 0.1},
        {"s": 1.02 * y, "m": 0.1 * stop},
        {"o": 1.0 - 8.4 * y, "m": 0 * y},
    )
    for wanted in cases:
        found = aim(camera, y, **wanted)
        for condition, goal in wanted.items():
            assert getattr(found, condition) == pytest.approx(goal, abs=1e-9)


def test_the_blur_on_the_axis_is_that_of_two_lenses_traced_with_50_digits() -> None:
    """From a point on the axis, angle by angle through both lenses, to the ray at the edge of the
    microlens.
    """
    setting = Setting(SINGLET, 4.0, 0.0)
    camera = build(setting)
    distance, known = 1 / float(camera.vergence), first_order(SINGLET)
    with mpmath.workdps(50):
        surfaces = [
            (1 / mp.mpf(SINGLET.curvature[0]), mp.mpf("1.5168"), mp.mpf(SINGLET.gap[0])),
            (None, mp.mpf(1), mp.mpf(0)),
        ]
        to_array = mp.mpf(60) + mp.mpf(known.rear) - mp.mpf(SINGLET.gap[0])
        lens = [(mp.mpf("0.422"), mp.mpf("1.46"), mp.mpf(1)), (None, mp.mpf(1), mp.mpf(0))]
        to_sensor = mp.mpf("1.15") - 1 / mp.mpf("1.46")

        def refract(
            height: Any, angle: Any, parts: list[tuple[Any, Any, Any]]
        ) -> tuple[Any, Any, Any]:
            """Height and angle at the first vertex to those behind the last one, and the height on
            the first surface.
            """
            index, first = mp.mpf(1), None
            for radius, behind, gap in parts:
                if radius is None:
                    hit, turned = height, mp.asin(index * mp.sin(angle) / behind)
                    back = mp.mpf(0)
                else:
                    # the ray height + z tan(angle) on the circle round (radius, 0)
                    t = mp.tan(angle)
                    a, b, c = 1 + t**2, height * t - radius, height**2
                    back = (-b - mp.sqrt(b**2 - a * c)) / a
                    hit = height + back * t
                    normal = mp.asin(hit / radius)
                    turned = mp.asin(index * mp.sin(angle + normal) / behind) - normal
                first = hit if first is None else first
                height, angle, index = hit + (gap - back) * mp.tan(turned), turned, behind
            return height, angle, first

        def through(angle: Any) -> tuple[Any, Any]:
            height, angle, _ = refract(mp.mpf(distance) * mp.tan(angle), angle, surfaces)
            height, angle, edge = refract(height + to_array * mp.tan(angle), angle, lens)
            return edge, height + to_sensor * mp.tan(angle)

        angle = mp.findroot(lambda angle: through(angle)[0] + mp.mpf("0.168"), 0.004)
        expected = 2 * float(abs(through(angle)[1]))
    found = compare(setting)["blur"]
    assert float(found.exact) == pytest.approx(expected, rel=1e-9)
    assert expected > 10 * PIXEL
    assert float(found.model) < 1e-12


def test_places_hold_and_widths_do_not() -> None:
    """What the page says in its first sentences, for the camera of the paper with a good main
    lens.
    """
    excess = {
        name: float(one.excess)
        for name, one in compare(
            Setting(scaled(MAIN_LENSES["double Gauss"], 50.0), 4.0, 2.0)
        ).items()
    }
    assert {name for name, value in excess.items() if value <= 1} == {
        "micro-image centre",
        "view position",
        "virtual depth",
    }


def test_the_blur_in_focus_falls_with_the_cube_of_the_microlens_aperture_as_spherical_aberration_does() -> (  # noqa: E501
    None
):
    apertures = np.array([0.1, 0.14, 0.2])
    blur = compare(
        Setting(scaled(MAIN_LENSES["double Gauss"], 50.0), 4.0, 0.0, aperture=apertures)
    )["blur"].exact
    assert np.polyfit(np.log(apertures), np.log(blur), 1)[0] == pytest.approx(3.0, abs=0.15)
