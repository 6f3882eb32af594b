"""Where the dots of a picture lie: one law for all their spots, found round where the nominal
camera puts them.

s - c = shift + (o_x, o_y, c_x, c_y) of the law, all mm: a spot's place s in the micro-image of
centre c, o the dot on the target.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.profile import ProfileTable
from flflab.measurement.lattice.registration import sensor_pixel, sensor_position
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.spots.fit import flat_centroids, illumination, lit
from flflab.optics.camera import Camera
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

SEARCH_PX = 8.0  # how far each may then still be
FLOOR_PX = 1e-4  # of a spot's place, that no scatter shows
# how well spots so placed tell the law's factors counts as much as that the nominal ones are so far
# off
PLACED_PX, DESCRIBED = (
    0.1,
    0.1,
)
HALF = 0.5  # of the dot's expected light: a view has at least this


@dataclass(frozen=True)
class Candidates:
    """Every pair of a dot and a micro-image it may be seen in."""

    dot: Whole
    lens: Whole


@dataclass(frozen=True)
class Square:
    """How large dots are in focus, as the square that they make on the sensor shows.

    Attributes:
        radius_px: by the law through spots where they are.
        uncertainty_px: standard, for the radius they were fitted with.
        by_places: how the radius grows with each spot's x and y, shape (n, 2).
    """

    radius_px: float
    uncertainty_px: float
    by_places: Array

    def those(self, which: Whole) -> "Square":
        """The same of some of the spots, the others held."""
        return Square(self.radius_px, self.uncertainty_px, self.by_places[which])


def law_at(dots: complex, parallax: complex, shift: complex = 0j) -> Array:
    """The law with factors ``dots`` of o and ``parallax`` of c (complex: x + i y; scale and turn)
    and a shift, mm; shape (5, 2).
    """
    return np.array(
        [
            [part.real, part.imag]
            for part in map(complex, (shift, dots, 1j * dots, parallax, 1j * parallax))
        ]
    )


def law_places(
    lattice: Lattice, camera: Camera, target: FourDot, law: Array, candidates: Candidates
) -> tuple[Array, Array]:
    """Where a law puts each candidate's spot, px, and the regressors of the law, shape (n, 5).

    The same numbers with a turn serve x and y.
    """
    centre = sensor_position(camera.sensor, lattice.centres_px)[candidates.lens]
    dots = target.centres[candidates.dot]
    regressors = np.concatenate([np.ones((len(dots), 1)), dots, centre], axis=1)
    return sensor_pixel(camera.sensor, centre + regressors @ law), regressors


def candidates_near(
    lattice: Lattice, camera: Camera, target: FourDot, law: Array, reach_px: float
) -> Candidates:
    """Dots and micro-images so near to where a law puts a spot that, ``reach_px`` wide, it is seen
    there.
    """
    lens, dot = (
        grid.ravel()
        for grid in np.meshgrid(
            np.arange(len(lattice.centres_px)), np.arange(len(target.centres)), indexing="ij"
        )
    )
    every = Candidates(dot, lens)
    places, _ = law_places(lattice, camera, target, law, every)
    near = np.hypot(*(places - lattice.centres_px[lens]).T) < lattice.outside_radius_px + reach_px
    columns, rows = camera.sensor.resolution
    near &= np.all((places > -reach_px) & (places < np.array([columns, rows]) + reach_px), axis=1)
    return Candidates(dot[near], lens[near])


def register(
    values: npt.NDArray[Any],
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    law: Array,
    spread: float,
    sizes: Array,
    table: ProfileTable,
    noise: SensorNoise,
) -> tuple[Array, float]:
    """The law that the spots themselves follow, and a spot's radius in px: centroids in shrinking
    windows, robustly regressed.
    """
    radius = target.diameter / 2 * float(np.hypot(*law[1])) / camera.sensor.pixel
    start = law
    for search in (SEARCH_PX, SEARCH_PX / 2, 3.0):
        candidates = candidates_near(lattice, camera, target, law, 0.0)
        places, regressors = law_places(lattice, camera, target, law, candidates)
        # beyond halfway to the next dot a micro-image may show that one, whose light draws the
        # centroid to the middle of both
        half = min(
            math.ceil(radius + spread / 2 + search),
            math.floor(radius * target.spacing / target.diameter),
        )
        own = lit(lattice, candidates.lens, (values.shape[0], values.shape[1]), sizes)
        centroids, total = flat_centroids(values, places, half, radius, own, noise)
        telling = _well_lit(centroids, total, lattice, candidates, radius, table)
        if (
            spread > radius
            # what an aperture cuts of so wide a blur draws its centroid further aside than the law is  # noqa: E501
            # off
        ):
            away = np.hypot(*(places - own.centres).T)
            telling &= away + radius + spread / 2 < lattice.inside_radius_px
        if not telling.any():
            return law, radius
        offsets = (
            sensor_position(camera.sensor, centroids)
            - sensor_position(camera.sensor, lattice.centres_px)[candidates.lens]
        )
        law, _, _ = regress(law, start, regressors[telling], offsets[telling], camera.sensor.pixel)
        radius = target.diameter / 2 * float(np.hypot(*law[1])) / camera.sensor.pixel
    return law, radius


def _well_lit(
    centroids: Array,
    total: Array,
    lattice: Lattice,
    candidates: Candidates,
    radius: float,
    table: ProfileTable,
) -> npt.NDArray[np.bool_]:
    """Spots that hold enough light, where there is enough, to say where the dots are."""
    own = lattice.centres_px[candidates.lens]
    lit = illumination(table, np.hypot(*(centroids - own).T)) > HALF
    enough = (
        total
        > 0.25 * np.pi * radius**2 * max(float(np.quantile(total, 0.98)) / (np.pi * radius**2), 0.1)
        if len(total)
        else lit
    )
    return lit & enough


def regress(
    law: Array, nominal: Array, regressors: Array, offsets: Array, pixel: float
) -> tuple[Array, Array, float]:
    """Update the law by a shift, and by one complex factor for dots and one for centres (scale and
    turn), outliers left out.

    Returns:
        The law, how the size of the dots' square (mm on the sensor per mm on the target) grows with
        each offset, per mm, shape (n, 2), and the standard uncertainty of that size, by how spots
        scatter round the law and how unsure the nominal one is.
    """
    rest = offsets - regressors @ law
    z, o, c = rest @ [1, 1j], regressors[:, 1:3] @ [1, 1j], regressors[:, 3:5] @ [1, 1j]
    # few spots, or dots that are seen once each, cannot tell the factors apart: then those of the
    # nominal camera hold
    prior = np.diag([0.0, *(PLACED_PX * pixel / DESCRIBED / np.hypot(*nominal[[1, 3]].T)) ** 2])
    off = (law - nominal)[[0, 1, 3]] @ [1, 1j]
    weight, left = np.ones(len(z)), np.abs(z)
    step, normal = np.zeros(3, dtype=np.complex128), np.eye(3, dtype=np.complex128)
    design = np.stack([np.ones(len(z)), o, c], axis=1)
    for _ in range(5):
        normal = (design.conj().T * weight) @ design
        step = np.linalg.solve(normal + prior, (design.conj().T * weight) @ z - prior @ off)
        left = np.abs(z - design @ step)
        limit = max(3 * float(np.median(left)), 0.3 * pixel)
        weight = np.minimum(1.0, limit / np.maximum(left, 1e-12)) ** 2
    shift, dots, centres = step
    found = law + law_at(dots, centres, shift)
    turn = complex(*found[1]) / max(abs(complex(*found[1])), 1e-300)
    inverse = np.linalg.inv(normal + prior)
    by_offset = (inverse[1] @ (design.conj().T * weight)) * turn.conjugate()
    scatter = math.sqrt(float((weight * left**2).sum()) / max(2 * len(z) - 6, 1)) + FLOOR_PX * pixel
    by_nominal = PLACED_PX * pixel * math.sqrt(float((inverse[1] @ prior @ inverse[:, 1]).real))
    doubt = math.hypot(scatter * float(np.linalg.norm(by_offset)), by_nominal)
    return found, np.stack([by_offset.real, -by_offset.imag], axis=1), doubt
