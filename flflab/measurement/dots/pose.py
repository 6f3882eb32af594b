"""Where a target of four dots is taken to stand, and where microlenses then show its dots, roughly:
by the nominal camera's rays through the centre of the limiting stop.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import sensor_pixel, sensor_position, target_scales
from flflab.optics.camera import Camera
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Pose:
    """A target's place.

    A dot at o on the target is shown at s - c = size turn o + shift + parallax c in the micro-image
    of centre c (complex: x + i y, mm).

    Attributes:
        distance: from the main lens, mm.
        turn: of the target, exp(i angle).
        shift: of all its images on the sensor, mm.
    """

    distance: float
    turn: complex = 1 + 0j
    shift: complex = 0j

    def moved(self, shift: complex) -> "Pose":
        """The same with all images elsewhere by ``shift``, mm on the sensor."""
        return replace(self, shift=self.shift + shift)

    def start(self, camera: Camera, target: FourDot) -> Array:
        """(x, y) of each dot times its vergence, and that, 1/mm, shape (4, 3)."""
        across, _ = target_scales(camera, self.distance)
        dots = self.turn * (target.centres @ [1, 1j]) + self.shift * across
        start = np.stack([dots.real, dots.imag, np.ones(len(dots))], axis=1) / self.distance
        return np.asarray(start, dtype=np.float64)


@dataclass(frozen=True)
class Candidates:
    """Every pair of a dot and a micro-image it may be seen in."""

    dot: Whole
    lens: Whole

    def those(self, which: npt.NDArray[np.bool_]) -> "Candidates":
        """Some of them."""
        return Candidates(self.dot[which], self.lens[which])


def places(
    pose: Pose, candidates: Candidates, lattice: Lattice, camera: Camera, target: FourDot
) -> Array:
    """Where each candidate's spot is due, px, shape (n, 2)."""
    across, along = target_scales(camera, pose.distance)
    dots = pose.turn * (target.centres @ [1, 1j]) / across + pose.shift
    centre = sensor_position(camera.sensor, lattice.centres_px[candidates.lens])
    s = centre @ [1, 1j] * (1 - along / across) + dots[candidates.dot]
    return sensor_pixel(camera.sensor, np.stack([s.real, s.imag], axis=1))


def candidates_near(
    pose: Pose, lattice: Lattice, camera: Camera, target: FourDot, reach_px: float
) -> Candidates:
    """Dots and micro-images of which a spot, ``reach_px`` in radius, is seen on the sensor."""
    lens, dot = (
        grid.ravel()
        for grid in np.meshgrid(
            np.arange(len(lattice.centres_px)), np.arange(len(target.centres)), indexing="ij"
        )
    )
    every = Candidates(dot, lens)
    due = places(pose, every, lattice, camera, target)
    near = np.hypot(*(due - lattice.centres_px[lens]).T) < lattice.outside_radius_px + reach_px
    size = np.array(camera.sensor.resolution)
    return every.those(near & np.all((due > -reach_px) & (due < size + reach_px), axis=1))
