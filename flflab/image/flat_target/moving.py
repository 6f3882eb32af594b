"""The light of one flat target that moves during the exposure.

What moves along the lines of bars or of an edge changes nothing but at the bars' ends; what moves
across them smears their profile, once for all moments. Only pixels that see an end, the rim of a
dot or a border between texels are formed at one place after the other.
"""

from itertools import chain

import numpy as np
import numpy.typing as npt

from flflab.image.flat_target.at_borders import at_borders
from flflab.image.flat_target.form import add_plane
from flflab.image.flat_target.moments import alike, at_heights, at_moments, moment_count
from flflab.image.geometry.setup import Setup
from flflab.image.radiance.profile import Cropped, Ruled
from flflab.targets import FourDot, Picture, Target

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]


def add_moving_plane(
    image: Array, setup: Setup, target: Target | Cropped, wanted: Chosen | None = None
) -> None:
    """Add the light of one flat target, not black, to an image [row, column] in units of the white
    level.

    Args:
        image: the image to add to.
        setup: what is formed.
        target: the target.
        wanted: which pixels to compute, [row, column]; the others stay as they are. None for all.
    """
    has_borders = isinstance(target, FourDot | Picture) or (
        isinstance(target, Ruled) and moment_count(setup, 1) > 1
    )
    if not has_borders or not (found := at_borders(image.shape, setup, target)).any():
        for part in alike(setup, 0):
            add_plane(image, part, target, wanted)
        return
    near, far = (found, ~found) if wanted is None else (wanted & found, wanted & ~found)
    away, close = setup.reaching(far), setup.reaching(near)
    for part in alike(away, 0):
        add_plane(image, part, target, far)
    if isinstance(target, Ruled):
        for part in chain.from_iterable(map(at_heights, alike(close, 1))):
            add_plane(image, part, target, near)
    elif len(close.origin):
        for part in at_moments(close):
            add_plane(image, part, target, near)
