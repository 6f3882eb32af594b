"""How long a picture will take, counted before a pixel of it is formed: pixels that microlenses
light, times what each kind of target was measured to take of them.

Seconds on the wall of a machine with two free cores; the share of a processor that others take is
not foreseen.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.image.coarse import step_of
from flflab.image.fast.form import Upright
from flflab.image.microlenses import Lenses, outside
from flflab.image.path import prepare
from flflab.image.scene import Scene, without
from flflab.image.waves import ANGLES, RADII, kinds_of
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]

CORES = 2
# Processor seconds, measured.
PIXEL = 6e-9  # a pixel of a micro-image, whatever it sees
COLUMN_STRIP = 1.7e-9  # a strip of a pixel whose target lies along the columns
STRIP = 1.2e-7  # a strip of a pixel of any other line
PART = 4e-8  # a part of a pixel on a narrow vignetting edge, each strip
DOT_PART = 1e-8  # a part of a pixel that sees a dot
BENT = 6e-8  # a pixel in light of one wavelength
TRANSFER, OF_DOTS = 3e-4, 1.5e-3  # a table's curve in light of one wavelength, of lines and dots
RAY = 2e-8  # a ray to one target
RAYS = 16  # a pixel, where a pilot has not looked
LENS = 1e-4  # a microlens


def predicted_seconds(scene: Scene, tolerance: float, effects: frozenset[str]) -> float:
    """How long ``render`` will take, within a factor of about two.

    Args:
        scene: what is pictured.
        tolerance: as for ``render``.
        effects: the same.

    Raises:
        InputError: as ``render``.
    """
    pictured = without(scene, effects)
    ready = prepare(pictured, tolerance, effects)
    if not ready.lenses:
        return 0.0
    lenses, pixel = ready.lenses[0], scene.camera.sensor.pixel
    columns, rows = scene.camera.sensor.resolution
    lit = lit_pixels(lenses, pixel)
    spent = LENS * len(lenses) + PIXEL * columns * rows
    if ready.made is None:  # rays
        spent += (PIXEL + RAY * RAYS * len(scene.planes)) * float(lit.sum())
    elif pictured.diffraction is not None and ready.path == "waves":
        kinds = len(kinds_of(ready.made, pictured.diffraction.wavelength))
        curve = OF_DOTS if isinstance(ready.made.target, FourDot) else TRANSFER
        spent += (PIXEL + BENT) * float(lit.sum()) + kinds * RADII * ANGLES * curve
    else:
        lit /= (step_of(ready.made, pixel, tolerance) if "overlap" in effects else 1) ** 2
        spent += PIXEL * float(lit.sum()) + _closed_forms(ready.made, lit, pixel)
    return spent / CORES


def lit_pixels(lenses: Lenses, pixel: float) -> Array:
    """How many pixels each microlens lights."""
    columns, rows = (
        np.maximum(lenses[f"end_{name}"] - lenses[f"first_{name}"], 0).astype(np.float64)
        for name in ("column", "row")
    )
    return np.minimum(columns * rows, math.pi * (outside(lenses) / pixel) ** 2)


def _closed_forms(made: Upright, lit: Array, pixel: float) -> float:
    """Processor seconds beside those of every pixel."""
    lenses = made.lenses
    strips = np.array([how.strips for how in made.how], dtype=np.float64)
    parts = np.array([how.parts for how in made.how], dtype=np.float64) ** 2
    if isinstance(made.target, FourDot):
        seen = made.target.diameter / 2 + np.abs(made.lines["pupil"])
        with np.errstate(divide="ignore"):
            dot = math.pi * (seen / np.abs(made.lines["sensor"]) / pixel) ** 2
        return DOT_PART * float((parts * np.minimum(lit, 4 * dot)).sum())
    wide = np.abs(lenses["slope"])
    inner = np.maximum(lenses["reach"] - wide, 0.0)
    edge = np.where(2 * wide < made.tabulated * pixel, 1 - (inner / outside(lenses)) ** 2, 0.0)
    strip = COLUMN_STRIP if made.by_columns or made.by_rows else STRIP
    return float((strips * (PART * parts * edge + strip) * lit).sum())
