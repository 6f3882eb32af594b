"""A picture that somebody else's camera took, fetched when this is run by hand: the depth map holds
together where the camera is described right, and falls apart where the picture is taken upside
down.

Dataset/R42 of PlenopticToolbox2.0 (GPL, so it is not kept here): three focal lengths, Galilean,
with its calibration in an XML file. No white picture is published with it, the model's stands in.
"""

import math
import urllib.request
from typing import Any

import cv2
import numpy as np
import pytest

from flflab.depth_map.depth import depth
from flflab.depth_map.result import DepthMap
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import White

PICTURE = (
    "https://raw.githubusercontent.com/PlenopticToolbox/PlenopticToolbox2.0/"
    "42c79aa9a0bb5e0971f6cdb42e9092d03a8139d0/Dataset/R42/sc2_klein.png"
)
# of its XML file, px of the sensor; the first centre counts from the middle, y upwards
DIAMETER, RIGHT, UP = 34.864704, 17.759811, 14.905209
PIXEL, GAP, DISTANCE = 0.0055, 0.9, 57.0  # mm; not published: virtual depths do not depend on them
SHARP_AT = 2.0, 3.4, 6.0  # virtual depths, within the three ranges of the XML file


def as_published(columns: int, rows: int, up: float) -> Camera:
    """The camera, with the centres' y counted so."""
    scale = 1 + GAP / DISTANCE
    pitch = DIAMETER * PIXEL / scale
    array = MicrolensArray(
        "hexagonal",
        (math.ceil(columns / DIAMETER) + 6 | 1, math.ceil(1.16 * rows / DIAMETER) + 6 | 1),
        (pitch, pitch),
        0.97 * pitch,
        tuple(GAP * depth / (depth - 1) for depth in SHARP_AT),
        DISTANCE,
        ((0, 1, 2), (2, 0, 1)),
        (RIGHT * PIXEL / scale, up * PIXEL / scale),
    )
    lens = MainLens(50.0, 50.0 / (0.97 * DIAMETER * PIXEL * DISTANCE / GAP))
    return Camera(lens, array, Sensor((columns, rows), PIXEL, DISTANCE + GAP))


@pytest.mark.full
@pytest.mark.timeout(300)
def test_a_strangers_picture_holds_together_where_its_camera_is_described_right() -> None:
    with urllib.request.urlopen(PICTURE, timeout=60) as answer:
        stored: Any = cv2.imdecode(np.frombuffer(answer.read(), np.uint8), cv2.IMREAD_COLOR)
    light = ((stored / 255.0) ** 2.2).mean(axis=2)
    maps: list[DepthMap] = []
    for up in (-UP, UP):
        camera = as_published(light.shape[1], light.shape[0], up)
        white = 3000 * np.clip(render(one_plane(camera, White(), 400.0)), 0, None)
        raw = 3000 * light / light.max()
        maps.append(depth(raw.astype(np.float32), camera, white.astype(np.float32)))
    right, wrong = maps
    assert right.density > 0.3
    assert right.density > 1.5 * wrong.density
    virtual = -1 / (right.disparity + GAP / DISTANCE)
    assert np.nanquantile(virtual, 0.05) > 3
