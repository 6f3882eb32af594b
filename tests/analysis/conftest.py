"""Pictures made here by brute force: textbook disc overlap at 5 x 5 points of every pixel, sharing no code with the package."""

import math

import numba
import numpy as np
import numpy.typing as npt
import pytest

from flflab.analysis.noise import SensorNoise

Array = npt.NDArray[np.float64]
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@numba.njit(cache=True)
def _overlap(d: float, a: float, b: float) -> float:
    if d >= a + b:
        return 0.0
    if d <= abs(a - b):
        return min(a, b) ** 2 / b**2
    alpha = math.acos((d * d + a * a - b * b) / (2 * d * a))
    beta = math.acos((d * d + b * b - a * a) / (2 * d * b))
    area = a * a * (alpha - math.sin(2 * alpha) / 2) + b * b * (beta - math.sin(2 * beta) / 2)
    return area / (math.pi * b * b)


@numba.njit(cache=True)
def _white(shape: tuple[int, int], centres: Array, a: float, b: float, nodes: Array, weights: Array) -> Array:
    picture = np.zeros(shape)
    reach = a + b + 1
    for n in range(len(centres)):
        cx, cy = centres[n]
        for row in range(max(0, math.ceil(cy - reach)), min(shape[0] - 1, math.floor(cy + reach)) + 1):
            for column in range(max(0, math.ceil(cx - reach)), min(shape[1] - 1, math.floor(cx + reach)) + 1):
                r = math.hypot(column - cx, row - cy)
                if r < abs(a - b) - 1:
                    picture[row, column] += min(a, b) ** 2 / b**2
                    continue
                for k in range(len(nodes)):
                    for m in range(len(nodes)):
                        d = math.hypot(column + nodes[k] / 2 - cx, row + nodes[m] / 2 - cy)
                        picture[row, column] += weights[k] * weights[m] / 4 * _overlap(d, a, b)
    return picture


class Brute:
    """Makers of pictures, handed to tests."""

    @staticmethod
    def vectors_of(layout: str, pitch: float, angle: float) -> Array:
        """Lattice vectors as columns."""
        turn = angle + (math.pi / 2 if layout == "square" else math.pi / 3)
        return pitch * np.array([[math.cos(angle), math.cos(turn)], [math.sin(angle), math.sin(turn)]])

    @staticmethod
    def lattice_points(shape: tuple[int, int], vectors: Array, origin: tuple[float, float], reach: float) -> Array:
        """Every lattice point of which a disc of radius ``reach`` touches the picture's bounding box."""
        n = np.arange(-400, 401)
        i, j = (grid.ravel() for grid in np.meshgrid(n, n))
        points = np.asarray(origin) + np.stack([i, j], 1) @ vectors.T
        near = np.all((points > -0.5 - reach) & (points < np.array([shape[1], shape[0]]) - 0.5 + reach), axis=1)
        return points[near]

    @staticmethod
    def white_picture(
        shape: tuple[int, int], layout: str, pitch: float, angle: float, origin: tuple[float, float], a: float, b: float,
    ) -> Array:
        """White picture, 1 at the middle of a micro-image; a, b: radii of the two discs, px."""
        centres = Brute.lattice_points(shape, Brute.vectors_of(layout, pitch, angle), origin, a + b)
        return _white(shape, centres, a, b, _NODES, _WEIGHTS)

    @staticmethod
    def expose(image: Array, noise: SensorNoise, level: float, rng: np.random.Generator) -> npt.NDArray[np.uint16]:
        """A noisy picture in DN of an image in units of the white level, which reads ``level`` DN above the offset."""
        electrons = rng.poisson(image * level / noise.dn_per_electron)
        dn = electrons * noise.dn_per_electron + noise.offset_dn + rng.normal(0, noise.read_noise_dn, image.shape)
        return np.clip(np.rint(dn), 0, noise.full_scale_dn).astype(np.uint16)


@pytest.fixture(scope="session")
def brute() -> type[Brute]:
    """The makers of pictures."""
    return Brute
