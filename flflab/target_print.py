"""A target on paper or film: a picture in its true size, as PNG or as SVG with a ruler."""

import base64
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.targets import Picture, Target, describe
from flflab.whole_file import require_writable, write_whole

Array = npt.NDArray[np.float64]

ENDINGS = (".png", ".svg")
MOST_PIXELS = 20_000  # a side
INCH = 25.4
RULER_MM = 10.0
MARGIN_MM = 6.0


def print_target(target: Target, file: Path, width: float | None, dots_per_inch: float) -> str:
    """Write a target in its true size.

    A printed texture is a target whose truth is known: the same kind, width, grain and seed make
    the same texture. Columns run with x and rows with y, upside down to an eye that sees y upwards.

    Args:
        target: what to print.
        file: ``.png`` with its resolution inside, or ``.svg`` with a ruler.
        width: of what is printed, mm; None takes the target's own.
        dots_per_inch: of the picture; a texture or a picture has its texels at least.

    Returns:
        A sentence that says how large a texel and the whole print are.

    Raises:
        InputError: a target without bounds and no width, an ending that is not allowed, more than
            20,000 pixels a side, or a file that cannot be written.
    """
    if file.suffix.lower() not in ENDINGS:
        raise InputError(f"{file}: targets are printed to files ending in {', '.join(ENDINGS)}")
    require_writable(file)
    own = getattr(target, "width", None)
    wide = width if width is not None else own
    if wide is None:
        raise InputError(f"target '{target.kind}' has no width of its own; give --width")
    tall = float(getattr(target, "height", wide)) if width is None else wide
    texel = INCH / dots_per_inch
    if isinstance(target, Picture):  # whole pixels a texel, or its edges would jitter
        texel = target.texel / max(1, round(target.texel / texel))
    columns, rows = round(wide / texel), round(tall / texel)
    if not 1 <= max(columns, rows) <= MOST_PIXELS:
        raise InputError(
            f"{file}: {columns} x {rows} pixels; at most {MOST_PIXELS} a side are written: ask for"
            " a smaller width or fewer dots an inch"
        )
    x, y = ((np.arange(count) - (count - 1) / 2) * texel for count in (columns, rows))
    grey = np.rint(255 * target.radiance(x[None, :], y[:, None])).astype(np.uint8)
    coded = png_of(grey, texel)
    write_whole(
        file,
        coded
        if file.suffix.lower() == ".png"
        else _svg(coded, columns * texel, rows * texel, target),
    )
    return (
        f"{file}: {columns * texel:.2f} mm x {rows * texel:.2f} mm, {columns} x {rows} pixels of"
        f" {1e3 * texel:.1f} um; print at 100 %, and measure it: its true size goes into the target"
        " file"
    )


def png_of(grey: npt.NDArray[np.uint8], texel: float) -> bytes:
    """A PNG that says how large its pixels are.

    Args:
        grey: numbers, [row, column].
        texel: side of a pixel, mm.
    """
    done, coded = cv2.imencode(".png", grey)
    if not done:
        raise InputError("the target could not be coded as PNG")
    plain = coded.tobytes()
    a_metre = round(1000 / texel)
    content = b"pHYs" + struct.pack(">IIB", a_metre, a_metre, 1)
    chunk = struct.pack(">I", 9) + content + struct.pack(">I", zlib.crc32(content))
    after_head = 8 + 25  # signature, and the chunk IHDR
    return plain[:after_head] + chunk + plain[after_head:]


def _svg(coded: bytes, wide: float, tall: float, target: Target) -> str:
    """The picture in millimetres with a ruler and the target's numbers beneath."""
    width, height = wide + 2 * MARGIN_MM, tall + 3 * MARGIN_MM
    line, below = tall + 1.6 * MARGIN_MM, tall + 2.4 * MARGIN_MM
    end = MARGIN_MM + RULER_MM
    picture = base64.b64encode(coded).decode("ascii")
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm"'
        f' viewBox="0 0 {width:g} {height:g}">\n'
        f'<image x="{MARGIN_MM:g}" y="{MARGIN_MM:g}" width="{wide:g}" height="{tall:g}"'
        ' preserveAspectRatio="none" style="image-rendering:pixelated"'
        f' href="data:image/png;base64,{picture}"/>\n'
        f'<path d="M{MARGIN_MM:g} {line - 1:g}v2m0 -1H{end:g}m0 -1v2" stroke="black" fill="none"'
        ' stroke-width="0.2"/>\n'
        f'<text x="{end + 2:g}" y="{line + 1:g}" font-size="3" font-family="sans-serif">'
        f"{RULER_MM:g} mm</text>\n"
        f'<text x="{MARGIN_MM:g}" y="{below:g}" font-size="3" font-family="sans-serif">'
        f"{describe(target)}, mm</text>\n</svg>\n"
    )
