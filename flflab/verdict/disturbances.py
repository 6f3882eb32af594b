"""What may disturb a measurement besides the bench's geometry, as suspects of ``diagnose``:
diffraction, blur, an unsteady lamp.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench
from flflab.optics.airy import diffraction_contrast
from flflab.verdict.diagnosis import Effect
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Values

Array = npt.NDArray[np.float64]
Factor = Callable[[int, Array], Array]  # configuration's place, frequencies in cycles/px
WAVELENGTHS = np.linspace(300e-6, 900e-6, 25)  # mm
BLURS = np.linspace(0.0, 2.0, 41)  # px, standard deviation
DRIFTS = np.linspace(-0.3, 0.3, 61)  # of the light over the run, a share


def disturbances(
    values: list[Values],
    measured: tuple[Measured, ...],
    predicted: tuple[Predicted, ...],
    bench: Bench,
) -> tuple[Effect, ...]:
    """Those that can be in question: diffraction only where the bench file states no light, a lamp
    only where light is compared.

    Args:
        values: the numbers that are explained, with the model's draws.
        measured: every configuration.
        predicted: the same.
        bench: as described.
    """
    place = {one.configuration.index: k for k, one in enumerate(measured)}

    def on_contrast(factor_of: Callable[[float], Factor]) -> Callable[[Array], Array]:
        def expected(sizes: Array) -> Array:
            return np.stack([_joined(values, "mtf", _of_curve(factor_of(size))) for size in sizes])

        def _of_curve(factor: Factor) -> Callable[[Values], Array]:
            def read(one: Values) -> Array:
                k = place[one.configuration]
                curve = measured[k].curve
                return np.ones(1) if curve is None else factor(k, curve.cycles_per_px)

            return read

        return expected

    def diffracted(wavelength: float) -> Factor:
        return lambda k, frequencies: diffraction_contrast(
            predicted[k].camera, predicted[k].distance, frequencies, wavelength
        )

    def blurred(sigma: float) -> Factor:
        return lambda k, frequencies: np.exp(-2 * (np.pi * sigma * frequencies) ** 2)

    def drifted(sizes: Array) -> Array:
        last = max(len(measured) - 1, 1)

        def factor(drift: float) -> Callable[[Values], Array]:
            return lambda one: np.array([1 + drift * (place[one.configuration] / last - 0.5)])

        return np.stack([_joined(values, "light", factor(drift)) for drift in sizes])

    quantities = {one.quantity for one in values}
    found: list[Effect] = []
    if "mtf" in quantities and bench.description.light is None:
        found.append(
            Effect(
                "diffraction", "of light of ({}) nm, which the bench file does not state", 1e6,
                WAVELENGTHS, on_contrast(diffracted), "light",
            )
        )  # fmt: skip
    if "mtf" in quantities:
        found.append(
            Effect(
                "a blur beyond the model (aberrations, focus, motion)", "of ({}) px rms", 1.0,
                BLURS, on_contrast(blurred), "lenses",
            )
        )  # fmt: skip
    if "light" in quantities:
        found.append(
            Effect(
                "unequal light", "of ({}) % from first to last configuration", 100.0, DRIFTS,
                drifted, "lamp",
            )
        )  # fmt: skip
    return tuple(found)


def _joined(values: list[Values], quantity: str, factor: Callable[[Values], Array]) -> Array:
    """The means of the model's draws as one list, those of a quantity times a factor."""
    return np.concatenate(
        [
            one.draws.mean(axis=0) * (factor(one) if one.quantity == quantity else 1.0)
            for one in values
        ]
    )
