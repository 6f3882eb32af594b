"""What the frames of one configuration of a run show."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.alignment import Attitude, attitude_of
from flflab.bench import Bench, Element
from flflab.errors import MeasurementError
from flflab.measurement.contrast.curve import ContrastCurve, fit_contrast
from flflab.measurement.dots.scale import DotScale
from flflab.measurement.dots.views import DotViews, count_views
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.sensor.pairs import NoiseRatio, noise_of_pair
from flflab.optics.camera import Camera
from flflab.record import FrameRecord, Run
from flflab.study import Configuration, Study
from flflab.targets import BarsAlongY, FourDot

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PlaneSeen:
    """The depth map of a flat target that faces the camera.

    Attributes:
        distance: mean over the map, mm.
        uncertainty: its standard uncertainty by the map, mm.
        scatter: of the places about that mean, root mean square, mm.
        within_1: share of places within one stated sigma of that mean.
        within_2: within two.
        density: share of places that two microlenses see which have a value.
    """

    distance: float
    uncertainty: float
    scatter: float
    within_1: float
    within_2: float
    density: float


@dataclass(frozen=True)
class Measured:
    """What the frames of one configuration show, and what else was recorded with them.

    Attributes:
        configuration: what was asked for.
        worlds: where the stages said the elements stood, mm.
        lattice: of the micro-images.
        dots: empty where they could not be measured.
        attitude: how the array is turned; None where too few micro-images are seen.
        curve: None where the bars could not be measured.
        curve_y: the same of bars along y; None where none were shown, too.
        dot_scale: size and turn of the square of dots; None where too few views tell them.
        noise: from frame to frame; None where no target was taken twice.
        plane: by the depth map of a texture; None where none was shown or made.
        exposure_s: s.
        saturated: most saturated pixels in one frame.
        failures: what could not be measured and why, a sentence each.
    """

    configuration: Configuration
    worlds: dict[Element, float]
    lattice: Lattice
    attitude: Attitude | None
    dots: tuple[DotViews, ...]
    curve: ContrastCurve | None
    exposure_s: float
    saturated: int
    failures: tuple[MeasurementError, ...] = ()
    dot_scale: DotScale | None = None
    noise: NoiseRatio | None = None
    plane: PlaneSeen | None = None
    curve_y: ContrastCurve | None = None

    @property
    def curves(self) -> dict[str, ContrastCurve]:
        """Those that were measured, by the quantity that they are."""
        found = {"mtf": self.curve, "mtf_y": self.curve_y}
        return {name: curve for name, curve in found.items() if curve is not None}


def measure_configuration(
    run: Run, configuration: Configuration, study: Study, bench: Bench
) -> Measured:
    """Lattice, views and contrast of one configuration of a run, from the means of its frames; of
    the targets that its study shows.

    Raises:
        MeasurementError: its frames are missing or do not show what they should.
    """
    pictures, frames = {}, {}
    for target in ("white", *study.shown):
        pictures[target], frames[target] = mean_picture(run, configuration, target)
    first = frames[study.shown[0]][0]
    # by this bench's zeros: it need not be the one that the run was recorded with
    elements = [
        (name, axis)
        for name, axis in bench.description.axes.items()
        if axis.moves in first.worlds and name in first.readings
    ]
    found = measure_pictures(
        pictures,
        {
            target: averaged(sensor_noise(run, taken[0].exposure_s), len(taken))
            for target, taken in frames.items()
        },
        configuration,
        first.worlds | {axis.moves: axis.world(first.readings[name]) for name, axis in elements},
        study,
        bench.optics,
        first.exposure_s,
        max(frame.saturated for taken in frames.values() for frame in taken),
        bench.description.mean_wavelength,
    )
    return replace(found, noise=_noise_of(run, frames))


def _noise_of(run: Run, frames: Mapping[str, tuple[FrameRecord, ...]]) -> NoiseRatio | None:
    """From the first two frames of a target that was taken twice in a row."""
    for taken in frames.values():
        if len(taken) > 1 and taken[0].exposure_s == taken[1].exposure_s:
            one, other = (run.picture(frame).astype(np.float64) for frame in taken[:2])
            return noise_of_pair(one, other, sensor_noise(run, taken[0].exposure_s))
    return None


def recorded(run: Run, study: Study) -> tuple[Configuration, ...]:
    """The configurations of which every picture that the study shows was recorded and is admitted;
    all of them where none is. Those that a run taken to its end lacks are kept: its study was
    changed, which the measurement says.
    """
    taken = {(frame.configuration, frame.target): False for frame in run.frames}
    taken |= {
        (frame.configuration, frame.target): True for frame in run.frames if frame.validity.admitted
    }

    def whole(one: Configuration) -> bool:
        due = [taken.get((one.index, target)) for target in ("white", *study.shown)]
        return all(due) or (run.complete and None in due)

    found = tuple(one for one in study.configurations if whole(one))
    return found or study.configurations


def measure_pictures(
    pictures: Mapping[str, Array],
    noises: Mapping[str, SensorNoise],
    configuration: Configuration,
    worlds: dict[Element, float],
    study: Study,
    optics: Camera,
    exposure_s: float = 1.0,
    saturated: int = 0,
    wavelength: float | None = None,
) -> Measured:
    """Lattice from the white picture, views from the dots, contrast from the bars, where there are
    such pictures.

    A camera far from its model may show no dots or bars that can be measured; the rest is measured
    all the same.

    Args:
        pictures: DN, [row, col], by target: white, four-dot, bars, bars-y.
        noises: the noise of each.
        configuration: what was asked for.
        worlds: where the stages said the elements stood, mm.
        study: whose targets were shown.
        optics: the bench's camera.
        exposure_s: of all the pictures, s.
        saturated: most saturated pixels in one frame.
        wavelength: of the light, mm; None where diffraction is too little to count.

    Raises:
        MeasurementError: the white picture shows no such lattice.
    """
    camera, distance = as_placed(configuration, optics, worlds)
    white = pictures["white"]
    lattice = lattice_behind(camera, white, noises["white"])
    try:
        attitude = attitude_of(lattice)
    except MeasurementError:
        attitude = None  # a sensor of so few micro-images says nothing of it
    measured = Measured(configuration, worlds, lattice, attitude, (), None, exposure_s, saturated)
    if FourDot.kind in pictures:
        try:
            dots = count_views(
                pictures[FourDot.kind],
                lattice,
                camera,
                study.dots,
                distance,
                noises[FourDot.kind],
            )
            measured = replace(measured, dots=dots, dot_scale=dots[0].scale)
        except MeasurementError as error:
            measured = replace(measured, failures=(*measured.failures, error))
    for bars in (study.bars, study.bars_y):
        if bars.kind not in pictures:
            continue
        try:
            curve = fit_contrast(
                pictures[bars.kind],
                lattice,
                camera,
                bars,
                distance,
                noises[bars.kind],
                wavelength=wavelength,
            )
            there = {"curve_y": curve} if isinstance(bars, BarsAlongY) else {"curve": curve}
            measured = replace(measured, **there)
        except MeasurementError as error:
            measured = replace(measured, failures=(*measured.failures, error))
    return measured


def as_placed(
    configuration: Configuration, optics: Camera, worlds: dict[Element, float]
) -> tuple[Camera, float]:
    """The nominal camera with the elements where the stages said they stood, and the target's
    distance, mm.
    """
    lens = worlds["main_lens.z"]
    placed = replace(
        configuration, array=worlds["array.z"] - lens, sensor=worlds["sensor.z"] - lens
    )
    return placed.camera(optics), lens - worlds["target.z"]


def sensor_noise(run: Run, exposure_s: float) -> SensorNoise:
    """What the camera says of its noise, with the black level of the dark frame where one was taken
    at that exposure.
    """
    noise = SensorNoise(**run.sensor_noise)
    dark = run.dark(exposure_s)
    return replace(noise, offset_dn=float(np.mean(run.picture(dark)))) if dark else noise


def averaged(noise: SensorNoise, frames: int) -> SensorNoise:
    """The noise of a mean of several frames."""
    return replace(
        noise,
        dn_per_electron=noise.dn_per_electron / frames,
        read_noise_dn=noise.read_noise_dn / frames**0.5,
    )


def mean_picture(
    run: Run, configuration: Configuration, target: str
) -> tuple[Array, tuple[FrameRecord, ...]]:
    """Mean of a configuration's admitted frames of one target, DN, and the frames."""
    taken = [
        frame
        for frame in run.frames
        if frame.configuration == configuration.index and frame.target == target
    ]
    frames = tuple(frame for frame in taken if frame.validity.admitted)
    if taken and not frames:
        raise MeasurementError(
            f"run {run.folder}: configuration {configuration.index} has no {target} frame that may"
            f" be judged: {taken[0].key} is {taken[0].validity.status},"
            f" {taken[0].validity.reason}; take them again"
        )
    if not frames:
        how = (
            "its study was changed"
            if run.complete
            else f"the run stopped before it was taken: `flflab resume {run.folder}` goes on"
        )
        raise MeasurementError(
            f"run {run.folder}: configuration {configuration.index} has no {target} frame; {how}"
        )
    total = run.picture(frames[0]).astype(np.float64)
    for frame in frames[1:]:
        total += run.picture(frame)
    return total / len(frames), frames
