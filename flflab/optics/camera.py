"""What the camera is made of: main lens, microlens array and sensor as frozen descriptions, and
where the microlenses lie.
"""

import math
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.optics.distortion import BrownDistortion

Array = npt.NDArray[np.float64]
Layout = Literal["square", "hexagonal"]
# Widest micro-image in pitches: a point of the sensor then has the light of some 500 microlenses,
# which no camera has use for.
WIDEST = 25.0
ApertureShape = Literal["round", "square"]


@dataclass(frozen=True)
class MainLens:
    """The main lens; lengths in mm.

    Object distances count from its front principal plane, all distances behind it from its rear
    one, at z = 0. A thin lens has both in one place; ``principal_separation`` (rear minus front,
    negative where they are crossed) only says how far apart they lie. ``distortion`` is beyond
    first order: only positions measured elsewhere are compared with it.
    """

    focal_length: float
    f_number: float
    principal_separation: float = 0.0
    distortion: BrownDistortion | None = None

    @property
    def aperture(self) -> float:
        """Diameter of the stop in mm."""
        return self.focal_length / self.f_number


@dataclass(frozen=True)
class Substrate:
    """The glass plate that carries the microlenses: ``thickness`` in mm, refractive ``index``, on
    which ``side`` of the lenses.

    Distances to the array are air, up to the nearest face of plate or lenses; the plate adds
    thickness/index to the optical one.
    """

    thickness: float
    index: float
    side: Literal["sensor", "main lens"] = "sensor"


@dataclass(frozen=True)
class MicrolensArray:
    """The microlens array; lengths in mm, angles in rad.

    ``pitch`` is (x, y): along a row, and between nearest neighbours of adjacent rows scaled so that
    equal numbers mean a regular lattice (hexagonal rows lie pitch_y sqrt(3)/2 apart). ``pattern``
    is a tile of indices into ``focal_lengths``, indexed [row % rows of the tile, column % columns
    of the tile]. ``distance`` is behind the main lens. ``tilt`` is the slope of the array's plane
    along (x, y): the microlens at (x, y) lies tilt_x x + tilt_y y further from the main lens.
    """

    layout: Layout
    count: tuple[int, int]
    pitch: tuple[float, float]
    aperture: float
    focal_lengths: tuple[float, ...]
    distance: float
    pattern: tuple[tuple[int, ...], ...] = ((0,),)
    offset: tuple[float, float] = (0.0, 0.0)
    roll: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    substrate: Substrate | None = None


@dataclass(frozen=True)
class Sensor:
    """The sensor: (columns, rows), square pixels in mm, behind the main lens by ``distance`` mm."""

    resolution: tuple[int, int]
    pixel: float
    distance: float
    offset: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Useful:
    """Which part of a micro-image counts: least relative illumination, and most crosstalk from
    neighbours.
    """

    minimum_illumination: float = 0.0
    maximum_crosstalk: float = 0.0


@dataclass(frozen=True)
class Camera:
    """A focused light field camera: everything the model needs and nothing else."""

    main_lens: MainLens
    array: MicrolensArray
    sensor: Sensor
    aperture_shape: ApertureShape = "round"
    useful: Useful = Useful()

    def __post_init__(self) -> None:
        """Refuse what is not a camera.

        Raises:
            InputError: a length is not positive or finite, the sensor is not behind the array, or
                the pattern points nowhere.
        """
        for path, value in _numbers(self, ""):
            if not math.isfinite(value):
                raise InputError(f"camera: {path} is {value}; a finite number is due")
        positive = {
            "main_lens.focal_length": self.main_lens.focal_length,
            "main_lens.f_number": self.main_lens.f_number,
            "microlens_array.pitch x": self.array.pitch[0],
            "microlens_array.pitch y": self.array.pitch[1],
            "microlens_array.aperture": self.array.aperture,
            "microlens_array.distance": self.array.distance,
            "sensor.pixel": self.sensor.pixel,
            "microlens_array.count": min(self.array.count),
            "sensor.resolution": min(self.sensor.resolution),
        }
        for path, value in positive.items():
            if value <= 0:
                raise InputError(f"camera: {path} is {value:g}; a number above 0 is due")
        if any(f == 0 for f in self.array.focal_lengths) or not self.array.focal_lengths:
            raise InputError(
                "camera: microlens_array.focal_length needs at least one focal length, none of"
                " them 0"
            )
        if self.sensor.distance <= self.array.distance:
            raise InputError(
                f"camera: sensor.distance is {self.sensor.distance:g} mm, in front of or on the"
                f" array at {self.array.distance:g} mm; the sensor lies behind the"
                f" array{_units_in_doubt(self.sensor.distance, self.array.distance)}"
            )
        plate = self.array.substrate
        if plate is not None and plate.thickness < 0:
            raise InputError(
                f"camera: microlens_array.substrate.thickness is {plate.thickness:g} mm; 0 mm or"
                " more is due"
            )
        if plate is not None and plate.index < 1:
            raise InputError(
                f"camera: microlens_array.substrate.refractive_index is {plate.index:g}; 1 or more"
                " is due"
            )
        nearest = nearest_neighbour(self.array)
        if self.array.aperture > nearest * (1 + 1e-9):
            raise InputError(
                f"camera: microlens_array.aperture is {self.array.aperture:g} mm, wider than the"
                f" {nearest:g} mm between neighbours; the pitch at most is"
                f" allowed{_units_in_doubt(self.array.aperture, nearest)}"
            )
        types = len(self.array.focal_lengths)
        if not self.array.pattern or any(
            not 0 <= kind < types for row in self.array.pattern for kind in row
        ):
            raise InputError(
                f"camera: microlens_array.pattern must be rows of indices from 0 to {types - 1}"
            )
        if len({len(row) for row in self.array.pattern}) != 1 or not self.array.pattern[0]:
            raise InputError(
                "camera: microlens_array.pattern must be rows of one and the same length"
            )
        for path, share in (
            ("minimum_illumination", self.useful.minimum_illumination),
            ("maximum_crosstalk", self.useful.maximum_crosstalk),
        ):
            if not 0 <= share <= 1:
                raise InputError(f"camera: useful.{path} is {share:g}; a share from 0 to 1 is due")
        _refuse_boundless_light(self)

    @property
    def gap(self) -> float:
        """Air from the array to the sensor, mm."""
        return self.sensor.distance - self.array.distance

    @property
    def optical_distance(self) -> float:
        """L, main lens to microlenses, mm: the air and, where the plate faces the main lens, its
        thickness over its index.
        """
        return self.array.distance + self._plate("main lens")

    @property
    def optical_gap(self) -> float:
        """b, microlenses to sensor, mm: the air and, where the plate faces the sensor, its
        thickness over its index.
        """
        return self.gap + self._plate("sensor")

    def _plate(self, side: str) -> float:
        plate = self.array.substrate
        return plate.thickness / plate.index if plate is not None and plate.side == side else 0.0


def nearest_neighbour(array: MicrolensArray) -> float:
    """Distance between the centres of the nearest two places of the lattice, mm."""
    x, y = array.pitch
    return min(x, math.hypot(x / 2, y * math.sqrt(0.75)) if array.layout == "hexagonal" else y)


def _units_in_doubt(value: float, other: float) -> str:
    """How a sentence about two lengths ends where one is about a thousand times the other."""
    doubtful = 300 * value < other < 3000 * value or 300 * other < value < 3000 * other
    return "; check the units of both" if doubtful else ""


def _refuse_boundless_light(camera: Camera) -> None:
    """Refuse micro-images that cover a large part of the array: with a length in the wrong unit
    each lies in the light of all others.

    The total field is A b/L + d |1 + b/L - b/f| wide, the pitch of the micro-images p (1 + b/L).

    Raises:
        InputError: a micro-image is wider than ``WIDEST`` pitches.
    """
    given = {
        "main_lens.focal_length": camera.main_lens.focal_length,
        "microlens_array.focal_length": min(camera.array.focal_lengths, key=abs),
        "microlens_array.pitch": nearest_neighbour(camera.array),
        "microlens_array.distance": camera.optical_distance,
        "sensor.distance": camera.optical_distance + camera.optical_gap,
    }

    def judge(F: float, f: float, p: float, L: float, behind: float) -> tuple[float, float]:
        """Width in pitches, and how far it, L/F and b/f are from 1."""
        b = behind - L
        if b <= 0:
            return math.inf, math.inf
        d = min(camera.array.aperture, p)
        field = F / camera.main_lens.f_number * b / L + d * abs(1 + b / L - b / f)
        width = field / (p * (1 + b / L))
        return width, sum(abs(math.log(abs(part) + 1e-300)) for part in (width, L / F, b / f))

    width, _ = judge(*given.values())
    if width <= WIDEST or not math.isfinite(width):
        return
    slips = [
        (judge(*{**given, name: value * factor}.values())[1], name, value, factor)
        for name, value in given.items()
        for factor in (1e3, 1e-3)
    ]
    _, name, value, factor = min(slips)
    raise InputError(
        f"camera: {name} is {value:g} mm; was {value * factor:g} mm meant (um for mm, or mm for"
        f" um)? A micro-image would be {width:,.0f} pitches of the array wide, {WIDEST:g} at most"
        " is allowed"
    )


def _numbers(part: Any, path: str) -> list[tuple[str, float]]:
    """Every number inside a frozen description with the path that names it."""
    if is_dataclass(part):
        return [
            found
            for field in fields(part)
            for found in _numbers(getattr(part, field.name), f"{path}.{field.name}".lstrip("."))
        ]
    if isinstance(part, tuple):
        return [
            found for index, item in enumerate(part) for found in _numbers(item, f"{path}[{index}]")
        ]  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
    return [(path, float(part))] if isinstance(part, (int, float)) else []


def microlens_indices(array: MicrolensArray) -> npt.NDArray[np.int64]:
    """(column, row) of every microlens, row by row, shape (N, 2)."""
    columns, rows = array.count
    row, column = np.divmod(np.arange(columns * rows, dtype=np.int64), columns)
    return np.stack([column, row], axis=1)


def microlens_centres(array: MicrolensArray) -> Array:
    """Centres (x, y) of every microlens in mm, row by row, shape (N, 2); the middle of the array
    lies at its offset.

    Hexagonal: microlens (k, l) lies at (pitch_x (k - (l mod 2)/2), pitch_y l sqrt(3)/2) before
    centring.
    """
    column, row = microlens_indices(array).T.astype(np.float64)
    if array.layout == "hexagonal":
        column = column - 0.5 * (row % 2)
        row = row * (math.sqrt(3) / 2)
    x = array.pitch[0] * (column - (column.min() + column.max()) / 2)
    y = array.pitch[1] * (row - (row.min() + row.max()) / 2)
    cos, sin = math.cos(array.roll), math.sin(array.roll)
    return np.stack(
        [cos * x - sin * y + array.offset[0], sin * x + cos * y + array.offset[1]], axis=1
    )


def microlens_types(array: MicrolensArray) -> npt.NDArray[np.int64]:
    """Index into ``focal_lengths`` of every microlens, row by row, shape (N,)."""
    tile = np.asarray(array.pattern, dtype=np.int64)
    column, row = microlens_indices(array).T
    return tile[row % tile.shape[0], column % tile.shape[1]]


def pixel_positions(sensor: Sensor) -> tuple[Array, Array]:
    """World x of the pixel columns and y of the pixel rows (centres) in mm: shapes (columns,) and
    (rows,).

    Columns rise with x and rows with y; the middle of the sensor lies at its offset.
    """
    columns, rows = sensor.resolution
    x = (np.arange(columns, dtype=np.float64) - (columns - 1) / 2) * sensor.pixel + sensor.offset[0]
    y = (np.arange(rows, dtype=np.float64) - (rows - 1) / 2) * sensor.pixel + sensor.offset[1]
    return x, y
