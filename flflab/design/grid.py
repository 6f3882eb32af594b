"""The configurations to try, numbered: main lens and f-number, array, sensor, array distance, and
the distance in focus.

The gap follows from the rest: the sensor stands where a target at the focus distance is sharp.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.design.requirements import ArrayPart, LensPart, Requirements, SensorPart
from flflab.errors import InputError

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


COLUMNS = (
    "number_in_grid",
    "lens",
    "lens_focal",
    "f_number",
    "place",
    "gap",
    "focal",
    "pitch",
    "aperture",
)


@dataclass(frozen=True)
class Grid:
    """All configurations of a search.

    Attributes:
        lenses: every main lens with one of its f-numbers.
        arrays: the arrays.
        sensors: the sensors.
        places: distances of the array behind the main lens, mm, shape (n,).
        focus: distances in focus, mm, shape (m,).
        gap: least and most distance from array to sensor, mm.
    """

    lenses: tuple[tuple[LensPart, float], ...]
    arrays: tuple[ArrayPart, ...]
    sensors: tuple[SensorPart, ...]
    places: Array
    focus: Array
    gap: tuple[float, float]

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Sensors, arrays, lenses, focus distances, places."""
        return (
            len(self.sensors),
            len(self.arrays),
            len(self.lenses),
            len(self.focus),
            len(self.places),
        )

    @property
    def size(self) -> int:
        """How many configurations there are."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Candidates:
    """Configurations with one sensor and one array; arrays of shape (n,), lengths in mm.

    Attributes:
        sensor: the sensor.
        array: the microlens array.
        number_in_grid: their numbers in the grid.
        lens: which of the grid's lenses and f-numbers.
        lens_focal: its focal length.
        f_number: its f-number.
        place: main lens to array.
        gap: array to sensor.
        focal: focal length of the microlenses.
        pitch: of the array.
        aperture: of a microlens.
    """

    sensor: SensorPart
    array: ArrayPart
    number_in_grid: Whole
    lens: Whole
    lens_focal: Array
    f_number: Array
    place: Array
    gap: Array
    focal: Array
    pitch: Array
    aperture: Array

    def kept(self, which: npt.NDArray[np.bool_]) -> "Candidates":
        """Only those marked."""
        return replace(self, **{name: getattr(self, name)[which] for name in COLUMNS})

    @property
    def number(self) -> int:
        """How many they are."""
        return len(self.gap)


def make_grid(wanted: Requirements) -> Grid:
    """The grid that has about as many configurations as the requirements ask for: what parts leave
    over goes into the array's places.

    Raises:
        InputError: the parts alone make more configurations than asked for, or no place of the
            array forms a real image behind it.
    """
    lenses = tuple((lens, number) for lens in wanted.parts.main_lenses for number in lens.f_number)
    arrays, sensors = tuple(wanted.parts.arrays), tuple(wanted.parts.sensors)
    near, far = wanted.measure.depth
    steps = wanted.search.focus_steps
    focus = 1 / (
        np.linspace(1 / near, 1 / far, steps) if steps > 1 else np.array([(1 / near + 1 / far) / 2])
    )
    fixed = len(lenses) * len(arrays) * len(sensors) * steps
    count = wanted.search.configurations // fixed
    if count < 1:
        raise InputError(
            f"search.configurations is {wanted.search.configurations}, but the parts and {steps}"
            f" focus distances make {fixed} for every place of the array; ask for at least {fixed},"
            " or for fewer focus_steps"
        )
    low, high = wanted.travel.array or (0.0, 0.0)
    places = np.linspace(low, high, count) if count > 1 else np.array([(low + high) / 2])
    return Grid(lenses, arrays, sensors, places, focus, wanted.travel.gap or (0.0, math.inf))


def candidates(grid: Grid, first: int, last: int) -> list[Candidates]:
    """The configurations numbered from first to below last that can be built: a real gap within its
    range.

    In focus kappa x = b/L with kappa = 1 + b (1/L - 1/f) and x = L (V - 1/F + 1/L), so b = x / (1/L
    - x (1/L - 1/f)).
    """
    numbers = np.arange(first, min(last, grid.size))
    sensor, array, lens, focus, place = np.unravel_index(numbers, grid.shape)
    focal = np.array([part.focal_length for part, _ in grid.lenses])[lens]
    f_number = np.array([number for _, number in grid.lenses])[lens]
    L, V = grid.places[place], 1 / grid.focus[focus]
    f = np.array([part.focal_length for part in grid.arrays])[array]
    x = L * (V - 1 / focal + 1 / L)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = x / (1 / L - x * (1 / L - 1 / f))
    possible = np.isfinite(gap) & (gap >= grid.gap[0]) & (gap <= grid.gap[1]) & (gap > 0)
    found: list[Candidates] = []
    for at_sensor in range(len(grid.sensors)):
        for at_array in range(len(grid.arrays)):
            these = possible & (sensor == at_sensor) & (array == at_array)
            if these.any():
                part = grid.arrays[at_array]
                found.append(
                    Candidates(
                        sensor=grid.sensors[at_sensor],
                        array=part,
                        number_in_grid=numbers[these],
                        lens=lens[these].astype(np.int64),
                        lens_focal=focal[these],
                        f_number=f_number[these],
                        place=L[these],
                        gap=gap[these],
                        focal=f[these],
                        pitch=np.full(np.count_nonzero(these), part.pitch),
                        aperture=np.full(np.count_nonzero(these), part.aperture),
                    )
                )
    return found
