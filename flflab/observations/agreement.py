"""How far a camera's model agrees with observations, frame by frame and in sentences: as found,
good or bad.
"""

import math
from dataclasses import dataclass

import numpy as np

from flflab.observations.points import PredictedPoints, SeenPoints
from flflab.observations.reading import Array, Observations

STEEP = math.radians(35.0)
"""Boards tilted further are judged apart: their distances span what the depth of field does not."""
VIEWS_SHARE, VIEWS_COUNT = 0.10, 1.0
"""Agreement of median view counts that is looked for: 10 %, or one view."""


@dataclass(frozen=True)
class FrameAgreement:
    """One frame: medians and totals over its points; ``None`` where no point has the quantity.

    Attributes:
        tilt_deg: between the board's normal and the axis.
        residual_px: root mean square of measured less predicted positions on the sensor, after the
            fit of two offsets.
        offset_mm: those offsets (x, y).
    """

    frame: int
    tilt_deg: float
    points: int
    measured_median: float
    predicted_median: float
    measured_total: int
    predicted_total: int
    virtual_depth_measured: float | None
    virtual_depth_predicted: float | None
    virtual_depth_refit: float | None
    predicted_median_refit: float | None
    predicted_total_refit: int | None
    residual_px: float
    offset_mm: tuple[float, float]

    @property
    def views_agree(self) -> bool:
        """Whether the median numbers of views differ by no more than 10 %, or by no more than
        one.
        """
        return abs(self.predicted_median - self.measured_median) <= max(
            VIEWS_COUNT, VIEWS_SHARE * self.measured_median
        )

    @property
    def depth_deviation(self) -> float | None:
        """Predicted over measured virtual depth, less 1."""
        if self.virtual_depth_measured is None or self.virtual_depth_predicted is None:
            return None
        return self.virtual_depth_predicted / self.virtual_depth_measured - 1


def compare_frames(
    observations: Observations,
    seen: SeenPoints,
    predicted: PredictedPoints,
    refit: PredictedPoints | None,
    pixel: float,
) -> tuple[FrameAgreement, ...]:
    """Medians and totals of every frame that has observations.

    Args:
        observations: as read.
        seen: its points as measured.
        predicted: the same points by the camera as described.
        refit: the same by the camera with refitted distances; ``None`` where the points allow no
            refit.
        pixel: pixel size, mm.
    """
    return tuple(
        _one_frame(
            frame, math.degrees(observations.poses[frame].tilt), seen, predicted, refit, pixel
        )
        for frame in observations.frames
    )


def _one_frame(
    frame: int,
    tilt_deg: float,
    seen: SeenPoints,
    predicted: PredictedPoints,
    refit: PredictedPoints | None,
    pixel: float,
) -> FrameAgreement:
    of = seen.frame == frame
    known = of & seen.with_parallax
    x, y = predicted.offset[of][0]
    return FrameAgreement(
        frame=frame,
        tilt_deg=tilt_deg,
        points=int(of.sum()),
        measured_median=float(np.median(seen.views[of])),
        predicted_median=float(np.median(predicted.views[of])),
        measured_total=int(seen.views[of].sum()),
        predicted_total=int(predicted.views[of].sum()),
        virtual_depth_measured=_median(seen.virtual_depth[known]),
        virtual_depth_predicted=_median(predicted.virtual_depth[known]),
        virtual_depth_refit=None if refit is None else _median(refit.virtual_depth[known]),
        predicted_median_refit=None if refit is None else float(np.median(refit.views[of])),
        predicted_total_refit=None if refit is None else int(refit.views[of].sum()),
        residual_px=float(np.sqrt(np.mean(predicted.residual[of[seen.owner]] ** 2))) / pixel,
        offset_mm=(float(x), float(y)),
    )


def _median(values: Array) -> float | None:
    median = float(np.median(values)) if len(values) else math.nan
    return median if math.isfinite(median) else None


def depth_deviation(seen: SeenPoints, predicted: PredictedPoints) -> float | None:
    """Median over all points of the deviation of predicted from measured virtual depth, relative
    and without sign.
    """
    known = seen.with_parallax
    return _median(np.abs(predicted.virtual_depth[known] / seen.virtual_depth[known] - 1))


def state_views(frames: tuple[FrameAgreement, ...]) -> list[str]:
    """Sentences on the number of views."""
    said: list[str] = []
    limit = f"{math.degrees(STEEP):.0f} degrees"
    for steep, which in (
        (False, f"tilted by less than {limit}"),
        (True, f"tilted by {limit} or more"),
    ):
        group = [frame for frame in frames if (math.radians(frame.tilt_deg) >= STEEP) == steep]
        if not group:
            continue
        worst = max(
            group, key=lambda frame: abs(frame.predicted_median / frame.measured_median - 1)
        )
        astray = [str(frame.frame) for frame in group if not frame.views_agree]
        verdict = (
            "in every one"
            if not astray
            else f"in {len(group) - len(astray)} of them, not in frame {', '.join(astray)}"
        )
        measured, predicted = (
            sum(getattr(frame, name) for frame in group)
            for name in ("measured_total", "predicted_total")
        )
        said.append(
            f"Views, {len(group)} frames {which}: the predicted median lies within 10 % or one view"
            f" of the measured one {verdict}; worst is frame {worst.frame}"
            f" ({worst.predicted_median:g} predicted, {worst.measured_median:g} measured); in all"
            f" {predicted} views are predicted, {measured} measured"
            f" ({predicted / measured - 1:+.1%})."
        )
    return said


def state_depths(
    frames: tuple[FrameAgreement, ...], before: float | None, after: float | None
) -> list[str]:
    """Sentences on the virtual depth.

    Args:
        frames: the frames.
        before: median relative deviation of all points by the camera as described.
        after: the same after the refit.
    """
    found = sorted(
        (frame for frame in frames if frame.depth_deviation is not None),
        key=lambda frame: frame.virtual_depth_measured or 0.0,
    )
    if not found or before is None:
        return ["Virtual depth: no point is seen often enough for a parallax."]
    trend = ", ".join(
        f"{frame.depth_deviation:+.0%} at v = {frame.virtual_depth_measured:.1f}" for frame in found
    )
    said = [
        f"Virtual depth by the camera as described against parallax: {trend}; median of all points'"
        f" deviations {before:.1%}."
    ]
    if after is not None:
        said.append(f"After a refit of the two distances L and b alone that median is {after:.1%}.")
    return said
