"""Boundary and useful chief rays, measurement area and volume, against rays traced by refraction
and counted.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.path import Path as Outline
from scipy import optimize
from scipy.spatial import KDTree

from flflab.optics.area import MeasurementArea, measurement_area
from flflab.optics.boundary import boundary_rays, object_fields, parallel_are_inside, useful_rays
from flflab.optics.camera import Camera, Substrate
from flflab.optics.discs import two_disc_area
from flflab.optics.pixels import useful_pixels
from flflab.optics.resolution import central_smms
from flflab.optics.smms import camera_smms
from flflab.optics.useful import in_useful, row_fields, sensor_fields
from flflab.optics.volume import measurement_volume

Array = npt.NDArray[np.float64]
Build = Callable[..., Camera]
Trace = Callable[[Camera, float, float, float, Array], tuple[Array, Array, npt.NDArray[np.bool_]]]


def lens_crossings(camera: Camera, number: int = 20_001) -> Array:
    return np.linspace(-0.5, 0.5, number) * camera.main_lens.aperture


@pytest.mark.parametrize("f_number", [1.6, 4.0])
@pytest.mark.parametrize(
    ("array", "gap"),
    [(60.0, 1.15), (55.0, 0.775), (60.0, 0.917 * 60 / (60 - 0.917)), (60.0, 0.917)],
)
def test_boundary_rays_refract_at_every_lens_and_the_inside_ones_are_named_right(
    f_number: float, array: float, gap: float, laboratory: Build
) -> None:
    camera = laboratory(f_number, array, gap)
    smms = camera_smms(camera)
    rays = boundary_rays(smms)
    slope = -rays.object_slope - rays.main_lens / 50.0
    at_array = rays.main_lens + slope * array
    assert at_array == pytest.approx(rays.microlens, rel=1e-12, abs=1e-12)
    slope = slope - (at_array - smms.centre_x[:, None]) / 0.917
    assert at_array + slope * gap == pytest.approx(rays.sensor, rel=1e-11, abs=1e-12)
    centre = (smms.centre_x * smms.image_scale)[:, None]
    parallel, diagonal = np.abs(rays.sensor - centre)[:, 0], np.abs(rays.sensor - centre)[:, 2]
    if abs(float(smms.kappa[0])) > 1e-12:
        assert np.array_equal(parallel_are_inside(smms), parallel < diagonal)
    assert np.maximum(parallel, diagonal) == pytest.approx(smms.outside_radius, rel=1e-9)
    assert np.minimum(parallel, diagonal) == pytest.approx(smms.inside_radius, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("distance", "inside"), [(299.0, True), (301.0, False)])
def test_parallel_rays_are_inside_nearer_than_the_array_s_conjugate(
    distance: float, inside: bool, laboratory: Build
) -> None:
    smms = central_smms(laboratory())
    assert bool(parallel_are_inside(smms, 1 / distance)) is inside
    rays = boundary_rays(smms)
    height = np.abs(rays.main_lens + distance * rays.object_slope)
    assert bool(height[0] < height[2]) is inside


def intervals_by_rays(
    camera: Camera, distance: float, centre: float, useful: Array, heights: Array, trace: Trace
) -> dict[str, Array]:
    m = lens_crossings(camera)
    full = np.count_nonzero(
        trace(camera, distance, -centre * distance / camera.array.distance, centre, m)[2]
    )
    held: dict[str, list[float]] = {
        "bright": [],
        "total": [],
        "useful_bright": [],
        "useful_total": [],
    }
    for height in heights:
        _, landed, through = trace(camera, distance, float(height), centre, m)
        good = through & (landed >= useful[0]) & (landed <= useful[1])
        whole = np.count_nonzero(through) >= full - 1
        for name, holds in (
            ("total", through.any()), ("bright", whole), ("useful_total", good.any()),
            ("useful_bright", whole and good.sum() >= through.sum() - 1),
        ):  # fmt: skip
            if holds:
                held[name].append(float(height))
    return {
        name: np.array([min(values), max(values)]) if values else np.full(2, np.nan)
        for name, values in held.items()
    }


@pytest.mark.parametrize(
    ("f_number", "array", "gap"),
    [(2.0, 60.0, 1.15), (4.0, 60.0, 1.15), (8.0, 60.0, 1.15), (2.8, 55.0, 0.775)],
)
@pytest.mark.parametrize("distance", [250.0, 350.0, 506.7, 1500.0])
def test_fields_in_the_object_plane_are_those_of_traced_rays(
    f_number: float, array: float, gap: float, distance: float, laboratory: Build, trace: Trace
) -> None:
    camera = laboratory(f_number, array, gap)
    row = row_fields(camera)
    found = object_fields(row.smms, row.useful, 1 / distance)
    for index in (12, 18):
        smms = row.smms
        reach = float(np.ptp(found.total[index])) * distance
        middle = float(found.total[index].mean()) * distance
        heights = middle + np.linspace(-0.55, 0.55, 301) * reach
        traced = intervals_by_rays(
            camera, distance, float(smms.centre_x[index]), row.useful[index], heights, trace
        )
        for name, interval in traced.items():
            assert getattr(found, name)[index] * distance == pytest.approx(
                interval, abs=0.005 * reach, nan_ok=True
            ), name


@pytest.mark.parametrize("f_number", [1.6, 2.0, 4.0, 16.0])
def test_useful_rays_pass_an_edge_of_a_stop_and_an_edge_of_the_useful_interval(
    f_number: float, laboratory: Build
) -> None:
    camera = laboratory(f_number)
    row = row_fields(camera)
    rays = useful_rays(row.smms, row.useful)
    for index in np.flatnonzero(~np.isnan(row.useful[:, 0])):
        for ray in np.flatnonzero(rays.exists[index, 4:]) + 4:
            assert rays.sensor[index, ray] == pytest.approx(
                row.useful[index, 0 if ray < 8 else 1], abs=1e-12
            )
            on_lens = abs(abs(rays.main_lens[index, ray]) - camera.main_lens.aperture / 2) < 1e-12
            on_microlens = (
                abs(
                    abs(rays.microlens[index, ray] - row.smms.centre_x[index])
                    - camera.array.aperture / 2
                )
                < 1e-12
            )
            assert on_lens or on_microlens
    assert not rays.exists[np.isnan(row.useful[:, 0])].any()


def inside(area: MeasurementArea, vergence: Array, angle: Array) -> npt.NDArray[np.bool_]:
    points = np.stack([vergence, angle], axis=1)
    held = np.zeros(len(points), dtype=bool)
    for polygon in area.polygons:
        held |= Outline(polygon * [1e4, 1.0]).contains_points(points * [1e4, 1.0])
    return held


@pytest.mark.parametrize("by", ["total", "chief"])
@pytest.mark.parametrize(
    ("f_number", "array", "gap", "span"),
    [(1.6, 60.0, 1.15, (480, 530)), (4.0, 60.0, 1.15, (480, 530)), (4.0, 55.0, 0.775, (270, 330))],
)
def test_points_of_the_measurement_area_are_seen_twice_and_sharply_by_rays(
    by: str,
    f_number: float,
    array: float,
    gap: float,
    span: tuple[float, float],
    laboratory: Build,
    trace: Trace,
) -> None:
    camera = laboratory(f_number, array, gap)
    row = row_fields(camera)
    area = measurement_area(camera, "total" if by == "total" else "chief")
    m = lens_crossings(camera, 4001)
    rng = np.random.Generator(np.random.Philox(key=5))
    wrong = 0
    for distance, height in zip(rng.uniform(*span, 150), rng.uniform(-30, 30, 150), strict=True):
        at_array, axial, passed = trace(camera, distance, 0.0, 0.0, m)
        sharp = np.ptp(axial[passed]) <= camera.sensor.pixel
        seen = 0
        for centre, useful in zip(row.smms.centre_x, row.useful, strict=True):
            if np.isnan(useful[0]):
                continue
            at_array, landed, through = trace(camera, distance, height, float(centre), m)
            good = through & (landed >= useful[0]) & (landed <= useful[1])
            if by == "total":
                seen += bool(good.any())
            elif passed.all():
                seen += bool(good[len(m) // 2])
            else:
                nearest = int(np.argmin(np.abs(at_array - centre)))
                seen += bool(
                    good[nearest]
                    and abs(at_array[nearest] - centre) <= abs(at_array[1] - at_array[0])
                )
        wrong += (sharp and seen >= 2) != bool(
            inside(area, np.array([1 / distance]), np.array([height / distance]))[0]
        )
    assert wrong <= 2  # points within a ray's width of an edge


def test_an_area_that_reaches_infinity_ends_there_and_has_no_size(laboratory: Build) -> None:
    camera = laboratory(4.0)
    area = measurement_area(camera, anywhere=True)
    assert np.isinf(area.size())
    assert min(float(polygon[:, 0].min()) for polygon in area.polygons) == 0.0
    assert all(np.all(polygon[:, 0] >= 0) for polygon in area.polygons)


def test_a_camera_without_a_measurement_area_says_why(laboratory: Build) -> None:
    assert "no sharp point is seen by 2" in measurement_area(laboratory(16.0)).reason
    assert (
        "no micro-image is sharp" in measurement_area(laboratory(4.0, array=55.0, gap=1.0)).reason
    )
    assert measurement_volume(laboratory(16.0)).volume is None


def test_the_area_between_two_distances_has_the_size_of_its_strips(laboratory: Build) -> None:
    area = measurement_area(laboratory(4.0), "chief")
    assert len(area.polygons) == 1
    distance = np.linspace(499.61133317, 514.31402103, 20001)
    steps = (distance[1:] + distance[:-1]) / 2
    z, y = -area.corners()[0][:, 0], area.corners()[0][:, 1]
    upper = np.interp(steps, np.sort(z[y > 0]), y[y > 0][np.argsort(z[y > 0])])
    assert area.size() == pytest.approx(
        float(np.sum(2 * upper) * (distance[1] - distance[0])), rel=1e-6
    )


def test_the_volume_is_that_of_random_points_counted_by_traced_chief_rays(
    laboratory: Build,
) -> None:
    camera = laboratory(4.0)
    found = measurement_volume(camera, points=4096)
    r1, r2 = 0.5 * 12.5 * 1.15 / 60, 0.5 * 0.336 * abs(1 + 1.15 / 60 - 1.15 / 0.917)
    lit = optimize.brentq(
        lambda s: two_disc_area(r1, r2, s) / (np.pi * r2**2) - 0.5,
        abs(r1 - r2),
        r1 + r2,
        xtol=1e-14,
    )
    rng = np.random.Generator(np.random.Philox(key=11))
    near, far, number = 499.61133317, 514.31402103, 6000
    points = rng.uniform([-40, -35], [40, 35], (number, 2))
    depth = rng.uniform(near, far, number)
    places = 0.4 * (np.arange(25) - 12)
    centre = np.stack(np.meshgrid(places, places), axis=-1).reshape(1, -1, 2)
    # The microlens limits here: the ray through its centre, straight to the sensor; backwards it
    # meets the main lens at m.
    image = points / depth[:, None] / (1 / depth - 1 / 50)[:, None]
    behind = 1 / (1 / 50 - 1 / depth)
    slope = (image[:, None] - centre) / (behind - 60)[:, None, None]
    m = centre - 60 * slope
    landed = centre + 1.15 * slope
    edge = np.array([3664, 2748]) * 1.66e-3 / 2
    home = centre * (1 + 1.15 / 60)
    seen = (np.hypot(*np.moveaxis(m, -1, 0)) <= 6.25) & (
        np.hypot(*np.moveaxis(landed - home, -1, 0)) <= lit
    )
    seen &= np.all(np.abs(landed) <= edge, axis=-1) & np.all(np.abs(home) <= edge, axis=-1)
    share = float(np.mean(seen.sum(axis=1) >= 2))
    assert share > 0.1
    expected = share * 80 * 70 * (far - near)
    spread = np.sqrt(share * (1 - share) / number) * 80 * 70 * (far - near)
    assert found.volume == pytest.approx(expected, abs=3 * spread)
    assert found.volume is not None
    assert found.uncertainty < 0.01 * found.volume


@pytest.mark.parametrize("side", ["sensor", "main lens"])
def test_a_glass_plate_counts_with_its_thickness_over_its_index(
    side: str, laboratory: Build
) -> None:
    camera = laboratory()
    plate = Substrate(0.6, 1.5, "sensor" if side == "sensor" else "main lens")
    bare = laboratory(
        array=60.4 if side == "main lens" else 60.0, gap=1.15 + (0.4 if side == "sensor" else 0.0)
    )
    if side == "main lens":
        bare = replace(bare, sensor=replace(bare.sensor, distance=60.4 + 1.15))
    found, expected = (
        camera_smms(replace(camera, array=replace(camera.array, substrate=plate))),
        camera_smms(bare),
    )
    assert found.distance == pytest.approx(expected.distance, rel=1e-15)
    assert found.gap == pytest.approx(expected.gap, rel=1e-12)
    # Snell's law for a paraxial ray: refraction at both faces of the plate shifts it as t/n of air
    # would.
    slope = 1e-4
    through = 1.15 * slope + 0.6 * np.tan(np.arcsin(np.sin(np.arctan(slope)) / 1.5))
    assert through == pytest.approx((1.15 + 0.6 / 1.5) * slope, rel=1e-8)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("f_number", "layout", "roll"),
    [(1.6, "square", 0.1), (2.0, "hexagonal", 0.0), (2.8, "square", 0.0), (8.0, "square", 0.02)],
)
def test_pixels_counted_by_intervals_are_those_looked_at_one_by_one(
    f_number: float, layout: str, roll: float, laboratory: Build
) -> None:
    camera = laboratory(f_number, minimum=0.25)
    camera = replace(
        camera,
        array=replace(
            camera.array, layout="hexagonal" if layout == "hexagonal" else "square", roll=roll
        ),
        sensor=replace(camera.sensor, resolution=(1500, 1000), pixel=2.5e-3),
    )
    fields = sensor_fields(camera)
    low = fields.low
    x, y = (
        low[axis] + (np.arange(camera.sensor.resolution[axis]) + 0.5) * 2.5e-3 for axis in (0, 1)
    )
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    nearest: npt.NDArray[np.int64] = np.asarray(
        KDTree(fields.centre).query(points)[1], dtype=np.int64
    )
    assert useful_pixels(camera)[1] == int(np.count_nonzero(in_useful(fields, nearest, points)))
