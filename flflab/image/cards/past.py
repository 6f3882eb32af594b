"""A plane's light where cards stop some of its rays, and what diffraction changes of it there.

The change of it without cards counts by the share of a pixel's rays that the cards let pass, each
micro-image's for itself: where several reach a pixel they are laid side by side.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.image.cards.bends import add_bent
from flflab.image.cards.parts import CardParts, split, split_by_dots
from flflab.image.cards.single_rays import add_single_rays
from flflab.image.cards.windows import Card
from flflab.image.diffraction.form import add_plane_with_diffraction
from flflab.image.effects.distortion import Distortion
from flflab.image.flat_target.form import add_plane
from flflab.image.flat_target.moments import places_of
from flflab.image.flat_target.moving import add_moving_plane
from flflab.image.geometry.setup import Setup
from flflab.image.scene import Plane, Scene
from flflab.targets import FourDot, Picture, White

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

UNFELT = 0.05  # of the tolerance
# of it, for the rays that waves are held against: they cost less, and the errors of both add up
OF_RAYS = 0.3
OF_PASSED = 0.3  # of it, for the share of light that cards let pass
COARSEST = 0.1  # tolerance of that share
MANY = 16  # moments at which a moving picture is formed: more take single rays less time


def add_past_cards(
    image: Array,
    parts: CardParts,
    plane: Plane,
    distortion: Distortion | None,
    cards: tuple[Card, ...],
    wanted: Chosen | None,
) -> None:
    """Add the light of rays of a plane that cards leave of it, but for that of the clear parts.

    Args:
        image: picture to add to, [row, column], in units of the white level.
        parts: how micro-images see the plane.
        plane: the target.
        distortion: of the main lens.
        cards: those that stop rays; they move as the target does.
        wanted: the pixels to compute; None for all.
    """
    add_bent(image, parts.bent, plane, distortion, wanted)
    for before, target in parts.light:
        add_moving_plane(image, before, target, wanted)
    if parts.shadow:
        hidden = np.zeros_like(image)
        for before, target in parts.shadow:
            add_moving_plane(hidden, before, target, wanted)
        image -= hidden
    for before, target in parts.singly:
        add_single_rays(image, before, replace(plane, target=target), distortion, cards, wanted)


def bend_past_cards(
    image: Array,
    setup: Setup,
    scene: Scene,
    plane: Plane,
    cards: tuple[Card, ...],
    wanted: Chosen | None,
) -> None:
    """Add what diffraction changes of a plane's light behind cards.

    Args:
        image: picture to add to, [row, column], in units of the white level.
        setup: the parts of micro-images behind cards.
        scene: what is pictured; it has diffraction.
        plane: the target.
        cards: those that stop rays.
        wanted: the pixels to compute; None for all.
    """
    if scene.diffraction is None:
        return
    layer = _layers(setup)
    layers, rows = int(layer.max(initial=0)) + 1, image.shape[0]
    apart = _side_by_side(setup, layer, layers)
    chosen = None if wanted is None else np.tile(wanted, (layers, 1))
    change, passed, whole = np.zeros((3, layers * rows, image.shape[1]))
    finer = replace(apart, tolerance=OF_RAYS * setup.tolerance)
    if isinstance(
        plane.target, FourDot
    ):  # at many moments, or in wide blurs: single rays are fewer
        inside, across = split_by_dots(finer, plane, plane.target, scene.distortion)
        add_plane(change, inside, White(), chosen)
        add_single_rays(change, across, plane, scene.distortion, (), chosen)
    elif isinstance(plane.target, Picture) and len(places_of(finer)[1]) > MANY:
        add_single_rays(change, finer, plane, scene.distortion, (), chosen)
    else:
        add_moving_plane(change, finer, plane.target, chosen)
    np.negative(change, out=change)
    add_plane_with_diffraction(change, apart, plane.target, scene.diffraction.wavelength, chosen)
    felt = np.abs(change) > UNFELT * setup.tolerance
    if chosen is not None:
        felt &= chosen
    if not felt.any():
        return
    coarser = replace(
        apart,
        tolerance=min(OF_PASSED * setup.tolerance / float(np.abs(change[felt]).max()), COARSEST),
    )
    add_plane(whole, coarser, White(), felt)
    white = replace(plane, target=White())
    parts = split(coarser, white, scene.distortion, cards)
    add_plane(passed, parts.clear, white.target, felt)
    add_past_cards(passed, parts, white, scene.distortion, cards, felt)
    share = np.divide(passed, whole, out=np.zeros_like(whole), where=felt & (whole > 0))
    image += (np.clip(share, 0.0, 1.0) * change).reshape(layers, *image.shape).sum(axis=0)


def _layers(setup: Setup) -> Whole:
    """A number for each entry, such that micro-images of one number share no pixel."""
    pupils = setup.pupils
    centres, lens = np.unique(
        np.column_stack([pupils.centre_x, pupils.centre_y]), axis=0, return_inverse=True
    )
    near: list[set[int]] = [set() for _ in centres]
    for one, other in KDTree(centres).query_pairs(
        2 * (float(pupils.outside.max()) + setup.sensor.pixel)
    ):
        near[one].add(other)
        near[other].add(one)
    layer = np.full(len(centres), -1)
    for index, others in enumerate(near):
        taken = {int(layer[other]) for other in others}
        layer[index] = next(number for number in range(len(centres)) if number not in taken)
    return layer[lens.reshape(-1)]


def _side_by_side(setup: Setup, layer: Whole, layers: int) -> Setup:
    """The same before a sensor so many times as high, on which each layer has its own rows."""
    columns, rows = setup.sensor.resolution
    height = rows * setup.sensor.pixel
    offset = (setup.sensor.offset[0], setup.sensor.offset[1] + (layers - 1) * height / 2)
    return replace(
        setup,
        sensor=replace(setup.sensor, resolution=(columns, rows * layers), offset=offset),
        pupils=replace(setup.pupils, centre_y=setup.pupils.centre_y + layer * height),
        window=setup.window + layer[:, None] * np.array([0, 0, rows, rows]),
    )
