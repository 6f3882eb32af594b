"""Pictures that are no white pictures of a microlens array."""

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from white_pictures.drawing import draw_light
from white_pictures.profiles import SoftDisc
from white_pictures.read_out import read_out
from white_pictures.spec import Array, Readout, WhiteSpec

Picture = npt.NDArray[np.uint16]
Shape = tuple[int, int]


def _read(light: Array, rng: np.random.Generator, sensor: Readout | None = None) -> Picture:
    return read_out(sensor or Readout(), light, rng)


def clouds(shape: Shape, rng: np.random.Generator) -> Picture:
    """A photograph's spectrum: amplitudes fall as 1/f, phases are random."""
    y, x = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
    spectrum = np.fft.rfft2(rng.normal(size=shape)) / np.maximum(np.hypot(x, y), 1 / max(shape))
    light = np.fft.irfft2(spectrum, shape)
    light = (light - light.min()) / (light.max() - light.min())
    return _read(light, rng)


def leaves(shape: Shape, rng: np.random.Generator) -> Picture:
    """A photograph's edges: discs of all sizes that cover each other."""
    light = np.full(shape, 0.5)
    for _ in range(3000):
        radius = 4 / np.sqrt(rng.uniform(0.0016, 1))
        x, y = rng.uniform(-50, shape[1] + 50), rng.uniform(-50, shape[0] + 50)
        top, left = max(0, int(y - radius)), max(0, int(x - radius))
        part = light[top : max(0, int(y + radius) + 2), left : max(0, int(x + radius) + 2)]
        rows, columns = np.indices(part.shape)
        part[np.hypot(rows + top - y, columns + left - x) < radius] = rng.uniform(0.05, 1)
    return _read(ndimage.gaussian_filter(light, 0.7), rng)


def noise(shape: Shape, rng: np.random.Generator) -> Picture:
    """Numbers without any relation."""
    return rng.integers(0, 65536, shape).astype(np.uint16)


def flat(shape: Shape, rng: np.random.Generator) -> Picture:
    """Even light with shot noise: the array is not in the camera."""
    return _read(np.full(shape, 0.6), rng)


def constant(shape: Shape, rng: np.random.Generator) -> Picture:
    """One number everywhere."""
    return np.full(shape, 1234, dtype=np.uint16)


def dark(shape: Shape, rng: np.random.Generator) -> Picture:
    """A dark frame with columns."""
    return _read(np.zeros(shape), rng, Readout(column_offset=8.0, warm=1e-4))


def bars(shape: Shape, rng: np.random.Generator) -> Picture:
    """Bars across the whole picture."""
    x = np.arange(shape[1]) + 0.15 * np.arange(shape[0])[:, None]
    light = 0.1 + 0.8 * (x % 24 < 12)
    return _read(ndimage.gaussian_filter(light, 1.0), rng)


def checkerboard(shape: Shape, rng: np.random.Generator) -> Picture:
    """Squares of 20 px."""
    y, x = np.indices(shape)
    return _read(ndimage.gaussian_filter(0.1 + 0.8 * ((x // 20 + y // 20) % 2), 0.8), rng)


def scene_through_the_camera(shape: Shape, rng: np.random.Generator) -> Picture:
    """A scene in focus behind the array: every micro-image holds a piece of it."""
    light, _ = draw_light(WhiteSpec(shape=shape, pitch=40.0, profile=SoftDisc(17.0, 1.0)), rng)
    return _read(light * leaves(shape, rng) / 40000.0, rng)


def saturated_white(shape: Shape, rng: np.random.Generator) -> Picture:
    """A white picture with all of its micro-images at full scale."""
    light, _ = draw_light(WhiteSpec(shape=shape, profile=SoftDisc(13.0, 1.0)), rng)
    return _read(light, rng, Readout(saturated=0.55))


NOT_WHITES = {
    one.__name__: one
    for one in (
        clouds,
        leaves,
        noise,
        flat,
        constant,
        dark,
        bars,
        checkerboard,
        scene_through_the_camera,
        saturated_white,
    )
}
