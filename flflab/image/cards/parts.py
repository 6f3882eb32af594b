"""Parts of micro-images that see a target past cards: clearly, as a picture of one card tells, or
so that single rays are needed.

One card leaves of a white target as much light as a picture of the card holds, or one of its only
side that is met. Bars on a card that is too small for them are shorter bars. What looks into a dot
with all its rays sees white, and what looks past all dots nothing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.image.cards.windows import PARTS, SIDES, Card, pupils_before, seen_of_dots, seen_past
from flflab.image.effects.distortion import Distortion
from flflab.image.geometry.rays import linearised
from flflab.image.geometry.setup import MAP_SHARE, Setup
from flflab.image.geometry.tiles import blur_of, counts_needed, cut, middles
from flflab.image.radiance.profile import Cropped
from flflab.image.scene import Plane
from flflab.targets import Bars, Edge, FourDot, Target, White

Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]
Parts = tuple[Whole, Whole]  # entries of a setup, and windows of pixels
Pictures = list[tuple[Setup, Target | Cropped]]

SMALLEST = 4  # pixels a side of a part that is summed by single rays
SMALLEST_WHITE = 2  # the same before a white target
SHARP = 1.0  # pixels of blur; corners that are blurred more take single rays less time


@dataclass(frozen=True)
class CardParts:
    """Which parts of micro-images see a target past cards, and how; what sees nothing is in none.

    Attributes:
        clear: with all their rays.
        bent: with all their rays too, which end crookedly.
        light: what is seen past one card, as a picture of what that leaves.
        shadow: pictures of a card, white, that takes as much of the light of ``clear`` and
            ``light``.
        singly: parts that need single rays, and what they look at: past several cards, or crookedly
            past the edge of one.
        behind: all that a card leaves less than all light, dark or not.
    """

    clear: Setup
    bent: Setup
    light: Pictures
    shadow: Pictures
    singly: list[tuple[Setup, Target]]
    behind: Setup


def split(
    setup: Setup, plane: Plane, distortion: Distortion | None, cards: tuple[Card, ...]
) -> CardParts:
    """Tell apart how the parts of micro-images see a plane past cards.

    Parts for which there is no closed form are quartered until they are small.

    Args:
        setup: made for the plane.
        plane: the target.
        distortion: of the main lens.
        cards: those that stop rays.
    """
    own = next((card for card in cards if card.own), None)  # the first, if there is one
    target = plane.target
    white, ruled = isinstance(target, White), own is not None and isinstance(target, Bars)

    def sort(entries: Whole, windows: Whole, small: Flags) -> tuple[Flags, ...]:
        full, none, met = seen_past(
            setup, setup.pupils.of(entries), windows, 1 / plane.distance, distortion, cards
        )
        crooked, dark = setup.crooked[entries] & (not white), np.zeros(len(entries), dtype=np.bool_)
        clear = full & ~crooked
        alone = (met >= 0) & ~none & ~crooked
        if white:
            alone[alone] = _told(
                setup, entries[alone], windows[alone], plane, distortion, cards, met[alone]
            )
        elif isinstance(target, FourDot):
            alone, dark = seen_of_dots(
                setup, setup.pupils.of(entries), windows, plane, target, distortion
            )
            alone, dark = alone & ~none & ~clear, dark & ~none & ~clear
        else:
            # Ends of bars take single rays less time; waves are held against rays in all these
            # parts, so that they must be small.
            alone &= ((met == 0) | (met == 2)) & ruled & small
        told = alone | dark
        return none, clear, full & crooked & ~told, alone, dark, small & ~full & ~told

    clear, bent, alone, dark, singly = _quartered(
        setup, sort, SMALLEST_WHITE if white else SMALLEST
    )
    behind = setup.of(*_together(alone, dark, singly))
    rest = [(setup.of(*singly), target)]
    if own is not None and isinstance(target, Bars):
        width, height = own.size
        bars = Cropped(target, min(width, target.width), min(height, target.height))
        return CardParts(
            setup.of(*clear), setup.of(*bent), [(setup.of(*alone), bars)], [], rest, behind
        )
    if isinstance(target, FourDot):
        dots = split(setup.of(*alone), replace(plane, target=White()), distortion, cards)
        light = [(dots.clear, White()), *dots.light]
        return CardParts(
            setup.of(*clear), setup.of(*bent), light, dots.shadow, [*rest, *dots.singly], behind
        )
    met = seen_past(
        setup, setup.pupils.of(alone[0]), alone[1], 1 / plane.distance, distortion, cards
    )[2]
    light, shadow = Pictures(), Pictures()
    for number in np.unique(met):
        card = cards[int(number) // PARTS]
        part = alone[0][met == number], alone[1][met == number]
        before = _before(setup.of(*part), plane, distortion, card.plane)
        if number % PARTS < len(SIDES):
            light.append(_side(before, card, int(number) % PARTS))
        elif card.own:
            light.append((before, _white(card)))
        else:
            shadow.append((before, _white(card)))
            clear = _together(clear, part)
    return CardParts(setup.of(*clear), setup.of(*bent), light, shadow, rest, behind)


def split_by_dots(
    setup: Setup, plane: Plane, dots: FourDot, distortion: Distortion | None
) -> tuple[Setup, Setup]:
    """Parts of micro-images that look into one dot with all their rays, and those that see a dot's
    edge; not those that see none.
    """

    def sort(entries: Whole, windows: Whole, small: Flags) -> tuple[Flags, ...]:
        inside, outside = seen_of_dots(
            setup, setup.pupils.of(entries), windows, plane, dots, distortion
        )
        return outside, inside, small & ~inside

    inside, across = _quartered(setup, sort, SMALLEST)
    return setup.of(*inside), setup.of(*across)


def _together(*parts: Parts) -> Parts:
    return np.concatenate([one[0] for one in parts]), np.concatenate([one[1] for one in parts])


def _quartered(
    setup: Setup, sort: Callable[[Whole, Whole, Flags], tuple[Flags, ...]], least: int
) -> list[Parts]:
    """Entries and windows of each class but the first that ``sort`` makes; what is in none is
    quartered down to ``least`` pixels a side.
    """
    entries, windows = np.arange(len(setup.blur)), setup.window
    found: list[list[Parts]] = []
    while len(entries) or not found:
        sides: Whole = np.stack(
            [windows[:, 1] - windows[:, 0], windows[:, 3] - windows[:, 2]], axis=1
        )
        dropped, *classes = sort(entries, windows, np.asarray((sides <= least).all(axis=1)))
        rest = ~dropped & (sides > 0).all(axis=1)
        found.append([(entries[rest & one], windows[rest & one]) for one in classes])
        rest &= ~np.any(classes, axis=0)
        quarters, smaller = cut(windows[rest], np.where(sides[rest] > least, 2, 1))
        entries, windows = entries[rest][quarters], smaller
    return [
        (np.concatenate([one[0] for one in parts]), np.concatenate([one[1] for one in parts]))
        for parts in zip(*found, strict=True)
    ]


def _told(
    setup: Setup,
    entries: Whole,
    windows: Whole,
    plane: Plane,
    distortion: Distortion | None,
    cards: tuple[Card, ...],
    met: Whole,
) -> Flags:
    """Whether a picture of the one card that each part meets tells its light: by a linear map, and
    more cheaply than single rays.
    """
    told = np.zeros(len(entries), dtype=np.bool_)
    for number in np.unique(met // PARTS):
        card, this = cards[int(number)].plane, met // PARTS == number
        before = pupils_before(
            setup.pupils.of(entries[this]), 1 / plane.distance, 1 / card.distance
        )
        counts, crooked = counts_needed(
            setup.sensor, before, windows[this], card, distortion, MAP_SHARE * setup.tolerance
        )
        landing = linearised(
            before, card, distortion, middles(setup.sensor, before, windows[this])[0]
        )
        sharp = blur_of(landing.by_pupil, landing.by_sensor, setup.sensor.pixel) < SHARP
        told[this] = (
            (counts == 1).all(axis=1) & ~crooked & (sharp | (met[this] % PARTS < len(SIDES)))
        )
    return told


def _before(setup: Setup, plane: Plane, distortion: Distortion | None, other: Plane) -> Setup:
    """A setup made for a plane, made for another."""
    before = pupils_before(setup.pupils, 1 / plane.distance, 1 / other.distance)
    landing = linearised(before, other, distortion, middles(setup.sensor, before, setup.window)[0])
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


def _side(before: Setup, card: Card, side: int) -> tuple[Setup, Edge]:
    """One side of a card, from its middle: white where the card lets light pass."""
    (x, y), (width, height) = SIDES[side], card.size
    return before.seen_from(x * width / 2, y * height / 2), Edge(
        math.atan2(y, x) + (math.pi if card.own else 0.0)
    )


def _white(card: Card) -> Bars:
    """A card all white: half a cycle of bars."""
    width, height = card.size
    return Bars((0.5 / width, 0.5 / width), width, height)
