"""The exact image of a flat target behind round apertures: defocus, vignetting by both apertures,
overlap, pixel area.

For each microlens and each pixel its light can reach, the radiance averaged over the pixel is
integrated over the part of the pupil that lights the pixel. Source: physics.md, "Exact image of a
flat target".
"""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.cards.parts import split
from flflab.image.cards.past import add_past_cards, bend_past_cards
from flflab.image.cards.windows import cards_of
from flflab.image.diffraction.form import add_plane_with_diffraction
from flflab.image.effects.colour_filter import ColourFilter
from flflab.image.flat_target.moving import add_moving_plane
from flflab.image.geometry.setup import make_setup
from flflab.image.scene import ALL, Scene, without
from flflab.targets import Bars, Black, FourDot, Picture, White

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]

TOLERANCE = 0.002
LEAST_TOLERANCE = 1e-5


def render(
    scene: Scene,
    *,
    tolerance: float = TOLERANCE,
    effects: frozenset[str] = ALL,
    wanted: Chosen | None = None,
) -> Array:
    """Form the picture of a scene without noise.

    Args:
        scene: camera and targets; what has a size in mm is a point and black at infinity. Where a
            card stops some of a pixel's rays, what diffraction changes counts by the share of them
            that pass in the mean over the exposure; the card's own edge bends no light.
        tolerance: largest error asked for, in units of the white level.
        effects: what is formed; an effect that the scene does not have changes nothing.
        wanted: the pixels that matter, [row, column]; the others may hold anything. None for all.
            Stray light comes from all pixels: with it all are formed.

    Returns:
        Irradiance [row, column] in units of the white level: that at the centre of the micro-image
            nearest the axis under a
        boundless white target, without its neighbours' light.

    Raises:
        InputError: the apertures are not round, a number is impossible, an effect is unknown, or a
            tilted array reaches through the sensor.
    """
    pictured = without(scene, effects)
    _check(pictured, tolerance, wanted)
    columns, rows = pictured.camera.sensor.resolution
    image = np.zeros((rows, columns))
    formed = None if pictured.stray_light is not None else wanted
    for index in range(len(pictured.planes)):
        _add_plane(image, pictured, index, tolerance, effects, formed)
    if pictured.stray_light is not None:
        share = pictured.stray_light.share
        image[:] = (1 - share) * image + share * image.mean()
    if pictured.colour_filter is not None:
        image *= transmissions(pictured.colour_filter, (rows, columns))
    return image


def _add_plane(
    image: Array,
    scene: Scene,
    index: int,
    tolerance: float,
    effects: frozenset[str],
    wanted: Chosen | None,
) -> None:
    """Add the light of one of a scene's planes."""
    plane = scene.planes[index]
    if isinstance(plane.target, Black) or (
        math.isinf(plane.distance) and isinstance(plane.target, FourDot | Bars | Picture)
    ):
        return
    setup = make_setup(scene, plane, tolerance, effects)
    if wanted is not None:
        setup = setup.reaching(wanted)
    cards = cards_of(scene, index)
    if isinstance(plane.target, White) and not cards:  # it is alike wherever its rays end
        setup = replace(setup, crooked=np.zeros_like(setup.crooked), motion=None)
    if scene.diffraction is not None and not isinstance(
        plane.target, White
    ):  # which spreads light by more than crooked rays go astray
        setup = replace(setup, crooked=np.zeros_like(setup.crooked))
    if cards or setup.crooked.any():
        parts = split(setup, plane, scene.distortion, cards)
        add_past_cards(image, parts, plane, scene.distortion, cards, wanted)
        if (
            scene.diffraction is not None
            and len(parts.behind.blur)
            and not isinstance(plane.target, White)
        ):
            bend_past_cards(image, parts.behind, scene, plane, cards, wanted)
        setup = parts.clear
    if len(setup.blur) and scene.diffraction is not None:
        add_plane_with_diffraction(image, setup, plane.target, scene.diffraction.wavelength, wanted)
    elif len(setup.blur):
        add_moving_plane(image, setup, plane.target, wanted)


def transmissions(mosaic: ColourFilter, shape: tuple[int, int]) -> Array:
    """How much of the light the filter of each pixel lets through, [row, column]."""
    by_letter = {"r": mosaic.red, "g": mosaic.green, "b": mosaic.blue}
    tile = np.array([by_letter[letter] for letter in mosaic.pattern]).reshape(2, 2)
    rows, columns = shape
    return tile[np.ix_(np.arange(rows) % 2, np.arange(columns) % 2)]


def _check(scene: Scene, tolerance: float, wanted: Chosen | None) -> None:
    shape = scene.camera.aperture_shape
    if shape != "round":
        raise InputError(
            f"render: images are formed for round apertures only, not {shape}; set aperture_shape:"
            " round"
        )
    if not LEAST_TOLERANCE <= tolerance < 1:
        raise InputError(
            f"render: the tolerance is {tolerance:g}; a share of white from {LEAST_TOLERANCE:g} to"
            " below 1 is allowed"
        )
    size = scene.camera.sensor.resolution[::-1]
    if wanted is not None and wanted.shape != size:
        raise InputError(
            f"render: the wanted pixels are an array of {wanted.shape}; the sensor has {size} rows"
            " and columns"
        )
