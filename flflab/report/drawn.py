"""What the simulated camera of a run drew, and why."""

from flflab.record import Run
from flflab.report.tables import Table

NOTHING = 1e-6  # of a pixel or of white


def drawn_table(run: Run) -> Table | None:
    """Each effect, whether it is in the simulated pictures, and why, as the record has it; None
    where it has nothing of it.
    """
    rows: list[tuple[str, ...]] = []
    for drawing in run.start.get("simulated_light") or ():
        numbers = ", ".join(str(index) for index in drawing["configurations"])
        what = f"{drawing['target']}, {numbers}"
        rows.append(
            (
                what,
                drawing["path"],
                "",
                f"{drawing['tolerance']:.1g} of white",
                "",
                drawing["why_path"],
            )
        )
        rows += [
            (
                "",
                one["name"],
                "on" if one["on"] else "off",
                "" if one["size"] is None else f"{_shown(one['size'])} {one['unit']}",
                "" if one["bound"] is None else _shown(one["bound"]),
                one["why"],
            )
            for one in drawing["effects"]
        ]
        rows.append(("", ", ".join(drawing["absent"]), "off", "", "", "the scene has none"))
    if not rows:
        return None
    return Table(
        "What the simulated camera drew, and why",
        (
            "target, configurations",
            "path or effect",
            "",
            "tolerance or size",
            "most it changes, of white",
            "why",
        ),
        tuple(rows),
    )


def _shown(size: float) -> str:
    return "0" if abs(size) < NOTHING else f"{size:.2g}"
