"""The files of a depth map: TIFF pages, total focus as PNG, cloud as PLY, JSON and the page."""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import tifffile

from flflab.errors import InputError
from flflab.whole_file import make_folder, require_writable, write_together

Array = npt.NDArray[np.float64]

FILES = ("depth.tif", "focus.png", "cloud.ply", "depth.json", "depth.html")
FULL = 65535
POINT = np.dtype([(name, "<f4") for name in ("x", "y", "z", "sigma_z", "intensity")])


def require_writable_folder(folder: Path) -> None:
    """Refuse, before anything is computed, a folder in which the files could not be written.

    Raises:
        InputError: see there.
    """
    make_folder(folder, str(folder))
    for name in FILES:
        require_writable(folder / name)


def write_depth_files(
    folder: Path,
    pages: Mapping[str, Array],
    focus: Array,
    points: Array,
    summary: Mapping[str, Any],
    page: str,
) -> list[Path]:
    """Write all files of a depth map.

    Args:
        folder: is made where there is none.
        pages: of the TIFF file, by name.
        focus: total focus.
        points: x, y, z, sigma_z, intensity, shape (n, 5).
        summary: for the JSON file.
        page: HTML.

    Raises:
        InputError: a file cannot be written; then none is.
    """
    make_folder(folder, str(folder))
    contents = (
        tiff_bytes(pages),
        png_bytes(focus),
        ply_bytes(points),
        json.dumps(summary, allow_nan=False, indent=1) + "\n",
        page,
    )
    files = [folder / name for name in FILES]
    write_together(dict(zip(files, contents, strict=True)))
    return files


def tiff_bytes(pages: Mapping[str, Array]) -> bytes:
    """float32 pages, each named by its tags 285 (PageName) and 270 (ImageDescription)."""
    stream = io.BytesIO()
    with tifffile.TiffWriter(stream) as tiff:
        for name, values in pages.items():
            tiff.write(
                values.astype(np.float32),
                description=name,
                extratags=[(285, 2, 0, name, True)],
                metadata=None,
                compression="zlib",
                photometric="minisblack",
            )
    return stream.getvalue()


def png_bytes(picture: Array) -> bytes:
    """16 bits; the brightest thousandth reaches full scale, places without light are 0."""
    seen = picture[np.isfinite(picture)]
    top = float(np.quantile(seen, 0.999)) if seen.size else 1.0
    numbers = np.nan_to_num(picture) / max(top, 1e-12) * FULL
    whole = np.rint(np.clip(numbers, 0, FULL)).astype(np.uint16)
    done, coded = cv2.imencode(".png", whole)
    if not done:
        raise InputError("focus.png: the picture could not be coded as PNG")
    return coded.tobytes()


def ply_bytes(points: Array) -> bytes:
    """Binary little-endian PLY; mm, z is the distance from the main lens."""
    table = np.zeros(len(points), dtype=POINT)
    for index, name in enumerate(POINT.names or ()):
        table[name] = points[:, index]
    head = ["ply", "format binary_little_endian 1.0", "comment mm; z: distance from the main lens"]
    head += [f"element vertex {len(points)}"]
    head += [f"property float {name}" for name in POINT.names or ()]
    return ("\n".join([*head, "end_header"]) + "\n").encode("ascii") + table.tobytes()
