"""How far a camera's model agrees with observations, frame by frame and in sentences: as found,
good or bad.
"""

import math
from dataclasses import dataclass

import numpy as np

from flflab.digits import plus_minus
from flflab.observations.detector import Detector
from flflab.observations.points import Parallax, SeenPoints
from flflab.observations.prediction import Alignment, PredictedPoints
from flflab.observations.reading import Array, Observations

VIEWS_SHARE, VIEWS_COUNT = 0.10, 1.0
"""Agreement of median view counts that is looked for: 10 %, or one view."""


@dataclass(frozen=True)
class FrameAgreement:
    """One frame: medians and totals over its points; ``None`` where no point has the quantity.

    Attributes:
        tilt_deg: between the board's normal and the axis, after the rotation of all poses.
        expected_total: views that the fitted detector finds of the model's.
        z: measured less expected total over the scatter of as many views.
        residual_px: root mean square of measured less predicted positions on the sensor.
    """

    frame: int
    tilt_deg: float
    points: int
    measured_median: float
    predicted_median: float
    measured_total: int
    predicted_total: int
    expected_total: float
    z: float | None
    virtual_depth_measured: float | None
    virtual_depth_predicted: float | None
    virtual_depth_refit: float | None
    residual_px: float

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


@dataclass(frozen=True)
class Findings:
    """What the frames are judged by: points as seen and as predicted.

    Attributes:
        refit_depth: virtual depth with refitted distances, shape (P,); ``None`` where the points
            allow no refit.
        pixel: pixel size, mm.
    """

    seen: SeenPoints
    parallax: Parallax
    alignment: Alignment
    detector: Detector
    predicted: PredictedPoints
    refit_depth: Array | None
    pixel: float


def compare_frames(observations: Observations, found: Findings) -> tuple[FrameAgreement, ...]:
    """Medians and totals of every frame that has observations."""
    return tuple(
        _one_frame(
            frame, math.degrees(found.alignment.tilt(observations.poses[frame].normal)), found
        )
        for frame in observations.frames
    )


def _one_frame(frame: int, tilt_deg: float, found: Findings) -> FrameAgreement:
    seen, predicted, detector = found.seen, found.predicted, found.detector
    of = seen.frame == frame
    known = of & found.parallax.known
    total, expected = int(seen.views[of].sum()), float(detector.expected[of].sum())
    z = detector.z(total, expected)
    residual = found.alignment.residual[of[seen.owner]] / found.pixel
    return FrameAgreement(
        frame=frame,
        tilt_deg=tilt_deg,
        points=int(of.sum()),
        measured_median=float(np.median(seen.views[of])),
        predicted_median=float(np.median(predicted.views[of])),
        measured_total=total,
        predicted_total=int(predicted.views[of].sum()),
        expected_total=expected,
        z=z if math.isfinite(z) else None,
        virtual_depth_measured=_median(found.parallax.virtual_depth[known]),
        virtual_depth_predicted=_median(predicted.virtual_depth[known]),
        virtual_depth_refit=(
            None if found.refit_depth is None else _median(found.refit_depth[known])
        ),
        residual_px=float(np.sqrt(np.mean(residual**2))),
    )


def _median(values: Array) -> float | None:
    median = float(np.median(values)) if len(values) else math.nan
    return median if math.isfinite(median) else None


def depth_deviation(parallax: Parallax, predicted: Array) -> float | None:
    """Median over all points of the deviation of predicted from measured virtual depth, relative
    and without sign.
    """
    known = parallax.known
    return _median(np.abs(predicted[known] / parallax.virtual_depth[known] - 1))


def state_positions(
    frames: tuple[FrameAgreement, ...], found: Findings, undistorted: Alignment | None
) -> list[str]:
    """Sentences on where the views land.

    Args:
        frames: the frames.
        found: what they were judged by.
        undistorted: the fit without the camera's distortion; ``None`` where it has none.
    """
    rms = [frame.residual_px for frame in frames]
    turn, u = 1e3 * found.alignment.rotation, 1e3 * found.alignment.uncertainty
    angles = ", ".join(
        plus_minus(float(angle), float(by), "+") for angle, by in zip(turn, u, strict=True)
    )
    said = (
        f"Positions: {min(rms):.2f} to {max(rms):.2f} px rms a frame,"
        f" {found.alignment.rms / found.pixel:.2f} px in all, after one rotation of all poses"
        f" against the camera, {angles} mrad about x, y, z"
    )
    if undistorted is not None:
        said += f"; without the lens's distortion {undistorted.rms / found.pixel:.2f} px in all"
    return [said + "."]


def state_views(frames: tuple[FrameAgreement, ...], found: Findings) -> list[str]:
    """Sentences on the number of views."""
    seen, detector = found.seen, found.detector
    astray = [str(frame.frame) for frame in frames if not frame.views_agree]
    beyond = int(seen.beyond_field.sum())
    said = [
        f"Views: the detector finds half of them {detector.reach / found.pixel:.1f} px from the"
        f" centre of a micro-image (softness {detector.softness / found.pixel:.2f} px), one curve"
        f" for all frames. {beyond or 'None'} of {len(seen.owner)} views"
        f" lie{'s' if beyond == 1 else ''} outside the total field of the model.",
    ]
    z = [frame.z for frame in frames if frame.z is not None]
    if z:
        worst = max((f for f in frames if f.z is not None), key=lambda f: abs(f.z or 0.0))
        said.append(
            f"Totals of a frame stand {math.sqrt(sum(one**2 for one in z) / len(z)):.1f} rms of"
            f" their scatter ({detector.scatter:.2f} sqrt(N), of points within a frame) from what"
            f" that curve finds; worst is frame {worst.frame}: {worst.measured_total} found,"
            f" {worst.expected_total:.0f} expected, z = {worst.z:+.1f}."
        )
    said.append(
        "The median number of the model's chief views, which knows of no detector, lies within"
        " 10 % or one view of the measured one in"
        f" {'all frames but ' + ', '.join(astray) if astray else 'every frame'}."
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
