"""What only a simulated bench reads of a bench file: its seed, clock, errors, targets, light and
sensor.
"""

from typing import Annotated, Any

from pydantic import Field

from flflab.description import Description, Length, Ratio


class FaultDescription(Description):
    """A fault that the simulated bench shows on purpose: on which device, which one, after how many
    commands.
    """

    device: str
    fault: str
    after: Annotated[int, Field(ge=0)] = 0


class SecondStopDescription(Description):
    """A ring that clips the light: how far behind the main lens, and how wide."""

    distance: Annotated[Length, Field(gt=0)]
    diameter: Annotated[Length, Field(gt=0)]


class EffectsDescription(Description):
    """What the simulated optics do beside first order: natural fall-off, distortion of the main
    lens (1/rad^2), stray light and a halo as shares of all light, shading as the share that the
    corners lose, a ring behind the main lens, how far the rims of micro-images are blurred, the
    sensor's gamma, and the scatter of its gains from column to column and between two taps.

    ``choose`` says which of all effects are drawn: ``auto``, ``fast``, ``reference`` or a list, as
    ``flflab image --effects`` has it. ``tolerance`` is how finely frames are drawn, root mean
    square of white; without it as finely as their noise calls for.
    """

    choose: str = "auto"
    tolerance: Annotated[float, Field(gt=0, lt=1)] | None = None
    falloff: bool = False
    distortion: float = 0.0
    stray_light: Annotated[Ratio, Field(ge=0, le=1)] = 0.0
    shading: Annotated[Ratio, Field(ge=0, le=1)] = 0.0
    halo: Annotated[Ratio, Field(ge=0, le=1)] = 0.0
    halo_radius: Annotated[Length, Field(gt=0)] = 0.02
    gamma: Annotated[float, Field(ge=0.3, le=3)] = 1.0
    second_stop: SecondStopDescription | None = None
    soft_rims: Annotated[Length, Field(ge=0)] = 0.0
    column_gain: Annotated[Ratio, Field(ge=0, le=0.1)] = 0.0
    tap_gain: Annotated[Ratio, Field(ge=0, le=0.1)] = 0.0


class SimulatedDescription(Description):
    """What only a simulated bench reads: seed, clock rate, planted truths and faults, its targets
    by kind, its light and sensor, and what its optics do beside first order.

    ``drift`` is how fast axes move away by themselves, by name and speed. ``hot_pixels`` is the
    share of the sensor's pixels that gather ``hot_electrons_per_second`` more on average.
    """

    seed: Annotated[int, Field(ge=0)] = 0
    clock: Annotated[float, Field(gt=0)] = 1.0
    truths: dict[str, str | float] = {}
    drift: dict[str, str | float] = {}
    faults: list[FaultDescription] = []
    targets: dict[str, dict[str, Any]] = {}
    electrons_per_second: Annotated[float, Field(gt=0)] = 1e6
    full_well_electrons: Annotated[float, Field(gt=0)] = 12000.0
    read_noise_electrons: Annotated[float, Field(ge=0)] = 3.0
    hot_pixels: Annotated[Ratio, Field(ge=0, le=1)] = 0.0
    hot_electrons_per_second: Annotated[float, Field(ge=0)] = 1e4
    bits: Annotated[int, Field(ge=8, le=16)] = 12
    black_level: Annotated[float, Field(ge=0)] = 64.0
    effects: EffectsDescription = EffectsDescription()
