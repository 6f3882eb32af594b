"""From white and dot pictures at several settings to the bench that took them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.calibration.bench_model import BenchModel
from flflab.calibration.fit import Fit, fit_bench
from flflab.calibration.quantities import Quantities, measured_quantities
from flflab.errors import InputError, MeasurementError
from flflab.measurement.dots.views import count_views
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]

# reduced chi^2: nothing that only widens uncertainties makes them five times what is stated
INCREDIBLE = 25.0


@dataclass(frozen=True)
class Pictures:
    """What was taken in one setting: DN, [row, col], and their noise; no dots where none were
    shown.
    """

    white: npt.NDArray[np.generic]
    white_noise: SensorNoise
    dots: npt.NDArray[np.generic] | None = None
    dots_noise: SensorNoise | None = None


def calibrate(
    model: BenchModel, pictures: Sequence[Pictures], target: FourDot
) -> tuple[Fit, tuple[Quantities, ...]]:
    """Measure the pictures and fit the bench to them.

    Args:
        model: the bench as described, and one setting for each of ``pictures``.
        pictures: taken there.
        target: the dots.

    Raises:
        MeasurementError: a white picture shows no lattice, there are fewer than two settings, or no
            such bench explains the pictures.
    """
    lattices: list[Lattice] = []
    for number, taken in enumerate(pictures):
        camera, _ = model.camera(model.nominal, number)
        lattices.append(lattice_behind(camera, taken.white, taken.white_noise))

    def measure(shown: Sequence[Pictures], believed: Array) -> tuple[Quantities, ...]:
        settings = enumerate(zip(shown, lattices, strict=True))
        return tuple(
            _quantities(model, believed, number, taken, lattice, target)
            for number, (taken, lattice) in settings
        )

    # how dots are blurred decides where their middle is: they are looked at with the camera that
    # the white pictures show, where zeros are far off no other, and once more with what dots add to
    # that
    measured = measure([replace(taken, dots=None) for taken in pictures], model.nominal)
    found = fit_bench(model, measured)
    for _ in range(2):
        believed = np.where(np.isfinite(found.values), found.values, model.nominal)
        try:
            measured = measure(pictures, believed)
        except InputError as error:  # what was found is no camera
            raise _incredible(found) from error
        found = fit_bench(model, measured)
    if found.chi2 > INCREDIBLE:
        raise _incredible(found)
    return found, measured


def _incredible(found: Fit) -> MeasurementError:
    return MeasurementError(
        "calibration: no zeros, scales and optics explain the pictures: reduced chi-square"
        f" {found.chi2:.4g}, where noise leaves up to {found.most_by_noise:.2f} and up to"
        f" {INCREDIBLE:g} is accepted; the largest misfit is {found.farthest}; look at that"
        " picture, and at the pitch, pixel and dots of the files, which are taken as exact"
    )


def _quantities(
    model: BenchModel, found: Array, number: int, taken: Pictures, lattice: Lattice, target: FourDot
) -> Quantities:
    """Of one setting; without parallax and magnification where its dots are not seen."""
    camera, distance = model.camera(found, number)
    dots = None
    if taken.dots is not None and taken.dots_noise is not None:
        try:
            dots = count_views(taken.dots, lattice, camera, target, distance, taken.dots_noise)
        except MeasurementError:
            dots = None
    return measured_quantities(lattice, dots, camera, target, distance)
