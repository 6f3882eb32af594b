"""A ``model_uncertainty`` for a bench whose camera file tells of what glass its microlenses are: by
how much first order differs from exact rays in the settings of a study.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from flflab.accuracy.lenses import MAIN_LENSES, plano_convex_microlens
from flflab.accuracy.model import compare, through
from flflab.accuracy.thick import Lens, scaled
from flflab.accuracy.thick_camera import Setting, ThickCamera, build
from flflab.description import load
from flflab.files.camera import CameraDescription
from flflab.optics.camera import Camera
from flflab.optics.focus import blur, microlens_limits, virtual_depth
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]

LIKE = ("double Gauss", "achromat")  # main lenses that benches have; a camera file names none
FIELDS = 5  # microlenses from near the axis to the edge of the sensor
OF_NYQUIST = (0.1, 0.3, 0.5)  # frequencies on the sensor at which contrast is compared
ACROSS = np.cos(np.pi * (np.arange(24) + 0.5) / 24)  # of the limiting stop, where rays go
STEP = 1e-4  # of the vergence, for a derivative


@dataclass(frozen=True)
class Proposal:
    """Standard uncertainties of a first-order model, as shares: what a bench file states as
    ``model_uncertainty``, for a main lens like ``lens``.
    """

    lens: str
    contrast: float
    widths: float
    pitch: float
    distance: float

    @property
    def shares(self) -> dict[str, float]:
        """By the bench file's names, as numbers of two digits."""
        shares = {
            "contrast": self.contrast, "widths": self.widths, "pitch": self.pitch,
            "distance": self.distance,
        }  # fmt: skip
        return {name: float(f"{value:.1e}") for name, value in shares.items()}


def glass_of(file: Path) -> Lens | None:
    """The microlens that a camera file describes by radius and index; None where it does not."""
    described = load(file, CameraDescription)
    array = described.microlens_array
    if array.radius_of_curvature is None or array.refractive_index is None:
        return None
    gap = described.sensor.distance - array.distance
    plate = gap / 2 if array.substrate is None else array.substrate.thickness
    return plano_convex_microlens(array.radius_of_curvature, array.refractive_index, plate)


def proposals(microlens: Lens, settings: Iterable[tuple[Camera, float]]) -> tuple[Proposal, ...]:
    """What exact rays propose, once for each kind of main lens in ``LIKE``.

    Args:
        microlens: of the array.
        settings: cameras and distances of their targets, mm.
    """
    used = list(settings)
    found = []
    for lens in LIKE:
        shares = np.concatenate([_shares(lens, microlens, *one) for one in used], axis=1)
        found.append(Proposal(lens, *np.sqrt(np.nanmean(shares**2, axis=1)).tolist()))
    return tuple(found)


def _shares(lens: str, microlens: Lens, camera: Camera, distance: float) -> Array:
    """By which share exact rays differ from the model in contrast, widths, pitch and distance at
    each field, shape (4, fields).
    """
    sensor, middle = camera.sensor, central_smms(camera)
    half = sensor.pixel * max(sensor.resolution) / 2 / float(middle.image_scale)
    setting = Setting(
        scaled(MAIN_LENSES[lens], camera.main_lens.focal_length),
        camera.main_lens.f_number, np.linspace(0.1, 0.9, FIELDS) * half,
        camera.array.distance, float(middle.gap), camera.array.aperture, distance, microlens,
    )  # fmt: skip
    found, thick = compare(setting), build(setting)
    width = found["outside radius"]
    centre = found["micro-image centre"]
    depth = found["virtual depth"]
    shares = np.stack(
        [
            np.zeros(FIELDS),
            width.exact / width.model - 1,
            centre.exact / centre.model - 1,
            (depth.exact - depth.model) / _steepness(thick),
        ]
    )
    shares[0] = _contrast(thick, sensor.pixel)
    return shares


def _contrast(camera: ThickCamera, pixel: float) -> Array:
    """Root mean square over ``OF_NYQUIST`` by which rays leave a point another contrast than the
    model does, over that of the model, at each field.

    Chebyshev nodes weighted by 1 - u^2 are a round stop's chords.
    """
    smms = camera.smms
    point = -smms.centre_x / (smms.distance * camera.vergence)
    limits = microlens_limits(smms, camera.vergence)
    landing = np.array([through(camera, limits, share, o=point)[0] for share in ACROSS])
    model = ACROSS[:, None] * blur(smms, camera.vergence) / 2
    weight = (1 - ACROSS**2) / np.sum(1 - ACROSS**2)
    waves = [np.pi * share / pixel for share in OF_NYQUIST]
    exact, first = (
        np.abs([weight @ np.exp(1j * wave * s) for wave in waves]) for s in (landing, model)
    )
    return np.sqrt(np.mean((exact - first) ** 2, axis=0) / np.mean(first**2, axis=0))


def _steepness(camera: ThickCamera) -> Array:
    """By how much the virtual depth changes with a share of the target's distance."""
    near, far = (virtual_depth(camera.smms, camera.vergence * (1 + step)) for step in (STEP, -STEP))
    return (far - near) / (2 * STEP)
