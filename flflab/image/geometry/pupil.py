"""The pupil of every microlens as seen from its micro-image: which part of it sends light to a
sensor point, and from where.

Pupil points are t in the unit disc of the narrower aperture (the microlens where d |kappa| <= A
b/L, else the main lens). From a sensor point at e from the micro-image's centre the other aperture
lets through |slope t - e| <= reach, and the ray meets the object plane, in angle, at o V = spread t
+ scale e + direction. Source: physics.md, "Exact image of a flat target".
"""

from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from flflab.image.effects.scatter import Scatter
from flflab.optics.camera import Camera
from flflab.optics.smms import Smms, array_vergence, camera_smms

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Pupils:
    """One entry a microlens, shape (N,).

    Attributes:
        centre_x: centre of the micro-image on the sensor, mm.
        centre_y: the same along y.
        slope: mm on the sensor per unit of pupil, signed.
        reach: radius on the sensor of the wider aperture's shadow, mm.
        lens_spread: where the ray crosses the main lens, mm per unit of pupil.
        lens_scale: the same per mm on the sensor.
        spread: angle on the object side per unit of pupil, rad.
        scale: angle on the object side per mm on the sensor, rad/mm.
        direction_x: object direction of the micro-image's centre through the pupil's centre, rad.
        direction_y: the same along y.
        level: irradiance at full pupil in units of the white level.
        slant_x: slope at the sensor of the ray through the pupil's centre to the micro-image's
            centre.
        slant_y: the same along y.
        slant_scale: change of a ray's slope at the sensor per mm on the sensor, 1/mm.
        slant_spread: the same per unit of pupil; over the wavelength it is the pupil's half width
            in cycles/mm on the sensor.
    """

    centre_x: Array
    centre_y: Array
    slope: Array
    reach: Array
    lens_spread: Array
    lens_scale: Array
    spread: Array
    scale: Array
    direction_x: Array
    direction_y: Array
    level: Array
    slant_x: Array
    slant_y: Array
    slant_scale: Array
    slant_spread: Array

    @property
    def outside(self) -> Array:
        """Radius of the micro-image, mm: no light beyond."""
        return self.reach + np.abs(self.slope)

    def of(self, entries: npt.NDArray[np.int64]) -> "Pupils":
        """The pupils of these entries, any number of times each."""
        return Pupils(**{field.name: getattr(self, field.name)[entries] for field in fields(self)})


def axis_microlens(smms: Smms) -> int:
    """Index of the microlens nearest the axis, the lower one of equals; its micro-image sets the
    white level.
    """
    squared = smms.centre_x**2 + smms.centre_y**2
    return int(np.flatnonzero(squared <= squared.min() * (1 + 1e-9))[0])


def scattered(smms: Smms, scatter: Scatter) -> Smms:
    """Microlenses with errors of their own.

    The numbers come from Philox with the seed as its key: standard normal ones, three for every
    microlens in the order of the array (focal length, x, y), so that they depend on nothing but the
    seed and the microlens's index.
    """
    draws = np.random.Generator(np.random.Philox(key=scatter.seed)).standard_normal(
        (len(smms.focal), 3)
    )
    return replace(
        smms,
        focal=smms.focal * (1 + scatter.focal_length * draws[:, 0]),
        centre_x=smms.centre_x + scatter.position * draws[:, 1],
        centre_y=smms.centre_y + scatter.position * draws[:, 2],
    )


def camera_pupils(camera: Camera, vergence: float, scatter: Scatter | None = None) -> Pupils:
    """The pupils of all microlenses, row by row, for a target of this vergence (1/mm, 0 at
    infinity).

    The white level is that of the camera without scatter.
    """
    ideal = camera_smms(camera)
    white = axis_microlens(ideal)
    white_level = (ideal.limiting_radius[white] / ideal.gap[white]) ** 2
    smms = ideal if scatter is None else scattered(ideal, scatter)
    ratio = smms.gap / smms.distance
    w = array_vergence(smms, vergence)
    by_microlens = smms.microlens_width <= smms.lens_width
    kappa = np.where(by_microlens, 1.0, smms.kappa)  # not used where it may be 0
    radius = np.where(by_microlens, smms.aperture, smms.lens_aperture) / 2
    return Pupils(
        centre_x=smms.centre_x * smms.image_scale,
        centre_y=smms.centre_y * smms.image_scale,
        slope=radius * np.where(by_microlens, smms.kappa, -ratio),
        reach=np.where(by_microlens, smms.lens_width, smms.microlens_width) / 2,
        lens_spread=radius * np.where(by_microlens, smms.kappa / ratio, 1.0),
        lens_scale=np.where(by_microlens, -1 / ratio, 0.0),
        spread=radius
        * np.where(
            by_microlens,
            smms.kappa * w / ratio - 1 / smms.distance,
            w - ratio / (smms.distance * kappa),
        ),
        scale=np.where(by_microlens, -w / ratio, -1 / (smms.distance * kappa)),
        direction_x=-smms.centre_x / smms.distance,
        direction_y=-smms.centre_y / smms.distance,
        level=(smms.limiting_radius / smms.gap) ** 2 / white_level,
        slant_x=smms.centre_x / smms.distance,
        slant_y=smms.centre_y / smms.distance,
        slant_scale=np.where(by_microlens, 1, 1 - 1 / kappa) / smms.gap,
        slant_spread=-radius * np.where(by_microlens, 1 / smms.gap, 1 / (smms.distance * kappa)),
    )
