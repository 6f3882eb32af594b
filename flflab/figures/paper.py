"""What the figures share: a sheet with its caption, colours, and the stop at which micro-images
overlap.
"""

import textwrap
from dataclasses import replace
from typing import TYPE_CHECKING

from flflab.optics.camera import Camera, MainLens
from flflab.optics.resolution import central_smms

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INSIDE, OUTSIDE, USEFUL, GREY, DARK = "#0072b2", "#d55e00", "#009e73", "#9a9a9a", "#333333"
SMMS_COLOURS = ("#0072b2", "#d55e00", "#cc79a7")
_STOPS = (32.0, 22.0, 16.0, 11.0, 8.0, 5.6, 4.0, 2.8, 2.0, 1.4, 1.0, 0.7, 0.5)


def sheet(caption: str, height: float = 4.8, width: float = 11.0) -> "Figure":
    """An empty figure with room for its caption at the foot."""
    from matplotlib.figure import Figure

    lines = textwrap.wrap(caption, 150)
    figure = Figure(figsize=(width, height + 0.2 * len(lines)), layout="constrained")
    share = (0.2 * len(lines) + 0.1) / (height + 0.2 * len(lines))
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.set(rect=(0.0, share, 1.0, 1.0 - share), w_pad=0.08, h_pad=0.08)  # pyright: ignore[reportCallIssue]
    figure.text(
        0.015,
        share - 0.1 / (height + 0.2 * len(lines)),
        "\n".join(lines),
        va="top",
        fontsize=9,
        color=DARK,
    )
    return figure


def plain(axes: "Axes", title: str, across: str, up: str) -> None:
    """Title, labels and no box at the top and right."""
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    axes.spines[["top", "right"]].set_visible(False)


def overlapping_camera(camera: Camera) -> Camera:
    """The camera at the smallest full stop opening at which neighbours overlap by a fifth of a
    pitch or more; itself if it does.
    """
    for f_number in (
        camera.main_lens.f_number,
        *(stop for stop in _STOPS if stop < camera.main_lens.f_number),
    ):
        lens = MainLens(
            camera.main_lens.focal_length, f_number, camera.main_lens.principal_separation
        )
        opened = replace(camera, main_lens=lens)
        smms = central_smms(opened)
        pitch = camera.array.pitch[0] * float(smms.image_scale)
        if 2 * float(smms.outside_radius) > 1.2 * pitch:
            return opened
    return camera
