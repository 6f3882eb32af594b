"""Marginal angle and irradiance of every micro-image, and how they fall off, against quadrature and
fits.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mpmath
import numpy as np
import pytest

from flflab.optics.brightness import (
    brightness,
    fall_exponents,
    fitted_exponent,
    irradiance,
    limiting_half_width,
    vignetted_angle,
)
from flflab.optics.camera import Camera
from flflab.optics.focus import marginal_angle
from flflab.optics.smms import camera_smms
from flflab.optics.useful import select

Build = Callable[..., Camera]


def wide(camera: Camera) -> Camera:
    """The array of the figure: wide enough (15 mm off the axis) that the fall-off is seen."""
    return replace(camera, array=replace(camera.array, count=(75, 1)))


@pytest.mark.parametrize("f_number", [1.6, 4.0, 16.0])
@pytest.mark.parametrize("sensor", [60.4, 61.15, 62.0])
def test_fitted_exponents_agree_with_the_closed_forms(
    f_number: float, sensor: float, laboratory: Build
) -> None:
    camera = wide(laboratory(f_number))
    found = brightness(camera, np.array([sensor]))
    smms = select(
        camera_smms(replace(camera, sensor=replace(camera.sensor, distance=sensor))), np.array([37])
    )
    phi = np.arctan(found.centre / 60)
    angle, share = (float(part[0]) for part in fall_exponents(smms))
    assert fitted_exponent(phi, found.marginal_angle[0]) == pytest.approx(angle, abs=0.01)
    assert fitted_exponent(phi, found.irradiance[0]) == pytest.approx(share, abs=0.01)


def test_fifteen_millimetres_off_the_axis_six_and_twelve_percent_are_lost(
    laboratory: Build,
) -> None:
    found = brightness(wide(laboratory(4.0)), np.array([61.15]))
    assert found.centre[-1] == pytest.approx(14.8)
    assert 1 - found.marginal_angle[0, -1] / found.marginal_angle[0, 37] == pytest.approx(
        0.06, abs=0.005
    )
    assert 1 - found.irradiance[0, -1] / found.irradiance[0, 37] == pytest.approx(0.12, abs=0.015)
    assert 1 - found.marginal_angle[0, 30] / found.marginal_angle[0, 37] == pytest.approx(
        0.002, abs=0.0005
    )


@pytest.mark.parametrize("index", [0, 20, 37])
def test_irradiance_is_the_integral_over_the_cone(index: int, laboratory: Build) -> None:
    smms = select(camera_smms(wide(laboratory(4.0))), np.array([index]))
    b, g = float(smms.gap[0]), float(limiting_half_width(smms)[0])
    t = float(np.hypot(smms.centre_x[0], smms.centre_y[0])) * b / float(smms.distance[0])

    quad: Any = mpmath.quad

    def ring(r: mpmath.mpf) -> mpmath.mpf:
        return (
            quad(
                lambda a: r * b * b / (b * b + t * t + r * r + 2 * t * r * mpmath.cos(a)) ** 2,
                [0, mpmath.pi],
            )
            * 2
            / mpmath.pi
        )

    assert float(irradiance(smms)[0]) == pytest.approx(float(quad(ring, [0, g])), rel=1e-12)


def test_a_vignetted_point_has_its_share_of_the_marginal_angle(laboratory: Build) -> None:
    smms = select(camera_smms(laboratory(4.0)), np.array([312]))
    middle = (float(smms.inside_radius[0]) + float(smms.outside_radius[0])) / 2
    whole = float(marginal_angle(smms)[0])
    assert float(vignetted_angle(smms, 0.0)[0]) == whole
    assert float(vignetted_angle(smms, middle)[0]) == pytest.approx(whole / 2, rel=1e-9)
    assert float(vignetted_angle(smms, 0.3)[0]) == 0


def test_a_pinhole_s_irradiance_keeps_its_digits(laboratory: Build) -> None:
    smms = select(camera_smms(wide(laboratory(4.0, aperture=1e-9))), np.array([0, 37]))
    with mpmath.workdps(60):
        for got, y in zip(irradiance(smms), smms.centre_x, strict=True):
            b, g = mpmath.mpf(float(smms.gap[0])), mpmath.mpf(1e-9) / 2
            t = mpmath.mpf(float(abs(y))) * b / 60
            near = b * b + t * t - g * g
            assert float(got) == pytest.approx(
                float((1 - near / mpmath.sqrt(near**2 + 4 * b * b * g * g)) / 2), rel=1e-14
            )
