"""What the sensor makes of the light on its pixels."""

from typing import Any

import numpy as np
import numpy.typing as npt
from white_pictures.spec import Array, Readout


def shading(shape: tuple[int, int], corner: float, x: Any, y: Any) -> Array:
    """Light at places as a share of the middle's, falling as the distance squared."""
    middle_y, middle_x = (shape[0] - 1) / 2, (shape[1] - 1) / 2
    square = (x - middle_x) ** 2 + (y - middle_y) ** 2
    return np.asarray(1 - (1 - corner) * square / (middle_x**2 + middle_y**2))


def read_out(sensor: Readout, light: Array, rng: np.random.Generator) -> npt.NDArray[np.uint16]:
    """Numbers of a picture."""
    columns = light.shape[1]
    full = 2**sensor.bits - 1
    signal = light
    if sensor.pixel_gain:
        signal = signal * (1 + rng.normal(0, sensor.pixel_gain, light.shape))
    if sensor.column_gain:
        signal = signal * (1 + rng.normal(0, sensor.column_gain, columns))
    if sensor.second_tap:
        signal = signal * np.where(np.arange(columns) < columns // 2, 1, 1 + sensor.second_tap)
    white = sensor.white
    if sensor.saturated:
        white = (full - sensor.black) / float(np.quantile(signal, 1 - sensor.saturated))
    if sensor.electrons:
        signal = rng.poisson(np.maximum(signal, 0) * sensor.electrons) / sensor.electrons
        signal += rng.normal(0, sensor.read_noise / sensor.electrons, light.shape)
    numbers = sensor.black + white * signal
    if sensor.column_offset:
        numbers += rng.normal(0, sensor.column_offset, columns)
    if sensor.warm:
        at = rng.integers(0, light.size, round(sensor.warm * light.size))
        numbers.flat[at] += rng.uniform(0, 0.1 * full, len(at))
    if sensor.gamma != 1:
        numbers = full * np.clip(numbers / full, 0, 1) ** (1 / sensor.gamma)
    return np.clip(np.rint(numbers), 0, full).astype(np.uint16)
