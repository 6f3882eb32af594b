"""How far a picture is from the reference: the reference itself on the pixels where the difference
can be largest.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.image.render import LEAST_TOLERANCE, render, transmissions
from flflab.image.scene import Scene
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

BLOCKS = 12  # a side: of each block of the picture, its steepest pixel
# more pixels, evenly spread over those with light; with waves each costs little beside the tables
SPREAD, SPREAD_WAVES = (
    600,
    2000,
)
FINER, FINER_WAVES = (
    8.0,
    3.0,
)  # how much finer the reference is formed here; waves cost so much that less must do
# where a picture with waves is coarser than FINER_WAVES times that, the reference is this fine, or
# FINER times finer
ENOUGH = 0.002
SAFETY = 3.6  # the largest difference anywhere is up to 3.4 times the largest one found in trials
FAR = 0.7  # of the way from a picture's middle to its corners
LEAST = 0.02  # of the finer picture's tolerance: what neither picture shows


def estimate_error(scene: Scene, image: Array, tolerance: float, effects: frozenset[str]) -> float:
    """Estimate the largest difference of a picture from the reference, of white; it is not below it
    (see docs/pictures.md).

    Args:
        scene: what is pictured, with all its effects.
        image: the picture.
        tolerance: of the picture's quadrature, of white.
        effects: those that were formed.
    """
    if tolerance <= LEAST_TOLERANCE:
        return LEAST_TOLERANCE  # nothing finer is there to compare with
    wanted = telling_pixels(image, SPREAD if scene.diffraction is None else SPREAD_WAVES)
    filtered = "colour-filter" in effects

    def difference(held_against: Scene, finer: float, looked_at: Flags) -> float:
        truth = finer_picture(held_against, image, max(finer, LEAST_TOLERANCE), looked_at, filtered)
        return SAFETY * float(np.abs(truth - image)[looked_at].max(initial=0.0)) + LEAST * max(
            finer, LEAST_TOLERANCE
        )

    if scene.diffraction is None:
        return difference(scene, tolerance / FINER, wanted)
    least = max(tolerance / FINER, min(tolerance / FINER_WAVES, ENOUGH))
    of_all = max(
        difference(scene, least, wanted),
        difference(scene, least, wanted & outlying(image, scene.camera)),
    )
    # Twice as fine may mean the same orders again and repeat the picture's own error; where it is
    # one of rays, they say so.
    return (
        of_all
        if "diffraction" in effects
        else max(of_all, difference(replace(scene, diffraction=None), tolerance / FINER, wanted))
    )


def finer_picture(
    scene: Scene, image: Array, tolerance: float, wanted: Flags, filtered: bool = True
) -> Array:
    """The wanted pixels of a scene with every effect, at another tolerance than a picture of it.

    Stray light is that of the picture's own mean, since for the true one all pixels would have to
    be formed: it is off by its share of the mean of the picture's errors.

    Args:
        scene: what is pictured.
        image: a picture of it.
        tolerance: of the quadrature, of white.
        wanted: the pixels, [row, column]; the others hold anything.
        filtered: whether the picture's light came through the scene's colour filter.
    """
    light = render(
        replace(scene, stray_light=None, colour_filter=None), tolerance=tolerance, wanted=wanted
    )
    passed = (
        np.ones(image.shape)
        if scene.colour_filter is None
        else transmissions(scene.colour_filter, image.shape)
    )
    if scene.stray_light is not None:
        seen = passed if filtered else np.ones(image.shape)
        mean = float(image[seen > 0].sum() / seen[seen > 0].sum())
        light = (1 - scene.stray_light.share) * light + scene.stray_light.share * mean
    return passed * light


def telling_pixels(image: Array, spread: int) -> Flags:
    """The steepest pixel of every block of a picture, and so many others spread evenly over its
    light.
    """
    steep = steepness(image)
    wanted = steepest_pixels(steep)
    lit = np.flatnonzero(image.ravel() + steep.ravel())
    if len(lit):
        wanted.ravel()[lit[np.linspace(0, len(lit) - 1, spread).astype(np.int64)]] = True
    return wanted


def outlying(image: Array, camera: Camera) -> Flags:
    """Pixels within half a pitch of the steepest one that is far from the picture's middle.

    Microlenses there differ most from the others with which they share tables in waves; looked at
    alone, they have their own.
    """
    rows, columns = (np.arange(size) - (size - 1) / 2 for size in image.shape)
    from_middle = np.hypot(rows[:, None], columns)
    steep = np.where(from_middle >= FAR * from_middle.max(), steepness(image), -1.0)
    row, column = np.unravel_index(int(np.argmax(steep)), image.shape)
    half = max(camera.array.pitch) / 2 / camera.sensor.pixel
    near = np.abs(rows - rows[row]) <= half
    return near[:, None] & (np.abs(columns - columns[column]) <= half)


def steepness(image: Array) -> Array:
    """The largest step from each pixel to one of its four neighbours."""
    steep = np.zeros(image.shape)
    for axis in (0, 1):
        step = np.abs(np.diff(image, axis=axis))
        before, after = [slice(None)] * 2, [slice(None)] * 2
        before[axis], after[axis] = slice(0, -1), slice(1, None)
        np.maximum(steep[tuple(before)], step, out=steep[tuple(before)])
        np.maximum(steep[tuple(after)], step, out=steep[tuple(after)])
    return steep


def steepest_pixels(steep: Array) -> Flags:
    """The pixel of the largest value in each of 12 x 12 blocks."""
    wanted = np.zeros(steep.shape, dtype=np.bool_)
    rows = np.array_split(np.arange(steep.shape[0]), min(BLOCKS, steep.shape[0]))
    columns = np.array_split(np.arange(steep.shape[1]), min(BLOCKS, steep.shape[1]))
    for band in rows:
        for strip in columns:
            block = steep[band[0] : band[-1] + 1, strip[0] : strip[-1] + 1]
            row, column = np.unravel_index(int(np.argmax(block)), block.shape)
            wanted[band[0] + row, strip[0] + column] = True
    return wanted
