"""Whether a measured picture is a white one at all."""

import numpy as np

from flflab.errors import MeasurementError
from flflab.measurement.lattice.find import stretch
from flflab.measurement.lattice.white_picture import WhitePicture

MOST_SATURATED = 0.25  # of the pixels: no plateau is left
MOST_SCATTER = 0.03  # of the pitch, by which micro-images may stand off
MOST_OFF = 0.25  # of them, farther off than that
STRETCHED = 1.1  # times: no array's lattice, where spots explain the light badly too
UNLIKE = 0.05  # of the light, that they leave


def require_white(white: WhitePicture, saturated: float) -> None:
    """Refuse a picture whose lattice is none of micro-images in even light.

    Args:
        white: what was measured.
        saturated: share of the pixels.

    Raises:
        MeasurementError: see there.
    """
    if saturated > MOST_SATURATED:
        raise MeasurementError(
            f"white picture: {100 * saturated:.0f} % of its pixels are saturated, at most"
            f" {100 * MOST_SATURATED:.0f} % are allowed; expose it shorter"
        )
    pitch, scatter = white.rough.pitch, white.grid.scatter_px / white.rough.pitch
    aside = white.values[white.whole, :2] - white.grid.centres(white.indices[white.whole])
    off = float(np.mean(np.hypot(*aside.T) > MOST_SCATTER * pitch))
    if scatter > MOST_SCATTER or off > MOST_OFF:
        raise MeasurementError(
            f"white picture: it is probably none; bright spots repeat every {pitch:.1f} px, but"
            f" they stand {100 * scatter:.1f} % of that off a lattice ({100 * MOST_SCATTER:.0f} %"
            f" are allowed) and {100 * off:.0f} % of them far off; take an evenly lit target"
        )
    stretched = stretch(white.rough.layout, white.rough.vectors)
    if stretched > STRETCHED and white.misfit > UNLIKE:
        raise MeasurementError(
            "white picture: it is probably none; what repeats in it lies on a lattice that is"
            f" stretched {stretched:.2f} times, and spots leave {100 * white.misfit:.0f} % of its"
            " light; take an evenly lit target"
        )
