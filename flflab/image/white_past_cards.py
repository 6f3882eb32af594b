"""Light of a white target past cards: all of it, what one straight edge leaves, or, round corners and gaps, what single rays say."""

import numpy as np
import numpy.typing as npt

from flflab.image.cards import Card, split_white
from flflab.image.effects.distortion import Distortion
from flflab.image.form import add_plane
from flflab.image.moving import add_moving_plane
from flflab.image.scene import Plane
from flflab.image.setup import Setup
from flflab.image.single_rays import add_single_rays

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]


def add_white_past_cards(
    image: Array, setup: Setup, plane: Plane, distortion: Distortion | None, cards: tuple[Card, ...], wanted: Chosen | None
) -> None:
    """Add the light of a white plane to an image [row, column] in units of the white level.

    Args:
        image: picture to add to.
        setup: made for the plane.
        plane: the target, white.
        distortion: of the main lens.
        cards: those that stop rays; they move as the target does.
        wanted: the pixels to compute; None for all.
    """
    parts = split_white(setup, 1 / plane.distance, distortion, cards)
    if len(parts.clear.blur):
        add_plane(image, parts.clear, plane.target, wanted)
    for before, target in parts.light:
        add_moving_plane(image, before, target, wanted)
    hidden = np.zeros_like(image) if parts.shadow else image[:0]
    for before, target in parts.shadow:
        add_moving_plane(hidden, before, target, wanted)
    if parts.shadow:
        image -= hidden
    add_single_rays(image, parts.singly, plane, distortion, cards, wanted)
