"""A focused light field camera as a sensor plugin of Mitsuba 3, and its pictures; imported only
where mitsuba is.

Every sample picks a place on the pixel, the nearest microlens (one of nine where micro-images
overlap) and a place on it, refracts the ray there and at the main lens and drops it where a stop
does; what it then meets, Mitsuba traces. World units are mm.
"""

import importlib
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import Camera, microlens_centres

Array = npt.NDArray[np.float64]


def mitsuba() -> Any:
    """Mitsuba with its fast variant of one colour.

    Raises:
        ImportError: it is not installed, or has no LLVM ($DRJIT_LIBLLVM_PATH, 16 or newer).
    """
    mi = importlib.import_module("mitsuba")

    mi.set_variant("llvm_ad_mono")
    return mi


def register(mi: Any, camera: Camera) -> None:
    """Make the camera known to Mitsuba as the sensor "plenoptic"; its film is as large as the
    sensor.
    """
    dr = importlib.import_module("drjit")

    pitch, radius = camera.array.pitch, camera.array.aperture / 2
    centres = microlens_centres(camera.array)
    first, last = centres.min(axis=0), centres.max(axis=0)
    gap, depth, focal = camera.optical_gap, camera.optical_distance, camera.array.focal_lengths[0]
    stop, main_focal = camera.main_lens.aperture / 2, camera.main_lens.focal_length
    columns, rows = camera.sensor.resolution
    pixel, offset = camera.sensor.pixel, camera.sensor.offset
    gain = 1 + depth / gap - depth / focal  # mm on the main lens per mm on the microlens
    outside = (stop + radius * abs(gain)) * gap / depth  # radius of a micro-image
    around = 1 if outside + pixel < min(pitch) * (1 + gap / depth) / 2 else 3
    concentration = np.pi * min(radius, stop / abs(gain)) ** 2

    class Plenoptic(mi.Sensor):  # type: ignore[misc]
        def __init__(self, properties: Any) -> None:
            super().__init__(properties)

        def sample_ray(
            self,
            time: Any,
            wavelength_sample: Any,
            position_sample: Any,
            aperture_sample: Any,
            active: Any = True,
        ) -> Any:
            # the film counts pixels by their corners, we by their centres
            x = (position_sample.x * columns - columns / 2) * pixel + offset[0]
            y = (position_sample.y * rows - rows / 2) * pixel + offset[1]
            # one more random number, for the neighbour, out of the first of two for the place on
            # the microlens
            chosen = aperture_sample.x * around**2
            pick = dr.minimum(dr.floor(chosen), around**2 - 1)
            row = dr.floor(pick / around)
            column, row = pick - around * row - around // 2, row - around // 2
            shrink = depth / (depth + gap)
            cx = (dr.round((x * shrink - first[0]) / pitch[0]) + column) * pitch[0] + first[0]
            cy = (dr.round((y * shrink - first[1]) / pitch[1]) + row) * pitch[1] + first[1]
            there = (
                (cx > first[0] - pitch[0] / 2)
                & (cx < last[0] + pitch[0] / 2)
                & (cy > first[1] - pitch[1] / 2)
                & (cy < last[1] + pitch[1] / 2)
            )
            disc = mi.warp.square_to_uniform_disk_concentric(
                mi.Point2f(chosen - pick, aperture_sample.y)
            )
            tx, ty = radius * disc.x, radius * disc.y
            slope_x, slope_y = (x - cx - tx) / gap + tx / focal, (y - cy - ty) / gap + ty / focal
            main_x, main_y = cx + tx - depth * slope_x, cy + ty - depth * slope_y
            through = there & (main_x**2 + main_y**2 <= stop**2)
            direction = dr.normalize(
                mi.Vector3f(-(slope_x + main_x / main_focal), -(slope_y + main_y / main_focal), -1)
            )
            ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(main_x, main_y, 0), direction, time))
            weight = dr.select(through, around**2 * np.pi * radius**2 / concentration, 0)
            return ray, mi.Color1f(weight)

        def sample_ray_differential(
            self, time: Any, wavelength: Any, position: Any, aperture: Any, active: Any = True
        ) -> Any:
            return self.sample_ray(time, wavelength, position, aperture, active)

        def needs_aperture_sample(self) -> bool:
            return True

    mi.register_sensor("plenoptic", Plenoptic)


def picture_scene(
    mi: Any,
    camera: Camera,
    values: Array,
    width: float,
    distance: float,
    sampler: str,
    samples: int,
) -> Any:
    """Mitsuba's scene of a picture that shines by itself, black around."""
    rows, columns = values.shape
    height = width * rows / columns
    bitmap = mi.Bitmap(
        np.ascontiguousarray(values[..., None], dtype=np.float32)
    )  # columns rise with x and rows with y, as ours do
    to_world = mi.ScalarTransform4f().translate([0, 0, -distance]) @ mi.ScalarTransform4f().scale(
        [width / 2, height / 2, 1]
    )
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 1},
            "sensor": {
                "type": "plenoptic",
                "sampler": {"type": sampler, "sample_count": samples},
                "film": {
                    "type": "hdrfilm",
                    "width": camera.sensor.resolution[0],
                    "height": camera.sensor.resolution[1],
                    "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                    "component_format": "float32",
                },
            },
            "card": {
                "type": "rectangle",
                "to_world": to_world,
                "emitter": {
                    "type": "area",
                    "radiance": {
                        "type": "bitmap",
                        "bitmap": bitmap,
                        "raw": True,
                        "filter_type": "nearest",
                        "wrap_mode": "clamp",
                        "format": "variant",
                    },
                },
            },
        }
    )


def pictured(mi: Any, scene: Any, samples: int, seed: int) -> Array:
    """Mitsuba's picture [row, column] in units of the white level."""
    return np.array(mi.render(scene, spp=samples, seed=seed), dtype=np.float64)[..., 0]
