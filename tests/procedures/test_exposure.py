"""The exposure rule: found from any light, in steps, never saturated, refused in a sentence."""

import math
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bluesky.utils import Msg
from hypothesis import given
from hypothesis import strategies as st

from flflab.errors import MeasurementError
from flflab.record import Recording
from procedures.capture import MOST_TRIALS, brightest_view, expose, quantise
from procedures.devices import Frames


def played(frames: Frames, level: float, guess: float = 0.01) -> float:
    """Play a plan by hand: prepare and trigger are all it asks for."""
    plan = expose(frames, level, guess, "c0/white/0", 0)
    try:
        message: Msg = next(plan)
        while True:
            if message.command == "prepare":
                frames.prepare(*message.args)
            elif message.command == "trigger":
                frames.trigger().wait()
            message = plan.send(None)
    except StopIteration as end:
        return float(end.value)


@given(st.floats(1e-5, 10.0))
def test_an_exposure_is_rounded_down_to_a_sixth_of_an_octave(exposure: float) -> None:
    step = quantise(exposure)
    assert step <= exposure * (1 + 1e-9) < step * 2 ** (1 / 6) * (1 + 1e-8)
    assert 6 * math.log2(step) == pytest.approx(round(6 * math.log2(step)), abs=1e-9)
    assert quantise(step) == step


@pytest.mark.parametrize("rate", [600.0, 9e3, 4e5, 3.7e6, 8e7])
@pytest.mark.parametrize("level", [0.3, 0.7])
def test_the_brightest_view_reaches_its_share_of_full_scale(
    rate: float, level: float, memory_camera: Callable[..., Any], tmp_path: Path
) -> None:
    camera = memory_camera(rate)
    with closing(Recording(tmp_path, 1, (30, 40))) as recording:
        frames = Frames(camera, recording)
        exposure = played(frames, level)
    true_share = rate * exposure / (camera.full_scale - camera.offset_dn)
    # One step down by rounding, one that noise decides, and the 0.99 quantile lies above the mean.
    assert level * 2 ** (-2 / 6) * 0.93 < true_share <= level * 1.01
    assert len(camera.exposures) <= MOST_TRIALS
    assert frames.latest is not None
    assert frames.latest.exposure_s == exposure


@pytest.mark.parametrize("rate", [0.0, 10.0, 1e12])
def test_light_that_no_exposure_suits_is_refused_in_a_sentence(
    rate: float, memory_camera: Callable[..., Any], tmp_path: Path
) -> None:
    with (
        closing(Recording(tmp_path, 1, (30, 40))) as recording,
        pytest.raises(MeasurementError, match=r"c0/white/0: .*full scale"),
    ):
        played(Frames(memory_camera(rate), recording), 0.7)


SHUTTER = tuple(
    sorted({1 / n for n in (8000, 4000, 2000, 1000, 500, 250, 125, 60, 30, 15, 8, 4, 2)} | {1.0})
)  # s, as a body offers them


@pytest.mark.parametrize("rate", [9e3, 6e4, 4e5, 3.7e6])
def test_a_camera_that_offers_certain_exposures_gets_one_of_them(
    rate: float, memory_camera: Callable[..., Any], tmp_path: Path
) -> None:
    camera = memory_camera(rate)
    camera.exposure_limits, camera.offered_exposures = (SHUTTER[0], SHUTTER[-1]), SHUTTER
    with closing(Recording(tmp_path, 1, (30, 40))) as recording:
        exposure = played(Frames(camera, recording), 0.7)
    assert exposure in SHUTTER
    true_share = rate * exposure / (camera.full_scale - camera.offset_dn)
    assert (
        0.7 / 4.3 < true_share <= 0.7 * 1.01
    )  # rounded down to a step of an octave, and one that noise decides


@pytest.mark.parametrize("rate", [300.0, 1e12])
def test_light_beyond_the_exposures_offered_is_refused(
    rate: float, memory_camera: Callable[..., Any], tmp_path: Path
) -> None:
    camera = memory_camera(rate)
    camera.exposure_limits, camera.offered_exposures = (SHUTTER[0], SHUTTER[-1]), SHUTTER
    with (
        closing(Recording(tmp_path, 1, (30, 40))) as recording,
        pytest.raises(MeasurementError, match="the camera can do"),
    ):
        played(Frames(camera, recording), 0.7)


def test_hot_pixels_and_the_dark_between_micro_images_do_not_count(
    memory_camera: Callable[..., Any],
) -> None:
    camera = memory_camera()
    picture = np.full((300, 400), 64, np.uint16)
    picture[:, :40] = 2064
    picture[::100, ::100] = 4095
    share = 2000 / (4095 - 64)
    assert brightest_view(picture, camera) == pytest.approx(share)
    assert brightest_view(np.full((300, 400), 66, np.uint16), camera) == 0.0
