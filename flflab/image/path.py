"""Which of the two paths forms a scene: closed forms for one flat target that its maps leave
upright, else blocks of rays; and the picture by it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.accuracy import MISFIT, OFF_BY_MOTION, TOLERANCE
from flflab.image.coarse import add_coarsely, step_of
from flflab.image.fast.form import Upright, add_upright, upright
from flflab.image.general.form import Pilot, add_rays, blocks_of, pilot
from flflab.image.general.maps import misfit
from flflab.image.landing import linearised
from flflab.image.microlenses import Lenses, camera_lenses, is_lit
from flflab.image.scene import ALL, Plane, Scene
from flflab.image.waves import add_with_waves
from flflab.targets import Bars, Black, FourDot, Picture, White

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Light:
    """The light of a scene before what multiplies or blurs a finished picture.

    Attributes:
        image: of white, [row, column].
        path: how it was formed: closed forms, rays or waves.
        why: what decided that.
        pilot: what the pilot of the rays found.
    """

    image: Array
    path: str
    why: str
    pilot: Pilot | None = None


def form(scene: Scene, tolerance: float, effects: frozenset[str]) -> Light:
    """Form the light of a scene.

    Args:
        scene: what is pictured; what is None is ideal.
        tolerance: root mean square of the error over lit pixels, of white.
        effects: the effects of the light that are formed.

    Raises:
        InputError: a distortion or tilt that no picture shows, or waves where only rays can be
            formed.
    """
    columns, rows = scene.camera.sensor.resolution
    image = np.zeros((rows, columns))
    ready = prepare(scene, tolerance, effects)
    pixel = scene.camera.sensor.pixel if "pixel" in effects else 0.0
    found, made = None, ready.made
    if ready.path == "rays" and scene.diffraction is not None:
        raise InputError(
            f"render: light of one wavelength is formed for one upright target, and {ready.why};"
            " leave the wavelength out"
        )
    if ready.path == "rays":
        blocks = blocks_of(scene, ready.lenses, defocus="defocus" in effects, pixel=pixel)
        found = pilot(blocks, tolerance)
        add_rays(image, blocks, found.side)
    elif made is not None and ready.path == "waves" and scene.diffraction is not None:
        _add_waves(image, scene, made, scene.diffraction.wavelength, pixel)
    elif made is not None:
        step = step_of(made, scene.camera.sensor.pixel, tolerance) if "overlap" in effects else 1
        if step > 1:
            add_coarsely(image, scene, made, step)
        else:
            add_upright(image, scene, made)
    return Light(image, ready.path, ready.why, found)


@dataclass(frozen=True)
class Ready:
    """A scene before it is formed.

    Attributes:
        path: closed forms, rays or waves.
        why: what decides that.
        lenses: the microlenses that light the sensor, for the distance of each target; none where
            the picture is dark.
        made: its target for closed forms; None where rays are due or the picture is dark.
    """

    path: str
    why: str
    lenses: tuple[Lenses, ...] = ()
    made: Upright | None = None


def prepare(scene: Scene, tolerance: float, effects: frozenset[str] = ALL) -> Ready:
    """What is known of a scene before a pixel of it is formed; raises as ``form``."""
    if all(_is_dark(plane, scene) for plane in scene.planes):
        return Ready("closed forms", "nothing shines")
    lenses = _lenses(scene, "overlap" in effects, "vignetting" in effects)
    if not len(lenses[0]):
        return Ready("closed forms", "no light meets the sensor")
    pixel = scene.camera.sensor.pixel if "pixel" in effects else 0.0
    made, why = _upright(scene, lenses, tolerance, defocus="defocus" in effects, pixel=pixel)
    if made is None or scene.diffraction is None:
        return Ready("rays" if made is None else "closed forms", why, lenses, made)
    if isinstance(made.target, White):
        return Ready("closed forms", "white does not bend", lenses, made)
    return Ready("waves", "light of one wavelength", lenses, made)


def path_of(scene: Scene, tolerance: float, effects: frozenset[str] = ALL) -> tuple[str, str]:
    """By which path a scene is formed with these effects: closed forms, waves or rays; and why."""
    ready = prepare(scene, tolerance, effects)
    return ready.path, ready.why


def _is_dark(plane: Plane, scene: Scene) -> bool:
    """Whether no light comes from a target that hides none either."""
    a_point = math.isinf(plane.distance) and isinstance(plane.target, FourDot | Bars | Picture)
    return a_point or (isinstance(plane.target, Black) and len(scene.planes) == 1)


def _lenses(scene: Scene, overlap: bool, vignetting: bool) -> tuple[Lenses, ...]:
    """The microlenses that light the sensor, for the distance of each target."""
    found = [
        camera_lenses(scene.camera, 1 / plane.distance, scene.scatter, overlap)
        for plane in scene.planes
    ]
    seen = is_lit(found[0])
    kept = tuple(lenses[seen] for lenses in found)
    if not vignetting:
        for lenses in kept:
            lenses["slope"] = 0.0
    return kept


def _upright(
    scene: Scene, lenses: tuple[Lenses, ...], tolerance: float, *, defocus: bool, pixel: float
) -> tuple[Upright | None, str]:
    """The scene's target for closed forms, or None, and why."""
    plane = scene.planes[0]
    if len(scene.planes) > 1 or plane.size is not None:
        return None, "a card hides what is behind it"
    linearised(lenses[0], plane, scene.distortion)  # or refuses
    if isinstance(plane.target, White):
        flat = replace(plane, tilt=(0.0, 0.0), roll=0.0)
        even = replace(scene, planes=(flat,), distortion=None, motion=None)
        made = upright(even, flat, lenses[0], tolerance, defocus=defocus, pixel=pixel)
        return made, "white is alike wherever rays end"
    if isinstance(plane.target, Picture):
        return None, "the target is a texture"
    if scene.spherical_aberration is not None:
        return None, "rays through a microlens's rim land aside"
    made = upright(scene, plane, lenses[0], tolerance, defocus=defocus, pixel=pixel)
    off = misfit(scene, plane, lenses[0], made.lines)
    if off > MISFIT * tolerance:
        return None, f"tilt and distortion move rays by {off:.2g} of an edge's width"
    way = moved(scene, made)
    if (1.0 if isinstance(plane.target, FourDot) else OFF_BY_MOTION) * way**2 > tolerance:
        return None, f"the target moves by {way:.2g} of an edge's width"
    return made, "one upright target"


def moved(scene: Scene, made: Upright) -> float:
    """How far a target moves during the exposure, over the least width to which pixel and pupil
    blur a point of it.
    """
    if scene.motion is None or math.isinf(scene.planes[0].distance):
        return 0.0
    way = math.hypot(*scene.motion.drift) + 2 * math.hypot(*scene.motion.vibration)
    blur = np.hypot(made.lines["sensor"] * scene.camera.sensor.pixel, made.lines["pupil"])
    return way / max(float(blur.min()), 1e-300)


def _add_waves(image: Array, scene: Scene, made: Upright, wavelength: float, pixel: float) -> None:
    """Add the light of one wavelength. Fall-off dims it as it dims white, and moves light within a
    blur as it does without waves.
    """
    add_with_waves(image, scene, made, wavelength, pixel)
    if scene.falloff is not None:
        plane = Plane(White(), scene.planes[0].distance)
        white = upright(scene, plane, made.lenses, TOLERANCE, defocus=True, pixel=pixel)
        bright, dimmed = _even_and_weighted(scene, white)
        kept = np.where(bright > 0, dimmed / np.where(bright > 0, bright, 1.0), 1.0)
        even, weighted = _even_and_weighted(scene, made)
        image *= kept
        image += weighted - kept * even


def _even_and_weighted(scene: Scene, made: Upright) -> tuple[Array, Array]:
    """The light of rays without fall-off and with it."""
    columns, rows = scene.camera.sensor.resolution
    even, weighted = np.zeros((rows, columns)), np.zeros((rows, columns))
    add_upright(even, scene, replace(made, how=tuple(h._replace(weighted=False) for h in made.how)))
    add_upright(weighted, scene, made)
    return even, weighted
