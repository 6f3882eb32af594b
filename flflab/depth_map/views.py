"""All that the steps of a depth map share: the picture, the microlenses and the grid of the map,
and sums over the views of its places.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.depth_map.geometry import KAPPA_STEPS, MicrolensKind
from flflab.depth_map.kernels import LENS, OPTICS, SUMS, Pixels, stretches_at, sum_costs, sum_scores
from flflab.depth_map.lenses import Lenses
from flflab.depth_map.normalise import Normalised
from flflab.errors import MeasurementError
from flflab.optics.camera import Camera, Sensor

Array = npt.NDArray[np.float64]

BAND_ROWS = 16
SMALLEST = 12  # rows and columns of a map


@dataclass(frozen=True)
class Grid:
    """Places of the map on the array: columns rise with the object's x, so t falls.

    Attributes:
        first: (x, y) of place [0, 0] on the array, px of the sensor.
        step: from one place to the next along x and y, px; negative.
        shape: rows and columns.
    """

    first: tuple[float, float]
    step: float
    shape: tuple[int, int]


def grid_behind(sensor: Sensor, camera: Camera, disparity: float) -> Grid:
    """A grid whose step is one pixel of the sensor at a virtual disparity.

    Raises:
        MeasurementError: the sensor is too small for a map.
    """
    step = 1 / abs(disparity)
    scale = 1 + camera.optical_gap / camera.optical_distance
    columns, rows = (int(size / scale / step) for size in sensor.resolution)
    if min(columns, rows) < SMALLEST:
        raise MeasurementError(
            f"picture: too small for a depth map: {sensor.resolution[0]} x {sensor.resolution[1]}"
            f" pixels make {columns} x {rows} places, at least {SMALLEST} a side are due"
        )
    middle = np.asarray(sensor.offset) / sensor.pixel / scale
    first = middle + step * (np.array([columns, rows]) - 1) / 2
    return Grid((float(first[0]), float(first[1])), -step, (rows, columns))


@dataclass(frozen=True)
class Views:
    """A normalised picture with the microlenses that took it.

    Attributes:
        picture: the normalised picture.
        lenses: a table of the microlenses, sorted by y.
        optics: lengths of the whole camera and the grid.
        tables: ``shift``, ``inside`` and ``variance`` of every kind of microlens, shape (3, kinds,
            steps).
        kinds: the kinds of microlenses.
        grid: the places of the map.
    """

    picture: Normalised
    lenses: npt.NDArray[np.void]
    optics: npt.NDArray[np.void]
    tables: Array
    kinds: tuple[MicrolensKind, ...]
    grid: Grid

    def coarse(self, every: int) -> "Views":
        """The same on a grid of every second, third, ... place: each stands for so many a side."""
        step = every * self.grid.step
        aside = (every - 1) / 2 * self.grid.step
        first = (self.grid.first[0] + aside, self.grid.first[1] + aside)
        rows, columns = (-(-size // every) for size in self.grid.shape)
        optics = self.optics.copy()
        optics["first_x"], optics["first_y"] = first
        optics["step"] = step
        return replace(self, optics=optics, grid=Grid(first, step, (rows, columns)))

    def costs(self, disparity: float) -> Array:
        """Sums over the views of every place at one disparity: weight, weighted value, weighted
        square, number; shape (4, rows, columns).
        """
        sums = np.zeros((4, *self.grid.shape))
        kappa = np.array([kind.kappa for kind in self.kinds])
        stretches = stretches_at(kappa + disparity, self.tables, float(self.optics[0]["per_table"]))

        def band(first: int, last: int) -> None:
            table = np.rec.array(self.lenses)
            sum_costs(
                table,
                self.optics[0],
                stretches,
                self.tables,
                *self._pixels(),
                disparity,
                first,
                last,
                sums,
            )

        self._in_bands(band)
        return sums

    def scores(self, disparity: Array) -> Array:
        """What the views of every place say about its disparity, see ``sum_scores``; zero where
        fewer than two views see it.
        """
        sums = np.zeros((SUMS, *self.grid.shape))

        def band(first: int, last: int) -> None:
            table = np.rec.array(self.lenses)
            sum_scores(
                table, self.optics[0], self.tables, *self._pixels(), disparity, first, last, sums
            )

        self._in_bands(band)
        return sums

    def _pixels(self) -> tuple[Pixels, Pixels, Pixels]:
        return self.picture.value, self.picture.curvature, self.picture.weight

    def _in_bands(self, work: Callable[[int, int], None]) -> None:
        rows = self.grid.shape[0]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(
                pool.map(
                    lambda first: work(first, min(first + BAND_ROWS, rows)),
                    range(0, rows, BAND_ROWS),
                )
            )


def views_of(
    picture: Normalised,
    lenses: Lenses,
    kinds: tuple[MicrolensKind, ...],
    grid: Grid,
    camera: Camera,
) -> Views:
    """Put a picture, its microlenses and a grid together."""
    pixel = camera.sensor.pixel
    table = np.zeros(len(lenses.x), dtype=LENS)
    for name in ("x", "y", "column", "row", "rise", "kind", "variance"):
        table[name] = getattr(lenses, name)
    for name in ("reach", "skew", "blur"):
        table[name] = np.array([getattr(kind, name) for kind in kinds])[lenses.kind]
    middle = len(KAPPA_STEPS) // 2
    own = np.array([kind.kappa for kind in kinds])[middle :: len(KAPPA_STEPS)]
    table["kappa"] = own[lenses.kind // len(KAPPA_STEPS)] * lenses.kappa_factor
    end = max(kind.table_end for kind in kinds)
    steps = len(kinds[0].shift)
    even = np.linspace(0, end, steps)
    tables = np.array(
        [
            [np.interp(even, np.linspace(0, kind.table_end, steps), values) for kind, values in one]
            for one in (
                [(kind, kind.shift) for kind in kinds],
                [(kind, kind.inside) for kind in kinds],
                [(kind, kind.variance) for kind in kinds],
            )
        ]
    )
    optics = np.zeros(1, dtype=OPTICS)
    optics["distance"] = camera.optical_distance / pixel
    optics["gap"] = camera.optical_gap / pixel
    optics["first_x"], optics["first_y"] = grid.first
    optics["step"] = grid.step
    optics["kappa"], optics["kappa_square"] = own.mean(), (own**2).mean()
    optics["per_table"] = (steps - 1) / end
    return Views(picture, table, optics, tables, kinds, grid)
