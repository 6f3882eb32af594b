"""Contrast of bars against frequency: the picture's own curve, and the paper's reading of it."""

import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.curve import ContrastCurve
from flflab.optics.contrast import contrast_paper, disc_transfer
from flflab.optics.focus import magnification
from flflab.optics.resolution import central_smms
from flflab.targets import Bars, BarsAlongY
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Values

Array = npt.NDArray[np.float64]
TARGETS = {"mtf": Bars.kind, "mtf_y": BarsAlongY.kind}


def contrasts(one: Measured, model: Predicted) -> list[Values]:
    """Those of bars across x and y, and the paper's reading of the former; none of bars that could
    not be measured.
    """
    index = one.configuration.index
    found = [
        mtf(index, quantity, curve, model.contrasts[quantity])
        for quantity, curve in one.curves.items()
    ]
    return found if one.curve is None else [*found, paper_contrast(index, one.curve, model)]


def mtf(index: int, quantity: str, curve: ContrastCurve, draws: Array) -> Values:
    """Contrast of the image's fundamental over the target's, signed."""
    return Values(
        index,
        quantity,
        TARGETS[quantity],
        curve.contrast,
        curve.covariance,
        draws.mean(axis=0),
        draws,
        (None,) * len(curve.contrast),
        tuple(curve.cycles_per_mm.tolist()),
    )


def paper_contrast(index: int, curve: ContrastCurve, model: Predicted) -> Values:
    """Eq. (2) of the paper, which knows no blur and is claimed inside the depth of field only:
    nowhere else are there values.

    What a blur of up to one pixel, and diffraction, take away there is the model's own slack: a
    rectangular distribution from none to all.
    """
    camera = model.camera
    count = len(curve.cycles_per_mm) if model.blur_px <= 1 else 0
    scale = camera.sensor.pixel / float(magnification(central_smms(camera), 1 / model.distance))
    cycles_per_px = curve.cycles_per_mm[:count] * scale
    claimed = contrast_paper(cycles_per_px)
    slack = claimed * (1 - disc_transfer(1.0, cycles_per_px) * model.waves_left[:count]) / 3**0.5
    noise = np.diag(curve.extremes_uncertainty[:count] ** 2 + slack**2)
    draws = np.tile(claimed, (len(model.contrast_draws), 1))
    return Values(
        index,
        "contrast_paper",
        "bars",
        curve.extremes[:count],
        noise,
        claimed,
        draws,
        (None,) * count,
        tuple(curve.cycles_per_mm[:count].tolist()),
    )
