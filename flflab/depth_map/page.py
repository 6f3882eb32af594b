"""``depth.html``: the depth map to look at in a browser, without a network."""

import base64
import html
import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import jinja2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

WIDEST = 480  # columns on the page; a larger map is thinned out
FULL = 65535  # of the numbers on the page; the largest one means no value


def depth_page(
    distance: Array,
    sigma: Array,
    focus: Array,
    directions: tuple[Array, Array],
    summary: Mapping[str, Any],
) -> str:
    """The page: depth and sigma in colour, total focus, a cross-section with its band, and the
    cloud turned by the mouse.

    Args:
        distance: mm, NaN where there is no value.
        sigma: of it, mm.
        focus: total focus.
        directions: slopes of the columns and rows.
        summary: see ``DepthMap.summary``.
    """
    every = max(1, -(-distance.shape[1] // WIDEST))
    thin = (slice(None, None, every), slice(None, None, every))
    data = {
        "rows": distance[thin].shape[0],
        "columns": distance[thin].shape[1],
        "distance": _coded(distance[thin]),
        "sigma": _coded(sigma[thin]),
        "focus": _coded(focus[thin]),
        "x": [round(float(value), 6) for value in directions[0][::every]],
        "y": [round(float(value), 6) for value in directions[1][::every]],
    }
    template = jinja2.Environment(autoescape=True).from_string(
        files("flflab.depth_map").joinpath("page.html.jinja").read_text(encoding="utf-8")
    )
    return template.render(
        rows=summary_rows(summary),
        remarks=summary["remarks"],
        every=every,
        # no "</script>" can stand in numbers and base64
        data=json.dumps(data),
    )


def summary_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What a table says of a depth map, name and value with its unit."""
    rows = [("places with a value", f"{summary['values']} ({100 * summary['density']:.1f} %)")]
    away = summary["distance_mm"]
    if away is not None:
        rows += [
            ("median distance", f"{away['median']:.2f} mm"),
            ("98 % of the values", f"{away['low']:.2f} to {away['high']:.2f} mm"),
            ("median own sigma", f"{summary['sigma_mm']:.3f} mm"),
        ]
        common = summary["common_mm"]
        rows.append(
            ("sigma common to all places", "not stated" if common is None else f"{common:.3f} mm")
        )
        slopes = summary["derivatives_at_median"]
        rows += [
            (f"distance change per µm of {name}", f"{slopes[key] / 1000:+.3f} mm")
            for name, key in (
                ("focal length", "focal_length"),
                ("array distance", "array_distance"),
                ("gap", "gap"),
            )
        ]
    near, far = summary["searched_mm"]
    rows.append(
        ("searched", f"{near:.1f} mm to " + ("infinity" if far is None else f"{far:.1f} mm"))
    )
    return rows


def small_table(summary: Mapping[str, Any]) -> str:
    """An HTML table for notebooks."""
    cells = "".join(
        f"<tr><th align='left'>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>"
        for name, value in summary_rows(summary)
    )
    return f"<table>{cells}</table>"


def _coded(values: Array) -> dict[str, Any]:
    """Numbers in 16 bits between their smallest and largest, base64."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    step = (high - low) / (FULL - 1) or 1.0
    whole = np.where(np.isfinite(values), (values - low) / step, FULL)
    return {
        "low": low,
        "step": step,
        "numbers": base64.b64encode(np.rint(whole).astype("<u2").tobytes()).decode("ascii"),
    }
