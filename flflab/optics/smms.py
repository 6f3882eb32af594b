"""One main lens - microlens system (SMMS): vignetting on the sensor and where its rays go.

A ray is (m, q): where it crosses the main lens and the microlens plane. All functions take arrays
and broadcast; lengths in mm, vergences in 1/mm. Source: paper, "Chief rays and useful chief rays",
Figs. 2 to 4.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.optics.camera import Camera, microlens_centres, microlens_types

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Smms:
    """Main lens - microlens systems; every field broadcasts to the same shape (one number an SMMS).

    Attributes:
        lens_focal: focal length of the main lens, mm.
        lens_aperture: diameter of the main lens's stop, mm.
        distance: main lens to this microlens, mm.
        gap: this microlens to the sensor, mm.
        focal: focal length of this microlens, mm.
        aperture: clear aperture of this microlens, mm.
        centre_x: centre of this microlens, mm.
        centre_y: centre of this microlens, mm.
    """

    lens_focal: Array
    lens_aperture: Array
    distance: Array
    gap: Array
    focal: Array
    aperture: Array
    centre_x: Array
    centre_y: Array

    @property
    def kappa(self) -> Array:
        """Slope of the sensor position over the position on the microlens: 1 + b/L - b/f; 0 in the
        exit pupil.
        """
        return 1 + self.gap / self.distance - self.gap / self.focal

    @property
    def lens_width(self) -> Array:
        """Width A b/L of the main lens's shadow on the sensor, mm (w_m)."""
        return self.lens_aperture * self.gap / self.distance

    @property
    def microlens_width(self) -> Array:
        """Width d |kappa| of the microlens's shadow on the sensor, mm (w_q)."""
        return self.aperture * np.abs(self.kappa)

    @property
    def limiting_radius(self) -> Array:
        """Radius g = min(d, A b / (L |kappa|)) / 2 in the microlens plane of the cone that lights a
        micro-image's centre, mm.
        """
        with np.errstate(divide="ignore"):
            return np.minimum(self.aperture, self.lens_width / np.abs(self.kappa)) / 2

    @property
    def outside_radius(self) -> Array:
        """Half width of the total field on the sensor, mm: no light beyond."""
        return (self.lens_width + self.microlens_width) / 2

    @property
    def inside_radius(self) -> Array:
        """Half width of the bright field on the sensor, mm: full light within."""
        return np.abs(self.lens_width - self.microlens_width) / 2

    @property
    def image_scale(self) -> Array:
        """Micro-image centre over microlens centre: 1 + b/L."""
        return 1 + self.gap / self.distance


def camera_smms(camera: Camera) -> Smms:
    """The SMMS of every microlens of a camera, row by row, each field of shape (N,); a tilted array
    gives each its own L and b.

    Raises:
        InputError: the array is tilted so far that a microlens would lie behind the sensor or
            before the main lens.
    """
    centres = microlens_centres(camera.array)
    rise = centres @ np.asarray(camera.array.tilt)
    if rise.max() >= camera.optical_gap or -rise.min() >= camera.optical_distance:
        worst = max(float(rise.max()), -float(rise.min()))
        raise InputError(
            f"camera: microlens_array.tilt is {camera.array.tilt} and moves an outer microlens by"
            f" {worst:g} mm along the axis; less than the {camera.optical_gap:g} mm to the sensor"
            " is allowed"
        )
    ones = np.ones(len(centres))
    return Smms(
        lens_focal=ones * camera.main_lens.focal_length,
        lens_aperture=ones * camera.main_lens.aperture,
        distance=camera.optical_distance + rise,
        gap=camera.optical_gap - rise,
        focal=np.asarray(camera.array.focal_lengths)[microlens_types(camera.array)],
        aperture=ones * camera.array.aperture,
        centre_x=centres[:, 0],
        centre_y=centres[:, 1],
    )


def sensor_crossing(smms: Smms, m: Array, q: Array, centre: Array) -> Array:
    """Where the ray (m, q) meets the sensor, mm: s = kappa q - (b/L) m + (b/f) y."""
    return smms.kappa * q - smms.gap / smms.distance * m + smms.gap / smms.focal * centre


def object_crossing(smms: Smms, m: Array, q: Array, vergence: Array) -> Array:
    """Where the ray (m, q) meets the object plane, times the vergence: o V = m W - q/L (an angle
    for an object at infinity).

    Args:
        smms: the systems.
        m: crossing of the main lens, mm.
        q: crossing of the microlens plane, mm.
        vergence: V = 1/D of the object plane, 1/mm.
    """
    return m * array_vergence(smms, vergence) - q / smms.distance


def array_vergence(smms: Smms, vergence: Array | float) -> Array:
    """W = V - 1/F + 1/L, 1/mm: 0 where the target's image lies on the array."""
    return vergence - 1 / smms.lens_focal + 1 / smms.distance


def image_offset(smms: Smms, vergence: Array | float) -> Array:
    """x = L W = -a/D': where the main lens's image lies against the array; negative Keplerian, from
    0 to 1 Galilean.
    """
    return smms.distance * array_vergence(smms, vergence)


def row_illumination(smms: Smms, offset: Array) -> Array:
    """Relative illumination of slit apertures at ``offset`` mm from the micro-image's centre: 1
    inside, linear to 0 outside.
    """
    limit = np.minimum(smms.lens_width, smms.microlens_width)
    with np.errstate(divide="ignore", invalid="ignore"):
        ramp = (smms.outside_radius - np.abs(offset)) / limit
    return np.where(
        np.abs(offset) <= smms.inside_radius,
        1.0,
        np.where(limit > 0, np.clip(np.nan_to_num(ramp), 0.0, 1.0), 0.0),
    )
