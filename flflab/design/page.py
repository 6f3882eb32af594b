"""The page of a design search: aims, options, the front to click through, sensitivities; one file
without anything from outside.
"""

import json
import math
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from flflab.design.answer import Option, row
from flflab.design.chunk_log import Found
from flflab.design.judgement import demands
from flflab.design.requirements import Requirements
from flflab.design.tolerances import DIMENSIONS, RELATIVE, Sensitivity
from flflab.whole_file import write_whole

PARTS = ("main_lens", "array", "sensor")
AIMS = ("area_mm2", "elr_px", "contrast", "marginal_angle_deg")
NO_BREAK = "\N{NO-BREAK SPACE}"
UNITS = {"mm": "mm", "mm2": "mm²", "um": "um", "px": "px", "deg": "deg"}


def write_page(
    file: Path,
    title: str,
    wanted: Requirements,
    found: Found,
    named: tuple[Option, ...],
    front: tuple[Option, ...],
) -> None:
    """Write the page of a search that found something."""
    rows = [row(wanted, option) for option in (*named, *front)]
    heads = [
        head for head in rows[0] if head not in PARTS or len({cells[head] for cells in rows}) > 1
    ]
    page = Environment(
        loader=PackageLoader("flflab.design", "."), undefined=StrictUndefined, autoescape=True
    ).get_template("page.html.jinja")
    text = page.render(
        title=title,
        summary=summary(found),
        parts="; ".join(
            f"{part.replace('_', ' ')}: {rows[0][part]}" for part in PARTS if part not in heads
        ),
        asked=asked(wanted),
        heads=heads,
        named=[
            ([_cell(row(wanted, option)[head]) for head in heads], *_built(option))
            for option in named
        ],
        sensitivities=[
            (option.name, [_sensitivity(one, wanted) for one in option.sensitivities])
            for option in named
        ],
        dimensions=[
            _off(name, wanted) for name in DIMENSIONS if getattr(wanted.tolerances, name) > 0
        ],
        labels=[label(head) for head in heads],
        labels_json=_script([label(head) for head in heads]),
        heads_json=_script(heads),
        rows_json=_script([[cells[head] for head in heads] for cells in rows]),
        aims_json=_script([head for head in heads if head in AIMS]),
        named_count=len(named),
    )
    write_whole(file, text)


def summary(found: Found) -> str:
    """One sentence: how many were tried, could be built, met everything, and stand on the front."""
    kind = (
        "exact"
        if found.front.epsilon == 0
        else f"within {100 * found.front.epsilon:g} % in every aim"
    )
    return (
        f"Of {found.tried:,} configurations {found.built:,} can be built and {found.met:,} meet"
        f" every requirement; {len(found.front.numbers):,} of them make the front ({kind})."
    )


def asked(wanted: Requirements) -> list[str]:
    """The requirements as sentences."""
    near, far = wanted.measure.depth
    lines = [f"depth {near:g} mm to {far:g} mm from the main lens; in all of it:"]
    lines += [
        f"{one.name if one.name != one.unit else ''} {'at least' if one.least else 'at most'}"
        f" {one.show(one.limit)}".strip()
        for one in demands(wanted)
    ]
    if wanted.require.contrast is not None:
        lines[-1 - (wanted.require.marginal_angle is not None)] += (
            f" at {wanted.require.contrast.at:g} cycles/mm"
        )
    return [*lines, f"as much as possible of {', '.join(wanted.maximise)}"]


def label(head: str) -> str:
    """A column's name as people read it, with its unit after a comma."""
    name, _, unit = head.rpartition("_")
    return f"{name.replace('_', ' ')}, {UNITS[unit]}" if unit in UNITS else head.replace("_", " ")


def _off(name: str, wanted: Requirements) -> str:
    """A dimension and its tolerance, which stays on one line."""
    value: float = getattr(wanted.tolerances, name)
    if name in RELATIVE:
        size = f"{100 * value:.4g} %"
    else:
        size = f"{math.degrees(value):.4g} deg" if name == "tilt" else f"{1e3 * value:.4g} um"
    return f"{name.replace('_', ' ')} {f'± {size}'.replace(' ', NO_BREAK)}"


def _built(option: Option) -> tuple[str, str]:
    if option.built is None:
        return "", ""
    share, first = option.built.share, option.built.buys_most
    better = (
        ""
        if first is None
        else f"{first.replace('_', ' ')}: {100 * option.built.halved[first]:.1f} %"
    )
    return f"{100 * share:.1f} %", better


def _cell(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _sensitivity(one: Sensitivity, wanted: Requirements) -> list[str]:
    name = one.name.replace("_", " ") + (f", {one.unit}" if one.unit else "")
    changes = [
        change
        for dimension, change in zip(DIMENSIONS, one.per_tolerance, strict=True)
        if getattr(wanted.tolerances, dimension) > 0
    ]
    return [
        name,
        f"{one.value:.5g}",
        *("0" if change == 0 else f"{change:+.2g}" for change in changes),
    ]


def _script(value: Any) -> Markup:
    # our own numbers and names, with no way out of the script
    return Markup(json.dumps(value).replace("<", "\\u003c"))  # noqa: S704
