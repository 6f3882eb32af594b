"""Focused light field camera: its model, pictures, their measurement, the bench, and the comparison
of model and experiment.

    import flflab as ff

    camera = ff.read_camera("camera.yaml")
    with ff.connect("bench.yaml") as bench:
        bench.home()
        bench.go(sensor_z="61.15 mm", f_number=4, target="bars")
        frame = bench.snap(exposure="5 ms")

Each name is loaded when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from flflab.kernel_cache import use_kernel_cache

if TYPE_CHECKING:
    from flflab.bench import read_bench
    from flflab.depth_map.depth import depth, refocused
    from flflab.depth_map.result import DepthMap
    from flflab.errors import DeviceError, FlflabError, InputError, MeasurementError
    from flflab.files.camera import read_camera
    from flflab.files.image import read_picture, read_sensor_picture, write_picture
    from flflab.files.target import load_target
    from flflab.measurement.measure import measure
    from flflab.measurement.white import measure_blind
    from flflab.optics.solution import solve_camera, solve_distance
    from flflab.record.reading import read_run as open_run
    from flflab.study import read_study
    from procedures.script import connect
    from procedures.validate import validate

__all__ = [
    "DepthMap", "DeviceError", "FlflabError", "InputError", "MeasurementError", "connect", "depth",
    "load_target", "measure", "measure_blind", "open_run", "read_bench", "read_camera",
    "read_picture", "read_sensor_picture", "read_study", "refocused", "solve_camera",
    "solve_distance", "validate", "write_picture",
]  # fmt: skip

_PLACES = {
    "DepthMap": "flflab.depth_map.result",
    "DeviceError": "flflab.errors",
    "FlflabError": "flflab.errors",
    "InputError": "flflab.errors",
    "MeasurementError": "flflab.errors",
    "connect": "procedures.script",
    "depth": "flflab.depth_map.depth",
    "load_target": "flflab.files.target",
    "measure": "flflab.measurement.measure",
    "measure_blind": "flflab.measurement.white",
    "open_run": "flflab.record.reading",
    "read_bench": "flflab.bench",
    "read_camera": "flflab.files.camera",
    "read_picture": "flflab.files.image",
    "read_sensor_picture": "flflab.files.image",
    "read_study": "flflab.study",
    "refocused": "flflab.depth_map.depth",
    "solve_camera": "flflab.optics.solution",
    "solve_distance": "flflab.optics.solution",
    "validate": "procedures.validate",
    "write_picture": "flflab.files.image",
}
_INSIDE = {"open_run": "read_run"}  # where the name is another inside

use_kernel_cache()


def __getattr__(name: str) -> Any:
    """A name of the front door, loaded when it is first asked for."""
    if name not in _PLACES:
        raise AttributeError(f"module 'flflab' has no attribute {name!r}")
    found = getattr(import_module(_PLACES[name]), _INSIDE.get(name, name))
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
