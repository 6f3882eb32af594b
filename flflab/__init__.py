"""Focused light field camera: its model, pictures, their measurement, and the comparison of the
two.

The functions named here are loaded when they are first used.

Example:
    >>> import flflab as ff
    >>> camera = ff.read_camera("camera.yaml")  # doctest: +SKIP
    >>> found = ff.depth(ff.read_picture("scene.png"), camera, ff.read_picture("white.png"))
    ... # doctest: +SKIP
    >>> found.save("depth")  # doctest: +SKIP
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from flflab.kernel_cache import use_kernel_cache

if TYPE_CHECKING:
    from flflab.camera_file import read_camera
    from flflab.depth_map.depth import depth, refocused
    from flflab.depth_map.result import DepthMap
    from flflab.image_file import read_picture, read_sensor_picture
    from flflab.measurement.measure import measure

__all__ = [
    "DepthMap",
    "depth",
    "measure",
    "read_camera",
    "read_picture",
    "read_sensor_picture",
    "refocused",
]
_HOMES = {
    "DepthMap": "flflab.depth_map.result",
    "depth": "flflab.depth_map.depth",
    "measure": "flflab.measurement.measure",
    "read_camera": "flflab.camera_file",
    "read_picture": "flflab.image_file",
    "read_sensor_picture": "flflab.image_file",
    "refocused": "flflab.depth_map.depth",
}

use_kernel_cache()


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'flflab' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
