"""The model against rays traced by refraction at each thin lens, one after another, without the
model's algebra.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful
from flflab.optics.focus import blur, magnification
from flflab.optics.resolution import central_smms
from flflab.optics.smms import camera_smms
from flflab.optics.useful import row_fields
from flflab.optics.views import row_views

Array = npt.NDArray[np.float64]
Trace = Callable[[Camera, float, float, float, Array], tuple[Array, Array, npt.NDArray[np.bool_]]]
RAYS = 200_001


def crossings(camera: Camera) -> Array:
    return np.linspace(-0.5, 0.5, RAYS) * camera.main_lens.aperture


@pytest.mark.parametrize("f_number", [1.6, 2.8, 4.0, 8.0, 16.0])
@pytest.mark.parametrize(
    ("array", "gap"), [(60.0, 1.15), (55.0, 0.775), (60.0, 0.917), (60.0, 0.9312)]
)
def test_inside_and_outside_rays_bound_the_light_on_the_sensor(
    f_number: float, array: float, gap: float, laboratory: Callable[..., Camera]
) -> None:
    camera = laboratory(f_number, array, gap)
    smms = central_smms(camera)
    half_lens, half_microlens = camera.main_lens.aperture / 2, camera.array.aperture / 2
    landed = {}
    for name, m, q in (
        ("parallel", half_lens, half_microlens),
        ("diagonal", half_lens, -half_microlens),
    ):
        slope = (q - m) / array - q / camera.array.focal_lengths[0]
        landed[name] = abs(q + slope * gap)
    assert float(smms.outside_radius) == pytest.approx(max(landed.values()), rel=1e-12)
    assert float(smms.inside_radius) == pytest.approx(min(landed.values()), rel=1e-9, abs=1e-13)


@pytest.mark.parametrize("f_number", [1.6, 4.0, 16.0])
@pytest.mark.parametrize("distance", [350.0, 506.7, 900.0, 300.0])
def test_blur_and_magnification_are_those_of_traced_points(
    f_number: float, distance: float, laboratory: Callable[..., Camera], trace: Trace
) -> None:
    camera = laboratory(f_number)
    smms = central_smms(camera)
    _, on_axis, through = trace(camera, distance, 0.0, 0.0, crossings(camera))
    assert float(blur(smms, 1 / distance)) == pytest.approx(
        np.ptp(on_axis[through]), rel=2e-3, abs=1e-7
    )
    step = 0.01
    at_array, at_sensor, passed = trace(camera, distance, step, 0.0, crossings(camera))
    through_lens = np.flatnonzero(passed)[np.argmin(np.abs(crossings(camera)[passed]))]
    through_microlens = np.flatnonzero(passed)[np.argmin(np.abs(at_array[passed]))]
    smallest = min(abs(at_sensor[through_lens]), abs(at_sensor[through_microlens]))
    largest = max(abs(at_sensor[through_lens]), abs(at_sensor[through_microlens]))
    assert (
        smallest * 0.99 - 1e-6
        <= float(magnification(smms, 1 / distance)) * step
        <= largest * 1.01 + 1e-6
    )


def count_by_rays(
    camera: Camera, distance: float, height: float, trace: Trace
) -> tuple[int, int, int]:
    """Views of a point in the row by tracing: some ray useful, the full cone useful, the limiting
    stop's central ray useful.
    """
    row = row_fields(camera)
    m = crossings(camera)
    totals = brights = chiefs = 0
    full = np.count_nonzero(trace(camera, distance, 0.0, 0.0, m)[2])
    for centre, useful in zip(row.smms.centre_x, row.useful, strict=True):
        if np.isnan(useful[0]):
            continue
        at_array, at_sensor, through = trace(camera, distance, height, float(centre), m)
        good = (at_sensor >= useful[0]) & (at_sensor <= useful[1]) & through
        totals += bool(good.any())
        brights += bool(np.count_nonzero(through) >= full * 0.999 and good.sum() == through.sum())
        spacing = abs(at_array[1] - at_array[0])
        central = int(np.argmin(np.abs(at_array - centre))) if full < RAYS else RAYS // 2
        reached = through[central] and (full == RAYS or abs(at_array[central] - centre) <= spacing)
        chiefs += bool(reached and good[central])
    return totals, brights, chiefs


@settings(max_examples=25, deadline=None)
@given(
    f_number=st.floats(1.6, 16.0),
    distance=st.floats(300.0, 1200.0),
    height=st.floats(-6.0, 6.0),
    galilean=st.booleans(),
)
def test_views_along_the_row_agree_with_counted_rays(
    f_number: float, distance: float, height: float, galilean: bool
) -> None:
    length, gap = (55.0, 0.775) if galilean else (60.0, 1.15)
    camera = Camera(
        MainLens(50.0, f_number),
        MicrolensArray("square", (25, 1), (0.4, 0.4), 0.336, (0.917,), length),
        Sensor((3664, 2748), 1.66e-3, length + gap),
        useful=Useful(0.5, 0.0),
    )

    def trace(
        cam: Camera, away: float, up: float, centre: float, m: Array
    ) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
        slope = (m - up) / away - m / cam.main_lens.focal_length
        at_array = m + slope * cam.array.distance
        slope = slope - (at_array - centre) / cam.array.focal_lengths[0]
        return (
            at_array,
            at_array + slope * cam.gap,
            np.abs(at_array - centre) <= cam.array.aperture / 2,
        )

    # A count may change within a ray's width of its threshold: the rays must agree with a point
    # nearby, and there almost always here.
    found = row_views(row_fields(camera), 1 / distance, height / distance)
    traced = count_by_rays(camera, distance, height, trace)
    nearby = [
        row_views(row_fields(camera), 1 / distance, (height + shift) / distance)
        for shift in (-2e-3, -5e-4, 0.0, 5e-4, 2e-3)
    ]
    for index, kind in enumerate(("total", "bright", "chief")):
        assert traced[index] in {getattr(views, kind) for views in nearby}, (kind, traced, found)


def test_two_microlenses_share_points_at_f16_only_from_833_mm_on(
    laboratory: Callable[..., Camera], trace: Trace
) -> None:
    camera = laboratory(16.0)

    def most_views(distance: float) -> int:
        # Points whose light falls midway between two microlenses.
        heights = 0.2 * distance / 60 * np.linspace(0.97, 1.03, 7)
        return max(count_by_rays(camera, distance, float(height), trace)[2] for height in heights)

    assert most_views(800.0) == 1
    assert most_views(870.0) == 2


def test_a_tilted_array_gives_each_microlens_its_own_distances(
    laboratory: Callable[..., Camera],
) -> None:
    camera = laboratory()
    tilted = replace(camera, array=replace(camera.array, tilt=(0.01, 0.0)))
    smms = camera_smms(tilted)
    assert smms.distance + smms.gap == pytest.approx(np.full(625, 61.15))
    assert smms.distance[-1] - smms.distance[-2] == pytest.approx(0.4 * 0.01)
