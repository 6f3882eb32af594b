"""Random scenes of random cameras, for trials of what is promised for every scene. Deterministic
effects only.
"""

import math

import numpy as np

from flflab.errors import InputError
from flflab.image.effects.colour_filter import PATTERNS, ColourFilter
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.motion import Motion
from flflab.image.effects.scatter import Scatter
from flflab.image.effects.stray_light import StrayLight
from flflab.image.scene import Plane, Scene
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars, Black, Chirp, Edge, FourDot, Picture, Target, White

RESOLUTION = (256, 192)


def random_scene(rng: np.random.Generator, resolution: tuple[int, int] = RESOLUTION) -> Scene:
    """A camera with 10 to 60 pixels to a microlens's radius before one or two targets; it has every
    imperfection, from none to plain.
    """
    while True:
        try:
            camera = _camera(rng, resolution)
            return _scene(rng, camera)
        except InputError:
            continue  # numbers that are no camera


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _camera(rng: np.random.Generator, resolution: tuple[int, int]) -> Camera:
    focal = _log(rng, 0.4, 2.0)
    f_number = _log(rng, 1.6, 16.0)
    distance = rng.uniform(52.0, 70.0)
    gap = focal * (1 + _sign(rng) * _log(rng, 0.02, 0.4))
    pitch = _log(rng, 0.1, 0.5)
    pixel = pitch / rng.uniform(20.0, 120.0)
    hexagonal = rng.random() < 0.5
    count = 2 * math.ceil(resolution[0] * pixel / pitch) + 5
    array = MicrolensArray(
        layout="hexagonal" if hexagonal else "square",
        count=(count, count),
        pitch=(pitch, pitch),
        aperture=pitch * rng.uniform(0.5, 1.0),
        focal_lengths=tuple(focal * step for step in (1.0, 0.95, 1.05)),
        distance=distance,
        pattern=((0, 1, 2),) if hexagonal and rng.random() < 0.3 else ((0,),),
        offset=(_log(rng, 1e-7, 1e-2), -_log(rng, 1e-7, 1e-2)),
        roll=_sign(rng) * _log(rng, 1e-8, 1e-2),
        tilt=(_log(rng, 1e-8, 1e-2), -_log(rng, 1e-8, 1e-2)),
    )
    return Camera(MainLens(50.0, f_number), array, Sensor(resolution, pixel, distance + gap))


def _target(rng: np.random.Generator, width: float) -> Target:
    """A target whose details are of the size that the sensor sees, ``width`` mm."""
    kind = rng.choice(
        ["four-dot", "bars", "chirp", "edge", "white", "black", "picture"],
        p=[0.15, 0.25, 0.2, 0.15, 0.08, 0.02, 0.15],
    )
    cycles = sorted(_log(rng, 0.5, 100.0) / width for _ in range(2))
    match str(kind):
        case "four-dot":
            spacing = width * rng.uniform(0.2, 1.0)
            return FourDot(spacing * rng.uniform(0.05, 0.9), spacing)
        case "bars" | "chirp":
            size = width * rng.uniform(0.5, 3.0), width * rng.uniform(0.5, 3.0)
            return (Bars if kind == "bars" else Chirp)((cycles[0], cycles[1]), *size)
        case "edge":
            return Edge(rng.uniform(0, 2 * math.pi))
        case "picture":
            return Picture(rng.random((24, 32)), width * rng.uniform(0.5, 3.0))
        case _:
            return White() if kind == "white" else Black()


def _plane(rng: np.random.Generator, camera: Camera, distance: float, card: bool) -> Plane:
    sensor = camera.sensor
    width = (
        distance
        / camera.array.distance
        * sensor.resolution[0]
        * sensor.pixel
        * rng.uniform(1.0, 10.0)
    )
    return Plane(
        _target(rng, width),
        distance,
        offset=(width * rng.uniform(-0.3, 0.3), width * rng.uniform(-0.3, 0.3)),
        roll=_sign(rng) * _log(rng, 1e-8, 1.0),
        tilt=(_log(rng, 1e-8, 0.2), -_log(rng, 1e-8, 0.2)),
        size=(width * rng.uniform(0.2, 0.8), width * rng.uniform(0.2, 0.8)) if card else None,
    )


def _sharp_distance(camera: Camera) -> float:
    """Where a target is sharp: 1 / (1/F - (1 - x)/L) with x = (b/L) / kappa (physics.md); not above
    0 where nowhere.
    """
    gap, distance = camera.gap, camera.array.distance
    kappa = 1 + gap / distance - gap / camera.array.focal_lengths[0]
    return 1 / (1 / camera.main_lens.focal_length - (1 - gap / distance / kappa) / distance)


def _scene(rng: np.random.Generator, camera: Camera) -> Scene:
    sharp = _sharp_distance(camera)
    distances = sorted(
        sharp * math.exp(_sign(rng) * _log(rng, 1e-4, 0.3))
        if 150 < sharp < 5000 and rng.random() < 0.5
        else _log(rng, 150.0, 5000.0)
        for _ in range(2 if rng.random() < 0.2 else 1)
    )
    planes = tuple(
        _plane(rng, camera, distance, card=place < len(distances) - 1)
        for place, distance in enumerate(distances)
    )
    way = [_log(rng, 1e-7, 1e-1) for _ in range(4)]
    return Scene(
        camera,
        planes,
        diffraction=Diffraction(_log(rng, 400e-6, 900e-6)),
        falloff=Falloff(),
        distortion=Distortion(_sign(rng) * _log(rng, 1e-5, 1.0)),
        scatter=Scatter(_log(rng, 1e-7, 1e-2), _log(rng, 1e-8, 1e-3), int(rng.integers(1 << 30))),
        stray_light=StrayLight(_log(rng, 1e-6, 1e-1)),
        colour_filter=ColourFilter(str(rng.choice(PATTERNS))),
        motion=Motion((way[0], -way[1]), (way[2], way[3])),
    )
