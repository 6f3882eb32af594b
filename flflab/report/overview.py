"""The report's first figure: every property on one axis, in standard uncertainties."""

import math
from statistics import NormalDist

from flflab.property_names import PROPERTY_NAMES
from flflab.report.charts import PREDICTED, TELLABLE, as_svg, look, new_figure, styled
from flflab.verdict.comparison import Verdict
from flflab.verdict.evaluation import JUDGED, Evaluation
from flflab.verdict.properties.values import Values

SHORT = {"micro_images_mm": "fields and pitch", "elr_row_px": "lateral resolution"}
SHOWN = 5.0  # standard uncertainties up to which the axis is linear; logarithmic beyond
LEAST_WIDE = 6.0  # half the axis at least
MOST = 1e6  # a difference without any uncertainty is drawn here


def overview_chart(evaluation: Evaluation) -> str:
    """One row a property, a mark a configuration: its number farthest from the model, signed, in
    its standard uncertainty. Ticks show how far the farthest of as many independent numbers may
    lie.
    """
    verdicts = evaluation.comparison.verdicts
    configurations = [one.configuration.index for one in evaluation.measured]
    farthest = {
        one.quantity: _farthest(evaluation.values, JUDGED.get(one.quantity, (one.quantity,)))
        for one in verdicts
    }
    widest = max(
        [LEAST_WIDE]
        + [1.3 * abs(z) for members in farthest.values() for z in members.values()]
        + [1.1 * z_limit(one) for one in verdicts]
    )
    with styled():
        figure = new_figure(5.4, 0.9 + 0.29 * len(verdicts) + 0.35 * (len(configurations) > 1))
        axes = figure.add_subplot()
        axes.axvspan(-2, 2, color="black", alpha=0.07, linewidth=0)
        axes.axvline(0, color=PREDICTED, linewidth=1)
        for place, index in enumerate(configurations):
            points = [
                (members[index], row)
                for row, members in enumerate(farthest.values())
                if index in members
            ]
            if points:
                style = look(place, len(configurations))
                axes.plot(
                    [z for z, _ in points],
                    [_aside(row, place, len(configurations)) for _, row in points],
                    **style,
                    linestyle="none",
                    markersize=4.5,
                    markeredgecolor="black",
                    markeredgewidth=0.3,
                    label=str(index),
                )
        for row, verdict in enumerate(verdicts):
            limit = z_limit(verdict)
            for end in (-limit, limit):
                axes.plot([end, end], [row - 0.36, row + 0.36], color="black", linewidth=1.1)
        if widest > SHOWN + 1:
            axes.set_xscale("symlog", linthresh=SHOWN, linscale=1.3)
            ticks = [10**power for power in range(1, math.ceil(math.log10(widest)) + 1)]
            every = max(1, len(ticks) // 3)
            far = [tick for tick in ticks[::every] if tick <= widest]
            axes.set_xticks([-tick for tick in far[::-1]] + [-2, 0, 2] + far)
            axes.xaxis.set_major_formatter(_plain)
            axes.minorticks_off()
        axes.set_xlim(-widest, widest)
        axes.set_ylim(len(verdicts) - 0.5, -0.5)
        axes.set_yticks(range(len(verdicts)), [_label(one) for one in verdicts])
        for label, one in zip(axes.get_yticklabels(), verdicts, strict=True):
            if not one.accepted:
                label.set_fontweight("bold")
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("(measured - predicted)/uncertainty")
        if 1 < len(configurations) <= TELLABLE:
            figure.legend(
                loc="outside lower center", ncols=min(12, len(configurations)),
                title="configuration", handletextpad=0.1, columnspacing=0.8,
            )  # fmt: skip
        return as_svg(figure)


def property_name(verdict: Verdict) -> str:
    """A property in few words, for headlines and axes."""
    return SHORT.get(verdict.quantity) or PROPERTY_NAMES.get(verdict.quantity, verdict.quantity)


def z_limit(verdict: Verdict) -> float:
    """How far the farthest of a verdict's numbers may lie from the model, in standard
    uncertainties, were they independent and normal.
    """
    one = -math.expm1(math.log1p(-verdict.threshold) / verdict.rows)
    return NormalDist().inv_cdf(1 - one / 2)


def _farthest(values: tuple[Values, ...], quantities: tuple[str, ...]) -> dict[int, float]:
    """Signed z of the number farthest from the model in every configuration."""
    found: dict[int, float] = {}
    for one in values:
        if one.quantity not in quantities:
            continue
        for difference, u in zip(
            (one.measured - one.expected).tolist(), one.uncertainty.tolist(), strict=True
        ):
            z = 0.0 if difference == 0 else math.copysign(MOST, difference)
            if u > 0:
                z = max(-MOST, min(MOST, difference / u))
            if abs(z) >= abs(found.get(one.configuration, 0.0)):
                found[one.configuration] = z
    return found


def _aside(row: int, place: int, count: int) -> float:
    """Where a configuration's mark stands within its row, so that marks do not hide one another."""
    return row + (0.5 * (place / (count - 1) - 0.5) if count > 1 else 0.0)


def _label(verdict: Verdict) -> str:
    name = property_name(verdict)
    return name if verdict.accepted else f"{name}: REJECTED"


def _plain(value: float, place: float) -> str:
    return f"{value:g}" if abs(value) < 1e4 else f"{value:.0e}".replace("e+0", "e")
