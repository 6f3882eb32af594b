"""What is hidden in a bench of the trials: errors within what its file states, how its lenses and
its light really are, and at most one fault besides.

The kinds and sizes of faults were fixed before any was tried. The hidden errors are drawn here, by
this file's own generator; the analysis knows only what the bench file states.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from random_benches import log_uniform
from scipy.ndimage import gaussian_filter

from flflab.bench import AxisDescription, Bench, Element
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.gamma import Gamma
from flflab.image.effects.halo import Halo
from flflab.image.effects.scatter import Scatter
from flflab.image.effects.shading import Shading
from flflab.image.effects.stray_light import StrayLight
from flflab.image.render import render
from flflab.image.scene import Plane, Scene
from flflab.image.sensor.exposure import white_irradiance
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.study import Configuration, Study
from flflab.targets import Bars, FourDot, Target, White
from flflab.verdict.prediction import ELEMENTS
from flflab.verdict.properties.measured import Measured, measure_pictures
from flflab.verdict.sources import attitude_uncertainty

Array = npt.NDArray[np.float64]
GAIN, READ_NOISE_E, OFFSET, FULL_SCALE, WHITE_E = 4095 / 12000, 3.0, 64.0, 4095.0, 8000.0
NOISE = SensorNoise(GAIN, READ_NOISE_E * GAIN, OFFSET, FULL_SCALE)
BENT_WHITE, RAYS_WHITE, BENT, RAYS = 3e-4, 3e-5, 1e-3, 5e-4  # of white: errors of the pictures
RAYS_TRACED = 1e-3  # the same of single rays, which average out
KINDS = {  # of faults: smallest and largest size, and what the report should name
    "lens": (0.01, 0.10, "focal length of the main lens"),
    "lens, its stop kept": (0.01, 0.10, "focal length of the main lens"),
    "microlens focal length": (0.05, 0.20, "focal length of the microlenses"),
    "microlens aperture": (0.02, 0.05, "aperture of the microlenses"),
    "pitch": (0.005, 0.05, "pitch of the microlenses"),
    "pixel": (0.005, 0.05, "pixel size"),
    "dot spacing": (0.01, 0.10, "spacing of the dots"),
    "bars": (0.01, 0.06, "frequency of the bars"),
    "main lens zero": (0.02, 0.2, "zero of main_lens_stage"),
    "array zero": (0.02, 0.1, "zero of array_stage"),
    "sensor zero": (0.02, 0.1, "zero of sensor_stage"),
    "target zero": (5.0, 50.0, "zero of target_stage"),
    "f-number": (0.05, 0.20, "aperture of the main lens"),
    "roll": (0.005, 0.02, "roll of the array"),
    "tilt": (0.005, 0.02, "yaw of the array"),
    "target tilt": (0.05, 0.17, "tilt of the target"),
    "stray light": (0.03, 0.15, "stray light"),
    "gamma": (0.15, 0.4, "gamma"),
    "light not stated": (450e-6, 650e-6, "diffraction"),
    "lamp drifts": (0.05, 0.15, "unequal light"),
    "blur": (0.4, 1.0, "a blur beyond the model"),
    "settings exchanged": (1.0, 1.0, "settings exchanged"),
}


@dataclass(frozen=True)
class World:
    """What is hidden.

    Attributes:
        zeros: errors of the stages, mm.
        scales: the same of their scales.
        sizes: true over described sizes.
        turns: of the array, rad.
        wavelength: of the light, mm; None: rays.
        real: whether lenses and light are those of a workshop.
        seed: of the array.
        kind: of the fault; empty: none.
        size: of it, signed.
    """

    zeros: dict[Element, float]
    scales: dict[Element, float]
    sizes: dict[str, float]
    turns: Array
    wavelength: float | None
    real: bool
    seed: int
    kind: str = ""
    size: float = 0.0

    def fault(self, kind: str) -> float:
        """The size of this fault, 0 where it is not planted."""
        return self.size if self.kind == kind else 0.0


def drawn_world(
    rng: np.random.Generator, bench: Bench, wavelength: float | None, real: bool, kind: str = ""
) -> World:
    """Errors within what the bench file states; a fault of this kind comes on top."""
    axes: dict[Element, AxisDescription] = {
        e: found[1] for e in ELEMENTS if (found := bench.description.axis_of(e))
    }
    doubt = bench.description.optics_uncertainty
    stated = {
        "lens": doubt.main_lens_focal_length,
        "iris": doubt.f_number,
        "focal": doubt.microlens_focal_length,
        "aperture": doubt.microlens_aperture,
        "pitch": doubt.pitch,
    }
    zeros: dict[Element, float] = {
        element: rng.normal(0.0, axis.zero_uncertainty) for element, axis in axes.items()
    }
    scales: dict[Element, float] = {
        element: rng.normal(0.0, axis.scale_uncertainty) for element, axis in axes.items()
    }
    sizes = {name: 1 + rng.normal(0.0, share) for name, share in stated.items()}
    turns = rng.normal(0.0, 1.0, 3) * attitude_uncertainty(bench)
    size = 0.0
    if kind:
        side = float(rng.choice([-1.0, 1.0]))
        if kind in ("stray light", "light not stated", "blur", "settings exchanged"):
            side = 1.0
        if kind == "microlens aperture":
            side = -1.0  # a wider one may not fit the pitch
        size = side * log_uniform(rng, *KINDS[kind][:2])
    moved: dict[str, Element] = {
        "main lens zero": "main_lens.z", "array zero": "array.z", "sensor zero": "sensor.z",
        "target zero": "target.z",
    }  # fmt: skip
    larger = {
        "lens": ("lens",), "lens, its stop kept": ("lens", "iris"), "f-number": ("iris",),
        "microlens focal length": ("focal",), "microlens aperture": ("aperture",),
        "pitch": ("pitch",),
    }  # fmt: skip
    if kind in moved:
        zeros[moved[kind]] += size
    for name in larger.get(kind, ()):
        sizes[name] *= 1 + size
    if kind in ("roll", "tilt"):
        turns[("roll", "tilt").index(kind)] += size
    if kind == "light not stated":
        wavelength = size
    return World(
        zeros, scales, sizes, turns, wavelength, real, int(rng.integers(2**31)), kind, size
    )


def built(camera: Camera, world: World) -> Camera:
    """The camera of a configuration as it really is, stages aside."""
    lens, array, sizes = camera.main_lens, camera.array, world.sizes
    slopes = (array.tilt[0] + math.tan(world.turns[1]), array.tilt[1] + math.tan(world.turns[2]))
    pixel = camera.sensor.pixel * (1 + world.fault("pixel"))
    return replace(
        camera,
        main_lens=replace(lens, focal_length=lens.focal_length * sizes["lens"],
        f_number=lens.f_number * sizes["iris"]),
        array=replace(
            array,
            aperture=min(array.aperture * sizes["aperture"], array.pitch[0] * sizes["pitch"]),
            focal_lengths=tuple(one * sizes["focal"] for one in array.focal_lengths),
            pitch=(array.pitch[0] * sizes["pitch"], array.pitch[1] * sizes["pitch"]),
            roll=array.roll + world.turns[0], tilt=slopes,
        ),
        sensor=replace(camera.sensor, pixel=pixel),
    )  # fmt: skip


def seen(
    rng: np.random.Generator, place: int, bench: Bench, study: Study, world: World
) -> Measured:
    """The configuration at this place of the study, drawn with what is hidden and measured."""
    configuration = study.configurations[place]
    first, second = study.configurations[0], study.configurations[1]
    shown = configuration
    if world.kind == "settings exchanged":
        shown = {0: second, 1: first}.get(place, configuration)
    camera, distance = stands(shown, bench, world)
    lamp = 1 + rng.normal(0.0, bench.description.light_uncertainty)
    lamp *= 1 + world.fault("lamp drifts") * (place / max(len(study.configurations) - 1, 1) - 0.5)
    light = lamp * white_irradiance(camera) / white_irradiance(bench.optics)
    dots, bars = study.dots, study.bars
    spacing, period = 1 + world.fault("dot spacing"), 1 / (1 + world.fault("bars"))
    targets: tuple[Target, ...] = (
        White(),
        FourDot(dots.diameter, dots.spacing * spacing),
        Bars((bars.cycles_per_mm[0] / period, bars.cycles_per_mm[1] / period), bars.width * period,
             bars.height * period),
    )  # fmt: skip
    drawn = {t.kind: light * irradiance(camera, t, distance, world) for t in targets}
    exposure = 1.0
    if world.real:  # 2 % of the white picture's pixels are saturated, by their noise
        well = (FULL_SCALE - OFFSET) / GAIN
        white = drawn[White.kind] * WHITE_E
        exposure = well / float(np.quantile(rng.poisson(white), 0.98))
    pictures = {kind: recorded(rng, exposure * picture) for kind, picture in drawn.items()}
    return measure_pictures(
        pictures,
        {target.kind: NOISE for target in targets},
        configuration,
        asked(configuration),
        study,
        bench.optics,
        exposure_s=exposure,
        wavelength=bench.description.mean_wavelength,
    )


def asked(configuration: Configuration) -> dict[Element, float]:
    """Where the stages say that the elements stand, mm."""
    lens = configuration.main_lens
    return {
        "main_lens.z": lens,
        "array.z": configuration.array + lens,
        "sensor.z": configuration.sensor + lens,
        "target.z": lens - configuration.distance,
    }


def stands(configuration: Configuration, bench: Bench, world: World) -> tuple[Camera, float]:
    """The true camera of a configuration, and how far its target really is, mm."""
    true = asked(configuration)
    for element, place in asked(configuration).items():
        if found := bench.description.axis_of(element):
            along = found[1].sign * world.scales[element] * found[1].reading(place)
            true[element] = place + world.zeros[element] + along
    camera, lens = built(configuration.camera(bench.optics), world), true["main_lens.z"]
    return replace(
        camera,
        array=replace(camera.array, distance=true["array.z"] - lens),
        sensor=replace(camera.sensor, distance=true["sensor.z"] - lens),
    ), lens - true["target.z"]


def scene_of(camera: Camera, target: Target, distance: float, world: World) -> Scene:
    """What the light does, workmanship and slight imperfections included where they are real.

    Distortion of the main lens is among them where light is rays: pictures by waves have none.
    """
    tilt = math.tan(world.fault("target tilt")) if not isinstance(target, White) else 0.0
    stray, gamma = world.fault("stray light"), 1 + world.fault("gamma")
    scene = Scene(
        camera,
        (Plane(target, distance, tilt=(tilt, 0.0)),),
        diffraction=None if world.wavelength is None else Diffraction(world.wavelength),
        stray_light=StrayLight(stray) if stray else None,
        gamma=Gamma(gamma) if gamma != 1 else None,
    )
    if not world.real:
        return scene
    pixel = camera.sensor.pixel
    field = max(camera.sensor.resolution) * pixel / 2 / camera.array.distance
    return replace(
        scene,
        scatter=Scatter(
            focal_length=0.01, position=3e-4, seed=world.seed, brightness=0.01,
            aperture_decentre=1e-4,
        ),
        shading=Shading(0.05),
        halo=Halo(0.003, 20 * pixel),
        distortion=None if world.wavelength else Distortion(1e-4 / field**2),
    )  # fmt: skip


def irradiance(camera: Camera, target: Target, distance: float, world: World) -> Array:
    """A picture without noise, of white."""
    white, bent = isinstance(target, White), world.wavelength is not None
    tolerance = (BENT_WHITE if bent else RAYS_WHITE) if white else BENT if bent else RAYS
    if world.real:
        tolerance = max(tolerance, RAYS_TRACED)
    drawn = render(scene_of(camera, target, distance, world), tolerance=tolerance)
    drawn = np.maximum(drawn, 0.0)
    return gaussian_filter(drawn, sigma) if (sigma := world.fault("blur")) > 0 else drawn


def recorded(rng: np.random.Generator, picture: Array) -> Array:
    """A frame of it, DN."""
    electrons = rng.poisson(picture * WHITE_E) + rng.normal(0.0, READ_NOISE_E, picture.shape)
    return np.clip(np.rint(electrons * GAIN + OFFSET), 0, FULL_SCALE)
