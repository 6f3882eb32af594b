"""What the simulated camera of a bench file draws: which scene, how finely, with which effects, and
how long that takes. The report states it from the same functions.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from flflab.bench import Bench
from flflab.errors import InputError
from flflab.image.accuracy import LEAST_TOLERANCE
from flflab.image.choose import Choice, choose
from flflab.image.cost import predicted_seconds
from flflab.image.effects.columns import Columns
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.gamma import Gamma
from flflab.image.effects.halo import Halo
from flflab.image.effects.scatter import Scatter
from flflab.image.effects.second_stop import SecondStop
from flflab.image.effects.shading import Shading
from flflab.image.effects.soft_rims import SoftRims
from flflab.image.effects.stray_light import StrayLight
from flflab.image.path import path_of
from flflab.image.scene import Plane, Scene, without
from flflab.optics.camera import Camera
from flflab.optics.light import lines_of
from flflab.study import Study
from flflab.targets import Target, White

SHARE = 0.1  # of a frame's uncertainty: what its drawing may add
# Pixels over which noise averages away in what is measured, and errors of a drawing do not: radii
# are fitted to the edges of micro-images, contrasts to few pixels a period. Drawings that are ten
# times coarser flip verdicts.
ALIKE = {White.kind: 1000.0}
ALIKE_ELSE = 4.0
COARSEST = 0.02  # of white
DEAREST = 20.0  # s that drawing one frame may take
ON_THIS_MACHINE = ("simulated", "127.0.0.1", "localhost", "[::1]")


@dataclass(frozen=True)
class DrawnEffect:
    """One effect of the light: whether frames hold it, how large it is in ``unit`` and most that
    it changes, of white (None: without bound), and why.
    """

    name: str
    on: bool
    size: float | None
    unit: str
    bound: float | None
    why: str


@dataclass(frozen=True)
class Drawing:
    """How the simulated camera draws a target in some configurations.

    Attributes:
        target: its kind.
        configurations: their numbers; sizes are those of the first.
        tolerance: asked for, root mean square of white.
        path: closed forms, rays or waves.
        why_path: what decided that.
        effects: those that the scene has.
        absent: names of the others.
    """

    target: str
    configurations: tuple[int, ...]
    tolerance: float
    path: str
    why_path: str
    effects: tuple[DrawnEffect, ...]
    absent: tuple[str, ...]


def is_simulated(address: str) -> bool:
    """Whether a device's address leads to a simulator on this machine."""
    return any(word in address for word in ON_THIS_MACHINE)


def drawings(bench: Bench, study: Study) -> tuple[Drawing, ...]:
    """What the simulated camera decides to draw of a study, worked out for the optics and places
    as described; configurations that are drawn alike share an entry.
    """
    found: dict[tuple[object, ...], Drawing] = {}
    for target in (White(), *study.targets):
        for one in study.configurations:
            camera = one.camera(bench.optics)
            scene, _ = next(light_scenes(bench, camera, target, one.distance))
            drawing = _drawing(bench, scene, one.index)
            key = drawing.target, drawing.path, tuple(e.name for e in drawing.effects if e.on)
            known = found.setdefault(key, drawing)
            if known is not drawing:
                alike = (*known.configurations, one.index)
                found[key] = replace(known, configurations=alike)
    return tuple(found.values())


def _drawing(bench: Bench, scene: Scene, index: int) -> Drawing:
    choice, target = chosen(bench, scene), scene.planes[0].target
    path, why = path_of(without(scene, choice.formed), choice.tolerance, choice.formed)
    effects = tuple(
        DrawnEffect(one.name, one.on, _finite(one.size), one.unit, _finite(one.bound), one.why)
        for one in choice.decisions
        if one.size is not None
    )
    absent = tuple(one.name for one in choice.decisions if one.size is None)
    tolerance = drawing_tolerance(bench, target)
    return Drawing(target.kind, (index,), tolerance, path, why, effects, absent)


def _finite(number: float | None) -> float | None:
    return number if number is not None and math.isfinite(number) else None


def light_scenes(
    bench: Bench, camera: Camera, target: Target, distance: float
) -> Iterator[tuple[Scene, float]]:
    """The scenes whose weighted sum is the light of a frame: one for each line of the spectrum.

    Args:
        bench: the bench; its lenses differ as ``workmanship`` states, drawn from its seed.
        camera: the true camera.
        target: what is shown.
        distance: main lens to target, mm.
    """
    described, built = bench.description.simulated.effects, bench.description.workmanship
    scatter = Scatter(
        focal_length=built.microlens_focal_length,
        position=built.microlens_position,
        seed=bench.description.simulated.seed,
        brightness=built.microlens_brightness,
        aperture_decentre=built.aperture_decentre,
    )
    ring, seed = described.second_stop, bench.description.simulated.seed
    columns = Columns(described.column_gain, described.tap_gain, seed=seed)
    for wavelength, weight in lines_of(bench.description.spectrum):
        yield (
            Scene(
                camera,
                (Plane(target, distance),),
                diffraction=None if wavelength is None else Diffraction(wavelength),
                falloff=falloff_of(bench),
                distortion=Distortion(described.distortion) if described.distortion else None,
                scatter=scatter if scatter != Scatter(seed=scatter.seed) else None,
                stray_light=StrayLight(described.stray_light) if described.stray_light else None,
                shading=Shading(described.shading) if described.shading else None,
                halo=Halo(described.halo, described.halo_radius) if described.halo else None,
                gamma=Gamma(described.gamma) if described.gamma != 1 else None,
                second_stop=SecondStop(ring.distance, ring.diameter) if ring else None,
                soft_rims=SoftRims(described.soft_rims) if described.soft_rims else None,
                columns=columns if columns.column or columns.tap else None,
            ),
            weight,
        )


def falloff_of(bench: Bench) -> Falloff | None:
    """Natural fall-off, where the bench file has the simulated light fall off."""
    return Falloff() if bench.description.simulated.effects.falloff else None


def drawing_tolerance(bench: Bench, target: Target) -> float:
    """How finely a frame is drawn: a tenth of what its noise, averaged over the pixels that share
    an error of the drawing, and the ``measurement_floor`` leave unsure; of white, root mean square.

    The noise is that of a full well, the least that a frame has: sqrt(N + r^2) / N for N electrons
    and a read noise r. A radius that is off by u changes a micro-image of radius R by u / R.
    """
    if (stated := bench.description.simulated.effects.tolerance) is not None:
        return max(stated, LEAST_TOLERANCE)
    light, floor = bench.description.simulated, bench.description.measurement_floor
    well = light.full_well_electrons
    noise = math.hypot(math.sqrt(well), light.read_noise_electrons) / well
    array, sensor = bench.optics.array, bench.optics.sensor
    radius = min(array.pitch) / 2 / sensor.pixel
    unsure = floor.radius / radius if isinstance(target, White) else floor.contrast
    alike = ALIKE.get(target.kind, ALIKE_ELSE)
    tolerance = SHARE * math.hypot(noise / math.sqrt(alike), unsure)
    return min(max(tolerance, LEAST_TOLERANCE), COARSEST)


def chosen(bench: Bench, scene: Scene) -> Choice:
    """Which effects a frame of this scene holds, and why.

    Raises:
        InputError: ``simulated.effects.choose`` names an effect that there is not.
    """
    tolerance = drawing_tolerance(bench, scene.planes[0].target)
    try:
        return choose(scene, tolerance, bench.description.simulated.effects.choose)
    except InputError as error:
        raise InputError(f"{bench.where('simulated', 'effects', 'choose')}: {error}") from error


def require_affordable(parts: Sequence[tuple[Scene, Choice]]) -> None:
    """Refuse a frame that would take too long to draw.

    Args:
        parts: the scenes that are drawn for it, one for each line of the spectrum, as chosen.

    Raises:
        InputError: with the predicted time.
    """
    seconds = sum(predicted_seconds(one, choice.tolerance, choice.formed) for one, choice in parts)
    if seconds > DEAREST:
        gap = parts[0][0].camera.optical_gap
        raise InputError(
            f"camera: drawing this frame would take about {seconds:.0f} s, and frames of up to"
            f" {DEAREST:g} s are drawn; each pixel sees many micro-images where the sensor is far"
            f" behind the array ({gap:.3g} mm), and each line of the spectrum is drawn by itself:"
            " bring the sensor nearer, close the iris, or state fewer lines or pixels"
        )
