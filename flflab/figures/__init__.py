"""The paper's Figures 1 to 9, drawn by the model for any camera: ``flflab model CAMERA --figures
DIR``.
"""

import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from flflab.optics.camera import Camera
from flflab.whole_file import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Drawing = Callable[[Camera], tuple["Figure", str]]


def draw_figures(camera: Camera, folder: Path) -> list[tuple[Path, str]]:
    """Draw Figures 1 to 9 into a folder as figure-1.png to figure-9.png, and captions.md beside
    them.

    Args:
        camera: the camera; Figures 3 and 4 open its main lens to the first full stop at which
            micro-images overlap clearly.
        folder: where to write.

    Returns:
        Each file with its caption, which says what to see.

    Raises:
        InputError: a file cannot be written.
    """
    from flflab.figures import areas, quality, rays

    drawings: tuple[Drawing, ...] = (
        rays.system, rays.boundary, rays.overlapping, rays.useful, areas.stereo, areas.measurement,
        quality.bars, rays.marginal, quality.marginal_angles,
    )  # fmt: skip
    drawn: list[tuple[Path, str]] = []
    for number, drawing in enumerate(drawings, start=1):
        figure, caption = drawing(camera)
        file = folder / f"figure-{number}.png"
        picture = io.BytesIO()
        figure.savefig(picture, dpi=150)
        write_whole(file, picture.getbuffer())
        drawn.append((file, f"Figure {number}. {caption}"))
    text = "\n".join(f"![{file.name}]({file.name})\n\n{caption}\n" for file, caption in drawn)
    write_whole(folder / "captions.md", text)
    return drawn
