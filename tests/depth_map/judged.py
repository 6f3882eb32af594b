"""Cameras and scenes that depth maps are judged on, and how far a map is from the truth."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import ray_pictures as rays

from flflab.depth_map.depth import depth
from flflab.depth_map.result import DepthMap
from flflab.files.camera import read_camera
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor

Array = npt.NDArray[np.float64]
OSINSKI = Path(__file__).parents[2] / "examples" / "cameras" / "osinski.yaml"


def osinski(columns: int = 1000, rows: int = 760) -> Camera:
    """The built-in camera behind a part of its sensor."""
    camera = read_camera(OSINSKI)
    return replace(camera, sensor=replace(camera.sensor, resolution=(columns, rows)))


def raytrix_like(size: int = 420) -> Camera:
    """Galilean, hexagonal, three focal lengths, micro-images of 23 pixels; a sensor of ``size``
    pixels a side.
    """
    pitch, pixel, gap = 0.127, 0.0055, 0.34
    count = round(size * pixel / pitch) + 6
    # sharp where virtual depths are 2.2, 3.5 and 6
    focal = tuple(gap * depth / (depth - 1) for depth in (2.2, 3.5, 6.0))
    return Camera(
        MainLens(50.0, 2.5),
        MicrolensArray(
            "hexagonal",
            (count, round(count * 1.2)),
            (pitch, pitch),
            0.12,
            focal,
            57.0,
            ((0, 1, 2), (2, 0, 1)),
        ),
        Sensor((size, size), pixel, 57.0 + gap),
    )


def at_virtual_depth(camera: Camera, depth: float) -> float:
    """Distance in mm of a virtual depth behind the array of a Galilean camera."""
    image = camera.optical_distance + depth * camera.optical_gap
    return 1 / (1 / camera.main_lens.focal_length - 1 / image)


@dataclass(frozen=True)
class Judged:
    """Figures of one map or of several; lengths in mm.

    Attributes:
        bias: mean error.
        rms: scatter about the mean.
        density: share of places that two microlenses see which have a value.
        within_1: share of errors within one stated sigma.
        within_2: within two.
        beyond_5: beyond five.
    """

    bias: float
    rms: float
    density: float
    within_1: float
    within_2: float
    beyond_5: float

    def __str__(self) -> str:
        return (
            f"density {self.density:.3f} bias {self.bias:+.3f} rms {self.rms:.3f}"
            f" 68: {self.within_1:.3f} 95: {self.within_2:.3f} >5: {self.beyond_5:.1e}"
        )


def judged(found: DepthMap, truth: Array | float) -> Judged:
    """One map against the true distances of its places."""
    error = found.distance - truth
    share = (np.abs(error) / found.sigma)[np.isfinite(error)]
    error = error[np.isfinite(error)]
    return Judged(
        float(error.mean()),
        float(error.std()),
        found.density,
        float(np.mean(share < 1)),
        float(np.mean(share < 2)),
        float(np.mean(share > 5)),
    )


def map_of(
    camera: Camera,
    cards: list[rays.Card],
    seed: int,
    *,
    workmanship: bool,
    distances: tuple[float, float] | None = None,
    count: int = 64,
) -> DepthMap:
    """The depth map of cards, raw and white with noise of their own."""
    built = rays.build(camera, seed + 1000 if workmanship else None)
    raw, white = rays.pair(built, cards, seed, count)
    return depth(raw, camera, white, distances=distances)


def tilted_truth(found: DepthMap, distance: float, slope: float) -> Array:
    """Distances of a plane that lies ``slope`` mm further a mm along x, at the map's places."""
    x, _ = found.directions()
    return np.broadcast_to(distance / (1 - slope * x), found.distance.shape)
