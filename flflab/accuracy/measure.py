"""What a measured number's accuracy costs: frames averaged, pixels used, method; on simulated
frames whose truth is in closed form.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.contrast.curve import fit_contrast
from flflab.measurement.edges.edge import fit_edge
from flflab.measurement.edges.profile import edge_profile, pixel_transfer
from flflab.measurement.edges.spread import line_spread
from flflab.measurement.lattice.nominal import nominal_lattice
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.optics.contrast import transfer
from flflab.optics.resolution import central_smms
from flflab.targets import Bars, White

Array = npt.NDArray[np.float64]

NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
WHITE_DN = 3000.0  # 1 % of noise at white
FRAMES = (1, 4, 16, 64)
CAMERA_S = 0.1  # a camera gives a frame in about this time
REPEATS = 6
FOCUS = 506.7016  # mm
RESOLUTIONS = ((760, 520), (1000, 760))
SIDES = (50, 100)  # pixels of a square with an edge in it
EDGE_BLUR, EDGE_ANGLE = 0.7, math.radians(5)
FREQUENCIES = np.linspace(0.02, 0.5, 25)  # cycles/px
CONTRAST, PITCH, EDGE = "contrast of bars", "lattice pitch", "edge transfer"
FIT, CLASSIC, LATTICE, FREE = "chirp fit", "max and min", "micro-images", "free form"


@dataclass(frozen=True)
class Reading:
    """Numbers as measured, their truth, and the standard uncertainties stated for them; nan where
    none is stated.
    """

    values: Array
    truth: Array
    uncertainty: Array


@dataclass(frozen=True)
class Row:
    """One method on one quantity, averaged over frames and repeats.

    Attributes:
        quantity: what was measured.
        method: how.
        pixels: of one frame.
        frames: averaged before measuring.
        repeats: with noise of their own.
        uncertainty: as stated, root mean square; None where none is.
        rms_error: against the truth.
        bias: mean error.
        camera_s: what the camera takes for the frames, 0.1 s each.
        processor_s: of all cores, for measuring once, warm.
    """

    quantity: str
    method: str
    pixels: int
    frames: int
    repeats: int
    uncertainty: float | None
    rms_error: float
    bias: float
    camera_s: float
    processor_s: float

    @property
    def total_s(self) -> float:
        """Camera and processor."""
        return self.camera_s + self.processor_s


@dataclass(frozen=True)
class Case:
    """A picture in DN without noise, and ways to measure it."""

    quantity: str
    picture: Array
    methods: dict[str, Callable[[Array, SensorNoise], Reading]]


def measure_rows(tell: Callable[[str], None]) -> tuple[Row, ...]:
    """Every method on every quantity, below two minutes on two cores.

    Args:
        tell: is told what is being done.
    """
    cases = [
        *(_contrast_case(size) for size in RESOLUTIONS),
        *(_lattice_case(size) for size in RESOLUTIONS),
        *map(_edge_case, SIDES),
    ]
    rows: list[Row] = []
    for case in cases:
        tell(f"{case.quantity}, {case.picture.size} px")
        for method, run in case.methods.items():
            run(case.picture, NOISE)  # compiles
            rows += [_row(case, method, run, frames) for frames in FRAMES]
    return tuple(rows)


def _row(case: Case, method: str, run: Callable[[Array, SensorNoise], Reading], frames: int) -> Row:
    errors, doubts, spent = list[Array](), list[Array](), 0.0
    averaged = SensorNoise(
        NOISE.dn_per_electron / frames,
        NOISE.read_noise_dn / math.sqrt(frames),
        NOISE.offset_dn,
        NOISE.full_scale_dn,
    )
    spread = np.sqrt(NOISE.variance(case.picture) / frames)
    for seed in range(REPEATS):
        noisy = case.picture + spread * np.random.default_rng((seed, frames)).standard_normal(
            case.picture.shape
        )
        began = time.process_time()
        found = run(noisy, averaged)
        spent += (time.process_time() - began) / REPEATS
        errors.append(found.values - found.truth)
        doubts.append(found.uncertainty)
    error, doubt = np.concatenate(errors), np.concatenate(doubts)
    stated = float(np.sqrt(np.mean(doubt**2)))
    return Row(
        quantity=case.quantity,
        method=method,
        pixels=case.picture.size,
        frames=frames,
        repeats=REPEATS,
        uncertainty=stated if math.isfinite(stated) else None,
        rms_error=float(np.sqrt(np.mean(error**2))),
        bias=float(np.mean(error)),
        camera_s=CAMERA_S * frames,
        processor_s=spent,
    )


def _camera(resolution: tuple[int, int]) -> Camera:
    """The camera of the worked example on a smaller sensor."""
    array = MicrolensArray("square", (25, 25), (0.4, 0.4), 0.336, (0.917,), 60.0)
    return Camera(MainLens(50.0, 4.0), array, Sensor(resolution, 0.00166, 61.15))


def _exposed(camera: Camera, target: Bars | White) -> Array:
    return NOISE.offset_dn + WHITE_DN * render(one_plane(camera, target, FOCUS), tolerance=2e-5)


def _contrast_case(resolution: tuple[int, int]) -> Case:
    camera, target = _camera(resolution), Bars()
    lattice, smms = nominal_lattice(camera, WHITE_DN), central_smms(camera)

    def read(picture: Array, noise: SensorNoise, classic: bool) -> Reading:
        curve = fit_contrast(picture, lattice, camera, target, FOCUS, noise)
        if classic:
            # the extremes of bars in focus are 1 up to half a cycle a pixel, eq. (2)
            held = (curve.cycles_per_px < 0.5) & np.isfinite(curve.classic)
            return Reading(
                curve.classic[held],
                np.ones(np.count_nonzero(held)),
                np.full(np.count_nonzero(held), math.nan),
            )
        truth = transfer(smms, 1 / FOCUS, camera.sensor.pixel, curve.cycles_per_mm)
        return Reading(curve.contrast, truth, curve.uncertainty)

    methods = {
        FIT: lambda picture, noise: read(picture, noise, False),
        CLASSIC: lambda picture, noise: read(picture, noise, True),
    }
    return Case(CONTRAST, _exposed(camera, target), methods)


def _lattice_case(resolution: tuple[int, int]) -> Case:
    camera = _camera(resolution)
    due = nominal_lattice(camera, WHITE_DN)

    def read(picture: Array, noise: SensorNoise) -> Reading:
        found = lattice_behind(camera, picture, noise)
        return Reading(
            *(
                np.array([value / due.pitch_px])
                for value in (found.pitch_px, due.pitch_px, found.pitch_uncertainty_px)
            )
        )

    # in units of the pitch
    return Case(PITCH, _exposed(camera, White()), {LATTICE: read})


def _edge_case(side: int) -> Case:
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    t = x * math.cos(EDGE_ANGLE) + y * math.sin(EDGE_ANGLE) - 0.3
    picture = NOISE.offset_dn + WHITE_DN * (
        0.2 + 0.6 * edge_profile(t.ravel(), EDGE_BLUR, EDGE_ANGLE)[0].reshape(t.shape)
    )
    truth = np.exp(-2 * (math.pi * EDGE_BLUR * FREQUENCIES) ** 2) * np.abs(
        pixel_transfer(FREQUENCIES, EDGE_ANGLE)
    )

    def free(picture: Array, noise: SensorNoise) -> Reading:
        edge = fit_edge(picture, None, np.sqrt(noise.variance(picture)))
        mtf, own, form = line_spread(edge).mtf(FREQUENCIES)
        return Reading(mtf, truth, np.hypot(own, form))

    return Case(EDGE, picture, {FREE: free})
