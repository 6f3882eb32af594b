"""A recorded run, looked at by hand.

    python look_at_a_run.py RUN

Cell by cell in an editor that knows ``# %%`` (VS Code, Spyder, Jupyter with jupytext), or as a
script. Without a RUN it takes the newest under ``runs``. Prints two tables and draws one figure
beside the report.
"""

# %% Read the run: documents and frames, every frame checked against its sum.
import csv
import sys
from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from flflab.record import read_run

named = [Path(word) for word in sys.argv[1:] if Path(word).is_dir()]
folder = named[0] if named else max(Path("runs").iterdir())
run = read_run(folder)
print(
    f"{folder}: {run.start['study']}, {len(run.frames)} frames,"
    f" {'complete' if run.complete else 'cut short'}"
)

# %% How much light each white frame got: the mean of what lies above half its brightest, less the
# dark frame, a second.
black = run.sensor_noise["offset_dn"]
print("\nframe          F/   target, mm   exposure, ms   lit pixels   DN a second")
for frame in run.frames:
    if frame.target == "white":
        picture = run.picture(frame).astype(float) - black
        lit = picture > np.quantile(picture, 0.999) / 2
        rate = picture[lit].mean() / frame.exposure_s
        place = f"{frame.key:12s} {frame.f_number:4g} {frame.distance:12.3f}"
        print(f"{place} {1e3 * frame.exposure_s:14.3f} {100 * lit.mean():10.1f} % {rate:13.0f}")

# %% The comparison as numbers: how far measured contrast lies from predicted, by configuration.
with (folder / "comparison.csv").open(newline="", encoding="utf-8") as file:
    rows = [row for row in csv.DictReader(file) if row["quantity"] == "mtf"]
curves = {
    index: np.array(
        [
            [float(row[name]) for name in ("cycles_per_mm", "measured", "uncertainty", "predicted")]
            for row in members
        ]
    )
    for index, members in groupby(rows, key=lambda row: int(row["configuration"]))
}
print("\nconfiguration   frequencies   mean difference   largest   standard uncertainty")
for index, (_, measured, uncertainty, predicted) in (
    (index, curve.T) for index, curve in curves.items()
):
    difference = measured - predicted
    print(
        f"{index:13d} {len(difference):13d} {difference.mean():17.4f}"
        f" {np.abs(difference).max():9.4f} {uncertainty.mean():22.4f}"
    )

# %% A figure of one's own: a piece of the bars as the sensor saw them, and every measured curve
# over its prediction.
figure = Figure(figsize=(10, 4), layout="constrained")
seen, plot = figure.subplots(1, 2)
bars = next(frame for frame in run.frames if frame.target == "bars")
picture = run.picture(bars)
middle = [size // 2 for size in picture.shape]
half = min(350, *middle)
seen.imshow(
    picture[middle[0] - half : middle[0] + half, middle[1] - half : middle[1] + half], cmap="gray"
)
seen.set(title=f"{bars.key}, the middle {2 * half} pixels", xticks=[], yticks=[])
for index, (frequency, measured, uncertainty, predicted) in (
    (index, curve.T) for index, curve in curves.items()
):
    points = plot.errorbar(
        frequency,
        measured,
        2 * uncertainty,
        fmt=".",
        markersize=3,
        linewidth=0.7,
        label=f"configuration {index}",
    )
    plot.plot(frequency, predicted, color=points[0].get_color(), linewidth=0.8)
plot.set(
    xlabel="cycles/mm on the target",
    ylabel="contrast (MTF)",
    title="measured (k = 2) over the model's line",
)
plot.legend(fontsize=7)
figure.savefig(folder / "look.png", dpi=120)
print(f"\n{folder / 'look.png'}")
figure  # noqa: B018  (a notebook shows it)
