"""The radii of bright and total field, micro-image by micro-image, against closed forms and brute
force.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import one_plane, without
from flflab.measurement.lattice.profile import cone_of
from flflab.measurement.lattice.white import find_lattice
from flflab.measurement.measure import measure
from flflab.measurement.micro_images import every_micro_image
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful
from flflab.targets import White

Array = npt.NDArray[np.float64]

NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
SHAPE, PITCH, ANGLE, ORIGIN = (90, 112), 24.0, 0.03, (57.3, 46.6)


def closed_form(f_number: float, focal: float) -> tuple[float, float]:
    """Bright and total field of the worked example, px: boundary rays through the rims of main lens
    and microlens, physics.md.
    """
    away, gap, pixel = 60.0, 1.15, 0.00166
    lens, microlens = (
        50.0 / f_number * gap / away / 2,
        0.336 * abs(1 + gap / away - gap / focal) / 2,
    )
    return abs(lens - microlens) / pixel, (lens + microlens) / pixel


def scores(brute: Any, radii: tuple[float, float], level: float, repeats: int) -> Array:
    """Errors over stated uncertainties of (x, y, inside, outside) of every micro-image of which
    enough is seen, shape (n, 4).
    """
    vectors, rng = brute.vectors_of("square", PITCH, ANGLE), np.random.default_rng(21)
    image = brute.white_picture(SHAPE, "square", PITCH, ANGLE, ORIGIN, *radii)
    found: list[Array] = []
    for _ in range(repeats):
        picture = brute.expose(image, NOISE, level, rng)
        lattice = find_lattice(picture, "square", PITCH, NOISE)
        each = every_micro_image(picture, lattice, NOISE)
        true = (
            ORIGIN + np.rint((lattice.centres_px - ORIGIN) @ np.linalg.inv(vectors).T) @ vectors.T
        )
        doubt = np.sqrt(np.einsum("nkk->nk", each.covariance_px))[:, :2]
        inside, outside = each.inside_px, each.outside_px
        errors = [
            (each.centres_px - true) / doubt,
            ((inside[0] - abs(radii[0] - radii[1])) / inside[1])[:, None],
        ]
        one = np.concatenate([*errors, ((outside[0] - sum(radii)) / outside[1])[:, None]], axis=1)
        found.append(one[np.isfinite(one).all(axis=1)])
    return np.concatenate(found)


def multi_focal(f_number: float) -> Camera:
    array = MicrolensArray(
        "square", (25, 25), (0.4, 0.4), 0.336, (0.917, 1.0), 60.0, pattern=((0, 1), (1, 0))
    )
    return Camera(
        MainLens(50.0, f_number), array, Sensor((760, 520), 0.00166, 61.15), "round", Useful(0.5)
    )


def test_each_radius_is_the_closed_form_of_its_own_microlens() -> None:
    camera = multi_focal(4.0)
    paraxial = without(
        one_plane(camera, White(), 506.7016),
        frozenset({"defocus", "vignetting", "overlap", "pixel"}),
    )
    picture = NOISE.offset_dn + 3000 * render(paraxial, tolerance=3e-5)
    said = measure(picture, camera, White(), noise=NOISE)["lattice"]
    kinds = set[float]()
    for one in said["micro_images"]:
        due = min(
            (closed_form(4.0, f) for f in (0.917, 1.0)),
            key=lambda radii: abs(radii[1] - one["model"]["outside_radius_px"]),
        )
        assert [
            one["model"][name] for name in ("inside_radius_px", "outside_radius_px")
        ] == pytest.approx(due, rel=1e-6)
        for name, value in zip(("inside_radius_px", "outside_radius_px"), due, strict=True):
            if one[name] is not None:
                assert abs(one[name] - value) < 0.01
                kinds.add(due[1])
    assert len(kinds) == 2


@pytest.mark.parametrize(
    ("radii", "level", "repeats"),
    [
        ((8.0, 2.5), 3000.0, 8),
        pytest.param((13.0, 3.0), 1000.0, 8, marks=pytest.mark.ci),
        pytest.param((4.0, 3.0), 3000.0, 8, marks=pytest.mark.ci),
    ],
)
def test_errors_are_as_large_as_stated(
    brute: Any, radii: tuple[float, float], level: float, repeats: int
) -> None:
    found = scores(brute, radii, level, repeats)
    assert len(found) >= 12 * repeats
    assert np.all(np.abs(np.sqrt(np.mean(found**2, axis=0)) - 1) < 5 / math.sqrt(2 * len(found)))
    assert np.all(np.abs(np.mean(found, axis=0)) < 5 / math.sqrt(len(found)))


@pytest.mark.full
@pytest.mark.timeout(0)
@pytest.mark.parametrize(("radii", "level"), [((8.0, 2.5), 3000.0), ((13.0, 3.0), 1000.0)])
def test_intervals_of_single_radii_cover_94_to_96_percent_of_ten_thousand(
    brute: Any, radii: tuple[float, float], level: float
) -> None:
    found = scores(brute, radii, level, 700)
    assert len(found) > 10_000
    share = np.mean(np.abs(found) < 1.959964, axis=0)
    assert np.all((share > 0.94) & (share < 0.96)), share


def test_a_micro_image_unlike_the_others_does_not_pass_for_one_of_them(brute: Any) -> None:
    image = brute.white_picture(SHAPE, "square", PITCH, 0.0, ORIGIN, 8.0, 2.5)
    odd = brute.white_picture(SHAPE, "square", 10 * PITCH, 0.0, ORIGIN, 7.0, 3.0)
    columns, rows = (slice(round(at) - 12, round(at) + 12) for at in ORIGIN)
    image[rows, columns] = odd[rows, columns]
    picture = brute.expose(image, NOISE, 3000, np.random.default_rng(4))
    lattice = find_lattice(picture, "square", PITCH, NOISE)
    each = every_micro_image(picture, lattice, NOISE)
    one = int(np.argmin(np.hypot(*(lattice.centres_px - ORIGIN).T)))
    for found, due in ((each.inside_px, 4.0), (each.outside_px, 10.0)):
        assert abs(found[0, one] - due) < 4 * found[1, one]
    known = np.isfinite(each.inside_px[0])
    known[one] = False
    assert np.median(np.abs(each.inside_px[0, known] - 5.5) / each.inside_px[1, known]) < 2


@pytest.mark.ci
def test_fall_off_moves_neither_the_radii_nor_a_single_centre() -> None:
    array = MicrolensArray("square", (25, 25), (0.4, 0.4), 0.336, (0.917,), 60.0)
    camera = Camera(
        MainLens(50.0, 4.0), array, Sensor((760, 560), 0.00166, 61.15), "round", Useful(0.5)
    )
    for place in ((0.0, 0.0), (2.6, 1.9)):
        away = replace(camera, sensor=replace(camera.sensor, offset=place))
        picture = NOISE.offset_dn + 3000 * render(
            replace(one_plane(away, White(), 506.7016), falloff=Falloff()), tolerance=3e-5
        )
        lattice = find_lattice(picture, "square", 245.0, NOISE, cone_of(away))
        due = closed_form(4.0, 0.917)
        assert [lattice.inside_radius_px, lattice.outside_radius_px] == pytest.approx(due, abs=0.03)
        each = every_micro_image(picture, lattice, NOISE)
        whole = np.all((lattice.centres_px > 100) & (lattice.centres_px < [660, 460]), axis=1)
        assert np.count_nonzero(whole) >= 1
        assert np.abs(each.centres_px[whole] - lattice.centres_px[whole]).max() < 0.01
        for radius, expected in zip((each.inside_px, each.outside_px), due, strict=True):
            assert np.abs(radius[0, whole] - expected).max() < 0.05


def test_where_the_fit_starts_moves_no_micro_image_by_a_fifth_of_its_uncertainty_even_where_the_border_cuts_it() -> (  # noqa: E501
    None
):
    array = MicrolensArray(
        "square", (7, 7), (0.4, 0.4), 0.336, (0.917,), 60.0, tilt=(0.0012, -0.0017)
    )
    camera = Camera(MainLens(50.0, 2.8), array, Sensor((760, 560), 0.00166, 61.15))
    light = render(one_plane(camera, White(), 506.7016), tolerance=3e-5)
    rng = np.random.default_rng(3)
    picture = np.rint(
        rng.poisson(np.maximum(light, 0.0) * 2700 / 0.3) * 0.3
        + rng.normal(NOISE.offset_dn, 2.0, light.shape)
    )
    lattice = find_lattice(picture, "square", 245.6, NOISE, cone_of(camera))
    found = every_micro_image(picture, lattice, NOISE)
    doubt = np.sqrt(np.einsum("nkk->nk", found.covariance_px))
    for _ in range(4):
        started = replace(
            lattice, centres_px=lattice.centres_px + rng.normal(0.0, 0.2, lattice.centres_px.shape)
        )
        again = every_micro_image(picture, started, NOISE)
        moved = np.concatenate(
            [again.centres_px - found.centres_px, again.radii_px - found.radii_px], axis=1
        )
        assert np.nanmax(np.abs(moved) / doubt) < 0.2
