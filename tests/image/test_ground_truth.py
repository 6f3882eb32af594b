"""What the file beside a picture says, against the picture."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.effects.distortion import Distortion
from flflab.image.effects.scatter import Scatter
from flflab.image.ground_truth import dot_position, ground_truth, paraxial_angle
from flflab.image.render import render
from flflab.image.scene import Plane, Scene
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars, FourDot, White

Array = npt.NDArray[np.float64]

SMALL = FourDot(diameter=0.3, spacing=3.0)
POINTS = FourDot(diameter=0.02, spacing=3.0)
FOCUS = 506.7016


@pytest.fixture(scope="module")
def wide() -> Camera:
    """The laboratory's camera with a sensor of about three by three micro-images, so that every dot
    is seen a few times.
    """
    array = MicrolensArray("square", (25, 25), (0.4, 0.4), 0.336, (0.917,), 60.0)
    return Camera(MainLens(50.0, 4.0), array, Sensor((700, 700), 0.00166, 61.15))


def hexagonal(wide: Camera) -> Camera:
    array = replace(wide.array, layout="hexagonal", roll=0.03, offset=(0.05, -0.03))
    return replace(wide, array=array, sensor=replace(wide.sensor, offset=(0.02, 0.01)))


def window(image: Array, place: list[float], half: int) -> Array:
    column, row = (round(part) for part in place)
    return image[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]


def centroid(image: Array, place: list[float], half: int) -> Array:
    light = window(image, place, half)
    rows, columns = np.indices(light.shape)
    at = np.array([(columns * light).sum(), (rows * light).sum()]) / light.sum()
    return at + np.array([max(round(place[0]) - half, 0), max(round(place[1]) - half, 0)])


def images_of(truth: dict[str, Any]) -> list[dict[str, Any]]:
    return [image for dot in truth["planes"][0]["dots"] for image in dot["images"]]


@pytest.mark.parametrize(
    ("plane", "change"),
    [
        (Plane(SMALL, FOCUS), {}),
        (Plane(SMALL, 495.0, offset=(1.3, -0.7), roll=0.2), {}),
        (Plane(SMALL, FOCUS, offset=(0.4, 0.9), roll=-0.3, tilt=(0.2, -0.1)), {}),
        (Plane(SMALL, FOCUS, offset=(0.4, 0.9)), {"distortion": Distortion(30.0)}),
        (Plane(SMALL, FOCUS, offset=(0.4, 0.9)), {"scatter": Scatter(0.005, 0.002, 3)}),
        (Plane(SMALL, FOCUS, offset=(0.4, 0.9)), {"camera": hexagonal}),
    ],
    ids=["plain", "defocused and rolled", "tilted", "distorted", "scattered", "hexagonal"],
)
def test_dots_lie_where_the_truth_says(wide: Camera, plane: Plane, change: dict[str, Any]) -> None:
    camera = change.get("camera", lambda camera: camera)(wide)
    scene = replace(
        Scene(camera, (plane,)), **{name: part for name, part in change.items() if name != "camera"}
    )
    truth = ground_truth(scene)
    image = render(scene)
    lattice = truth["lattice"]
    inside = {
        tuple(lens): (centre, radius)
        for lens, centre, radius in zip(
            lattice["microlenses"], lattice["centres_px"], lattice["inside_radii_px"], strict=True
        )
    }
    compared = 0
    for found in images_of(truth):
        centre, radius = inside[tuple(found["microlens"])]
        if math.dist(centre, found["place_px"]) + 8 < radius:  # the dot's whole image is fully lit
            assert centroid(image, found["place_px"], 9) == pytest.approx(
                found["place_px"], abs=0.02
            )
            compared += 1
    assert compared >= 4


def test_a_tilted_and_rolled_target_keeps_its_shape_and_lies_in_its_plane() -> None:
    plane = Plane(SMALL, 400.0, offset=(0.4, 0.9), roll=-0.3, tilt=(0.3, -0.2))
    corners = np.array([dot_position(plane, place) for place in SMALL.centres])
    for one in range(4):
        for other in range(4):
            assert math.dist(corners[one], corners[other]) == pytest.approx(
                math.dist(SMALL.centres[one], SMALL.centres[other])
            )
    assert corners.mean(axis=0) == pytest.approx([0.4, 0.9, 400.0])
    for x, y, away in corners:
        assert away == pytest.approx(400 + 0.3 * (x - 0.4) - 0.2 * (y - 0.9))
    flat = np.array(
        [dot_position(replace(plane, tilt=(0.0, 0.0)), place) for place in SMALL.centres]
    )[:, :2] - [0.4, 0.9]
    assert np.arctan2(*(flat[1] - flat[0])[::-1]) == pytest.approx(
        -0.3
    )  # its x axis turns from the world's towards y


@pytest.mark.parametrize("coefficient", [-5.0, 0.0, 5.0])
def test_a_distorted_direction_leads_back_to_where_it_came_from(coefficient: float) -> None:
    angle = np.array([0.06, -0.1])
    paraxial = paraxial_angle(angle, Distortion(coefficient))
    assert paraxial * (1 + coefficient * float(paraxial @ paraxial)) == pytest.approx(
        angle, rel=1e-12
    )


def test_light_is_at_the_places_of_the_total_views_and_nowhere_else(wide: Camera) -> None:
    scene = Scene(wide, (Plane(POINTS, 500.0, offset=(0.4, 0.9)),))
    truth = ground_truth(scene)
    image = render(scene)
    brightest = max(float(window(image, found["place_px"], 4).sum()) for found in images_of(truth))
    for found in images_of(truth):
        share = float(window(image, found["place_px"], 4).sum()) / brightest
        assert share > 0
        if found["bright"]:
            assert share == pytest.approx(1.0, abs=0.03)
        if found["chief"]:
            assert share > 0.3
        window(image, found["place_px"], 4)[:] = 0
    assert image.sum() < 0.01 * brightest
    counts = [dot["views"] for dot in truth["planes"][0]["dots"]]
    assert all(count["total"] >= count["chief"] >= count["bright"] >= 1 for count in counts)


def test_the_lattice_is_that_of_the_white_picture(wide: Camera) -> None:
    scene = Scene(hexagonal(wide), (Plane(White(), FOCUS),))
    lattice, image = ground_truth(scene)["lattice"], render(scene)
    whole = [
        centre
        for centre in lattice["centres_px"]
        if 100 < centre[0] < 600 and 100 < centre[1] < 600
    ]
    assert len(whole) >= 3
    for centre in whole:
        assert centroid(image, centre, math.ceil(lattice["outside_radius_px"])) == pytest.approx(
            centre, abs=0.01
        )
    assert lattice["angle_deg"] == pytest.approx(math.degrees(0.03))
    apart = np.hypot(*(np.array(whole) - lattice["origin_px"]).T)
    assert lattice["pitch_px"] == pytest.approx(apart[apart > 1].min(), rel=1e-9)
    lit = image > 0
    rows, columns = np.indices(image.shape)
    near = min(lattice["centres_px"], key=lambda centre: math.dist(centre, lattice["origin_px"]))
    away = np.hypot(columns - near[0], rows - near[1])[lit]
    own = away[away < lattice["pitch_px"] / 2]
    assert own.max() == pytest.approx(lattice["outside_radius_px"], abs=1.0)


def test_what_the_model_does_not_say_is_null_with_a_reason_and_all_is_json(wide: Camera) -> None:
    near = Plane(White(), 400.0, size=(5.0, 5.0))
    for planes, key in (
        ((Plane(Bars(), FOCUS),), "planes[0].dots"),
        ((Plane(SMALL, math.inf),), "planes[0].distance_mm"),
        ((near, Plane(SMALL, FOCUS)), "planes[1].dots"),
        ((Plane(SMALL, FOCUS, size=(2.0, 2.0)),), "planes[0].dots"),
    ):
        truth = json.loads(json.dumps(ground_truth(Scene(wide, planes)), allow_nan=False))
        assert key in truth["reasons"]
        assert truth["planes"][-1]["dots"] is None
    assert truth["camera"]["sharp_distance_mm"] == pytest.approx(FOCUS, abs=1e-3)
    assert truth["planes"][0]["target"] == {
        "kind": "four-dot",
        "diameter_mm": 0.3,
        "spacing_mm": 3.0,
    }
    assert truth["planes"][0]["magnification"] == pytest.approx(0.0278179, rel=1e-5)
