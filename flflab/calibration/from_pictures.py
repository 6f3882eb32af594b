"""From white and dot pictures at several settings to the bench that took them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.analysis.dots.views import count_views
from flflab.analysis.lattice.registration import lattice_behind
from flflab.analysis.lattice.white import Lattice
from flflab.analysis.sensor.noise import SensorNoise
from flflab.calibration.bench_model import BenchModel
from flflab.calibration.fit import Fit, fit_bench
from flflab.calibration.quantities import Quantities, measured_quantities
from flflab.errors import MeasurementError
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Pictures:
    """What was taken in one setting: DN, [row, col], and their noise; no dots where none were shown."""

    white: npt.NDArray[np.generic]
    white_noise: SensorNoise
    dots: npt.NDArray[np.generic] | None = None
    dots_noise: SensorNoise | None = None


def calibrate(model: BenchModel, pictures: Sequence[Pictures], target: FourDot) -> tuple[Fit, tuple[Quantities, ...]]:
    """Measure the pictures and fit the bench to them.

    Args:
        model: the bench as described, and one setting for each of ``pictures``.
        pictures: taken there.
        target: the dots.

    Raises:
        MeasurementError: a white picture shows no lattice, or there are fewer than two settings.
    """
    lattices: list[Lattice] = []
    for number, taken in enumerate(pictures):
        camera, _ = model.camera(model.nominal, number)
        lattices.append(lattice_behind(camera, taken.white, taken.white_noise))

    def measure(found: Array) -> tuple[Quantities, ...]:
        settings = enumerate(zip(pictures, lattices, strict=True))
        return tuple(_quantities(model, found, number, taken, lattice, target) for number, (taken, lattice) in settings)

    # the second pass looks at the dots with the camera that the first found: how they are blurred decides where their middle is
    first = fit_bench(model, measure(model.nominal))
    measured = measure(np.where(np.isfinite(first.values), first.values, model.nominal))
    return fit_bench(model, measured), measured


def _quantities(model: BenchModel, found: Array, number: int, taken: Pictures, lattice: Lattice, target: FourDot) -> Quantities:
    """Of one setting; without parallax and magnification where its dots are not seen."""
    camera, distance = model.camera(found, number)
    dots = None
    if taken.dots is not None and taken.dots_noise is not None:
        try:
            dots = count_views(taken.dots, taken.white, lattice, camera, target, distance, taken.dots_noise)
        except MeasurementError:
            dots = None
    return measured_quantities(lattice, dots, camera, target, distance)
