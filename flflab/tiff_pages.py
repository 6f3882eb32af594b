"""The pages of a TIFF file, read from its directories alone (TIFF 6.0, section 2; BigTIFF)."""

import struct
from dataclasses import dataclass

CMYK = 5  # PhotometricInterpretation
MOST = 10_000  # pages; more is a ring of directories
_PHOTOMETRIC = 262


@dataclass(frozen=True)
class Page:
    """One page: what its numbers mean, None where it does not say."""

    photometric: int | None


def read_pages(content: bytes) -> list[Page]:
    """The pages in their order.

    Raises:
        ValueError: not a TIFF file, or cut short.
    """
    order = {b"II": "<", b"MM": ">"}.get(content[:2])
    version = (
        0 if order is None or len(content) < 16 else struct.unpack_from(f"{order}H", content, 2)[0]
    )
    if version not in (42, 43):
        raise ValueError("it does not begin as a TIFF file does")
    big = version == 43
    pointer, count, entry = ("Q", "Q", 20) if big else ("I", "H", 12)
    pages: list[Page] = []
    try:
        (at,) = struct.unpack_from(f"{order}{pointer}", content, 8 if big else 4)
        while at and len(pages) < MOST:
            (entries,) = struct.unpack_from(f"{order}{count}", content, at)
            first = at + struct.calcsize(f"{order}{count}")
            meaning = None
            for place in range(first, first + entry * entries, entry):
                (tag,) = struct.unpack_from(f"{order}H", content, place)
                if tag == _PHOTOMETRIC:
                    (meaning,) = struct.unpack_from(
                        f"{order}H", content, place + (12 if big else 8)
                    )
            pages.append(Page(meaning))
            (at,) = struct.unpack_from(f"{order}{pointer}", content, first + entry * entries)
    except struct.error as error:
        raise ValueError("it ends before its directory does") from error
    if not pages:
        raise ValueError("it holds no page")
    return pages
