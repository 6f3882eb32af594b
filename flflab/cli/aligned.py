"""What an alignment ends with: its table, its sentences, the bench file with its zeros."""

from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table

from flflab.bench import ANGLE, LENGTH, Bench
from flflab.digits import plus_minus, two_digits
from flflab.yaml_file import edit_yaml, put

if TYPE_CHECKING:
    from procedures.align import Outcome


def table_of(outcomes: "tuple[Outcome, ...]") -> Table:
    """One line a thing aligned: before, after, uncertainty and pictures."""
    table = Table(box=box.SIMPLE_HEAD)
    for head in ("deviation of", "before", "after", "unit", "pictures"):
        table.add_column(
            head, justify="left" if head == "deviation of" else "right", overflow="fold"
        )
    for one in outcomes:
        of = ANGLE if one.unit == "rad" else LENGTH
        doubt = of.per_unit * one.uncertainty
        before = plus_minus(of.per_unit * one.before, doubt, "+").partition(" ")[0]
        after = plus_minus(of.per_unit * one.after, doubt, "+")
        table.add_row(one.what, before, after, of.shown, str(one.pictures))
    return table


def ending_of(one: "Outcome") -> str:
    """Why aligning one thing stopped, and where its axis stands, in a sentence."""
    at = (
        f"; {one.axis} stands at"
        f" {(ANGLE if one.unit == 'rad' else LENGTH).show(one.reading, '.4f')}"
        if one.axis
        else ""
    )
    return f"{one.what}: {one.why}{at}"


def with_zeros(text: str, outcomes: "tuple[Outcome, ...]", bench: Bench) -> str:
    """A bench file's text with zeros by which a reading of every turned axis says how the array
    truly stands to the sensor; comments and the rest stay.
    """
    axes = bench.description.axes

    def change(data: Any) -> None:
        for one in turned(outcomes):
            uncertainty = f"{two_digits(ANGLE.per_unit * one.uncertainty)} {ANGLE.shown}"
            put(data["axes"][one.axis], "zero", ANGLE.show(zero_of(one, bench), ".5f"))
            put(data["axes"][one.axis], "zero_uncertainty", uncertainty)

    lines = [
        f"# {one.axis}: {axes[one.axis].moves}; {one.why}; zero before"
        f" {ANGLE.show(axes[one.axis].zero, 'g')}\n"
        for one in turned(outcomes)
    ]
    head = (
        "# Zeros by `flflab align`: with them a reading says how the array stands to the sensor.\n"
    )
    return head + "".join(lines) + edit_yaml(text, str(bench.file), change)


def turned(outcomes: "tuple[Outcome, ...]") -> "list[Outcome]":
    """What an axis turned."""
    return [one for one in outcomes if one.axis and one.unit == "rad"]


def zero_of(one: "Outcome", bench: Bench) -> float:
    """The zero, rad, with which the reading of an axis that turned says how the array stands."""
    return one.after - bench.description.axes[one.axis].sign * one.reading
