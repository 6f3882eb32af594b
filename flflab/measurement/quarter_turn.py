"""Picture, camera and lattice seen after a quarter turn, so that what lies along y lies along x.

A place (x, y) is at (y, -x) then: the picture's rows become its columns.
"""

import math
from dataclasses import replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]
Number = TypeVar("Number", bound=np.generic)

TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
LIGHT = [0, 2, 1, 5, 4, 3], [1.0, 1.0, -1.0, 1.0, -1.0, 1.0]  # of 1, x, y, x^2, x y, y^2
EVERY = {"square": math.pi / 2, "hexagonal": math.pi / 3}  # an angle comes again after so much


def turned_picture(picture: npt.NDArray[Number]) -> npt.NDArray[Number]:
    """The picture, [row, col]."""
    return np.rot90(picture)


def turned_gains(gains: Array | None, columns: int) -> Array | None:
    """Gains of a mosaic's four sub-lattices in a picture that had so many columns, shape (2, 2)."""
    return None if gains is None else np.rot90(np.roll(gains, columns % 2, axis=1))


def turned_pixels(places: Array, columns: int) -> Array:
    """Places (x, y), px, in a picture that had so many columns; shape (..., 2)."""
    return places @ TURN.T + [0.0, columns - 1.0]


def turned_camera(camera: Camera) -> Camera:
    """The camera. Its main lens is round."""
    array, sensor = camera.array, camera.sensor
    return replace(
        camera,
        array=replace(
            array,
            roll=array.roll - math.pi / 2,
            offset=_turned(array.offset),
            tilt=_turned(array.tilt),
        ),
        sensor=replace(sensor, resolution=sensor.resolution[::-1], offset=_turned(sensor.offset)),
    )


def turned_lattice(lattice: Lattice, columns: int) -> Lattice:
    """The lattice in a picture that had so many columns; its micro-images keep their numbers."""
    six, place = np.kron(np.eye(3), TURN), [1.0, -1.0]
    every = EVERY[lattice.layout]
    axis = lattice.axis
    if axis is not None:
        there = turned_pixels(np.array(axis.place_px), columns)
        axis = replace(axis, place_px=(float(there[0]), float(there[1])))
    return replace(
        lattice,
        angle=math.remainder(lattice.angle - math.pi / 2, every),
        origin_px=turned_pixels(lattice.origin_px, columns),
        vectors_px=TURN @ lattice.vectors_px,
        centres_px=turned_pixels(lattice.centres_px, columns),
        origin_uncertainty_px=lattice.origin_uncertainty_px[::-1],
        covariance_px=six @ lattice.covariance_px @ six.T,
        light=lattice.light[LIGHT[0]] * LIGHT[1],
        axis=axis,
        tilt=lattice.tilt[::-1] * place,
        tilt_uncertainty=lattice.tilt_uncertainty[::-1],
        common_px=None if lattice.common_px is None else six @ lattice.common_px @ six.T,
    )


def _turned(vector: tuple[float, float]) -> tuple[float, float]:
    return vector[1], -vector[0]
