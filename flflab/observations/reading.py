"""Reader of a folder in the format of the published R12-A measurements: points of a board, seen in
micro-images.

``observations.csv`` has one row per point seen in one micro-image: microlens column k and row l,
pixel column u and row v, the point (``cluster``) and the ``frame``; further columns are not read.
``poses.json`` has a rotation and a translation per frame, ``camera.json`` the board (``target``).
Source of the format: docs/r12a.md.
"""

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from flflab.description import Description, check, written_as
from flflab.errors import InputError, reason
from flflab.yaml_file import read_yaml

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]
_WHOLE, _REAL = ("k", "l", "cluster", "frame"), ("u", "v")
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Board:
    """A checkerboard: inner corners along its rows and columns, and their spacing in mm."""

    columns: int
    rows: int
    spacing: float

    def corners(self) -> Array:
        """Position of every point in the board's frame, mm, shape (points, 3): point c lies in
        column c % columns, row c // columns.
        """
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        return np.stack([column * self.spacing, row * self.spacing, np.zeros(len(row))], axis=1)


@dataclass(frozen=True)
class Pose:
    """Where the board stood: a point X of the board lies at R (X - t) in the main lens's frame.

    Attributes:
        rotation: R, shape (3, 3).
        translation: t, shape (3,), mm.
    """

    rotation: Array
    translation: Array

    def positions(self, points: Array) -> Array:
        """World (x, y, D) of points of the board, mm, shape (points, 3).

        The third coordinate of R (X - t) is the distance D in front of the lens. The other two run
        against the sensor's columns and rows in the published poses, so they change sign here
        (see ``docs/r12a.md``).
        """
        return (points - self.translation) @ self.rotation.T * np.array([-1.0, -1.0, 1.0])

    @property
    def normal(self) -> Array:
        """The board's normal in the world, shape (3,)."""
        return self.rotation[:, 2] * np.array([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Observations:
    """A folder of measurements as read; K views.

    Attributes:
        folder: where they were read.
        board: the points.
        poses: the pose of each frame that has one.
        microlens: (column, row) of the microlens of each view, shape (K, 2).
        pixel: (column, row) of each view on the sensor, shape (K, 2).
        point: point of each view, shape (K,).
        frame: frame of each view, shape (K,).
    """

    folder: Path
    board: Board
    poses: dict[int, Pose]
    microlens: Numbers
    pixel: Array
    point: Numbers
    frame: Numbers

    @property
    def frames(self) -> tuple[int, ...]:
        """Frames that have observations, rising."""
        return tuple(int(frame) for frame in np.unique(self.frame))

    @property
    def empty_frames(self) -> tuple[int, ...]:
        """Frames without an observation, from frame 0 to the last one that is named in any file."""
        last = max((*self.poses, *self.frames))
        return tuple(frame for frame in range(last + 1) if frame not in self.frames)


class _Target(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)
    checkerboard_corners: Annotated[
        str, written_as(r"\s*[1-9]\d*\s*x\s*[1-9]\d*\s*", "two numbers are due, such as '8 x 5'")
    ]
    spacing_mm: Annotated[float, Field(gt=0)]


class _CameraFacts(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)
    target: _Target


class _PoseDescription(Description):
    rotation: tuple[
        tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]
    ]
    translation_mm: tuple[float, float, float]


def read_observations(folder: Path) -> Observations:
    """Read ``observations.csv``, ``poses.json`` and the board of ``camera.json``.

    Raises:
        InputError: a file, column, cell or field is missing or impossible; the message names file,
            line and field.
    """
    if not folder.is_dir():
        raise InputError(
            f"{folder}: no such folder; give one that holds observations.csv, poses.json and"
            " camera.json"
        )
    missing = [
        name
        for name in ("observations.csv", "poses.json", "camera.json")
        if not (folder / name).is_file()
    ]
    if missing:
        raise InputError(
            f"{folder}: lacks {' and '.join(missing)}; give a folder that holds observations.csv,"
            " poses.json and camera.json"
        )
    board = _read_board(folder / "camera.json")
    poses = _read_poses(folder / "poses.json")
    file = folder / "observations.csv"
    views: dict[tuple[int, ...], tuple[float, float]] = {}
    lines: dict[tuple[int, ...], int] = {}
    for line, whole, real in _rows(file):
        _, _, point, frame = whole
        if point >= board.columns * board.rows:
            raise InputError(
                f"{file}:{line}: cluster: {point} is not a point of the board; its {board.columns}"
                f" x {board.rows} points have the numbers 0 to {board.columns * board.rows - 1}"
            )
        if frame not in poses:
            raise InputError(
                f"{file}:{line}: frame: {frame} has no pose in {folder / 'poses.json'}; poses"
                f" there: {sorted(poses)}"
            )
        if whole in views:
            raise InputError(
                f"{file}:{line}: this view stands in line {lines[whole]} already (same k, l,"
                " cluster and frame); keep one"
            )
        views[whole], lines[whole] = real, line
    if not views:
        raise InputError(
            f"{file}:1: no view below the header; one row per point and micro-image is due"
        )
    keys = np.array(list(views), dtype=np.int64)
    return Observations(
        folder, board, poses, keys[:, :2], np.array(list(views.values())), keys[:, 2], keys[:, 3]
    )


def _read_board(file: Path) -> Board:
    data, lines = read_yaml(file)  # JSON is YAML, and this reader keeps the lines
    target = check(data, _CameraFacts, str(file), lines).target
    columns, rows = (int(number) for number in target.checkerboard_corners.split("x"))
    return Board(columns, rows, target.spacing_mm)


def _read_poses(file: Path) -> dict[int, Pose]:
    data, lines = read_yaml(file)
    poses: dict[int, Pose] = {}
    for name, given in data.items():
        where = f"{file}:{lines.get((name,), 1)}: {name}"
        if not str(name).isdecimal():
            raise InputError(f"{where}: a frame is a whole number from 0")
        pose = check(given, _PoseDescription, str(file), lines, under=(name,))
        rotation = np.array(pose.rotation)
        if (
            not np.allclose(rotation @ rotation.T, np.eye(3), atol=_ROUNDING)
            or np.linalg.det(rotation) < 0
        ):
            raise InputError(
                f"{where}.rotation: not a rotation; rows of length 1 at right angles and"
                " determinant +1 are due"
            )
        poses[int(name)] = Pose(rotation, np.array(pose.translation_mm))
    return poses


def _rows(file: Path) -> Iterator[tuple[int, tuple[int, ...], tuple[float, float]]]:
    """Line number, (k, l, cluster, frame) and (u, v) of each row of the table."""
    try:
        with file.open(encoding="utf-8", newline="") as text:
            table = csv.DictReader(text)
            missing = [name for name in (*_WHOLE, *_REAL) if name not in (table.fieldnames or ())]
            if missing:
                raise InputError(
                    f"{file}:1: no column {', '.join(missing)}; the columns k, l, u, v, cluster and"
                    " frame are due"
                )
            for row in table:
                line = table.line_num
                whole = tuple(_whole(row[name], f"{file}:{line}: {name}") for name in _WHOLE)
                yield (
                    line,
                    whole,
                    (_real(row["u"], f"{file}:{line}: u"), _real(row["v"], f"{file}:{line}: v")),
                )
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            f"{file}: cannot be read ({reason(error)}); a table of views with a header line is due"
        ) from error


def _whole(cell: str | None, where: str) -> int:
    if cell is None or not cell.strip().isdecimal():
        raise InputError(f"{where}: {cell or 'nothing'!r} given; a whole number from 0 is due")
    return int(cell)


def _real(cell: str | None, where: str) -> float:
    try:
        value = float(cell or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {cell or 'nothing'!r} given; a finite number of pixels is due")
    return value
