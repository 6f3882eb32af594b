"""A small set in the format of the published measurements, traced ray by ray; nothing here leans on
the model's algebra.
"""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]

CAMERA = """\
main_lens: {{focal_length: 50 mm, f_number: 5.6}}
microlens_array: {{layout: hexagonal, count: [44, 36], pitch: 200 um, aperture: 180 um, focal_length: [1.2 mm, 1.1 mm],
  pattern: [[0, 1]], distance: {distance} mm, offset: [0.03 mm, -0.05 mm], roll: 0.002 rad, tilt: [0.0008 rad, -0.0006 rad]}}
sensor: {{resolution: [1600, 1150], pixel: 5.5 um, distance: {sensor} mm, offset: [0.01 mm, 0.02 mm]}}
"""  # noqa: E501
FOCAL, APERTURE, DISTANCE, GAP, PIXEL = 50.0, 50.0 / 5.6, 56.5, 0.6, 0.0055
BOARD, SPACING = (5, 4), 4.0
TURN = (0.011, -0.024, 0.006)


def rotation(about_x: float, about_y: float) -> Array:
    a, b = math.radians(about_x), math.radians(about_y)
    rx = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    ry = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    return rx @ ry


def microlenses() -> tuple[list[tuple[int, int]], Array]:
    """Column and row, and centre (x, y, z) of every microlens of the camera above."""
    numbers = [(k, row) for row in range(36) for k in range(44)]
    places: list[tuple[float, float, float]] = []
    for k, row in numbers:
        x, y = 0.2 * (k - (row % 2) / 2 - 21.25), 0.2 * math.sqrt(3) / 2 * (row - 17.5)
        x, y = (
            math.cos(0.002) * x - math.sin(0.002) * y + 0.03,
            math.sin(0.002) * x + math.cos(0.002) * y - 0.05,
        )
        places.append((x, y, DISTANCE + 0.0008 * x - 0.0006 * y))
    return numbers, np.array(places)


def trace(target: Array, start: Array, lens: Array) -> tuple[Array, Array]:
    """Where rays from ``target`` through ``start`` on the main lens meet the planes of microlenses,
    and their slopes there.
    """
    slope = (start - target[:2]) / target[2]
    slope = slope - start / FOCAL
    return start + slope * lens[:, 2:], slope


def views_of(target: Array, lenses: Array) -> tuple[npt.NDArray[np.int64], Array]:
    """Microlenses through whose centre a ray of the target passes, and where it lands on the
    sensor.
    """
    origin, _ = trace(target, np.zeros((len(lenses), 2)), lenses)
    one, _ = trace(target, np.ones((len(lenses), 2)), lenses)
    start = (lenses[:, :2] - origin) / (one - origin)
    hit, slope = trace(target, start, lenses)
    assert np.allclose(hit, lenses[:, :2])
    seeing = np.flatnonzero(np.hypot(*start.T) <= APERTURE / 2)
    return seeing, (hit + slope * (DISTANCE + GAP - lenses[:, 2:]))[seeing]


@pytest.fixture(scope="session")
def write_set(tmp_path_factory: pytest.TempPathFactory) -> Callable[[float], Path]:
    """Writes the set, its camera file and truth.json, with a given noise of the positions in
    pixels.
    """

    def write(noise_px: float) -> Path:
        folder = tmp_path_factory.mktemp("synthetic")
        rng = np.random.default_rng(20)
        numbers, lenses = microlenses()
        stands = {
            0: ((3.0, -4.0), 300.0),
            1: ((10.0, 25.0), 285.0),
            3: ((-2.0, 5.0), 255.0),
            4: ((0.0, -40.0), 275.0),
        }
        # The poses as published are turned against the camera by this rotation, in the world.
        common = Rotation.from_rotvec(TURN).as_matrix()
        flip = np.diag([-1.0, -1.0, 1.0])
        poses: dict[str, object] = {}
        lines = ["k,l,u,v,rho,cluster,frame"]
        depth: dict[str, float] = {}
        middle = np.array([(BOARD[0] - 1) * SPACING / 2, (BOARD[1] - 1) * SPACING / 2, 0])
        first = np.array([0.01, 0.02]) - (np.array([1600, 1150]) - 1) / 2 * PIXEL
        for frame, (angles, distance) in stands.items():
            turn = rotation(*angles)
            for corner in range(BOARD[0] * BOARD[1]):
                place = np.array([corner % BOARD[0] * SPACING, corner // BOARD[0] * SPACING, 0.0])
                inside = turn @ (place - middle) + np.array([0.0, 0.0, distance])
                target = inside * np.array(
                    [-1, -1, 1]
                )  # the format's lateral axes run against columns and rows
                seeing, landing = views_of(target, lenses)
                behind = 1 / (1 / FOCAL - 1 / target[2])
                z = lenses[seeing, 2]
                depth[f"{frame} {corner}"] = float(np.mean((behind - z) / (DISTANCE + GAP - z)))
                pixels = (landing - first) / PIXEL + noise_px * rng.standard_normal(landing.shape)
                for microlens, (u, v) in zip(seeing, pixels, strict=True):
                    k, row = numbers[microlens]
                    lines.append(f"{k},{row},{u:.9f},{v:.9f},0,{corner},{frame}")
            shift = middle - turn.T @ np.array([0.0, 0.0, distance])
            published = flip @ common.T @ flip @ turn
            poses[str(frame)] = {"rotation": published.tolist(), "translation_mm": shift.tolist()}
        (folder / "observations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        (folder / "poses.json").write_text(json.dumps(poses, indent=1), encoding="utf-8")
        board = {
            "target": {"checkerboard_corners": f"{BOARD[0]} x {BOARD[1]}", "spacing_mm": SPACING}
        }
        (folder / "camera.json").write_text(json.dumps(board, indent=1), encoding="utf-8")
        (folder / "camera.yaml").write_text(
            CAMERA.format(distance=DISTANCE, sensor=DISTANCE + GAP), encoding="utf-8"
        )
        truth = {"distance": DISTANCE, "gap": GAP, "virtual_depth": depth}
        (folder / "truth.json").write_text(json.dumps(truth), encoding="utf-8")
        return folder

    return write


@pytest.fixture(scope="session")
def traced(write_set: Callable[[float], Path]) -> Path:
    """The folder of the set without noise."""
    return write_set(0.0)


@pytest.fixture(scope="session")
def noisy(write_set: Callable[[float], Path]) -> Path:
    """The folder of the set with positions that scatter by 0.4 pixels."""
    return write_set(0.4)
