"""Cards before a target, and which windows of pixels see it past them: with all their rays, with
none, or with some.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.image.effects.distortion import Distortion
from flflab.image.effects.motion import Motion
from flflab.image.geometry.pupil import Pupils
from flflab.image.geometry.rays import land, linearised
from flflab.image.geometry.setup import Setup
from flflab.image.geometry.tiles import RIM, middles
from flflab.image.scene import Plane, Scene
from flflab.targets import Bars, FourDot, Picture, Target

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

SIDES = ((1, 0), (0, 1), (-1, 0), (0, -1))  # of a card, from its middle
PARTS = len(SIDES) + 1  # of a card that a part of a micro-image may see: one side, or several
CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])


@dataclass(frozen=True)
class Card:
    """A card between light and lens: rays must end on it where it carries the target (``own``), and
    beside it where it hides one.
    """

    plane: Plane
    own: bool

    @property
    def size(self) -> tuple[float, float]:
        """Its width and height, mm."""
        return self.plane.size or (math.inf, math.inf)


def cards_of(scene: Scene, index: int) -> tuple[Card, ...]:
    """The cards whose edges the light of a scene's plane can meet."""
    plane = scene.planes[index]
    own = (
        (Card(plane, True),)
        if plane.size is not None and _sticks_out(plane.target, plane.size)
        else ()
    )
    return own + tuple(Card(near, False) for near in scene.planes[:index])


def _sticks_out(target: Target, size: tuple[float, float]) -> bool:
    match target:
        case FourDot():
            half_x = half_y = (target.spacing + target.diameter) / 2
        case Bars() | Picture():
            half_x, half_y = target.width / 2, target.height / 2
        case _:
            half_x = half_y = math.inf
    return half_x > size[0] / 2 or half_y > size[1] / 2


def pupils_before(pupils: Pupils, vergence: float, other: float) -> Pupils:
    """Pupils made for one vergence (1/mm), for another."""
    change = other - vergence
    return replace(
        pupils,
        spread=pupils.spread + change * pupils.lens_spread,
        scale=pupils.scale + change * pupils.lens_scale,
    )


def seen_past(
    setup: Setup,
    pupils: Pupils,
    windows: Whole,
    vergence: float,
    distortion: Distortion | None,
    cards: tuple[Card, ...],
) -> tuple[Flags, Flags, Whole]:
    """Which windows of these pupils, made for a vergence, see a target past cards, and what of the
    cards.

    Returns:
        Those whose rays all pass, those whose rays are all stopped, and what some rays meet: -1
        where it is several cards or none, else PARTS times the card's number, and the number of its
        side or, if there are several, of SIDES.
    """
    full, none, met = (
        np.ones(len(windows), dtype=np.bool_),
        np.zeros(len(windows), dtype=np.bool_),
        np.full(len(windows), -1),
    )
    cards_met = np.zeros(len(windows), dtype=np.int64)
    middle, half = middles(setup.sensor, pupils, windows)
    half = half + setup.sensor.pixel / 2
    for index, card in enumerate(cards):
        before = pupils_before(pupils, vergence, 1 / card.plane.distance)
        low, high = _extent(before, card.plane, distortion, setup.motion, middle, half)
        size = np.array(card.size) / 2
        on = ((low >= -size) & (high <= size)).all(axis=1)
        beside = ((low > size) | (high < -size)).any(axis=1)
        passing = on if card.own else beside
        full &= passing
        none |= beside if card.own else on
        crossed = np.concatenate(
            [(low < size) & (high > size), (low < -size) & (high > -size)], axis=1
        )
        side = np.where(crossed.sum(axis=1) == 1, crossed.argmax(axis=1), len(SIDES))
        met = np.where(passing, met, PARTS * index + side)
        cards_met += ~passing
    return full, none, np.where(cards_met == 1, met, -1)


def seen_of_dots(
    setup: Setup,
    pupils: Pupils,
    windows: Whole,
    plane: Plane,
    dots: FourDot,
    distortion: Distortion | None,
) -> tuple[Flags, Flags]:
    """Which windows of these pupils, made for the dots' plane, look into one dot with all their
    rays, and which past all dots.
    """
    middle, half = middles(setup.sensor, pupils, windows)
    low, high = _extent(
        pupils, plane, distortion, setup.motion, middle, half + setup.sensor.pixel / 2
    )
    inside, outside = np.zeros(len(windows), dtype=np.bool_), np.ones(len(windows), dtype=np.bool_)
    for centre in dots.centres:
        nearest = np.maximum(np.maximum(low - centre, centre - high), 0.0)
        farthest = np.maximum(np.abs(low - centre), np.abs(high - centre))
        inside |= np.hypot(*farthest.T) < dots.diameter / 2
        outside &= np.hypot(*nearest.T) > dots.diameter / 2
    return inside, outside


def _extent(
    pupils: Pupils,
    plane: Plane,
    distortion: Distortion | None,
    motion: Motion | None,
    middle: Array,
    half: Array,
) -> tuple[Array, Array]:
    """Lowest and highest places on a card of all rays from a rectangle on the sensor during an
    exposure; (N, 2) each.
    """
    landing = linearised(pupils, plane, distortion, middle)
    sensor = middle[:, None] + half[:, None] * np.repeat(CORNERS, len(RIM), axis=0)
    pupil = np.tile(RIM, (len(CORNERS), 1))[None]
    crooked = np.abs(
        landing.at(pupil, sensor) - land(pupils, plane, distortion, pupil, sensor)
    ).max(axis=1)
    reach = (np.abs(landing.by_sensor) @ half[:, :, None])[:, :, 0] + np.hypot(
        landing.by_pupil[:, :, 0], landing.by_pupil[:, :, 1]
    )
    if motion is not None:
        reach = reach + np.abs(landing.by_motion) @ (
            np.abs(motion.drift) / 2 + np.abs(motion.vibration)
        )
    centre = landing.origin + (landing.by_sensor @ middle[:, :, None])[:, :, 0]
    return centre - reach - 1.5 * crooked, centre + reach + 1.5 * crooked
