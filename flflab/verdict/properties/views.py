"""Number of views of each dot."""

import numpy as np

from flflab.measurement.dots.views import DotViews
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.properties.values import Values


def views(one: Measured, model: Predicted) -> list[Values]:
    """How many micro-images see each dot (the paper's number of views; the rule is physics' chief
    views); nothing where the model's were not counted.
    """
    if model.view_draws is None:
        return []
    found = Values(
        one.configuration.index,
        "views",
        "four-dot",
        np.array([dot.views for dot in one.dots], dtype=np.float64),
        np.diag([count_doubt(dot) ** 2 for dot in one.dots]),
        model.views.astype(np.float64),
        model.view_draws,
        tuple(dot.dot for dot in one.dots),
        (None,) * len(one.dots),
    )
    return [found]


def count_doubt(dot: DotViews) -> float:
    """Standard uncertainty of a measured count: each undecided view is one or none, and a sure
    count is sure to 1 in 400.
    """
    return float(np.sqrt(dot.views_uncertain / 4 + 1 / 400))
