"""Compiles the kernels that most tests need, before workers would each do so: pictures in one
process, measurements in another.
"""

from dataclasses import replace

import numpy as np

from flflab.built_in import Kind, built_in
from flflab.files.camera import read_camera
from flflab.image.render import render
from flflab.image.scene import Plane, Scene, in_light, one_plane
from flflab.measurement.contrast.curve import fit_contrast
from flflab.measurement.dots.views import count_views
from flflab.measurement.lattice.white_picture import measure_white
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.targets import Bars, Edge, FourDot, White

NOISE = SensorNoise(0.34, 1.0, 64.0, 4095.0)
FOCUS = 506.7016


def small_camera() -> Camera:
    """The built-in camera with a few micro-images."""
    camera = read_camera(built_in(Kind.CAMERA))
    return replace(camera, sensor=replace(camera.sensor, resolution=(760, 560)))


def pictures() -> None:
    """Form every kind of picture once."""
    camera = small_camera()
    for target in (White(), Bars((0.5, 10.0), 12.0, 8.0), FourDot(1.0, 4.0), Edge()):
        for distance in (FOCUS, 490.0):
            scene = one_plane(camera, target, distance)
            render(scene, tolerance=1e-3)
            render(in_light(scene, 550e-6), tolerance=3e-3)
    tilted = Plane(Bars((0.5, 10.0), 12.0, 8.0), FOCUS, tilt=(0.1, 0.0))
    render(Scene(camera, (tilted,)), tolerance=1e-2)


def measurements() -> None:
    """Measure what most tests measure."""
    camera = small_camera()
    white, dots, bars = (
        64.0 + 3000.0 * render(one_plane(camera, target, FOCUS), tolerance=1e-3)
        for target in (White(), FourDot(1.0, 4.0), Bars((0.5, 10.0), 12.0, 8.0))
    )
    coarse = replace(camera, sensor=replace(camera.sensor, pixel=5 * camera.sensor.pixel))
    many = 64.0 + 3000.0 * render(one_plane(coarse, White(), FOCUS), tolerance=1e-3)
    measure_white(many.astype(np.float32), NOISE)
    lattice = lattice_behind(camera, white, NOISE)
    count_views(dots, lattice, camera, FourDot(1.0, 4.0), FOCUS, NOISE)
    fit_contrast(bars, lattice, camera, Bars((0.5, 10.0), 12.0, 8.0), FOCUS, NOISE)
