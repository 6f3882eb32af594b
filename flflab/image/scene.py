"""What a picture is formed of: a camera, the flat targets before it, and what is not ideal about
either.
"""

import math
from dataclasses import dataclass, fields, replace

from flflab.errors import InputError
from flflab.image.effects.colour_filter import ColourFilter
from flflab.image.effects.columns import Columns
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.gamma import Gamma
from flflab.image.effects.halo import Halo
from flflab.image.effects.motion import Motion
from flflab.image.effects.scatter import Scatter
from flflab.image.effects.second_stop import SecondStop
from flflab.image.effects.shading import Shading
from flflab.image.effects.soft_rims import SoftRims
from flflab.image.effects.spherical_aberration import SphericalAberration
from flflab.image.effects.stray_light import StrayLight
from flflab.optics.camera import Camera
from flflab.targets import BarsAlongY, Target

FARTHEST = 1e12  # mm; from there on numbers only overflow
STEEPEST = 0.5  # slope of a target's plane
QUARTER = math.pi / 2


@dataclass(frozen=True)
class Plane:
    """A flat target before the camera.

    Attributes:
        target: what is on it; bars along y become bars, rolled by a quarter turn.
        distance: main lens to the place where the plane meets the axis, mm; infinity allowed.
        offset: where the target's centre stands, world (x, y) mm; without meaning at infinity.
        roll: the target's x axis turned from the world's towards its y axis, rad.
        tilt: slopes along the world's (x, y) round the target's centre, which stays at
            ``distance``: the place of the plane that lies (u, v) further along (x, y) lies tilt_x u
            + tilt_y v further from the main lens. The target, rolled, is turned into this plane by
            the shortest way, rigidly: lengths on it stay, and seen along the axis it is
            foreshortened.
        size: width and height in mm of the opaque card that carries the target, along the target's
            own axes; None for a boundless one.
    """

    target: Target
    distance: float
    offset: tuple[float, float] = (0.0, 0.0)
    roll: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    size: tuple[float, float] | None = None

    @property
    def askew(self) -> float:
        """The roll beyond quarter turns, rad."""
        return math.remainder(self.roll, QUARTER)

    def __post_init__(self) -> None:
        """Refuse what no plane can be.

        Raises:
            InputError: a number is not finite or outside what is allowed, or a tilt or a card at
                infinity.
        """
        if isinstance(self.target, BarsAlongY):
            object.__setattr__(self, "target", self.target.unturned)
            object.__setattr__(self, "roll", self.roll + QUARTER)
        if not (0 < self.distance <= FARTHEST or self.distance == math.inf):
            raise InputError(
                f"scene: the target's distance is {self.distance:g} mm; above 0, in front of the"
                f" main lens, up to {FARTHEST:g} mm is allowed, or infinity"
            )
        if not all(math.isfinite(part) for part in (*self.offset, self.roll)):
            raise InputError(
                f"scene: offset is {self.offset} mm and roll {self.roll:g} rad; finite numbers"
                " are due"
            )
        if not math.hypot(*self.tilt) <= STEEPEST:
            raise InputError(
                f"scene: the target's tilt is {self.tilt}; slopes of together at most {STEEPEST:g}"
                " are allowed"
            )
        if self.size is not None and not all(
            math.isfinite(side) and side > 0 for side in self.size
        ):
            raise InputError(
                f"scene: a card's size is {self.size} mm; width and height above 0 are due"
            )
        if math.isinf(self.distance) and (any(self.tilt) or self.size is not None):
            raise InputError(
                "scene: a target at infinity has neither tilt nor size; leave them out"
            )


@dataclass(frozen=True)
class Scene:
    """A camera before its targets; what is None is ideal.

    Attributes:
        camera: the camera, its misalignment included.
        planes: the targets; the nearest stands first, and only the last may be boundless.
        diffraction: the light's wavelength.
        falloff: natural fall-off.
        distortion: of the main lens.
        scatter: of the microlenses.
        motion: of the targets during the exposure.
        spherical_aberration: of the microlenses.
        second_stop: a ring behind the main lens. It and those that follow change the finished
            picture, in this order.
        soft_rims: of the micro-images.
        shading: of the main lens, towards the corners.
        halo: of every point of light.
        stray_light: veiling glare.
        colour_filter: the sensor's mosaic.
        columns: gains of the sensor's columns and taps.
        gamma: of the sensor.
    """

    camera: Camera
    planes: tuple[Plane, ...]
    diffraction: Diffraction | None = None
    falloff: Falloff | None = None
    distortion: Distortion | None = None
    scatter: Scatter | None = None
    motion: Motion | None = None
    spherical_aberration: SphericalAberration | None = None
    second_stop: SecondStop | None = None
    soft_rims: SoftRims | None = None
    shading: Shading | None = None
    halo: Halo | None = None
    stray_light: StrayLight | None = None
    colour_filter: ColourFilter | None = None
    columns: Columns | None = None
    gamma: Gamma | None = None

    def __post_init__(self) -> None:
        """Refuse what is no scene.

        Raises:
            InputError: no target, targets not in the order of their distances, or a boundless one
                before another.
        """
        if not self.planes:
            raise InputError("scene: there is no target; give at least one plane")
        for near, far in zip(self.planes, self.planes[1:], strict=False):
            if near.distance >= far.distance:
                raise InputError(
                    f"scene: a target at {near.distance:g} mm stands before one at {far.distance:g}"
                    " mm in the list; the nearest comes first"
                )
            if near.size is None:
                raise InputError(
                    f"scene: the boundless target at {near.distance:g} mm hides all behind it; give"
                    " it a size"
                )


DESCRIBED = tuple(one.name.replace("_", "-") for one in fields(Scene)[2:])  # None is ideal
FINISHING = DESCRIBED[DESCRIBED.index("second-stop") :]  # they change the finished picture
ALL = frozenset(
    ("defocus", "vignetting", "overlap", "pixel", "misalignment", *DESCRIBED)
)  # effects of the light, the noise not among them


def one_plane(
    camera: Camera, target: Target, distance: float, offset: tuple[float, float] = (0.0, 0.0)
) -> Scene:
    """The plain scene: one flat target at a distance (mm), its centre off the axis by ``offset``
    (mm).
    """
    return Scene(camera, (Plane(target, distance, offset),))


def in_light(scene: Scene, wavelength: float | None) -> Scene:
    """The scene in light of a wavelength (mm), which bends; None: rays."""
    return replace(scene, diffraction=None if wavelength is None else Diffraction(wavelength))


def without(scene: Scene, effects: frozenset[str]) -> Scene:
    """The scene in which what is not among ``effects`` is ideal.

    Without ``misalignment`` the array has no offset, roll and tilt, the sensor no offset, and no
    target tilt, or roll beyond quarter turns; a target's offset is where it stands and stays.

    Raises:
        InputError: there is no effect of that name.
    """
    for name in sorted(effects - ALL):
        raise InputError(f"effects: there is no '{name}'; allowed: {', '.join(sorted(ALL))}")
    ideal = replace(
        scene, **{name.replace("-", "_"): None for name in DESCRIBED if name not in effects}
    )
    if "misalignment" in effects:
        return ideal
    camera = scene.camera
    array = replace(camera.array, offset=(0.0, 0.0), roll=0.0, tilt=(0.0, 0.0))
    camera = replace(camera, array=array, sensor=replace(camera.sensor, offset=(0.0, 0.0)))
    return replace(
        ideal,
        camera=camera,
        planes=tuple(
            replace(plane, roll=plane.roll - plane.askew, tilt=(0.0, 0.0)) for plane in scene.planes
        ),
    )
