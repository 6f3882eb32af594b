"""Take a frame; find the exposure first where it is not known: the brightest view at the study's
share of full scale.
"""

import bisect
import math
from collections.abc import Generator
from typing import Any

import numpy as np
import numpy.typing as npt
from bluesky import Msg
from bluesky import plan_stubs as bps

from drivers.base import CameraDevice, Setting
from flflab.errors import MeasurementError
from procedures.devices import Frames, Shot, Stages

Plan = Generator[Msg, Any, Any]
STEPS_PER_OCTAVE = 6
FIRST_GUESS_S = 0.01
MOST_TRIALS = 6
LARGEST_FACTOR = (
    16.0  # between two trials: where almost nothing or everything is lit, proportion tells little
)
BRIGHTEST = 0.99  # quantile of the lit pixels
LEAST_LIT = 1e-3  # share of all pixels


def quantise(exposure_s: float, offered: tuple[float, ...] = ()) -> float:
    """The largest step not above an exposure: of those a camera offers, else of 2^(k/6) s.

    In steps few dark frames serve many configurations. Beyond what is offered one step more is
    counted on either side: who wants more than there is gets what the camera cannot do.
    """
    if len(offered) > 1:
        steps = (offered[0] ** 2 / offered[1], *offered, offered[-1] ** 2 / offered[-2])
        return steps[max(bisect.bisect_right(steps, exposure_s * (1 + 1e-9)) - 1, 0)]
    return 2.0 ** (math.floor(STEPS_PER_OCTAVE * math.log2(exposure_s) + 1e-9) / STEPS_PER_OCTAVE)


def brightest_view(picture: npt.NDArray[np.uint16], camera: CameraDevice) -> float:
    """How bright the brightest view is, as a share of full scale above the offset: the 0.99
    quantile of the lit pixels.

    Every second row and column is looked at. A pixel is lit at 5 standard deviations of read noise
    above the offset, and 2 DN. Where less than a thousandth is lit it is 0.
    """
    sample = picture[::2, ::2].ravel()
    counts = np.bincount(sample, minlength=camera.full_scale + 1)
    lit = int(camera.offset_dn + max(5 * camera.read_noise_dn, 2.0)) + 1
    above = np.cumsum(counts[lit:])
    if above.size == 0 or above[-1] < LEAST_LIT * sample.size:
        return 0.0
    value = lit + int(np.searchsorted(above, BRIGHTEST * above[-1]))
    return (value - camera.offset_dn) / (camera.full_scale - camera.offset_dn)


def better_exposure(
    exposure_s: float, reached: float, level: float, offered: tuple[float, ...] = ()
) -> float:
    """The exposure to try next, a step of ``quantise``, in proportion; far off where the picture is
    almost dark or saturated.
    """
    factor = 1 / LARGEST_FACTOR if reached >= 0.98 else level / max(reached, level / LARGEST_FACTOR)
    return quantise(exposure_s * factor, offered)


def fits(exposure_s: float, wanted_s: float, offered: tuple[float, ...] = ()) -> bool:
    """Whether an exposure is the wanted step or the one below it: noise moves the wanted step by
    one.
    """
    if len(offered) > 1:
        return wanted_s in offered and offered.index(wanted_s) - offered.index(exposure_s) in (0, 1)
    return -0.5 < STEPS_PER_OCTAVE * math.log2(wanted_s / exposure_s) < 1.5


def expose(frames: Frames, level: float, guess_s: float, key: str, configuration: int) -> Plan:
    """Take pictures of the white target until one is exposed as wanted; that one is the latest
    then.

    Args:
        frames: the camera.
        level: share of full scale for the brightest view.
        guess_s: exposure of the first picture.
        key: of the point.
        configuration: index of the configuration.

    Returns:
        The exposure in s.

    Raises:
        MeasurementError: none was found in six pictures, or the camera cannot expose so long or so
            briefly.
    """
    (shortest, longest), offered = frames.camera.exposure_limits, frames.camera.offered_exposures
    exposure = quantise(min(max(guess_s, shortest), longest), offered)
    reached = 0.0
    for _ in range(MOST_TRIALS):
        yield from take(frames, Shot(key, configuration, 0, exposure))
        if frames.latest is None:  # a rehearsal: nothing is triggered
            return exposure
        reached = brightest_view(frames.latest.picture, frames.camera)
        wanted = better_exposure(exposure, reached, level, offered)
        if fits(exposure, wanted, offered):
            return exposure
        if not shortest <= wanted <= longest:
            raise MeasurementError(
                f"{key}: the brightest view is at {reached:.3f} of full scale at {exposure:.3g} s,"
                f" {level:g} would need {wanted:.3g} s, the camera can do {shortest:g} s to"
                f" {longest:g} s; change the light, see that the target is in place"
            )
        exposure = wanted
    raise MeasurementError(
        f"{key}: after {MOST_TRIALS} pictures the brightest view is at {reached:.3f} of full scale,"
        f" {level:g} is due; is the light steady?"
    )


def take(frames: Frames, shot: Shot) -> Plan:
    """Take one picture; it is not in the record yet."""
    yield from bps.prepare(frames, shot, wait=True)
    yield from bps.trigger(frames, wait=True)


def keep(frames: Frames, stages: Stages, *settings: Setting[Any]) -> Plan:
    """Record the latest picture with everything the bench reads now."""
    yield from open_event(stages, *settings)
    yield from close_event(frames)


def shoot(frames: Frames, stages: Stages, shot: Shot, *settings: Setting[Any]) -> Plan:
    """Expose, and note what the bench reads; things may move then, while the picture is read out.
    ``close_event`` records it.
    """
    yield from bps.prepare(frames, shot, wait=True)
    yield from bps.trigger(stages.before, wait=True)
    yield from bps.trigger(frames.light, wait=True)
    yield from open_event(stages, *settings)


def open_event(stages: Stages, *settings: Setting[Any]) -> Plan:
    """Note everything the bench reads now for the frame to be recorded next."""
    yield from bps.create("primary")
    for device in (stages, *settings):
        yield from bps.read(device)


def close_event(frames: Frames) -> Plan:
    """Wait for the picture and record it with what was noted."""
    yield from bps.trigger(frames.arrival, wait=True)
    yield from bps.read(frames)
    yield from bps.save()
