"""Light that bends: one wavelength, or the lines of a spectrum as the sensor weighs them."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Spectrum:
    """Lines of light; the picture is the sum of theirs.

    Attributes:
        wavelengths: mm.
        weights: share of each in what the sensor counts; they add up to 1.
    """

    wavelengths: tuple[float, ...]
    weights: tuple[float, ...]

    @property
    def mean(self) -> float:
        """Mean wavelength, mm: what diffraction takes in proportion to the wavelength is taken as
        of this one.
        """
        return sum(w * length for w, length in zip(self.weights, self.wavelengths, strict=True))


def lines_of(light: Spectrum | None) -> tuple[tuple[float | None, float], ...]:
    """(wavelength in mm, weight) of every line; one without a wavelength where light is rays."""
    if light is None:
        return ((None, 1.0),)
    return tuple(zip(light.wavelengths, light.weights, strict=True))
