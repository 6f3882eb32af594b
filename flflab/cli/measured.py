"""Terminal tables of what was measured in one picture."""

from statistics import fmean, median, pstdev
from typing import Any

from rich import box
from rich.table import Table

from flflab.cli.terminal import Terminal
from flflab.digits import plus_minus
from flflab.measurement.lattice.kernel import LIGHT
from flflab.measurement.white import MeasuredWhite


def print_white(console: Terminal, found: MeasuredWhite) -> None:
    """Ten lines, and two by a camera file: what was found, how sure, and remarks."""
    lattice, white = found.json()["lattice"], found.white
    sure = lattice["uncertainty"]
    whole, seen = int(white.whole.sum()), int(white.found.sum())
    light = white.values[white.whole, LIGHT]
    table = Table(title="Lattice of micro-images", show_header=False, box=box.SIMPLE)
    table.add_row("layout", str(lattice["layout"]))
    table.add_row("pitch", f"{plus_minus(lattice['pitch_px'], sure['pitch_px'])} px")
    if "chief_pitch_px" in lattice:
        chief = plus_minus(lattice["chief_pitch_px"], sure["chief_pitch_px"])
        table.add_row("pitch of chief rays", f"{chief} px")
    table.add_row("angle", f"{plus_minus(lattice['angle_deg'], sure['angle_deg'])} deg")
    origin = ", ".join(map(plus_minus, lattice["origin_px"], sure["origin_px"]))
    table.add_row("origin (x, y)", f"{origin} px")
    table.add_row("micro-images", f"{seen} seen, {whole} of them whole")
    radii = ", ".join(f"{kind['radius_px']:.2f}" for kind in lattice["types"])
    table.add_row("radius at half light", f"{radii} px, soft over {lattice['softness_px']:.2f} px")
    if "chief_pitch_px" in lattice:
        _add_fields(table, lattice)
    table.add_row("light", f"{light.min():.4g} to {light.max():.4g} DN, median {median(light):.4g}")
    kinds = len(lattice["types"])
    table.add_row("kinds of microlens", f"{kinds}" + (", by radius or light" if kinds > 1 else ""))
    table.add_row(
        "off the lattice",
        f"{lattice['residual_px']:.2g} px (rms), of it placement {lattice['scatter_px']:.2g} px;"
        f" smooth bend {lattice['distortion']['bend_px']:.2g} px",
    )
    table.add_row("left of the light", f"{100 * white.misfit:.1f} % beside a common profile")
    console.print(table)
    for remark in found.remarks:
        console.print(f"Note: {remark.sentence}.", highlight=False)


def print_lattice(console: Terminal, lattice: dict[str, Any]) -> None:
    """The lattice of a picture of another target."""
    table = Table(title="Lattice of micro-images", show_header=False, box=box.SIMPLE)
    table.add_row("layout", str(lattice["layout"]))
    sure = lattice["uncertainty"]
    table.add_row("pitch", f"{_sure(lattice['pitch_px'], sure['pitch_px'])} px")
    table.add_row("angle", f"{_sure(lattice['angle_deg'], sure['angle_deg'])} deg")
    origin = ", ".join(map(_sure, lattice["origin_px"], sure["origin_px"]))
    table.add_row("origin (x, y)", f"{origin} px")
    radii = (_sure(lattice[key], sure[key]) for key in ("inside_radius_px", "outside_radius_px"))
    table.add_row("inside, outside radius", f"{', '.join(radii)} px")
    table.add_row("micro-images", str(len(lattice["centres_px"])))
    console.print(table)


def _sure(value: float, uncertainty: float | None) -> str:
    return f"{value:.5g}" if uncertainty is None else plus_minus(value, uncertainty)


def _add_fields(table: Table, lattice: dict[str, Any]) -> None:
    """Bright and total field of each kind of microlens, and what the camera's description makes
    of them.
    """
    for name, key in (("bright", "inside_radius_px"), ("total", "outside_radius_px")):
        parts = list[str]()
        for due in sorted({one["model"][key] for one in lattice["micro_images"]}):
            kind = [one for one in lattice["micro_images"] if one["model"][key] == due]
            seen = [one[key] for one in kind if one["whole"] and one[key] is not None]
            shown = f"{fmean(seen):.3f} (scatter {pstdev(seen):.2g})" if seen else "none"
            parts.append(f"{shown}, described {due:.3f}")
        table.add_row(f"{name} field's radius", f"{'; '.join(parts)} px")


def dots_table(dots: list[dict[str, Any]]) -> Table:
    """Views and places of dots."""
    table = Table(title="Dots", box=box.SIMPLE)
    for head in ("dot", "views", "uncertain\nviews", "x mm", "y mm", "z mm"):
        table.add_column(head, justify="right")
    for dot in dots:
        position = [
            "none" if value is None or sigma is None else plus_minus(value, sigma)
            for value, sigma in zip(
                dot["position_mm"] or [None] * 3, dot["uncertainty_mm"] or [None] * 3, strict=True
            )
        ]
        table.add_row(str(dot["dot"]), str(dot["views"]), str(dot["views_uncertain"]), *position)
    return table


def contrasts_table(points: list[dict[str, Any]]) -> Table:
    """Of several kinds of microlenses a curve each; Michelson's contrast of the pixels,
    (max - min)/(max + min), with its bias.
    """
    table = Table(title="Contrast against frequency", box=box.SIMPLE)
    kinds = dict.fromkeys(point.get("microlens_focal_length_mm") for point in points)
    classic = any("classic" in point for point in points)
    heads = (
        ["microlens mm"] * (len(kinds) > 1)
        + ["cycles/px", "contrast"]
        + ["views", "Michelson", "its bias"] * classic
    )
    for head in heads:
        table.add_column(head, justify="right")
    for point in points:
        row = [f"{point['microlens_focal_length_mm']:g}"] if len(kinds) > 1 else []
        row += [
            f"{point['cycles_per_px']:.4f}",
            plus_minus(point["contrast"], point["uncertainty"]),
        ]
        if classic:
            row += [str(point["views"])]
            row += [
                "none" if value is None else f"{round(value, 3) + 0.0:+.3f}"
                for value in (point["classic"], point["classic_bias"])
            ]
        table.add_row(*row)
    return table
