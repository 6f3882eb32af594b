"""What differs from one microlens type to the next: where each is sharp, how wide its micro-images
are. Lengths in mm.
"""

import math
from dataclasses import dataclass

import numpy as np

from flflab.optics.camera import Camera
from flflab.optics.focus import Interval, depth_of_field, sharp_vergence
from flflab.optics.resolution import central_smms
from flflab.optics.smms import Smms


@dataclass(frozen=True)
class TypeSolution:
    """One microlens type.

    Attributes:
        focal_length: of the type, mm.
        arrangement: keplerian, galilean or afocal.
        kappa: slope of the sensor position over the position on the microlens.
        sharp_distance: target distance in focus; infinite at infinity, None where no real target
            is.
        depth_of_field: (near, far) intervals of target distance; far may be infinite.
        inside_radius: half width of the bright field on the sensor.
        outside_radius: half width of the total field on the sensor.
    """

    focal_length: float
    arrangement: str
    kappa: float
    sharp_distance: float | None
    depth_of_field: tuple[Interval, ...]
    inside_radius: float
    outside_radius: float


def arrangement_of(gap: float, focal: float) -> str:
    """keplerian where the gap exceeds the focal length, galilean where it falls short of it, afocal
    where they are equal.
    """
    return "keplerian" if gap > focal > 0 else "afocal" if gap == focal else "galilean"


def type_smms(camera: Camera) -> list[Smms]:
    """One central system a microlens type, fields of shape ()."""
    central = central_smms(camera)
    fields = {name: getattr(central, name) for name in Smms.__dataclass_fields__}
    return [Smms(**{**fields, "focal": np.asarray(focal)}) for focal in camera.array.focal_lengths]


def sharp_distance(smms: Smms) -> float | None:
    """Target distance in focus of one system; infinite at infinity, None where no real target
    is.
    """
    sharp = float(sharp_vergence(smms))
    return math.inf if sharp == 0 else 1 / sharp if sharp > 0 and math.isfinite(sharp) else None


def as_distances(vergences: list[Interval]) -> tuple[Interval, ...]:
    """Vergence intervals as (near, far) target distances, rising."""
    return tuple(
        (1 / high if math.isfinite(high) else 0.0, 1 / low if low > 0 else math.inf)
        for low, high in reversed(vergences)
        if high > 0
    )


def solve_types(camera: Camera) -> tuple[TypeSolution, ...]:
    """Every microlens type at the array's middle."""
    return tuple(
        TypeSolution(
            focal_length=float(smms.focal),
            arrangement=arrangement_of(camera.optical_gap, float(smms.focal)),
            kappa=float(smms.kappa),
            sharp_distance=sharp_distance(smms),
            depth_of_field=as_distances(depth_of_field(smms, camera.sensor.pixel)),
            inside_radius=float(smms.inside_radius),
            outside_radius=float(smms.outside_radius),
        )
        for smms in type_smms(camera)
    )
