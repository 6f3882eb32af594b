"""Light of pixels whose rays do not all fare alike: past the edges of cards, or too crooked for a
linear map; summed ray by ray.

Over the moments of the exposure, the pixel's parts, and rows and columns of the lit part of the
pupil, each ray stands for its neighbourhood: steps of target and cards are smoothed by what a part
of the pixel and a cell of the pupil cover there. Each pixel is summed with few rays first, and with
more of what changes it.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.image.cards.single_ray_sums import add_rays
from flflab.image.cards.surfaces import lens_numbers, surface_numbers
from flflab.image.cards.windows import Card, pupils_before
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.motion import Motion
from flflab.image.geometry.rays import linearised
from flflab.image.geometry.setup import Setup
from flflab.image.geometry.tiles import blur_of, middles
from flflab.image.light.orders import in_bands
from flflab.image.radiance.neighbourhood import described
from flflab.image.scene import Plane
from flflab.optics.camera import pixel_positions
from flflab.targets import Picture, White

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

# rows that a core sums at a time: pixels take so long that even a small picture is worth all cores
BAND = 8
MOST_PARTS, STEEP_PARTS = 32, 8  # of a pixel a side; of one that a steep rim cuts
# pixels; a rim narrower than this cuts the parts of a pixel, for each ray elsewhere, instead of the
# pupil
STEEP = 2.0
# of white, times the square of the rim's width in pixels over that of the number of rows, where it
# does
STEEP_ERROR = 0.01
MOST_ROWS = 96
FEWEST_MOMENTS = (
    2  # of those that a pixel is first summed with: one and two agree by chance too often
)
SKEW = 0.2  # angle, in rad, above which edges of cards and targets do not count as parallel
# error, of white, times the square of the number of parts, where the edges of two surfaces cross
# under an angle
TURNED_ERROR = 0.1
ENOUGH = 0.15  # of the tolerance: all that twice an order may change
# twice the error, of white, times the square of the number of rows; measured on dots, edges and
# bars
ROWS_ERROR = 0.6
PICTURE_ROWS_ERROR = 2.4  # the same of pictures, measured on black and white texels


def add_single_rays(
    image: Array,
    setup: Setup,
    plane: Plane,
    distortion: Distortion | None,
    cards: tuple[Card, ...],
    wanted: Chosen | None = None,
) -> None:
    """Add the light of a plane to the pixels of the setup's windows.

    Args:
        image: picture to add to, [row, column], in units of the white level.
        setup: made for the plane; its maps are not used. Target and cards move alike.
        plane: the target.
        distortion: of the main lens.
        cards: those that stop rays.
        wanted: the pixels to compute; None for all.
    """
    if not len(setup.blur):
        return
    pupils, pixel = setup.pupils, setup.sensor.pixel
    middle = middles(setup.sensor, pupils, setup.window)[0]
    surfaces = np.array(
        [surface_numbers(Card(plane, False)), *(surface_numbers(card) for card in cards)]
    )
    maps = np.empty((len(setup.blur), len(surfaces), 8))
    blurs, smears = np.zeros((2, len(setup.blur), len(surfaces)))
    for index, before in enumerate((plane, *(card.plane for card in cards))):
        landing = linearised(
            pupils_before(pupils, 1 / plane.distance, 1 / before.distance),
            before,
            distortion,
            middle,
        )
        maps[:, index, :4] = landing.by_pupil.reshape(-1, 4)
        maps[:, index, 4:] = landing.by_sensor.reshape(-1, 4) * setup.pixel_width
        blurs[:, index] = blur_of(landing.by_pupil, landing.by_sensor, pixel)
        smears[:, index] = _smear_of(landing.by_motion, landing.by_sensor * pixel, landing.by_pupil)
    width = np.maximum(2 * np.abs(pupils.slope) / pixel, 1e-9)
    tolerance, blur = (
        setup.tolerance / np.sqrt(_shared(setup, image.shape)),
        blurs.max(axis=1),
    )  # errors of either sign on the way
    steps = np.array(
        [not (isinstance(plane.target, White) and card.own) for card in cards], dtype=np.float64
    )
    change = 0.34 / width + 0.25 * (steps / np.maximum(blurs[:, 1:], 1.0)).sum(
        axis=1
    )  # of rim and cards within a pixel, against a step
    parts = np.clip(
        np.ceil(np.sqrt(change / (tolerance * np.sqrt(np.maximum(blurs[:, 0], 1.0))))),
        1,
        MOST_PARTS,
    )
    steep = width < STEEP
    parts = np.where(steep, STEEP_PARTS, parts)
    by_pupil, by_sensor = (
        np.linalg.norm(maps[:, :, :4], axis=2),
        np.linalg.norm(maps[:, :, 4:], axis=2),
    )
    turned = _turned(np.where((by_sensor >= by_pupil)[:, :, None], maps[:, :, 4:], maps[:, :, :4]))
    crossing = (turned & (by_sensor >= by_pupil)).any(axis=1)
    parts = np.where(
        crossing,
        np.maximum(parts, np.minimum(np.ceil(np.sqrt(TURNED_ERROR / tolerance)), MOST_PARTS)),
        parts,
    )
    rows = (
        (PICTURE_ROWS_ERROR if isinstance(plane.target, Picture) else ROWS_ERROR)
        * np.minimum(blur / 3, 1.0)
        / tolerance
    )
    if setup.falloff:  # rays count by a square of their slope
        rows = np.maximum(rows, 8 * pupils.slant_spread**2 / tolerance)
    rows = np.where(steep, np.maximum(rows, STEEP_ERROR * width**2 / tolerance), rows)
    rows = np.clip(np.ceil(np.sqrt(rows)), np.where(blur == 0, 1, 2), MOST_ROWS)
    if setup.pixel_width == 0:
        parts = np.ones_like(parts)
    aligned: Chosen = ~turned
    along = aligned.all(axis=1) & ~_aslant(maps[:, 0, :4])
    kind, numbers, table, law, sums = described(plane.target)
    known, (xs, ys) = lens_numbers(pupils), pixel_positions(setup.sensor)
    coefficient = 0.0 if distortion is None else distortion.coefficient
    chosen = np.zeros((0, 0), dtype=np.bool_) if wanted is None else wanted
    smear = smears.max(axis=1)
    most = _moment_counts(setup.motion, smear, tolerance)
    # Farther apart than an edge is wide, moments see it or not by chance, and twice as many may
    # agree.
    moments = np.minimum(
        np.maximum(np.ceil(_widths_moved(setup.motion, smear)), FEWEST_MOMENTS), most
    ).astype(np.int64)
    orders = np.column_stack([parts, rows, rows, most]).astype(np.int64)
    brightest = (
        min(float(plane.target.values.max()), 1.0) if isinstance(plane.target, Picture) else 1.0
    )  # half of it is half the light
    motion = (
        np.zeros((2, 2))
        if setup.motion is None
        else np.array([setup.motion.drift, setup.motion.vibration])
    )

    def add(band: tuple[int, int]) -> None:
        add_rays(
            image,
            band,
            setup.window,
            known,
            surfaces,
            maps,
            aligned,
            along,
            orders,
            moments,
            steep,
            ENOUGH * tolerance * brightest,
            motion,
            coefficient,
            setup.falloff,
            xs,
            ys,
            pixel,
            setup.pixel_width,
            kind,
            numbers,
            table,
            law,
            sums,
            chosen,
        )

    in_bands(add, setup.window, BAND)


def _smear_of(by_motion: Array, by_pixel: Array, by_pupil: Array) -> Array:
    """Over how many widths of a smoothed edge a target moves on the sensor when it moves by 1 mm,
    for maps to it (N, 2, 2).
    """
    way, pixel, pupil = (
        np.linalg.norm(part, axis=(1, 2)) for part in (by_motion, by_pixel, by_pupil)
    )
    width = np.maximum(pixel, np.pi / 2 * pupil)
    return np.divide(way, width, out=np.zeros_like(way), where=width > 0)


def _widths_moved(motion: Motion | None, smear: Array) -> Array:
    """Over how many widths of a smoothed edge drift and vibration carry a target from end to end,
    shape (N, 2); see ``_smear_of``.
    """
    motion = motion or Motion()
    return smear[:, None] * np.array([math.hypot(*motion.drift), 2 * math.hypot(*motion.vibration)])


def _moment_counts(motion: Motion | None, smear: Array, tolerance: Array | float) -> Whole:
    """How many moments drift and vibration need, shape (N, 2): n of them leave about S / (4 n^2) of
    white.

    Measured on edges and bars boxed by a pixel, which wander over S times the width to which pixel
    and blur smooth them (Gauss's rule for the drift is worse there); a half more for the sine.

    Args:
        motion: of the targets; None for none.
        smear: see ``_smear_of``, shape (N,).
        tolerance: largest error asked for, of white, of each or of all.
    """
    if motion is None:
        return np.ones((len(smear), 2), dtype=np.int64)
    demand = _widths_moved(motion, smear) * np.array([1.0, 1.6]) / np.reshape(tolerance, (-1, 1))
    return np.maximum(np.ceil(np.sqrt(demand)), 1).astype(np.int64)


def _shared(setup: Setup, shape: tuple[int, int]) -> Array:
    """How many of the windows, at most, share a pixel of each."""
    counts = np.zeros(shape)
    parts = [(slice(low, high), slice(left, right)) for left, right, low, high in setup.window]
    for part in parts:
        counts[part] += 1
    return np.array([counts[part].max(initial=1) for part in parts])


def _turned(maps: Array) -> Chosen:
    """Whether the axes of each surface do not count as parallel to the target's, the first one's;
    maps (T, K, 4), answer (T, K).
    """
    rows = maps.reshape(*maps.shape[:2], 2, 2)
    rows = rows / np.maximum(np.linalg.norm(rows, axis=3, keepdims=True), 1e-300)
    first = rows[:, :1]
    aside = np.maximum(
        np.abs((rows[:, :, 0] * first[:, :, 1]).sum(axis=2)),
        np.abs((rows[:, :, 1] * first[:, :, 0]).sum(axis=2)),
    )
    return np.any(aside[:, :, None] > SKEW, axis=2, keepdims=False)


def _aslant(by_pupil: Array) -> Chosen:
    """Whether rows and columns of the pupil do not count as parallel to a surface's axes, for maps
    to it (T, 4).
    """
    rows = np.abs(by_pupil.reshape(-1, 2, 2))
    return np.any(
        rows.min(axis=2) > SKEW * np.maximum(np.linalg.norm(rows, axis=2), 1e-300), axis=1
    )
