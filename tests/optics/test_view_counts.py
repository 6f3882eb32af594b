# longer than 450 lines because one subject's sentences of behaviour stand together
"""Numbers of views of any camera: along the row in 50 digits, on the sensor by dense rays; both lay
out the camera themselves.
"""

import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pytest

from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful
from flflab.optics.pixels import useful_pixels
from flflab.optics.resolution import mean_row_views, mean_sensor_views, stereo
from flflab.optics.useful import row_fields, sensor_fields
from flflab.optics.views import row_views, sensor_views

Array = npt.NDArray[np.float64]
Build = Callable[..., Camera]
mp: Any = mpmath


def drawn_camera(number: int, **changes: Any) -> Camera:
    """A camera at random: both layouts, up to three types, Keplerian, Galilean or both, tilted or
    not, few microlenses, any overlap.
    """
    rng = np.random.Generator(np.random.Philox(key=number))
    focal, pitch = rng.uniform(25, 75), rng.uniform(0.06, 0.7)
    length = focal * rng.uniform(1.05, 1.5)
    microlens = pitch * rng.uniform(1.5, 5)
    gap = microlens * (rng.uniform(1.05, 1.5) if rng.random() < 0.6 else rng.uniform(0.6, 0.95))
    shadow = pitch * rng.uniform(0.3, 1.5)
    count = (int(rng.integers(2, 15)), int(rng.integers(1, 10)))
    pixel = pitch / rng.uniform(15, 40)
    kinds = int(rng.choice([1, 1, 2, 3]))
    tilted = rng.random() < 0.4
    steep = min(0.01, 0.2 * gap / (pitch * max(count)))
    camera = Camera(
        MainLens(focal, focal * gap / (shadow * length)),
        MicrolensArray(
            "hexagonal" if rng.random() < 0.5 else "square",
            count, (pitch, pitch), pitch * float(rng.choice([1.0, 0.85, 0.5])),
            tuple((microlens * rng.uniform(0.9, 1.1, kinds)).tolist()), length,
            pattern=(tuple(range(kinds)), tuple(np.roll(range(kinds), 1).tolist())),
            offset=(pitch * rng.uniform(-0.5, 0.5), pitch * rng.uniform(-0.5, 0.5)),
            tilt=(steep * rng.uniform(-1, 1), steep * rng.uniform(-1, 1)) if tilted else (0.0, 0.0),
        ),
        Sensor(
            (max(4, int(count[0] * pitch / pixel * rng.uniform(0.6, 1.4))),
             max(4, int(count[1] * pitch / pixel * rng.uniform(0.6, 1.4)))),
            pixel, length + gap,
        ),
        "round" if rng.random() < 0.6 else "square",
        Useful(float(rng.choice([0.0, 0.3, 0.5])), float(rng.choice([0.0, 0.0, 0.1, 0.4]))),
    )  # fmt: skip
    return replace(camera, **changes)


@dataclass
class Lens:
    """A microlens in 50 digits: place, distances, focal length, where its micro-image lies."""

    y: Any
    L: Any
    b: Any
    f: Any
    kappa: Any
    centre: Any
    reach: Any
    ramp: Any


def row_in_50_digits(camera: Camera) -> list[Lens]:
    """The microlenses of the row nearest the axis."""
    array = camera.array
    half = mp.mpf(1) / 2
    hexagonal = array.layout == "hexagonal"
    rows = range(array.count[1])
    down = mp.sqrt(3) / 2 if hexagonal else mp.mpf(1)
    heights = [
        (row - mp.mpf(array.count[1] - 1) / 2) * down * mp.mpf(array.pitch[1]) for row in rows
    ]
    row = min(
        rows, key=lambda one: (mp.nint(abs(heights[one] + mp.mpf(array.offset[1])) * 10**12), one)
    )
    left = -half if hexagonal and len(rows) > 1 else mp.mpf(0)
    middle = (left + array.count[0] - 1) / 2
    found: list[Lens] = []
    A, d = (
        mp.mpf(camera.main_lens.focal_length) / mp.mpf(camera.main_lens.f_number),
        mp.mpf(array.aperture),
    )
    for column in range(array.count[0]):
        shift = half if hexagonal and row % 2 else 0
        x = (column - shift - middle) * mp.mpf(array.pitch[0]) + mp.mpf(array.offset[0])
        y = heights[row] + mp.mpf(array.offset[1])
        rise = x * mp.mpf(array.tilt[0]) + y * mp.mpf(array.tilt[1])
        L = mp.mpf(array.distance) + rise
        b = mp.mpf(camera.sensor.distance) - mp.mpf(array.distance) - rise
        tile = array.pattern[row % len(array.pattern)]
        f = mp.mpf(array.focal_lengths[tile[column % len(tile)]])
        kappa = 1 + b / L - b / f
        widths = A * b / L, d * abs(kappa)
        found.append(Lens(x, L, b, f, kappa, x * (1 + b / L), sum(widths) / 2, min(widths)))
    return found


def useful_in_50_digits(camera: Camera, row: list[Lens]) -> list[tuple[Any, Any] | None]:
    """The useful interval of each of them."""
    width = camera.sensor.resolution[0] * mp.mpf(camera.sensor.pixel) / 2
    edges = mp.mpf(camera.sensor.offset[0]) - width, mp.mpf(camera.sensor.offset[0]) + width
    rules = camera.useful
    found: list[tuple[Any, Any] | None] = []
    for one in row:
        half = one.reach - mp.mpf(rules.minimum_illumination) * one.ramp
        low, high = max(one.centre - half, edges[0]), min(one.centre + half, edges[1])
        for other in row:
            blocked = other.reach - mp.mpf(rules.maximum_crosstalk) * other.ramp
            if other.centre < one.centre:
                low = max(low, other.centre + blocked)
            elif other.centre > one.centre:
                high = min(high, other.centre - blocked)
        found.append((low, high) if low <= one.centre <= high else None)
    return found


def row_counts(
    camera: Camera, row: list[Lens], useful: list[tuple[Any, Any] | None], V: Any, angle: Any
) -> tuple[list[int], bool]:
    """(total, bright, chief) views along the row, and whether any comparison is nearer than 1e-11
    of the pitch.
    """
    F = mp.mpf(camera.main_lens.focal_length)
    A, d = F / mp.mpf(camera.main_lens.f_number), mp.mpf(camera.array.aperture)
    counts, close = [0, 0, 0], False
    near = mp.mpf(camera.array.pitch[0]) * mp.mpf("1e-11")
    for one, interval in zip(row, useful, strict=True):
        if interval is None:
            continue
        x = one.L * (V - 1 / F) + 1
        shift = one.y + angle * one.L

        def landing(m: Any, q: Any, one: Lens = one) -> Any:
            return one.kappa * q - one.b / one.L * m + one.b / one.f * one.y

        def crossing(m: Any, x: Any = x, one: Lens = one) -> Any:
            return x * m - angle * one.L

        gaps = []
        reach = (A * abs(x) + d) / 2 - abs(shift)
        if x == 0:
            ms = [-A / 2, A / 2] if reach >= 0 else []
        else:
            ends = sorted([(shift - d / 2) / x, (shift + d / 2) / x])
            ms = [max(ends[0], -A / 2), min(ends[1], A / 2)]
        lands = sorted(landing(m, crossing(m)) for m in ms)
        through = reach >= -near
        meets = through and lands[0] <= interval[1] + near and lands[1] >= interval[0] - near
        counts[0] += bool(meets)
        gaps += [reach] + ([interval[1] - lands[0], lands[1] - interval[0]] if lands else [])
        full = abs(A * abs(x) - d) / 2 - abs(shift)
        whole = full >= -near and lands[0] >= interval[0] - near and lands[1] <= interval[1] + near
        counts[1] += bool(whole)
        gaps += [full] + ([lands[0] - interval[0], interval[1] - lands[1]] if lands else [])
        passes = max(A * abs(x), d) / 2 - abs(shift)
        m = shift / x if d < A * abs(x) else mp.mpf(0)
        s = landing(m, crossing(m))
        counts[2] += bool(passes >= -near and interval[0] - near <= s <= interval[1] + near)
        gaps += [passes, s - interval[0], interval[1] - s]
        close = close or any(abs(gap) < near for gap in gaps)
    return counts, close


def lenses_laid_out(camera: Camera) -> tuple[Array, Array, Array]:
    """Centres (x, y), distances from the main lens and focal lengths of all, laid out by hand."""
    array = camera.array
    column, row = (part.ravel() for part in np.meshgrid(*(np.arange(n) for n in array.count)))
    x, y = column.astype(float), row.astype(float)
    if array.layout == "hexagonal":
        x, y = x - (row % 2) / 2, y * np.sin(np.pi / 3)
    x, y = (x - (x.min() + x.max()) / 2) * array.pitch[0], (y - np.ptp(y) / 2) * array.pitch[1]
    places = np.stack([x + array.offset[0], y + array.offset[1]], axis=1)
    tile = np.array(array.pattern)
    kind = tile[row % len(tile), column % len(tile[0])]
    return places, array.distance + places @ array.tilt, np.array(array.focal_lengths)[kind]


def shadows_of(camera: Camera, lens: tuple[Array, float, float]) -> tuple[float, float]:
    """Half widths of the two stops' shadows on the sensor, the smaller first."""
    _, depth, focal = lens
    gap = camera.sensor.distance - depth
    widths = (
        camera.main_lens.aperture * gap / depth,
        camera.array.aperture * abs(1 + gap / depth - gap / focal),
    )
    return min(widths) / 2, max(widths) / 2


def light_of(camera: Camera, lens: tuple[Array, float, float], points: Array) -> Array:
    """Relative illumination by one microlens at points of the sensor, by the stops' shadows."""
    place, depth, _ = lens
    small, large = shadows_of(camera, lens)
    away = np.abs(points - place * camera.sensor.distance / depth)
    if camera.aperture_shape == "square":
        return np.prod(np.clip((small + large - away) / (2 * small), 0, 1), axis=-1)
    away = np.hypot(away[..., 0], away[..., 1])
    with np.errstate(all="ignore"):
        one = np.arccos(np.clip((away**2 + small**2 - large**2) / (2 * away * small), -1, 1))
        two = np.arccos(np.clip((away**2 + large**2 - small**2) / (2 * away * large), -1, 1))
        area = small**2 * (one - np.sin(2 * one) / 2) + large**2 * (two - np.sin(2 * two) / 2)
    area = np.where(
        away <= large - small, np.pi * small**2, np.where(away < large + small, area, 0)
    )
    return area / (np.pi * small**2)


def rim_of(shape: str, number: int) -> Array:
    """Points round a stop of half width 1, its corners among them."""
    angles = np.linspace(0, 2 * np.pi, number, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return circle if shape == "round" else circle / np.abs(circle).max(axis=1, keepdims=True)


class SensorByRays:
    """Views on the sensor: rays through the rim of the limiting stop, refracted at thin lenses, and
    every way from a micro-image's centre to where they land.
    """

    def __init__(self, camera: Camera, V: float, angle: Array) -> None:
        self.camera, self.V, self.angle = camera, V, angle
        self.lenses = list(zip(*lenses_laid_out(camera), strict=True))
        self.homes = [place * camera.sensor.distance / depth for place, depth, _ in self.lenses]
        half = np.array(camera.sensor.resolution) * camera.sensor.pixel / 2
        self.low, self.high = camera.sensor.offset - half, camera.sensor.offset + half

    def size(self, shift: Array) -> Array:
        """How far out of round or square stops (x, y) lies."""
        return (
            np.hypot(shift[..., 0], shift[..., 1])
            if self.camera.aperture_shape == "round"
            else np.abs(shift).max(axis=-1)
        )

    def landing(self, index: int, m: Array) -> Array:
        """Where the rays that cross the main lens at m land."""
        place, depth, focal = self.lenses[index]
        q = m + depth * (m * self.V - self.angle - m / self.camera.main_lens.focal_length)
        gap = self.camera.sensor.distance - depth
        return np.asarray(q + gap * ((q - m) / depth - (q - place) / focal))

    def clearance(self, index: int, s: Array) -> float:
        """By how much all landing points are useful, in about a clear aperture's measure; below 0
        where one is not.
        """
        rules, d, home = self.camera.useful, self.camera.array.aperture, self.homes[index]
        places = np.concatenate([s, home[None]])
        worst = min(float(np.min(places - self.low)), float(np.min(self.high - places)))
        lit = light_of(self.camera, self.lenses[index], s)
        worst = min(worst, (float(np.min(lit)) - max(rules.minimum_illumination, 1e-9)) * d)
        way = home + np.linspace(0, 1, 101)[:, None, None] * (s - home)
        for other, lens in enumerate(self.lenses):
            if other != index and rules.maximum_crosstalk > 0:
                glow = float(np.max(light_of(self.camera, lens, way)))
                worst = min(worst, (rules.maximum_crosstalk - glow) * d)
            elif other != index:
                away = float(np.min(self.size(way - self.homes[other])))
                worst = min(worst, away - sum(shadows_of(self.camera, lens)))
        return worst

    def views(self, rim: Array) -> tuple[tuple[int, int], tuple[int, int]]:
        """(fewest, most) bright and chief views, as nearly decided as the rays are dense."""
        camera = self.camera
        A, d = camera.main_lens.aperture, camera.array.aperture
        slack = 4e-4 * camera.array.pitch[0]
        sure, possible = [0, 0], [0, 0]
        for index, (place, depth, _) in enumerate(self.lenses):
            x = depth * (self.V - 1 / camera.main_lens.focal_length) + 1
            shift = place + self.angle * depth
            limited, off = d < A * abs(x), float(self.size(shift))
            middle = shift / x if limited else np.zeros(2)
            stop = d / 2 / abs(x) if limited else A / 2
            for kind, gate, rays in (
                (0, abs(A * abs(x) - d) / 2 - off, middle + stop * rim),
                (1, max(A * abs(x), d) / 2 - off, middle[None]),
            ):
                if gate > -slack:
                    worst = min(gate, self.clearance(index, self.landing(index, rays)))
                    sure[kind] += worst > slack
                    possible[kind] += worst > -slack
        return (sure[0], possible[0]), (sure[1], possible[1])


def sensor_counts(
    camera: Camera, V: float, angle: Array, rays: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """(fewest, most) bright and chief views on the sensor by this many rays round each stop."""
    return SensorByRays(camera, V, angle).views(rim_of(camera.aperture_shape, rays))


def row_chief_counts(camera: Camera, V: float, angles: Array) -> npt.NDArray[np.int64]:
    """Chief views along the row of points with these o V, in doubles."""
    row = row_in_50_digits(camera)
    useful = useful_in_50_digits(camera, row)
    A, d = camera.main_lens.aperture, camera.array.aperture
    counts = np.zeros(len(angles), dtype=np.int64)
    for one, interval in zip(row, useful, strict=True):
        if interval is None:
            continue
        y, L, b, f = (float(part) for part in (one.y, one.L, one.b, one.f))
        x = L * (V - 1 / camera.main_lens.focal_length) + 1
        shift = y + angles * L
        m = shift / x if d < A * abs(x) else 0 * angles
        q = x * m - angles * L
        s = q + b * ((q - m) / L - (q - y) / f)
        lands = (s >= float(interval[0])) & (s <= float(interval[1]))
        counts += lands & (np.abs(shift) <= max(A * abs(x), d) / 2)
    return counts


def vergences_of(camera: Camera, number: int) -> list[float]:
    """The array's own conjugate, infinity, and five vergences round them."""
    own = 1 / camera.main_lens.focal_length - 1 / camera.array.distance
    rng = np.random.Generator(np.random.Philox(key=number))
    return [own, 0.0, *(own * rng.uniform(-0.5, 2, 5)).tolist()]


@pytest.mark.parametrize("first", range(0, 60, 20))
def test_views_along_the_row_are_those_of_50_digits(first: int) -> None:
    with mpmath.workdps(50):
        for number in range(first, first + 20):
            camera = drawn_camera(number)
            row, fields = row_in_50_digits(camera), row_fields(camera)
            useful = useful_in_50_digits(camera, row)
            for turn, V in enumerate(vergences_of(camera, number)):
                angle = (turn % 3 - 1) * 0.7 * camera.array.pitch[0] / camera.array.distance
                views = row_views(fields, V, angle)
                expected, _ = row_counts(camera, row, useful, mp.mpf(V), mp.mpf(angle))
                assert [views.total, views.bright, views.chief] == expected, (number, V, angle)


def test_many_bright_views_side_by_side_are_all_counted() -> None:
    # 176 hexagonal microlenses that touch, three types: bright views have equality in d = A |x|.
    camera = Camera(
        MainLens(49.88528586875341, 4.0),
        MicrolensArray(
            "hexagonal", (176, 3), (0.12744360322648965, 0.1274552010932988), 0.12744360322648965,
            (0.5826696686550624, 0.5240249316658897, 0.5605736155334103), 56.86606011659723,
            ((0, 1, 2), (1, 2, 0)), (0.187, 0.338), tilt=(0.000271, 0.000389),
        ),
        Sensor((4080, 3068), 5.5e-3, 57.197092795438614, (0.2136, 0.3163)),
    )  # fmt: skip
    fields = row_fields(camera)
    with mpmath.workdps(50):
        row = row_in_50_digits(camera)
        useful = useful_in_50_digits(camera, row)
        for distance in (56.7, 60.0, 75.0, 100.0, 140.0):
            expected, _ = row_counts(camera, row, useful, 1 / mp.mpf(distance), mp.mpf(0))
            views = row_views(fields, 1 / distance, 0.0)
            assert [views.total, views.bright, views.chief] == expected
            assert views.bright > 20


@pytest.mark.parametrize("first", [0, *(pytest.param(k, marks=pytest.mark.ci) for k in (4, 8))])
def test_views_on_the_sensor_are_those_of_dense_rays(first: int) -> None:
    decided = 0
    for number in range(first, first + 4):
        camera = drawn_camera(number, useful=Useful(0.3, 0.4 * (number % 2)))
        fields = sensor_fields(camera)
        for turn, V in enumerate(vergences_of(camera, number)[3:6]):
            angle = np.array([0.3, -0.2]) * turn * camera.array.pitch[0] / camera.array.distance
            views = sensor_views(fields, V, angle)
            (least, most), (few, many) = sensor_counts(camera, V, angle, 120)
            assert least <= views.bright <= most, (number, V, angle)
            assert few <= views.chief <= many, (number, V, angle)
            decided += least == most > 0
    assert decided


def test_a_footprint_is_useful_where_the_way_to_it_from_the_centre_is_free(
    laboratory: Build,
) -> None:
    camera = laboratory(1.6)
    camera = replace(camera, array=replace(camera.array, count=(9, 9)))
    views = sensor_views(sensor_fields(camera), 1 / 800, np.array([0.0017, 0.0011]))
    (least, most), _ = sensor_counts(camera, 1 / 800, np.array([0.0017, 0.0011]), 90)
    assert least == most == views.bright == 20


@pytest.mark.parametrize("shape", ["round", "square"])
def test_a_footprint_that_fills_the_bright_field_lies_in_it(shape: Any, laboratory: Build) -> None:
    # The sensor in the exit pupil and the image on the array: one footprint, one field, one edge.
    for number in range(40):
        length, focal = 60.0 + 0.013 * number, 0.917 - 0.0007 * number
        camera = laboratory(16.0, length, length * focal / (length - focal))
        camera = replace(
            camera,
            aperture_shape=shape,
            array=replace(camera.array, focal_lengths=(focal,)),
        )
        V = 1 / 50.0 - 1 / length
        assert row_views(row_fields(camera), V, 0.0).bright == 1
        assert sensor_views(sensor_fields(camera), V, np.zeros(2)).bright == 1


@pytest.mark.parametrize("number", [1, 4, 7])
def test_the_mean_number_of_views_is_that_of_the_points_round_the_axis(number: int) -> None:
    camera = drawn_camera(number)
    own = 1 / camera.main_lens.focal_length - 1 / camera.array.distance
    period = len(camera.array.pattern[0]) * camera.array.pitch[0] / camera.array.distance
    angles = period * ((np.arange(4000) + 0.5) / 4000 - 0.5)
    for V in (0.3 * own, 0.8 * own, 1.5 * own, 4 * own):
        counted = float(np.mean(row_chief_counts(camera, V, angles)))
        assert mean_row_views(row_fields(camera), camera, V) == pytest.approx(counted, abs=0.01)


@pytest.mark.ci
def test_the_mean_on_the_sensor_is_that_of_dense_rays_where_the_lattice_ends() -> None:
    camera = replace(
        drawn_camera(3), useful=Useful(0.3, 0.0), array=replace(drawn_camera(3).array, count=(5, 3))
    )
    own = 1 / camera.main_lens.focal_length - 1 / camera.array.distance
    rows = len(camera.array.pattern) * (2 if camera.array.layout == "hexagonal" else 1)
    columns = len(camera.array.pattern[0])
    down = np.sin(np.pi / 3) if camera.array.layout == "hexagonal" else 1.0
    period = np.array([columns * camera.array.pitch[0], rows * camera.array.pitch[1] * down])
    rng = np.random.Generator(np.random.Philox(key=3))
    points = (rng.permuted(np.tile(np.arange(60) / 60, (2, 1)), axis=1).T - 0.49) * period
    for V in (0.5 * own, 2 * own):
        bounds = np.array(
            [sensor_counts(camera, V, one / camera.array.distance, 4)[1] for one in points]
        )
        found = mean_sensor_views(sensor_fields(camera), camera, V)
        assert bounds[:, 0].mean() - 0.3 <= found <= bounds[:, 1].mean() + 0.3


def test_there_are_never_more_views_than_microlenses_whose_image_is_on_the_sensor() -> None:
    # Far from its conjugate a stopped-down camera shows every point in all micro-images.
    camera = drawn_camera(0)
    camera = replace(
        camera,
        main_lens=MainLens(26.387, 5.4546),
        array=MicrolensArray(
            "hexagonal", (16, 7), (0.06725562, 0.06254773), 0.05205406, (0.29592852,), 34.0313
        ),
        sensor=Sensor((188, 152), 0.0030403237, 34.16199),
        useful=Useful(0.5, 0.1),
        aperture_shape="square",
    )
    places, depths, _ = lenses_laid_out(camera)
    homes = np.abs(places * (camera.sensor.distance / depths)[:, None])
    lit = int(np.sum(np.all(homes <= np.array([188, 152]) * 0.0030403237 / 2, axis=1)))
    assert mean_sensor_views(sensor_fields(camera), camera, 1 / 316.6) == lit < 16 * 7


@pytest.mark.parametrize("first", range(0, 60, 20))
def test_stereo_begins_where_some_point_of_the_row_has_a_second_view(first: int) -> None:
    limits = 0
    for number in range(first, first + 20):
        camera = drawn_camera(number)
        own = 1 / camera.main_lens.focal_length - 1 / camera.array.distance
        found = stereo(camera)
        wide = (camera.array.count[0] + 2) * camera.array.pitch[0] / camera.array.distance
        angles = np.linspace(-wide, wide, 20_001)

        def shared(V: float, camera: Camera = camera, angles: Array = angles) -> bool:
            """More than a border that two touching ones share."""
            two = row_chief_counts(camera, V, angles) >= 2
            return bool(np.any(two[1:] & two[:-1]))

        limit = found.nearest or found.farthest
        if limit is not None:
            V, away = 1 / limit, abs(1 / limit - own)
            step = 0.02 * away if found.nearest else -0.02 * away
            assert not shared(V + step), number
            assert shared(V - step), number
            limits += 1
        elif found.nearest is None and "no real distance" in found.reason:
            assert not any(shared(own * part) for part in np.linspace(1e-3, 0.98, 5)), number
    assert limits


def test_touching_apertures_share_no_more_than_a_border() -> None:
    camera = Camera(
        MainLens(72.27, 31.115),
        MicrolensArray("square", (8, 6), (0.705114, 0.7756), 0.705114, (0.273056,), 92.45948),
        Sensor((269, 235), 0.014527221, 92.781875, (-0.169, -0.209)),
        useful=Useful(0.3, 0.1),
    )
    assert stereo(camera).nearest is None
    assert "no real distance" in stereo(camera).reason


@pytest.mark.parametrize("shape", ["round", "square"])
def test_useful_pixels_are_those_that_no_neighbour_hides_where_the_lattice_ends(
    shape: Any, laboratory: Build
) -> None:
    camera = laboratory(2.6)
    camera = replace(
        camera,
        aperture_shape=shape,
        array=replace(camera.array, count=(3, 3)),
        sensor=Sensor((137, 137), 13.28e-3, 61.15),
    )
    rays = SensorByRays(camera, 0.0, np.zeros(2))
    steps = (np.arange(137) - 68) * 13.28e-3
    pixels: Array = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2).astype(np.float64)
    counted = 0
    for index, (home, lens) in enumerate(zip(rays.homes, rays.lenses, strict=True)):
        own = pixels[light_of(camera, lens, pixels) >= 0.5]
        way = home + np.linspace(0, 1, 101)[:, None, None] * (own - home)
        free = np.ones(len(own), dtype=np.bool_)
        for other, neighbour in enumerate(rays.lenses):
            away = rays.size(way - rays.homes[other]).min(axis=0)
            free &= (other == index) | (away >= sum(shadows_of(camera, neighbour)))
        counted += int(free.sum())
    with np.errstate(all="raise", under="ignore"):
        assert useful_pixels(camera)[1] == pytest.approx(counted, abs=3)


def test_light_that_covers_many_neighbours_takes_little_memory() -> None:
    # Every micro-image lies in the light of about 300 others: 8 million pairs.
    camera = Camera(
        MainLens(50.0, 0.28),
        MicrolensArray("hexagonal", (176, 152), (0.127, 0.127), 0.127, (0.56,), 57.0),
        Sensor((4080, 3068), 5.5e-3, 57.33),
    )
    tracemalloc.start()
    fields = sensor_fields(camera)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 2**28
    assert useful_pixels(camera, fields) == (0, 0)
