"""A warning where diffraction is wider than a pixel and a bench file states no light."""

from collections.abc import Iterable

from flflab.bench import Bench
from flflab.optics.airy import WAVELENGTH, airy_diameter
from flflab.optics.camera import Camera
from flflab.optics.focus import sharp_vergence
from flflab.optics.resolution import central_smms
from flflab.study import Study


def missing_light(bench: Bench, study: Study | None = None) -> str:
    """The sentence that asks for ``light``; empty where light is stated, where the disc is within a
    pixel, or where the bench's simulated camera draws rays, too.

    Args:
        bench: as described.
        study: whose configurations are looked at; without one the camera as its file has it.
    """
    description = bench.description
    if description.light is not None or description.camera.address == "simulated":
        return ""
    diameter = max(
        (
            airy_diameter(camera, distance) / camera.sensor.pixel
            for camera, distance in _used(bench, study)
        ),
        default=0.0,
    )
    if diameter <= 1:
        return ""
    return (
        f"the Airy disc of {1e6 * WAVELENGTH:g} nm light is {diameter:.2g} pixels wide, and"
        f" {bench.file} states no light: the predicted contrast lacks diffraction. Add `light:"
        " {wavelength: 550 nm}`"
    )


def _used(bench: Bench, study: Study | None) -> Iterable[tuple[Camera, float]]:
    if study is not None:
        return ((one.camera(bench.optics), one.distance) for one in study.configurations)
    vergence = float(sharp_vergence(central_smms(bench.optics)))
    return [(bench.optics, 1 / vergence)] if vergence > 0 else []
