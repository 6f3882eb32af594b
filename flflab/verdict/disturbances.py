"""What may disturb a measurement besides the bench's geometry, as suspects of ``diagnose``: the
light, blur, the sensor's response, settings or pictures that were exchanged.
"""

from collections.abc import Callable
from itertools import combinations

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench
from flflab.optics.airy import diffraction_contrast
from flflab.verdict.diagnosis import Effect, changed
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Values

Array = npt.NDArray[np.float64]
Factor = Callable[[int, Array], Array]  # configuration's place, frequencies in cycles/px
Predictions = tuple[Predicted, ...]
WAVELENGTHS = np.linspace(300e-6, 900e-6, 25)  # mm
BLURS = np.linspace(0.0, 2.0, 41)  # px, standard deviation
DRIFTS = np.linspace(-0.3, 0.3, 61)  # of the light over the run, a share
VEILS = np.linspace(-0.2, 0.3, 51)  # of white
GAMMAS = np.linspace(-0.5, 0.5, 41)  # of the exponent, from 1
SHARP = 2 / np.pi  # contrast of sharp bars' fundamental over their mean, halved
MIRRORED = ("left and right", "top and bottom", "by half a turn")  # how pictures are turned


def disturbances(
    values: list[Values], measured: tuple[Measured, ...], predicted: Predictions, bench: Bench
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
    quantities = {one.quantity for one in values}

    def on_contrast(factor_of: Callable[[float], Factor]) -> Callable[[Array], Array]:
        def factor(size: float) -> Callable[[Values], Array]:
            def of(one: Values) -> Array:
                curve = measured[place[one.configuration]].curves.get(one.quantity)
                if curve is None:
                    return np.ones(1)
                return factor_of(size)(place[one.configuration], curve.cycles_per_px)

            return of

        return lambda sizes: np.stack([_joined(values, factor(size)) for size in sizes])

    def contrast_at(k: int, frequencies: Array) -> Array:
        name, curve = next(iter(measured[k].curves.items()))
        contrast = predicted[k].contrasts[name].mean(axis=0)
        return np.interp(frequencies, curve.cycles_per_px, contrast)

    def diffracted(wavelength: float) -> Factor:
        return lambda k, frequencies: diffraction_contrast(
            predicted[k].camera, predicted[k].distance, frequencies, wavelength
        )

    def blurred(sigma: float) -> Factor:
        return lambda k, frequencies: np.exp(-2 * (np.pi * sigma * frequencies) ** 2)

    widest = min((one.configuration.f_number for one in measured), default=1.0)

    def aberrated(sigma: float) -> Factor:
        # a lens of three times the aperture has 27 times the transverse aberration
        return lambda k, frequencies: blurred(
            sigma * (widest / measured[k].configuration.f_number) ** 3
        )(k, frequencies)

    effects = [
        _steady("a blur beyond the model (aberrations, focus, motion)", "of ({}) px rms", BLURS,
                on_contrast(blurred), "lenses"),
        _steady("spherical aberration", "that blurs by ({}) px rms with the iris widest open",
                BLURS, on_contrast(aberrated), "lenses"),
        _steady("stray light or a wrong black level", "of ({}) of white more than described", VEILS,
                on_contrast(lambda veil: lambda k, _: np.full(1, 1 - veil)), "look"),
        _steady("gamma", "({}) more than 1", GAMMAS, on_contrast(
            lambda bent: lambda k, nu: through_gamma(contrast_at(k, nu), 1 + bent)), "look"),
    ] if quantities & {"mtf", "mtf_y"} else []  # fmt: skip
    if effects and bench.description.light is None:
        effects.append(
            Effect("diffraction", WAVELENGTHS, on_contrast(diffracted),
                   changed("of light of ({}) nm, which the bench file does not state", 1e6),
                   "light")
        )  # fmt: skip
    if "light" in quantities:
        effects.append(_lamp(values, place))
    if "array_yaw_mrad" in quantities or "array_roll_mrad" in quantities:
        effects.append(_mirrored(values))
    if len(measured) > 1:
        effects.append(_exchanged(values, [one.configuration.index for one in measured]))
    return tuple(effects)


def through_gamma(contrast: Array, gamma: float) -> Array:
    """What a sensor whose numbers rise as a power of the light makes of contrasts, as factors.

    Bars 1/2 + (2/pi) c cos show the first harmonic of their power; light below 0 or above white
    there is none.
    """
    angle = 2 * np.pi * (np.arange(64) + 0.5) / 64
    light = np.clip(0.5 + SHARP * contrast[:, None] * np.cos(angle), 0.0, 1.0)
    plain, bent = (np.mean(one * np.cos(angle), axis=1) for one in (light, light**gamma))
    return np.divide(bent, plain, out=np.ones_like(plain), where=np.abs(plain) > 1e-9)


def _steady(
    what: str, words: str, sizes: Array, expected: Callable[[Array], Array], remedy: str
) -> Effect:
    return Effect(what, sizes, expected, changed(words), remedy)


def _lamp(values: list[Values], place: dict[int, int]) -> Effect:
    """A lamp that drifts from the first configuration to the last."""
    last = max(len(place) - 1, 1)

    def expected(drifts: Array) -> Array:
        def factor(drift: float) -> Callable[[Values], Array]:
            return lambda one: np.array(
                [1 + drift * (place[one.configuration] / last - 0.5) * (one.quantity == "light")]
            )

        return np.stack([_joined(values, factor(drift)) for drift in drifts])

    words = changed("of ({}) % more light from first to last configuration", 100.0)
    return Effect("unequal light", DRIFTS, expected, words, "lamp")


def _mirrored(values: list[Values]) -> Effect:
    """Pictures mirrored or turned: roll and tilts of the array change their signs."""
    signs = {"array_roll_mrad": (1, -1, -1, 1), "array_yaw_mrad": (1, -1, 1, -1),
             "array_pitch_mrad": (1, 1, -1, -1)}  # fmt: skip

    def expected(ways: Array) -> Array:
        return np.stack(
            [
                _joined(
                    values,
                    lambda one, way=way: np.full(1, signs.get(one.quantity, (1,) * 4)[way]),
                )
                for way in np.rint(ways).astype(int)
            ]
        )

    def in_words(way: float, _: float) -> str:
        return f"({MIRRORED[max(round(way), 1) - 1]})"

    return Effect("a picture mirrored or turned", np.arange(4.0), expected, in_words, "look")


def _exchanged(values: list[Values], indices: list[int]) -> Effect:
    """Two configurations whose frames were taken the other way round."""
    pairs = list(combinations(indices, 2))
    means = {(one.configuration, one.quantity): one.draws.mean(axis=0) for one in values}

    def with_pair(pair: int) -> Array:
        swap = dict[int, int]()
        if pair > 0:
            first, second = pairs[pair - 1]
            swap = {first: second, second: first}
        parts: list[Array] = []
        for one in values:
            own = means[one.configuration, one.quantity]
            other = means.get((swap.get(one.configuration, one.configuration), one.quantity), own)
            parts.append(other if len(other) == len(own) else own)
        return np.concatenate(parts)

    def expected(numbers: Array) -> Array:
        return np.stack([with_pair(int(number)) for number in np.rint(numbers)])

    def in_words(pair: float, _: float) -> str:
        first, second = pairs[max(round(pair), 1) - 1]
        return f"(configurations {first} and {second})"

    sizes = np.arange(len(pairs) + 1.0)
    return Effect("settings exchanged", sizes, expected, in_words, "look")


def _joined(values: list[Values], factor: Callable[[Values], Array]) -> Array:
    """The means of the model's draws as one list, each times a factor."""
    return np.concatenate([one.draws.mean(axis=0) * factor(one) for one in values])
