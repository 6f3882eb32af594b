"""How well a white picture tells the lattice of micro-images, f-number by f-number: stated,
achieved, and what is left without noise.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.accuracy.measure import NOISE, WHITE_DN
from flflab.errors import MeasurementError
from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.nominal import nominal_lattice
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.optics.camera import Camera
from flflab.targets import White

Array = npt.NDArray[np.float64]

F_NUMBERS = (1.6, 2.8, 4.0, 8.0, 16.0)
FRAMES = 4
TOLERANCE = 3e-5
AWAY = 10.0  # focal lengths of the main lens from it to the target: white is white at any distance


@dataclass(frozen=True)
class Row:
    """The lattice at one f-number; lengths in pixels, pitches relative; errors are against the
    camera's own lattice.

    Attributes:
        f_number: of the main lens.
        micro_images: measured.
        bias_px: how far the worst of all centres is off without noise.
        pitch_bias: error of the pitch without noise.
        origin_px: stated standard uncertainty of the origin, the larger coordinate.
        origin_error_px: achieved, root mean square of both coordinates.
        pitch: stated standard uncertainty.
        pitch_error: achieved, root mean square.
        centres_error_px: of all centres in a coordinate, root mean square.
        frames: with noise of their own.
    """

    f_number: float
    micro_images: int
    bias_px: float
    pitch_bias: float
    origin_px: float
    origin_error_px: float
    pitch: float
    pitch_error: float
    centres_error_px: float
    frames: int


def lattice_rows(camera: Camera, tell: Callable[[str], None]) -> tuple[Row, ...]:
    """One row an f-number at which the camera's white picture shows a lattice.

    Args:
        camera: whose lattice is asked for; its array of one kind of microlenses.
        tell: is told what is being done.

    Raises:
        MeasurementError: at no f-number is there a lattice to be seen.
    """
    rows, reasons = list[Row](), list[MeasurementError]()
    for f_number in F_NUMBERS:
        tell(f"white at F/{f_number:g}")
        try:
            rows.append(
                _row(replace(camera, main_lens=replace(camera.main_lens, f_number=f_number)))
            )
        except MeasurementError as error:
            reasons.append(error)
    if not rows:
        raise reasons[0]
    return tuple(rows)


def _row(camera: Camera) -> Row:
    scene = replace(
        one_plane(camera, White(), AWAY * camera.main_lens.focal_length), falloff=Falloff()
    )
    image = np.maximum(render(scene, tolerance=TOLERANCE), 0.0)
    clean = (
        NOISE.offset_dn + WHITE_DN / max(float(image.max()), 1e-300) * image
    )  # neighbours add: the brightest pixel is white
    due, spread = nominal_lattice(camera, WHITE_DN), np.sqrt(NOISE.variance(clean))
    still = lattice_behind(camera, clean.astype(np.float32), NOISE)
    noisy = list[Lattice]()
    for seed in range(FRAMES):
        drawn = np.random.default_rng(seed).standard_normal(clean.shape, dtype=np.float32)
        noisy.append(lattice_behind(camera, (clean + drawn * spread).astype(np.float32), NOISE))
    pitches = np.array([one.pitch_px / due.pitch_px - 1 for one in noisy])
    origins = np.concatenate([_errors(one.origin_px[None], due) for one in noisy])
    return Row(
        f_number=camera.main_lens.f_number,
        micro_images=len(still.centres_px),
        bias_px=float(np.hypot(*_errors(still.centres_px, due).T).max()),
        pitch_bias=still.pitch_px / due.pitch_px - 1,
        origin_px=_rms(np.array([one.origin_uncertainty_px.max() for one in noisy])),
        origin_error_px=_rms(origins),
        pitch=_rms(np.array([one.pitch_uncertainty_px / one.pitch_px for one in noisy])),
        pitch_error=_rms(pitches),
        centres_error_px=_rms(np.concatenate([_errors(one.centres_px, due) for one in noisy])),
        frames=FRAMES,
    )


def _errors(centres: Array, due: Lattice) -> Array:
    """How far centres are off from those that are due nearest to them, px, shape (n, 2)."""
    steps = np.rint((centres - due.origin_px) @ np.linalg.inv(due.vectors_px).T)
    return centres - due.origin_px - steps @ due.vectors_px.T


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
