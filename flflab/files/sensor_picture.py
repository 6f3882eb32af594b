"""A sensor's numbers with what is known of them, whatever file or camera they came from."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.files.raw import RawPicture
from flflab.files.stored_picture import MOSAICS
from flflab.remark import Remark

CLOSENESS = 0.03  # of exposures: cameras note 1/60 s for 0.0166 s
DARK_SHARE = 0.5  # of the picture's light: a dark frame with as much is not dark


@dataclass(frozen=True)
class SensorPicture:
    """One picture as the sensor read it.

    Attributes:
        values: shape (rows, columns), numbers as stored.
        pattern: the filters of the pixels [0, 0], [0, 1], [1, 0], [1, 1], a letter each; None for a
            sensor without filters, or one of which nothing is known.
        black_level: what these four read in the dark, DN; None where nothing says so.
        full_scale: what a saturated pixel reads, DN; None where nothing says so.
        dark: a picture taken in the dark, to subtract; same shape and kind as ``values``.
        exposure_s: exposure time, s; 0 where nothing says so.
        iso: speed; 0 where nothing says so.
        remarks: what its file says that a reader of its numbers should know.
    """

    values: npt.NDArray[Any]
    pattern: str | None = None
    black_level: tuple[int, int, int, int] | None = None
    full_scale: float | None = None
    dark: npt.NDArray[Any] | None = None
    exposure_s: float = 0.0
    iso: float = 0.0
    remarks: tuple[Remark, ...] = ()


def from_raw(raw: RawPicture) -> SensorPicture:
    """A raw picture, with the levels that its file gives.

    Black levels of 0 say nothing: they stand for levels that a file does not name, too.
    """
    return SensorPicture(
        raw.values,
        raw.pattern,
        raw.black_level if any(raw.black_level) else None,
        float(raw.white_level),
        exposure_s=raw.exposure_s,
        iso=raw.iso,
        remarks=raw.remarks,
    )


def declare(
    picture: SensorPicture, who: str, pattern: str | None, full_scale: float | None
) -> SensorPicture:
    """Add what an operator says of a picture to what its file says.

    Args:
        picture: as its file gives it.
        who: its name, for messages.
        pattern: the mosaic of filters; None says nothing.
        full_scale: what a saturated pixel reads, DN as stored; None says nothing.

    Raises:
        InputError: no such mosaic, the file names another one, or the full scale is not a number
            above 0.
    """
    if pattern is not None:
        if pattern not in MOSAICS:
            raise InputError(
                f"{who}: there is no mosaic {pattern!r}; allowed are {', '.join(MOSAICS)}"
            )
        if picture.pattern not in (None, pattern):
            raise InputError(
                f"{who}: its file says that the mosaic is {picture.pattern}, --mosaic says"
                f" {pattern}; leave --mosaic out"
            )
        picture = replace(picture, pattern=pattern)
    if full_scale is not None:
        if not (math.isfinite(full_scale) and full_scale > 0):
            raise InputError(
                f"{who}: full scale {full_scale:g}; what a saturated pixel reads is due, a number"
                " above 0 in the file's own units"
            )
        picture = replace(picture, full_scale=float(full_scale))
    return picture


def with_dark(picture: SensorPicture, who: str, dark: SensorPicture, of: str) -> SensorPicture:
    """Put a dark frame beside a picture, to be subtracted from it.

    Args:
        picture: the picture.
        who: its name, for messages.
        dark: taken with the same exposure and gain, the light shut out.
        of: the dark frame's name.

    Raises:
        InputError: another shape, kind, mosaic, exposure or speed, or it is not dark.
    """
    if dark.pattern not in (None, picture.pattern):
        raise InputError(
            f"{of}: the dark frame's file says that its mosaic is {dark.pattern}, that of {who} is"
            f" {picture.pattern}; give one of the same camera"
        )
    if dark.values.shape != picture.values.shape:
        raise InputError(
            f"{of}: the dark frame has (rows, columns) {dark.values.shape}, {who} has"
            f" {picture.values.shape}; take it with the same region and binning"
        )
    if dark.values.dtype != picture.values.dtype:
        raise InputError(
            f"{of}: the dark frame holds numbers of kind {dark.values.dtype}, {who} of kind"
            f" {picture.values.dtype}; save both in the same format"
        )
    for what, came, due in (
        ("exposure time, s", dark.exposure_s, picture.exposure_s),
        ("speed", dark.iso, picture.iso),
    ):
        if came and due and not math.isclose(came, due, rel_tol=CLOSENESS):
            raise InputError(
                f"{of}: the dark frame was taken with another {what}: {came:g}, {who} with {due:g};"
                " take it with the same settings"
            )
    level, light = (float(np.mean(one.values, dtype=np.float64)) for one in (dark, picture))
    spread = float(np.quantile(dark.values, 0.99)) - level  # hot pixels apart
    if level >= light or spread > DARK_SHARE * (float(picture.values.max()) - level):
        raise InputError(
            f"{of}: the dark frame is not dark beside {who}: it reads {level:.4g} on average, the"
            f" picture {light:.4g}; were the two exchanged, or was the light on?"
        )
    known = picture.exposure_s and dark.exposure_s
    doubt = "" if known else "; that its exposure and gain were the picture's, no file says"
    remark = Remark("dark-frame", f"the dark frame {of} was subtracted{doubt}")
    return replace(picture, dark=dark.values, black_level=None, remarks=(*picture.remarks, remark))
