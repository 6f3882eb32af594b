"""What stands in front of the camera: each target knows its own truth, the radiance at (x, y) mm
from its centre, from 0 to 1.
"""

import dataclasses
import math
from dataclasses import dataclass, fields
from typing import ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError

Array = npt.NDArray[np.float64]
CYCLES_AT_MOST = 100_000.0  # a table of this many cycles is still small

TEXELS = 16, 8192  # a side of a texture
COARSEST = 10.0  # cycles over a texture's width of its coarsest detail
RMS_CONTRAST = 0.2  # of a texture, of full radiance


def _refuse(target: "Target", field: str, value: object, allowed: str) -> InputError:
    return InputError(f"target '{target.kind}': {field} is {value}; {allowed} is due")


def _require_positive(target: "Target", **values: float) -> None:
    for field, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise _refuse(target, field, f"{value:g}", "a finite number above 0")


@dataclass(frozen=True)
class FourDot:
    """White discs of one ``diameter`` on black, centred at (+-spacing/2, +-spacing/2); mm."""

    diameter: float = 1.0
    spacing: float = 8.0
    kind: ClassVar[str] = "four-dot"

    def __post_init__(self) -> None:
        """Refuse dots without a size, and dots that overlap.

        Raises:
            InputError: see there.
        """
        _require_positive(self, diameter=self.diameter, spacing=self.spacing)
        if self.spacing < self.diameter:
            raise _refuse(
                self,
                "spacing",
                f"{self.spacing:g} mm",
                f"at least the diameter, {self.diameter:g} mm,",
            )

    @property
    def centres(self) -> Array:
        """Centres of the dots in mm, shape (4, 2), in the order (-,-), (+,-), (-,+), (+,+)."""
        return self.spacing / 2 * np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])

    def radiance(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Truth at (x, y) mm: 1 on the closed discs, else 0."""
        to_centre = np.hypot(
            np.abs(np.asarray(x, dtype=float)) - self.spacing / 2,
            np.abs(np.asarray(y, dtype=float)) - self.spacing / 2,
        )
        return (to_centre <= self.diameter / 2).astype(np.float64)


@dataclass(frozen=True)
class Bars:
    """Square bars across x, their frequency linear in x from the left edge to the right; centred,
    black around.

    ``cycles_per_mm`` is (left, right); ``width`` (along x) and ``height`` in mm.
    """

    cycles_per_mm: tuple[float, float] = (0.5, 10.0)
    width: float = 20.0
    height: float = 20.0
    kind: ClassVar[str] = "bars"

    def __post_init__(self) -> None:
        """Refuse bars without frequency or size.

        Raises:
            InputError: see there.
        """
        left, right = self.cycles_per_mm
        _require_positive(
            self,
            cycles_per_mm_left=left,
            cycles_per_mm_right=right,
            width=self.width,
            height=self.height,
        )
        if self.cycles > CYCLES_AT_MOST:
            raise _refuse(
                self,
                "width times mean cycles_per_mm",
                f"{self.cycles:g}",
                f"at most {CYCLES_AT_MOST:g} cycles",
            )

    @property
    def cycles(self) -> float:
        """Number of cycles from the left edge to the right."""
        return self.width * (self.cycles_per_mm[0] + self.cycles_per_mm[1]) / 2

    def frequency(self, x: npt.ArrayLike) -> Array:
        """Cycles/mm at x mm from the centre."""
        left, right = self.cycles_per_mm
        return left + (right - left) * (np.asarray(x, dtype=float) / self.width + 0.5)

    def phase(self, x: npt.ArrayLike) -> Array:
        """Cycles from the left edge to x mm from the centre."""
        left, right = self.cycles_per_mm
        along = np.asarray(x, dtype=float) + self.width / 2
        return along * (left + (right - left) * along / (2 * self.width))

    def position(self, phase: npt.ArrayLike) -> Array:
        """Inverse of ``phase``: mm from the centre where so many cycles have passed."""
        left, right = self.cycles_per_mm
        cycles = np.asarray(phase, dtype=float)
        return (
            2 * cycles / (left + np.sqrt(left**2 + 2 * (right - left) / self.width * cycles))
            - self.width / 2
        )

    def profile(self, phase: npt.ArrayLike) -> Array:
        """Radiance against phase in cycles: 1 where sin(2 pi phase) >= 0, else 0."""
        cycles = np.asarray(phase, dtype=float)
        return (cycles - np.floor(cycles) <= 0.5).astype(np.float64)

    def radiance(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Truth at (x, y) mm: the profile inside width and height, else 0."""
        across, up = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        inside = (np.abs(across) <= self.width / 2) & (np.abs(up) <= self.height / 2)
        return np.where(inside, self.profile(self.phase(across)), 0.0)


@dataclass(frozen=True)
class BarsAlongY(Bars):
    """The chart of bars turned by a quarter turn: bars across y, their frequency rising with y;
    ``width`` is along y, ``height`` along x.
    """

    kind: ClassVar[str] = "bars-y"

    @property
    def unturned(self) -> Bars:
        """The same chart as it is with its bars across x."""
        return Bars(self.cycles_per_mm, self.width, self.height)

    def radiance(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Truth at (x, y) mm: the profile along y inside width and height, else 0."""
        return super().radiance(y, x)


@dataclass(frozen=True)
class Chirp(Bars):
    """The sine of the same law: radiance (1 + sin(2 pi phase)) / 2 inside width and height, black
    around.
    """

    kind: ClassVar[str] = "chirp"

    def profile(self, phase: npt.ArrayLike) -> Array:
        """Radiance against phase in cycles."""
        return 0.5 + 0.5 * np.sin(2 * np.pi * np.asarray(phase, dtype=float))


@dataclass(frozen=True)
class Edge:
    """A boundless straight edge through the centre, turned by ``angle`` rad from the y axis away
    from +x; white on the +x side.
    """

    angle: float = math.radians(5)
    kind: ClassVar[str] = "edge"

    def __post_init__(self) -> None:
        """Refuse an angle that is no number.

        Raises:
            InputError: see there.
        """
        if not math.isfinite(self.angle):
            raise _refuse(self, "angle", self.angle, "a finite angle")

    def radiance(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Truth at (x, y) mm: 1 where x cos(angle) + y sin(angle) >= 0, else 0."""
        side = np.asarray(x, dtype=float) * math.cos(self.angle) + np.asarray(
            y, dtype=float
        ) * math.sin(self.angle)
        return (side >= 0).astype(np.float64)


@dataclass(frozen=True)
class White:
    """White without bounds."""

    kind: ClassVar[str] = "white"

    def radiance(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Truth at (x, y): 1 everywhere."""
        return np.ones(np.broadcast_shapes(np.shape(x), np.shape(y)))


@dataclass(frozen=True)
class Black:
    """No light at all."""

    kind: ClassVar[str] = "black"

    def radiance(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Truth at (x, y): 0 everywhere."""
        return np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))


@dataclass(frozen=True, eq=False)
class Picture:
    """Any picture, ``width`` mm wide, centred, black around; square texels of one radiance each.

    ``values`` from 0 to 1, indexed [row, column]; columns rise with x and rows with y.
    """

    values: Array
    width: float
    kind: ClassVar[str] = "picture"

    def __post_init__(self) -> None:
        """Refuse a picture that is none.

        Raises:
            InputError: the values are not a matrix of finite numbers from 0 to 1, or the width is
                not positive.
        """
        _require_positive(self, width=self.width)
        if self.values.ndim != 2 or self.values.size == 0:
            raise _refuse(
                self, "shape of values", self.values.shape, "(rows, columns) of a grey picture"
            )
        if not np.all((self.values >= 0) & (self.values <= 1)):
            raise _refuse(
                self,
                "values",
                "partly outside 0 to 1 or not finite",
                "a radiance from 0 to 1 everywhere",
            )

    @property
    def texel(self) -> float:
        """Side of a texel in mm."""
        return self.width / self.values.shape[1]

    @property
    def height(self) -> float:
        """Height in mm."""
        return self.texel * self.values.shape[0]

    def radiance(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Truth at (x, y) mm: the value of the texel there, 0 outside."""
        across, up = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        rows, columns = self.values.shape
        column = np.floor((across + self.width / 2) / self.texel)
        row = np.floor((up + self.height / 2) / self.texel)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return np.where(
            inside,
            self.values[
                np.where(inside, row, 0).astype(int), np.where(inside, column, 0).astype(int)
            ],
            0.0,
        )


@dataclass(frozen=True)
class Texture(Picture):
    """A random texture, to be printed and put before the camera: depth is seen wherever there is
    some.

    Every octave of detail, from ``grain`` up to a tenth of the width, has the same share of the
    contrast, so that there is detail at every distance. One seed is one texture, on every machine.

    ``width`` and height in mm, ``grain`` is the side of a texel in mm.
    """

    values: Array = dataclasses.field(init=False, repr=False, compare=False)
    width: float = 60.0
    grain: float = 0.06
    seed: int = 0
    kind: ClassVar[str] = "texture"

    def __post_init__(self) -> None:
        """Draw the texture.

        Raises:
            InputError: width or grain is not positive, the texture has too few or too many texels,
                or the seed is below 0.
        """
        _require_positive(self, width=self.width, grain=self.grain)
        side = round(self.width / self.grain)
        if not TEXELS[0] <= side <= TEXELS[1]:
            raise _refuse(
                self,
                "width over grain",
                f"{self.width / self.grain:g}",
                f"a number of texels from {TEXELS[0]} to {TEXELS[1]}",
            )
        if self.seed < 0:
            raise _refuse(self, "seed", self.seed, "a whole number from 0")
        object.__setattr__(self, "values", _random_texture(side, self.seed))
        super().__post_init__()


def _random_texture(side: int, seed: int) -> Array:
    """Radiance of random texels about 0.5; power falls as 1/frequency^2, which is equal shares an
    octave in two dimensions.
    """
    rng = np.random.Generator(np.random.Philox(key=seed))
    noise = np.fft.rfft2(rng.random((side, side)) - 0.5)
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :])
    slowest = COARSEST / side
    shape = np.where(frequency >= slowest, 1 / np.maximum(frequency, slowest), 0.0)
    even = np.fft.irfft2(noise * shape, s=(side, side))
    # six decimals: the last digit of a Fourier transform is another one on another machine
    return np.round(np.clip(0.5 + RMS_CONTRAST * even / np.std(even), 0.0, 1.0), 6)


Target: TypeAlias = FourDot | Bars | Chirp | Edge | White | Black | Picture


def describe(target: Target) -> str:
    """One line for people: the kind and its numbers."""
    numbers = ", ".join(
        f"{field.name} {getattr(target, field.name)}"
        for field in fields(target)
        if field.name != "values"
    )
    return f"{target.kind} ({numbers})" if numbers else target.kind
