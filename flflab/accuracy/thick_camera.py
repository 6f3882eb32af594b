"""A focused light field camera of real lenses: exact rays in its meridional plane, and how to aim
them.

The main lens stands as the model describes it: scaled to the model's focal length, its entrance
pupil F/N wide, the array counted from its rear principal plane and the target from its front one.
The gap counts the microlens's glass plate as thickness over index.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.accuracy.lenses import plano_convex_microlens
from flflab.accuracy.thick import Lens, at_plane, first_order, mirrored, trace
from flflab.optics.focus import sharp_vergence
from flflab.optics.smms import Smms

Array = npt.NDArray[np.float64]

MICROLENS = plano_convex_microlens()
NEWTON_STEPS = 8
SMALL_HEIGHT, SMALL_SLOPE = 1e-5, 1e-6  # steps of the numerical derivatives, mm and 1


@dataclass(frozen=True)
class Setting:
    """Cameras of one main lens; numbers, or arrays that broadcast to one shape.

    Attributes:
        lens: the main lens.
        f_number: focal length over the diameter of the entrance pupil.
        field: distance of the microlens from the axis, mm.
        array: rear principal plane of the main lens to the microlenses, mm.
        gap: microlenses to the sensor, mm.
        aperture: diameter of the microlens, mm.
        distance: target to the front principal plane of the main lens, mm; None puts it in focus by
            the model.
        microlens: its curved side, the stop, towards the main lens.
    """

    lens: Lens
    f_number: npt.ArrayLike
    field: npt.ArrayLike
    array: npt.ArrayLike = 60.0
    gap: npt.ArrayLike = 1.15
    aperture: npt.ArrayLike = 0.336
    distance: npt.ArrayLike | None = None
    microlens: Lens = MICROLENS


@dataclass(frozen=True)
class ThickCamera:
    """A setting made definite: systems and vergences of one shape, and the main lens as light from
    behind meets it.

    Attributes:
        smms: the model's systems.
        vergence: of the target, 1/mm.
        back: the main lens, mirrored.
        to_lens: rear principal plane to the lens's last vertex, mm.
        to_front: last vertex to the front principal plane, towards the target, mm.
        stop_share: height in the stop over height in the entrance pupil.
        microlens: of the array.
    """

    smms: Smms
    vergence: Array
    back: Lens
    to_lens: float
    to_front: float
    stop_share: float
    microlens: Lens


@dataclass(frozen=True)
class Rays:
    """Where rays go.

    Attributes:
        m: height in the stop, in the measure of the entrance pupil: its edge is at A/2, mm.
        q: height on the curved side of the microlens, mm.
        o: height on the target, mm.
        s: height on the sensor, mm.
        angle: in the air before the sensor, rad.
    """

    m: Array
    q: Array
    o: Array
    s: Array
    angle: Array


def build(setting: Setting) -> ThickCamera:
    """Make a setting definite."""
    given = (
        setting.f_number,
        setting.field,
        setting.array,
        setting.gap,
        setting.aperture,
        1.0 if setting.distance is None else setting.distance,
    )
    f_number, field, array, gap, aperture, distance = (
        np.array(part, dtype=float) for part in np.broadcast_arrays(*given)
    )
    known = first_order(setting.lens)
    smms = Smms(
        lens_focal=np.full_like(gap, known.focal_length),
        lens_aperture=known.focal_length / f_number,
        distance=array,
        gap=gap,
        focal=np.full_like(gap, first_order(setting.microlens).focal_length),
        aperture=aperture,
        centre_x=field,
        centre_y=np.zeros_like(gap),
    )
    last = float(setting.lens.vertex[-1])
    vergence = sharp_vergence(smms) if setting.distance is None else 1 / distance
    return ThickCamera(
        smms,
        vergence,
        mirrored(setting.lens),
        last - known.rear,
        last - known.front,
        known.stop_share,
        setting.microlens,
    )


def exact_rays(camera: ThickCamera, centre: Array, q: Array, slope: Array) -> Rays:
    """Trace rays both ways from a height ``q`` on the curved side of the microlens round
    ``centre``, mm, that they meet with ``slope``.
    """
    smms, microlens = camera.smms, camera.microlens
    plate, bend = microlens.gap[0], microlens.curvature[0]
    off, nothing, length = q - centre, np.zeros_like(q), np.hypot(slope, 1.0)
    sag = bend * off**2 / (1 + np.sqrt(1 - (bend * off) ** 2))
    onwards = np.stack([slope, nothing, nothing + 1], axis=-1) / length[..., None]
    met, leaving = trace(microlens, np.stack([off, nothing, sag], axis=-1), onwards)
    landing = at_plane(met[-1], leaving, plate + smms.gap - plate / microlens.index[0])
    before = np.stack([q, nothing, camera.to_lens - smms.distance - sag], axis=-1)
    seen, out = trace(camera.back, before, onwards * np.array([-1.0, 1.0, 1.0]))
    target = at_plane(seen[-1], out, camera.to_front + 1 / camera.vergence)
    return Rays(
        m=seen[camera.back.stop][..., 0] / camera.stop_share,
        q=q,
        o=target[..., 0],
        s=landing[..., 0] + centre,
        angle=np.arctan2(leaving[..., 0], leaving[..., 2]),
    )


def aim(camera: ThickCamera, centre: Array, **wanted: Array) -> Rays:
    """The rays through the microlens round ``centre`` that fulfil two conditions on ``m``, ``q``,
    ``o`` or ``s``, by Newton's method.

    Returns:
        The rays; nan where a ray on the way to them misses a surface.
    """
    q, slope = centre + 0.0, centre / camera.smms.distance
    (first, first_goal), (second, second_goal) = wanted.items()

    def misses(rays: Rays) -> tuple[Array, Array]:
        return getattr(rays, first) - first_goal, getattr(rays, second) - second_goal

    with np.errstate(invalid="ignore"):
        for _ in range(NEWTON_STEPS):
            here = misses(exact_rays(camera, centre, q, slope))
            aside = misses(exact_rays(camera, centre, q + SMALL_HEIGHT, slope))
            turned = misses(exact_rays(camera, centre, q, slope + SMALL_SLOPE))
            a, c = ((there - at) / SMALL_HEIGHT for there, at in zip(aside, here, strict=True))
            b, d = ((there - at) / SMALL_SLOPE for there, at in zip(turned, here, strict=True))
            determinant = a * d - b * c
            q = q - (d * here[0] - b * here[1]) / determinant
            slope = slope - (a * here[1] - c * here[0]) / determinant
        return exact_rays(camera, centre, q, slope)
