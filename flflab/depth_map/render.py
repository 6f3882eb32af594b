"""Total focus and refocus from the views, each place at its own disparity."""

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, gaussian_filter, median_filter

from flflab.depth_map.kernels import VALUE, VIEWS
from flflab.depth_map.views import Views

Array = npt.NDArray[np.float64]

LAYERS = 12  # strengths of blur between none and the strongest
# a uniform disc of radius r has the variance r^2/4 along each axis
DISC_SIGMA = 0.5


def filled(disparity: Array, otherwise: float) -> Array:
    """Every place with a disparity: where there is none, that of the nearest place that has one,
    smoothed by a median.
    """
    missing = ~np.isfinite(disparity)
    if missing.all():
        return np.full(disparity.shape, otherwise)
    if not missing.any():
        return disparity
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    full = disparity[tuple(np.asarray(nearest))]
    return np.where(missing, median_filter(full, 5), disparity)


def total_focus(views: Views, disparity: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """The weighted mean of all views at each place's own disparity, in units of the white target's
    radiance, NaN where no microlens looks; and where two microlenses look.

    Args:
        views: the picture.
        disparity: of every place, without gaps.
    """
    sums = views.scores(disparity)
    return np.where(sums[VIEWS] > 0, sums[VALUE], np.nan), sums[VIEWS] >= 2


def refocus(views: Views, focus: Array, disparity: Array, wanted: float) -> Array:
    """The scene as an ordinary camera with the main lens's aperture sees it, sharp at one
    disparity.

    A place of another disparity is blurred by the disc that it makes there: a microlens at the edge
    of the used aperture sees it aside by the difference of the disparities over the wanted one, of
    its own distance. The disc is laid over the total focus; the views themselves, a few microlenses
    apart, would show the place several times.

    Args:
        views: the picture.
        focus: total focus.
        disparity: of every place, without gaps.
        wanted: disparity to be sharp at.
    """
    reach = max(kind.reach for kind in views.kinds) / abs(wanted)
    radius = np.abs(disparity - wanted) / abs(wanted) * reach / abs(views.grid.step)
    seen = np.isfinite(focus)
    light = np.where(seen, focus, 0.0)
    top = float(np.quantile(radius, 0.999))
    steps = np.linspace(0, max(top, 1e-6), LAYERS)
    layer = np.clip(radius / steps[1], 0, LAYERS - 1)
    result = np.zeros_like(light)
    for index, blur in enumerate(steps):
        share = np.clip(1 - np.abs(layer - index), 0, 1)
        if not share.any():
            continue
        # light of places about as blurred as this layer's, spread over the others
        own = np.where(seen, np.clip(1.5 - np.abs(layer - index) / 2, 0.02, 1), 0.0)
        spread = gaussian_filter(own, DISC_SIGMA * blur)
        picture = gaussian_filter(own * light, DISC_SIGMA * blur)
        result += share * picture / np.maximum(spread, 1e-6)
    return np.where(seen, result, np.nan)
