"""What a thread of a device works out of a pixel is what the processor's kernels make of it, for
all sorts of targets and cameras.

Without a device the threads' functions run one after the other, compiled to round products and sums
as a device does; the test of a device itself is skipped.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import FunctionType
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
import pytest
from numba.core.registry import CPUDispatcher

from flflab.image.device import found, work
from flflab.image.device.dots import dot_pixel
from flflab.image.device.pieces import HIGH, WIDE
from flflab.image.device.ruled import ROOM, ruled_pixel
from flflab.image.device.texels import texel_pixel
from flflab.image.device.work import dots_work, ruled_work, texels_work
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.motion import Motion
from flflab.image.flat_target import form
from flflab.image.light.dot_area import MOST_SQUARES
from flflab.image.render import render
from flflab.image.scene import Plane, Scene
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars, Chirp, Edge, FourDot, Picture, Target, White

Array = npt.NDArray[np.float64]

PICTURE = Picture(np.random.default_rng(1).random((30, 40)), 40.0)
TARGETS = (
    White(),
    Bars(),
    Chirp((0.1, 2.0), width=30.0, height=20.0),
    Edge(0.3),
    FourDot(),
    PICTURE,
)
EQUAL = 1e-12


@cache
def rounded_once(kernel: Any) -> Any:
    """A kernel, and all that it calls, whose products and sums have one rounding together, as
    numba-cuda has them.
    """
    known = dict(kernel.py_func.__globals__)
    called = [
        name
        for name in kernel.py_func.__code__.co_names
        if isinstance(known.get(name), CPUDispatcher)
    ]
    known.update({name: rounded_once(known[name]) for name in called})
    function = FunctionType(kernel.py_func.__code__, known, kernel.py_func.__name__)
    return numba.njit(
        error_model="numpy", fastmath={"contract"} | set(kernel.targetoptions.get("fastmath", ()))
    )(function)


@numba.njit(error_model="numpy")
def by_pixels(
    image: Array, pixel: Any, across: int, room: Array, begins: Array, listed: Array, arguments: Any
) -> None:
    """What the threads of all blocks do, one after the other."""
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            block = row // HIGH * across + column // WIDE
            near = listed[begins[block] : begins[block + 1]]
            image[row, column] = pixel(image[row, column], row, column, near, room, *arguments)


def instead(pixel: Any, make: Callable[..., Any], room: tuple[int, ...]) -> Callable[..., None]:
    """A kernel that forms a picture pixel by pixel and takes the arguments of one that goes entry
    by entry.
    """

    def add(image: Array, rows: tuple[int, int], windows: Any, seen: Any) -> None:
        _, begins, listed, given = make(image.shape, windows, seen)
        by_pixels(
            image,
            rounded_once(pixel),
            -(-image.shape[1] // WIDE),
            np.empty(room),
            begins,
            listed,
            given,
        )

    return add


@pytest.fixture
def pixel_by_pixel(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    def change() -> None:
        monkeypatch.setattr(form, "in_bands", lambda add, windows: add((0, 0)))
        monkeypatch.setattr(form, "add_ruled", instead(ruled_pixel, ruled_work, (ROOM,)))
        monkeypatch.setattr(form, "add_dots", instead(dot_pixel, dots_work, (MOST_SQUARES, 3)))
        monkeypatch.setattr(form, "add_texels", instead(texel_pixel, texels_work, (3,)))

    return change


def camera(
    f_number: float = 4.0, count: tuple[int, int] = (9, 7), resolution: tuple[int, int] = (150, 110)
) -> Camera:
    distance = 1 / (1 / 50.0 - 1 / 1000.0) - 3.6
    array = MicrolensArray(
        layout="square",
        count=count,
        pitch=(0.4, 0.4),
        aperture=0.4,
        focal_lengths=(0.9,),
        distance=distance,
    )
    return Camera(MainLens(50.0, f_number), array, Sensor(resolution, 0.01, distance + 0.72))


def scenes(target: Target) -> list[Scene]:
    sharp, blurred = (Scene(camera(), (Plane(target, distance),)) for distance in (1000.0, 900.0))
    wide = Scene(camera(1.6), (Plane(target, 950.0, offset=(3.0, -2.0), roll=0.2),))
    return [
        sharp,
        blurred,
        replace(sharp, planes=(replace(sharp.planes[0], roll=0.3),)),
        wide,
        replace(blurred, falloff=Falloff(), motion=Motion((0.1, 0.05), (0.0, 0.1))),
        replace(sharp, falloff=Falloff(), distortion=Distortion(0.01)),
        replace(blurred, planes=(replace(blurred.planes[0], tilt=(0.2, 0.1)),)),
    ]


def pictures(scene: Scene) -> list[Array]:
    """All of it, and half of its pixels."""
    rows, columns = scene.camera.sensor.resolution[::-1]
    wanted = np.random.default_rng(2).random((rows, columns)) < 0.5
    coarse = isinstance(scene.planes[0].target, Picture)
    return [
        render(scene, tolerance=0.02 if coarse else 0.003, wanted=given) for given in (None, wanted)
    ]


@pytest.mark.ci
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: type(target).__name__)
@pytest.mark.parametrize("index", range(7))
def test_a_pixel_by_itself_is_what_it_is_among_its_neighbours_however_it_is_rounded(
    target: Target, index: int, pixel_by_pixel: Callable[[], None]
) -> None:
    scene = scenes(target)[index]
    together = pictures(scene)
    pixel_by_pixel()
    assert together[0].max() > 0.1
    assert (
        max(np.abs(one - other).max() for one, other in zip(together, pictures(scene), strict=True))
        < EQUAL
    )


@pytest.mark.ci
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: type(target).__name__)
@pytest.mark.parametrize(("distance", "roll"), [(1000.0, 0.0), (1000.0, 0.2), (990.0, 0.0)])
def test_a_pixel_by_itself_has_the_fall_off_of_its_parts(
    target: Target, distance: float, roll: float, pixel_by_pixel: Callable[[], None]
) -> None:
    """A tolerance so fine that the fall-off of a pixel's middle does not do."""
    scene = Scene(
        camera(2.8, resolution=(60, 50)), (Plane(target, distance, roll=roll),), falloff=Falloff()
    )
    together = render(scene, tolerance=4e-4)
    pixel_by_pixel()
    assert np.abs(together - render(scene, tolerance=4e-4)).max() < EQUAL


@pytest.mark.ci
@pytest.mark.parametrize(
    ("target", "make"), [(Bars(), ruled_work), (PICTURE, texels_work)], ids=["bars", "picture"]
)
def test_more_tables_than_memory_should_hold_are_left_to_the_processor(
    target: Target, make: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[bool] = []

    def add(image: Array, rows: tuple[int, int], windows: Any, seen: Any) -> None:
        made.append(make(image.shape, windows, seen) is not None)

    monkeypatch.setattr(form, "in_bands", lambda add, windows: add((0, 0)))
    monkeypatch.setattr(form, "add_ruled" if isinstance(target, Bars) else "add_texels", add)
    for most in (2**27, 2**12):
        monkeypatch.setattr(work, "MOST", most)
        render(scenes(target)[1], tolerance=0.003)
    assert made == [True, False]


@pytest.mark.ci
@pytest.mark.filterwarnings("ignore:.*Grid size")  # small pictures leave most of a device idle
@pytest.mark.skipif(found.device_kernels() is None, reason="needs a CUDA device and the extra cuda")
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: type(target).__name__)
@pytest.mark.parametrize("index", range(7))
def test_a_device_forms_the_picture_that_the_processor_forms(
    target: Target, index: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = scenes(target)[index]
    monkeypatch.setattr(found, "WORTH", 0.0)
    on_device = pictures(scene)
    monkeypatch.setattr(form, "device_kernels", lambda: None)
    on_cores = pictures(scene)
    assert on_cores[0].max() > 0.1
    assert (
        max(np.abs(one - other).max() for one, other in zip(on_device, on_cores, strict=True))
        < EQUAL
    )
