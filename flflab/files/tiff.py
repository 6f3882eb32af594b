"""TIFF files of any kind as numbers: ImageJ, OME, BigTIFF, tiles, every compression, through
tifffile.

A tag never turns, scales or inverts numbers here: it becomes a remark, or the file is refused.
"""

import contextlib
import io
import logging
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.files.stored_picture import (
    MOSAICS,
    StoredPicture,
    alpha_remark,
    gamma_remark,
    lossy_remark,
    orientation_remarks,
    require_bits,
    require_no_palette,
)
from flflab.remark import Remark

WHITE_IS_ZERO, BLACK_IS_ZERO, RGB, PALETTE, YCBCR = 0, 1, 2, 3, 6  # PhotometricInterpretation
FILTERS, LINEAR_RAW = 32803, 34892
PLAIN = (BLACK_IS_ZERO, RGB, YCBCR, FILTERS, LINEAR_RAW)
ASSOCIATED, UNASSOCIATED = 1, 2  # ExtraSamples: alpha, with the numbers multiplied by it or not
ORIENTATION, FILTER_REPEAT, FILTER_PLACES = 274, 33421, 33422  # tags
LOSSY = {6: "JPEG", 7: "JPEG", 34892: "JPEG", 50001: "WebP"}
WHOLE_BITS = (8, 16, 32, 64)


def read_tiff(file: Path, choose: Callable[[int], int]) -> StoredPicture:
    """Read one picture of a TIFF file.

    Args:
        file: the file.
        choose: which of so many pictures, from 0; may refuse.

    Raises:
        InputError: the numbers are not a sensor's (inks, palette, white at 0, one bit), or the
            compression cannot be undone.
        ValueError: not a TIFF file, or cut short.
    """
    import tifffile  # only those who read such files pay for its start-up

    with _without_its_own_lines(), tifffile.TiffFile(file, is_ome=False) as content:
        every: list[Any] = list(content.pages)
        pages = [page for page in every if not (page.is_reduced or page.is_mask)] or every
        if not pages:
            raise ValueError("it holds no page")
        virtual = _virtual_pages(content, pages)
        place = choose(virtual or len(pages))
        page = pages[0] if virtual else pages[place]
        _require_numbers(file, page)
        values = _virtual(content, page, place) if virtual else _decoded(file, page)
        remarks = _remarks(content, page)
    if page.planarconfig == 2 and values.ndim == 3:  # a plane for each channel
        values = np.moveaxis(values, 0, -1)
    values, alpha = _without_alpha(file, page, values)
    bits = int(page.bitspersample)
    return StoredPicture(
        values,
        None if bits in WHOLE_BITS or values.dtype.kind == "f" else float(2**bits - 1),
        _mosaic(page),
        (*remarks, *alpha),
    )


def require_whole_strips(file: Path) -> None:
    """Check that a file built as a TIFF holds the bytes of every strip and tile it names.

    Raises:
        ValueError: it ends before them, or names none.
    """
    import tifffile

    with _without_its_own_lines(), tifffile.TiffFile(file, is_ome=False) as content:
        for page in content.pages:
            _require_whole(content, page)
            for inner in page.pages or ():
                _require_whole(content, inner)


def filter_repeat(file: Path) -> tuple[int, int] | None:
    """Rows and columns after which the mosaic of a .dng repeats; None where it names none."""
    import tifffile

    with _without_its_own_lines(), tifffile.TiffFile(file, is_ome=False) as content:
        pages: list[Any] = list(content.pages)
        for page in pages:
            for one in (page, *(page.pages or ())):
                if (size := one.tags.get(FILTER_REPEAT)) is not None:
                    rows, columns = size.value
                    return int(rows), int(columns)
    return None


def _require_whole(content: Any, page: Any) -> None:
    size = content.filehandle.size
    ends = [at + count for at, count in zip(page.dataoffsets, page.databytecounts, strict=False)]
    if any(end > size for end in ends):
        raise ValueError(f"it has {size} bytes, its pixels would end at byte {max(ends)}")


@contextlib.contextmanager
def _without_its_own_lines() -> Generator[None]:
    """Keep what tifffile says of a file off the terminal: a refusal or a remark says it here."""
    logger = logging.getLogger("tifffile")

    def quiet(_: logging.LogRecord) -> bool:
        return False

    logger.addFilter(quiet)
    try:
        yield
    finally:
        logger.removeFilter(quiet)


def _virtual_pages(content: Any, pages: list[Any]) -> int:
    """How many pictures stand in one row of bytes behind a single page, as ImageJ writes large
    stacks; 0 where each has a page of its own.
    """
    if len(pages) > 1 or not (content.is_imagej or content.is_shaped):
        return 0
    count = int(content.series[0].size // max(pages[0].size, 1))
    return count if count > 1 and content.series[0].dataoffset is not None else 0


def _virtual(content: Any, page: Any, place: int) -> npt.NDArray[Any]:
    dtype = np.dtype(page.dtype).newbyteorder(content.byteorder)
    content.filehandle.seek(content.series[0].dataoffset + place * page.size * dtype.itemsize)
    stored = content.filehandle.read(page.size * dtype.itemsize)
    return np.frombuffer(stored, dtype).reshape(page.shape).astype(dtype.newbyteorder("="))


def _require_numbers(file: Path, page: Any) -> None:
    """Refuse a page whose numbers are not light as a sensor read it."""
    meaning = int(page.photometric)
    if meaning == PALETTE:
        require_no_palette(file)
    require_bits(file, int(page.bitspersample))
    if meaning == WHITE_IS_ZERO:
        raise InputError(
            f"{file}: its numbers fall with light (photometric WhiteIsZero), as scanners and fax"
            " programs write; save it with black at 0 (BlackIsZero)"
        )
    if meaning not in PLAIN:
        name = getattr(page.photometric, "name", str(meaning))
        inks = " in printing colours (CMYK)" if name == "SEPARATED" else f" of kind {name}"
        raise InputError(
            f"{file}: it holds a picture{inks}; was it made for print or a screen? Save the"
            " sensor's own numbers in grey"
        )
    if page.ndim - (page.samplesperpixel > 1) != 2:
        raise InputError(
            f"{file}: a page of it has {page.ndim} dimensions ({page.axes}); save one plane"
        )


def _decoded(file: Path, page: Any) -> npt.NDArray[Any]:
    """A page's numbers, in this machine's order of bytes."""
    _require_whole(page.parent, page)
    missing = sum(count == 0 for count in page.databytecounts)
    if missing or not page.dataoffsets:
        raise ValueError(
            f"{missing or 'all'} of its {len(page.databytecounts)} strips or tiles hold no pixels"
        )
    try:
        values = page.asarray()
    except Exception as error:  # decoders raise classes of their own
        number = int(page.compression)
        if number == 1:
            raise ValueError(str(error)) from error
        raise InputError(
            f"{file}: its compression, {getattr(page.compression, 'name', 'unknown')} ({number}),"
            f" cannot be undone ({error}); the file is damaged, or names a compression that it does"
            " not have. Save it again, uncompressed or with LZW"
        ) from error
    return values.astype(values.dtype.newbyteorder("="), copy=False)


def _without_alpha(
    file: Path, page: Any, values: npt.NDArray[Any]
) -> tuple[npt.NDArray[Any], tuple[Remark, ...]]:
    extra = [int(kind) for kind in page.extrasamples]
    if values.ndim < 3 or not extra or extra[-1] not in (ASSOCIATED, UNASSOCIATED):
        return values, ()
    alpha, values = values[..., -1], values[..., :-1]
    most = np.iinfo(alpha.dtype).max if alpha.dtype.kind in "ui" else 1
    if extra[-1] == ASSOCIATED and (alpha != most).any():
        raise InputError(
            f"{file}: its numbers are multiplied by an alpha channel, as image editors do; save it"
            " without alpha"
        )
    return values if values.shape[-1] > 1 else values[..., 0], (alpha_remark(),)


def _mosaic(page: Any) -> str | None:
    """The mosaic of two by two filters that a page names; None where it names none."""
    places = page.tags.get(FILTER_PLACES)
    if int(page.photometric) != FILTERS or places is None:
        return None
    letters = "".join("rgb"[place] if place < 3 else "?" for place in bytes(places.value))
    return letters if letters in MOSAICS else None


def _remarks(content: Any, page: Any) -> tuple[Remark, ...]:
    orientation = page.tags.get(ORIENTATION)
    remarks = [*orientation_remarks(int(orientation.value) if orientation else 1)]
    if int(page.compression) in LOSSY:
        remarks.append(lossy_remark(LOSSY[int(page.compression)]))
        remarks.append(gamma_remark("such a file is as a rule made for a screen"))
    function = (content.imagej_metadata or {}).get("Info", "") if content.is_imagej else ""
    description = str(page.description) if content.is_imagej else ""
    scaled = [word for word in description.split() if word.startswith(("cf=", "c0=", "c1="))]
    if scaled or "Calibration function" in str(function):
        remarks.append(
            Remark(
                "calibration-function",
                f"ImageJ notes a calibration function ({', '.join(scaled)}) for its numbers; they"
                " were taken as stored",
            )
        )
    return tuple(remarks)


def tiff_of(values: npt.NDArray[np.uint16], note: str = "") -> bytes:
    """A grey TIFF of one picture, losslessly compressed.

    Args:
        values: shape (rows, columns).
        note: its description, ASCII.
    """
    import tifffile  # only who has such files pays for its start-up

    stream = io.BytesIO()
    tifffile.imwrite(
        stream, values, photometric="minisblack", compression="zlib", metadata=None,
        description=note or None,
    )  # fmt: skip
    return stream.getvalue()
