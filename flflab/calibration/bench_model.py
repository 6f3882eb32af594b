"""What the seven quantities of a setting should be, given what is not known of a bench: zeros and
scales of its stages, and its optics.

With L, b, D from the stages, V = 1/D, kappa = 1 + b/L - b/f, x = L V + 1 - L/F, w_m = A b/L, w_q =
d |kappa| (physics.md):

    pitch = p (1 + b/L)            outside, inside = |w_m +- w_q| / 2          centre = a (1 + b/L)
    - s parallax = 1 + b/L - b/(L x)   magnification = -b V / x

p and the pixel are the rulers across the axis; a, s: offsets of a microlens and of the sensor from
the axis.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]

ELEMENTS = ("main_lens.z", "array.z", "sensor.z", "target.z")
OPTICS = (
    "main_lens.focal_length", "microlens_array.focal_length", "microlens_array.aperture",
    "iris.scale",
    "sensor.offset.x", "sensor.offset.y", "microlens_array.offset.x", "microlens_array.offset.y",
)  # fmt: skip


@dataclass(frozen=True)
class Stage:
    """A stage that moves an element: world z = zero + sign * reading, and how well zero and scale
    are known; mm.
    """

    name: str
    element: str
    sign: int
    zero: float
    zero_uncertainty: float
    scale_uncertainty: float


@dataclass(frozen=True)
class Setting:
    """Where the bench stood: readings by stage, world z of what no stage moves, f-number by the
    iris's reading.
    """

    readings: Mapping[str, float]
    standing: Mapping[str, float]
    f_number: float


@dataclass(frozen=True)
class BenchModel:
    """A bench as described, and what of it is to be found.

    Attributes:
        optics: as described; its pitch and pixel are believed.
        stages: those that move an element.
        settings: where pictures were taken.
    """

    optics: Camera
    stages: tuple[Stage, ...]
    settings: tuple[Setting, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters, named as a simulated bench's truths: errors of zeros (mm) and scales,
        then the optics (mm; iris a share).
        """
        return (
            *(f"{stage.name}.{what}" for stage in self.stages for what in ("zero", "scale")),
            *OPTICS,
        )

    @property
    def nominal(self) -> Array:
        """The parameters as described."""
        optics = self.optics
        lenses = (
            optics.main_lens.focal_length,
            optics.array.focal_lengths[0],
            optics.array.aperture,
            0.0,
        )
        return np.array(
            [0.0, 0.0] * len(self.stages) + [*lenses, *optics.sensor.offset, *self._lens_offset]
        )

    @property
    def prior(self) -> Array:
        """Standard uncertainty of each parameter by the description: of the optics none,
        infinite.
        """
        known = [
            u for stage in self.stages for u in (stage.zero_uncertainty, stage.scale_uncertainty)
        ]
        return np.array(known + [np.inf] * len(OPTICS))

    @property
    def natural(self) -> Array:
        """What counts as much of each parameter: 1 mm of a zero, 1 % of a scale or of the optics,
        0.1 mm of an offset.
        """
        shares = 0.01 * np.append(self.nominal[2 * len(self.stages) :][:3], 1.0)
        return np.array([1.0, 0.01] * len(self.stages) + [*shares, 0.1, 0.1, 0.1, 0.1])

    @property
    def symmetries(self) -> dict[str, Array]:
        """Changes of the parameters, each in words, that no picture can show where every element
        has a stage.
        """
        optics = 2 * len(self.stages)
        shift, stretch = np.zeros(len(self.names)), np.zeros(len(self.names))
        lens = np.zeros(len(self.names))
        for number, stage in enumerate(self.stages):
            shift[2 * number] = 1.0
            stretch[2 * number], stretch[2 * number + 1] = 0.01 * stage.zero, 0.01
            readings = {setting.readings[stage.name] for setting in self.settings}
            if len(readings) == 1:
                lens[2 * number], lens[2 * number + 1] = -0.01 * stage.sign * readings.pop(), 0.01
        stretch[optics : optics + 2], stretch[optics + 3] = (
            0.01 * self.nominal[optics : optics + 2],
            0.01,
        )
        found = {
            "where on the axis the bench as a whole stands: all zeros shifted alike": shift,
            "a common scale of all lengths along the axis, in stages and focal lengths, with the iris as much wider: the rulers, pitch and pixel, lie across it": (  # noqa: E501
                stretch
            ),
        }
        return found | (
            {"zero and scale of a stage that never moved from one another": lens}
            if lens.any()
            else {}
        )

    @property
    def _lens_offset(self) -> tuple[float, float]:
        """Where the microlens nearest the array's middle lies, mm."""
        array = self.optics.array
        x, y = (
            offset + (0.0 if count % 2 else pitch / 2)
            for offset, count, pitch in zip(array.offset, array.count, array.pitch, strict=True)
        )
        return x, y

    def places(self, parameters: Array) -> dict[str, Array]:
        """True world z of every element in every setting, mm."""
        found = {
            element: np.array([setting.standing.get(element, 0.0) for setting in self.settings])
            for element in ELEMENTS
        }
        for number, stage in enumerate(self.stages):
            reading = np.array([setting.readings[stage.name] for setting in self.settings])
            zero, scale = parameters[2 * number : 2 * number + 2]
            found[stage.element] = stage.zero + zero + stage.sign * (1 + scale) * reading
        return found

    def camera(self, parameters: Array, setting: int) -> tuple[Camera, float]:
        """The camera in one setting, and the target's distance, mm.

        Raises:
            InputError: with these parameters it would be none.
        """
        z, optics = (
            {element: float(place[setting]) for element, place in self.places(parameters).items()},
            self.optics,
        )
        F, f, d, iris, *offsets = (float(value) for value in parameters[2 * len(self.stages) :])
        shift = np.asarray(optics.array.offset) - self._lens_offset
        lens = replace(
            optics.main_lens, focal_length=F, f_number=self.settings[setting].f_number * (1 + iris)
        )
        array = replace(
            optics.array,
            focal_lengths=(f, *optics.array.focal_lengths[1:]),
            aperture=d,
            distance=z["array.z"] - z["main_lens.z"],
            offset=(offsets[2] + float(shift[0]), offsets[3] + float(shift[1])),
        )
        sensor = replace(
            optics.sensor,
            distance=z["sensor.z"] - z["main_lens.z"],
            offset=(offsets[0], offsets[1]),
        )
        return (
            replace(optics, main_lens=lens, array=array, sensor=sensor),
            z["main_lens.z"] - z["target.z"],
        )

    def quantities(self, parameters: Array) -> Array:
        """The quantities expected, in the order of ``quantities.NAMES``, shape (settings, 7);
        centres of the microlens nearest the axis.
        """
        z, optics = self.places(parameters), self.optics
        F, f, d, iris, *offsets = parameters[2 * len(self.stages) :]
        L = z["array.z"] - z["main_lens.z"] + optics.optical_distance - optics.array.distance
        b = z["sensor.z"] - z["array.z"] + optics.optical_gap - optics.gap
        V = 1 / (z["main_lens.z"] - z["target.z"])
        A = F / (np.array([setting.f_number for setting in self.settings]) * (1 + iris))
        x, lens, microlens = L * V + 1 - L / F, A * b / L, d * np.abs(1 + b / L - b / f)
        scale = 1 + b / L
        columns = (
            optics.array.pitch[0] * scale, (lens + microlens) / 2, np.abs(lens - microlens) / 2,
            offsets[2] * scale - offsets[0], offsets[3] * scale - offsets[1], scale - b / (L * x),
            -b * V / x,
        )  # fmt: skip
        return np.stack(columns, axis=1)

    def start(self, measured: Array, angles: Sequence[float]) -> Array:
        """The parameters as described, but with offsets by which the centres measured move as the
        pitch does.

        centre = a P/p - s for one and the same microlens, so the centres' slope over P/p gives a
        and s, whatever the lattice hides.
        """
        scale, first = measured[:, 0] / self.optics.array.pitch[0], measured[0, 3:5] @ [1, 1j]
        centres = np.array([
            first + _nearest(row[3:5] @ [1, 1j] - first, row[0], angle) for row,
            angle in zip(measured, angles, strict=True)
        ])  # fmt: skip
        parameters = self.nominal
        if np.ptp(scale) > 0:
            a, s = np.linalg.lstsq(
                np.stack([scale, -np.ones_like(scale)], axis=1), centres, rcond=None
            )[0]
            described = complex(*self._lens_offset)
            a = described + _nearest(a - described, self.optics.array.pitch[0], angles[0])
            parameters[-4:] = s.real, s.imag, a.real, a.imag
        return parameters

    def residuals(self, parameters: Array, measured: Array, angles: Sequence[float]) -> Array:
        """Measured less expected, shape (settings, 7); a centre counts modulo the lattice, which
        lies at these angles, rad.
        """
        rest = measured - self.quantities(parameters)
        for row, pitch, angle in zip(rest, measured[:, 0], angles, strict=True):
            left = _nearest(row[3:5] @ [1, 1j], pitch, angle)
            row[3:5] = left.real, left.imag
        return rest


def _nearest(away: complex, pitch: float, angle: float) -> complex:
    """What is left of a displacement after the nearest point of a square lattice at an angle."""
    turned = away * np.exp(-1j * angle) / pitch
    left = turned - np.round(turned.real) - 1j * np.round(turned.imag)
    return complex(left * pitch * np.exp(1j * angle))
