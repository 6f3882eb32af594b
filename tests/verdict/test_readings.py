"""How each property is read from measurements, against closed forms and against rays that never saw
the reading.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import j1

from flflab.files.camera import read_camera
from flflab.measurement.dots.fit import Seen, stand_of
from flflab.measurement.dots.model import microlenses_of
from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.camera import Camera, MainLens
from flflab.optics.focus import depth_of_field
from flflab.optics.resolution import central_smms
from flflab.optics.smms import Smms
from flflab.verdict.properties.depth import distance_of, offset_read
from flflab.verdict.properties.fields import useful_row
from flflab.verdict.properties.focus import blur_squared, line_ends
from flflab.verdict.properties.predicted import Predicted

CAMERA = Path(__file__).parents[2] / "examples" / "cameras" / "osinski.yaml"


@pytest.fixture(scope="module")
def camera() -> Camera:
    return read_camera(CAMERA)


@pytest.mark.parametrize("diameter", [0.0, 0.4, 1.3, 4.0])
def test_the_blur_is_read_from_a_curve_of_contrast(diameter: float) -> None:
    u = np.linspace(0.02, 0.45, 16)
    z = np.pi * diameter * u
    contrast = np.sinc(u) * (np.divide(2 * j1(z), z, out=np.ones_like(z), where=z > 0))
    square, doubt = blur_squared(
        contrast[None, :], u, 1e-6 * np.eye(16), np.array([(diameter + 0.5) ** 2])
    )
    assert square[0] == pytest.approx(diameter**2, abs=1e-9)
    assert 0 < doubt < 0.1


def test_noise_in_focus_biases_no_blur_for_squares_may_be_negative() -> None:
    u = np.linspace(0.02, 0.45, 16)
    noisy = np.sinc(u) + 0.01 * np.random.default_rng(1).normal(size=(4000, 16))
    squares, doubt = blur_squared(noisy, u, 1e-4 * np.eye(16), np.array([0.2]))
    assert abs(squares.mean()) < 4 * doubt / 4000**0.5 + doubt**2
    assert squares.std() == pytest.approx(doubt, rel=0.06)
    assert (squares < 0).mean() > 0.4


def test_the_ends_of_the_depth_of_field_are_the_model_s_where_the_blurs_are(camera: Camera) -> None:
    smms = central_smms(camera)
    pixel = camera.sensor.pixel
    distances = np.array([496.0, 506.0, 520.0])
    x = float(smms.distance) * (1 / distances - 1 / 50.0 + 1 / float(smms.distance))
    blur = (float(smms.kappa) - float(smms.gap / smms.distance) / x) * float(smms.aperture) / pixel
    nominal = (
        np.array(
            [float(smms.aperture * smms.kappa), -float(smms.aperture * smms.gap / smms.distance)]
        )
        / pixel
    )
    ends, slopes = line_ends((blur**2)[None, :], 1 / x, np.ones(3), 1.01 * nominal, camera)
    ((low, high),) = depth_of_field(smms, pixel)
    assert ends[0].tolist() == pytest.approx([1 / high, 1 / low], rel=1e-9)
    assert ends[0].tolist() == pytest.approx([499.61, 514.31], abs=0.01)  # physics' worked example
    for k in range(3):
        step = np.eye(3)[k] * 1e-5
        moved = line_ends((blur**2 + step)[None, :], 1 / x, np.ones(3), nominal, camera)[0] - ends
        assert moved[0].tolist() == pytest.approx((slopes[0] @ step).tolist(), rel=2e-3)


@pytest.mark.parametrize(
    ("f_number", "pixels"),
    [(1.6, 1240), (2.0, 2324), (2.8, 3094), (4.0, 2164), (5.6, 1546), (8.0, 1082), (16.0, 714)],
)
def test_the_useful_pixels_of_the_row_are_those_of_the_worked_example(
    camera: Camera, f_number: float, pixels: int
) -> None:
    smms = central_smms(replace(camera, main_lens=MainLens(50.0, f_number)))
    inside, outside, pitch = (
        np.array([float(value)])
        for value in (smms.inside_radius, smms.outside_radius, 0.4 * smms.image_scale)
    )
    length = float(useful_row(camera, inside, outside, pitch)[0])
    assert length / camera.sensor.pixel == pytest.approx(
        pixels, abs=16
    )  # whole pixels, one lost or won at either end of 15 intervals


def as_lattice(places_px: np.ndarray) -> Lattice:
    none = np.zeros(2)
    return Lattice(
        "square", 245.0, 0.0, none, 245.0 * np.eye(2),
        np.zeros((len(places_px), 2), dtype=np.int64), places_px, 0, 0, 0, 0, none, 0, 0,
        np.zeros((6, 6)), np.zeros((3, 3)), np.zeros(6),
    )  # fmt: skip


def test_a_depth_read_with_the_nominal_camera_is_what_a_bench_with_other_distances_shows(
    camera: Camera,
) -> None:
    true = replace(
        camera,
        array=replace(camera.array, distance=60.02),
        sensor=replace(camera.sensor, distance=61.155),
    )
    smms = central_smms(true)
    L, b, F, distance = float(smms.distance), float(smms.gap), 50.0, 505.0
    Q = 0.4 * np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 2)
    point = np.array([1.2, -0.7])
    x = L * (1 / distance - 1 / F + 1 / L)
    centres = Q * (1 + b / L)
    landings = (
        centres - b / (L * x) * Q - point / distance * b / x
    )  # the rays from the point through the microlenses' centres
    to_pixel = (np.array([camera.sensor.resolution[0], camera.sensor.resolution[1]]) - 1) / 2
    lattice = as_lattice(centres / camera.sensor.pixel + to_pixel)
    uncut = replace(microlenses_of(lattice, camera), stop=50.0)
    seen = Seen(
        uncut, np.zeros(9, np.int64), np.arange(9), landings - centres,
        np.full((9, 2), 1e-14), np.zeros(9), 0.0, np.ones(9, np.bool_), (0.0, 1e-9), 1e-6,
    )  # fmt: skip
    start = np.array([[0.0, 0.0, 1 / 507.0]])
    read = 1 / stand_of(seen, start, start, 0.0).values[0, 2]
    model = Predicted(
        camera, 507.0, np.zeros(4, np.int64), None, (), np.zeros((1, 0)), np.ones(0), 0.0,
        Smms(**{name: getattr(smms, name)[None] for name in Smms.__dataclass_fields__}),
        np.array([1 / distance]),
        np.zeros(1), np.zeros(1), np.zeros(1), np.ones(1), np.zeros((1, 3)), np.zeros((1, 4)),
        np.zeros((1, 4)), np.ones(1), np.ones(1), np.zeros(1), np.zeros((1, 0)),
    )  # fmt: skip
    assert float(distance_of(offset_read(model), camera)[0]) == pytest.approx(read, rel=1e-7)
    assert abs(read - 505.0) > 1  # and such a bench does show it wrongly
