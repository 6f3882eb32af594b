"""The four scenes by which renderers of this camera are compared: one bench, one chart, what is
hard about it changed.

A 50 mm lens, an array of 0.9 mm lenses 400 um apart that touch, the chart's image 3.6 mm behind the
array and the sensor 0.72 mm behind it; the chart is a sine of 20 to 620 cycles across 160 mm. In
focus it stands at 1000 mm.
"""

from flflab.image.scene import Scene, one_plane
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Chirp

CHART = Chirp(cycles_per_mm=(0.125, 3.875), width=160.0, height=120.0)
FOCUS = 1000.0  # mm
ARRAY = 1 / (1 / 50.0 - 1 / FOCUS) - 3.6  # mm behind the main lens: 3.6 mm before the chart's image
GAP = 0.72  # mm
RESOLUTION = (480, 360)  # the middle of the sensor, two by one and a half micro-images


def bench_scene(f_number: float, distance: float, resolution: tuple[int, int]) -> Scene:
    """The bench at an f-number with the chart at a distance in mm, the middle (columns, rows) of
    its sensor.
    """
    array = MicrolensArray(
        layout="square", count=(17, 13), pitch=(0.4, 0.4), aperture=0.4, focal_lengths=(0.9,),
        distance=ARRAY
    )  # fmt: skip
    sensor = Sensor(resolution, 0.00166, ARRAY + GAP)
    return one_plane(Camera(MainLens(50.0, f_number), array, sensor), CHART, distance)


def bench_scenes(resolution: tuple[int, int]) -> dict[str, Scene]:
    """The four scenes by name."""
    return {
        "F/4, in focus": bench_scene(4.0, FOCUS, resolution),
        "F/4, defocused": bench_scene(4.0, 900.0, resolution),
        "F/1.6, overlapping": bench_scene(1.6, 900.0, resolution),
        "F/16": bench_scene(16.0, FOCUS, resolution),
    }
