"""Results in JSON's own types: None where there is no value, points of a curve one by one."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from flflab.remark import Remark


def plain(value: Any) -> Any:
    """Arrays as lists, numpy's numbers as Python's, None for what is not finite."""
    if isinstance(value, Mapping):
        return {key: plain(one) for key, one in cast(Mapping[str, Any], value).items()}
    if isinstance(value, np.ndarray | np.generic):
        value = cast(Any, value).tolist()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(one) for one in cast(Sequence[Any], value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def result_json(
    seen: dict[str, Any],
    remarks: Sequence[Remark],
    saturated_share: float | np.floating[Any],
    misfit: float,
    offset_dn: float,
) -> dict[str, Any]:
    """All that is said of a picture: what was seen in it, the picture itself, and remarks."""
    picture = {"saturated_share": saturated_share, "misfit": misfit, "offset_dn": offset_dn}
    said = {
        "remarks": [remark.sentence for remark in remarks],
        "remark_codes": [remark.code for remark in remarks],
    }
    whole: dict[str, Any] = plain(seen | {"picture": picture} | said)
    return whole


def points_json(**columns: Any) -> list[dict[str, Any]]:
    """A point for each entry of the arrays and lists among columns; all points share the rest."""
    several = {name: one for name, one in columns.items() if isinstance(one, np.ndarray | list)}
    rows = zip(*several.values(), strict=True)
    return [columns | dict(zip(several, row, strict=True)) for row in rows]
