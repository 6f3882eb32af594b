"""Which parts of micro-images see a target past the edges of cards: with all their rays, with none, past one edge, or with some."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.image.effects.distortion import Distortion
from flflab.image.effects.motion import Motion
from flflab.image.pupil import Pupils
from flflab.image.rays import land, linearised
from flflab.image.scene import Plane, Scene
from flflab.image.setup import MAP_SHARE, Setup
from flflab.image.tiles import LEAST_SIDE, RIM, blur_of, counts_needed, cut, middles
from flflab.targets import Bars, Edge, FourDot, Picture, Target

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

SMALLEST = 4  # pixels a side of a part that a card's edge crosses
SIDES = ((1, 0), (0, 1), (-1, 0), (0, -1))  # of a card, from its middle
PARTS = len(SIDES) + 1  # of a card that a part of a micro-image may see: one side, or several
CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])


@dataclass(frozen=True)
class Card:
    """A card between light and lens: rays must end on it where it carries the target (``own``), and beside it where it hides one."""

    plane: Plane
    own: bool


def cards_of(scene: Scene, index: int) -> tuple[Card, ...]:
    """The cards whose edges the light of a scene's plane can meet."""
    plane = scene.planes[index]
    own = (Card(plane, True),) if plane.size is not None and _sticks_out(plane.target, plane.size) else ()
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
    return replace(pupils, spread=pupils.spread + change * pupils.lens_spread, scale=pupils.scale + change * pupils.lens_scale)


def split(setup: Setup, vergence: float, distortion: Distortion | None, cards: tuple[Card, ...]) -> tuple[Setup, Setup]:
    """Tell the parts that see a target (of this vergence, for which the setup is made) with all rays from those that need single rays.

    Single rays need the parts that a card's edge crosses, which are quartered until they are small, and those that are ``crooked``.
    What sees nothing is in neither.
    """

    def sort(entries: Whole, windows: Whole, small: Flags) -> tuple[Flags, Flags, Flags]:
        full, none, _ = _seen(setup, setup.pupils.of(entries), windows, vergence, distortion, cards)
        single = np.where(full, setup.crooked[entries], small)
        return none, full & ~single, single

    clear, crossed = _quartered(setup, sort, SMALLEST)
    return setup.of(*clear), setup.of(*crossed)


@dataclass(frozen=True)
class PastCards:
    """A white target past cards: which parts of micro-images see it how.

    Attributes:
        clear: with all their rays.
        light: what is seen of it through or beside one card, as a picture of that card or of one edge of it.
        shadow: pictures of a card that hides as much, the light of which is in ``clear``.
        singly: parts that need single rays, for they see it past several cards or too crookedly.
    """

    clear: Setup
    light: list[tuple[Setup, Target]]
    shadow: list[tuple[Setup, Target]]
    singly: Setup


def split_white(setup: Setup, vergence: float, distortion: Distortion | None, cards: tuple[Card, ...]) -> PastCards:
    """The same for a white target, of which one card leaves as much light as a picture of the card tells, all of it or one edge."""

    def sort(entries: Whole, windows: Whole, small: Flags) -> tuple[Flags, Flags, Flags, Flags]:
        full, none, met = _seen(setup, setup.pupils.of(entries), windows, vergence, distortion, cards)
        alone = (met >= 0) & ~none
        alone[alone] = _straight(setup, entries[alone], windows[alone], vergence, distortion, cards, met[alone])
        return none, full, alone, small & ~alone & ~full

    clear, alone, singly = _quartered(setup, sort, LEAST_SIDE)
    met = _seen(setup, setup.pupils.of(alone[0]), alone[1], vergence, distortion, cards)[2]
    light, shadow = list[tuple[Setup, Target]](), list[tuple[Setup, Target]]()
    for number in np.unique(met):
        card, this = cards[number // PARTS], met == number
        part = alone[0][this], alone[1][this]
        if number % PARTS < len(SIDES):
            light.append(_before_side(setup.of(*part), vergence, distortion, card, int(number) % PARTS))
            continue
        before = _before(setup.of(*part), vergence, distortion, card.plane), _white_card(card.plane)
        (light if card.own else shadow).append(before)
        if not card.own:
            clear = np.concatenate([clear[0], part[0]]), np.concatenate([clear[1], part[1]])
    return PastCards(setup.of(*clear), light, shadow, setup.of(*singly))


def _quartered(setup: Setup, sort: Callable[[Whole, Whole, Flags], tuple[Flags, ...]], least: int) -> list[tuple[Whole, Whole]]:
    """Entries and windows of each class but the first that ``sort`` makes; what is in none is quartered down to ``least`` pixels a side."""
    entries, windows = np.arange(len(setup.blur)), setup.window
    found: list[list[tuple[Whole, Whole]]] = []
    while len(entries) or not found:
        sides = np.stack([windows[:, 1] - windows[:, 0], windows[:, 3] - windows[:, 2]], axis=1)
        dropped, *classes = sort(entries, windows, (sides <= least).all(axis=1))
        rest = ~dropped & (sides > 0).all(axis=1)
        found.append([(entries[rest & one], windows[rest & one]) for one in classes])
        rest &= ~np.any(classes, axis=0)
        quarters, smaller = cut(windows[rest], np.where(sides[rest] > least, 2, 1))
        entries, windows = entries[rest][quarters], smaller
    return [(np.concatenate([one[0] for one in parts]), np.concatenate([one[1] for one in parts])) for parts in zip(*found, strict=True)]


def _seen(
    setup: Setup,
    pupils: Pupils,
    windows: Whole,
    vergence: float,
    distortion: Distortion | None,
    cards: tuple[Card, ...],
) -> tuple[Flags, Flags, Whole]:
    """Parts whose rays all pass, parts whose rays are all stopped, and what some rays meet.

    That is -1 where it is several cards or none; else PARTS times the card's number, and the number of its side or, if several, SIDES.
    """
    full, none, met = np.ones(len(windows), dtype=np.bool_), np.zeros(len(windows), dtype=np.bool_), np.full(len(windows), -1)
    cards_met = np.zeros(len(windows), dtype=np.int64)
    middle, half = middles(setup.sensor, pupils, windows)
    half = half + setup.sensor.pixel / 2
    for index, card in enumerate(cards):
        before = pupils_before(pupils, vergence, 1 / card.plane.distance)
        low, high = _extent(before, card.plane, distortion, setup.motion, middle, half)
        size = np.array(card.plane.size) / 2
        on = ((low >= -size) & (high <= size)).all(axis=1)
        beside = ((low > size) | (high < -size)).any(axis=1)
        passing = on if card.own else beside
        full &= passing
        none |= beside if card.own else on
        crossed = np.concatenate([(low < size) & (high > size), (low < -size) & (high > -size)], axis=1)
        side = np.where(crossed.sum(axis=1) == 1, crossed.argmax(axis=1), len(SIDES))
        met = np.where(passing, met, PARTS * index + side)
        cards_met += ~passing
    return full, none, np.where(cards_met == 1, met, -1)


def _straight(
    setup: Setup, entries: Whole, windows: Whole, vergence: float, distortion: Distortion | None, cards: tuple[Card, ...], met: Whole
) -> Flags:
    """Whether the rays of each part end on the one card that they meet where a linear map says."""
    straight = np.zeros(len(entries), dtype=np.bool_)
    for number in np.unique(met // PARTS):
        plane, this = cards[number].plane, met // PARTS == number
        before = pupils_before(setup.pupils.of(entries[this]), vergence, 1 / plane.distance)
        counts, crooked = counts_needed(setup.sensor, before, windows[this], plane, distortion, MAP_SHARE * setup.tolerance)
        straight[this] = (counts == 1).all(axis=1) & ~crooked
    return straight


def _before(setup: Setup, vergence: float, distortion: Distortion | None, plane: Plane) -> Setup:
    """The same before another plane."""
    before = pupils_before(setup.pupils, vergence, 1 / plane.distance)
    landing = linearised(before, plane, distortion, middles(setup.sensor, before, setup.window)[0])
    return replace(
        setup,
        pupils=before,
        origin=landing.origin,
        by_pupil=landing.by_pupil,
        by_sensor=landing.by_sensor,
        by_motion=landing.by_motion,
        blur=blur_of(landing.by_pupil, landing.by_sensor, setup.sensor.pixel),
        crooked=np.zeros_like(setup.crooked),
    )


def _before_side(setup: Setup, vergence: float, distortion: Distortion | None, card: Card, side: int) -> tuple[Setup, Edge]:
    """The same before one side of a card, and the edge there: white where the card lets light pass."""
    x, y = SIDES[side]
    half_x, half_y = np.array(card.plane.size) / 2
    there = _before(setup, vergence, distortion, card.plane).seen_from(x * half_x, y * half_y)
    return there, Edge(math.atan2(y, x) + (math.pi if card.own else 0.0))


def _white_card(plane: Plane) -> Bars:
    """A card all white: half a cycle of bars."""
    width, height = plane.size or (math.inf, math.inf)
    return Bars((0.5 / width, 0.5 / width), width, height)


def _extent(
    pupils: Pupils, plane: Plane, distortion: Distortion | None, motion: Motion | None, middle: Array, half: Array
) -> tuple[Array, Array]:
    """Lowest and highest places on a card of all rays from a rectangle on the sensor during an exposure; (N, 2) each."""
    landing = linearised(pupils, plane, distortion, middle)
    sensor = middle[:, None] + half[:, None] * np.repeat(CORNERS, len(RIM), axis=0)
    pupil = np.tile(RIM, (len(CORNERS), 1))[None]
    crooked = np.abs(landing.at(pupil, sensor) - land(pupils, plane, distortion, pupil, sensor)).max(axis=1)
    reach = (np.abs(landing.by_sensor) @ half[:, :, None])[:, :, 0] + np.hypot(landing.by_pupil[:, :, 0], landing.by_pupil[:, :, 1])
    if motion is not None:
        reach = reach + np.abs(landing.by_motion) @ (np.abs(motion.drift) / 2 + np.abs(motion.vibration))
    centre = landing.origin + (landing.by_sensor @ middle[:, :, None])[:, :, 0]
    return centre - reach - 1.5 * crooked, centre + reach + 1.5 * crooked
