"""The exact image of a flat target behind round apertures: defocus, vignetting by both apertures, overlap, pixel area.

For each microlens and each pixel its light can reach, the radiance averaged over the pixel is integrated over the part of the
pupil that lights the pixel. Source: physics.md, "Exact image of a flat target".
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.profile import profile_table
from flflab.image.rim import STEEP, disc_nodes
from flflab.image.ruled import add_ruled, strip_nodes
from flflab.image.sampled import add_sampled, chord_nodes
from flflab.image.scene import (
    Scene,
    grid_counts,
    in_bands,
    lit_windows,
    make_scene,
    pixel_parts,
    rim_rows,
    spot_parts,
    strip_counts,
)
from flflab.optics.camera import Camera, pixel_positions
from flflab.targets import Bars, Black, Edge, FourDot, Picture, Target, White

Array = npt.NDArray[np.float64]

TOLERANCE = 0.002
LEAST_TOLERANCE = 1e-5
LARGE_BLUR = 0.7  # pixels; from here on a dot's image is the area common to three discs


def render(
    camera: Camera,
    target: Target,
    distance: float,
    *,
    tolerance: float = TOLERANCE,
    target_offset: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Form the image of a flat target.

    Args:
        camera: the camera, with round apertures.
        target: what stands in front of it.
        distance: main lens to target, mm; at infinity all that has a size in mm is a point and black.
        tolerance: largest error asked for, in units of the white level.
        target_offset: where the target's centre stands, (x, y) mm; without meaning at infinity.

    Returns:
        Irradiance [row, column] in units of the white level: that at the centre of the micro-image nearest the axis under a
        boundless white target, without its neighbours' light.

    Raises:
        InputError: the apertures are not round, a number is impossible, or a tilted array reaches through the sensor.
    """
    _check(camera, distance, tolerance, target_offset)
    columns, rows = camera.sensor.resolution
    image = np.zeros((rows, columns))
    if isinstance(target, Black) or (math.isinf(distance) and isinstance(target, FourDot | Bars | Picture)):
        return image
    scene = make_scene(camera, distance, tolerance, target_offset)
    match target:
        case FourDot():
            for x, y in target.centres:
                _add_sampled(image, scene.seen_from(x, y), target.diameter / 2, target.diameter / 2, target.diameter / 2, None)
        case Picture():
            _add_sampled(image, scene, 0.0, target.width / 2, target.height / 2, target)
        case _:
            _add_ruled(image, scene, target)
    return image


def _check(camera: Camera, distance: float, tolerance: float, target_offset: tuple[float, float]) -> None:
    if camera.aperture_shape != "round":
        raise InputError(f"render: images are formed for round apertures only, not {camera.aperture_shape}; set aperture_shape: round")
    if math.isnan(distance) or distance <= 0:
        raise InputError(f"render: the target's distance is {distance:g} mm; one above 0, in front of the main lens, or infinity is due")
    if not LEAST_TOLERANCE <= tolerance < 1:
        raise InputError(f"render: the tolerance is {tolerance:g}; a share of white from {LEAST_TOLERANCE:g} to below 1 is allowed")
    if not all(math.isfinite(part) for part in target_offset):
        raise InputError(f"render: target_offset is {target_offset}; two finite lengths in mm are due")


def _rows_of(scene: Scene, axes: Array) -> tuple[Array, Array]:
    """Centres of the micro-images (N, 2) and what the kernels know of a pupil (N, 6), directions in the target's axes."""
    pupils = scene.pupils
    turned = np.stack([pupils.direction_x, pupils.direction_y], axis=1) @ axes.T
    known = np.column_stack([pupils.slope, pupils.reach, pupils.spread, pupils.scale, turned])
    return np.column_stack([pupils.centre_x, pupils.centre_y]), known


def _add_ruled(image: Array, scene: Scene, target: Bars | Edge | White) -> None:
    axes, bounds = np.eye(2), np.array([-np.inf, np.inf])
    table, law = np.zeros((0, 8)), np.zeros(5)
    half_x = half_y = math.inf
    if isinstance(target, Bars):
        table, law = profile_table(target)
        half_x, half_y = target.width / 2, target.height / 2
        bounds = np.array([-half_y, half_y])
    elif isinstance(target, Edge):
        cos, sin = math.cos(target.angle), math.sin(target.angle)
        axes, bounds = np.array([[sin, -cos], [cos, sin]]), np.array([0.0, np.inf])
    parts, steep = pixel_parts(scene)
    if isinstance(target, White):
        parts = np.where(scene.rims.width < STEEP, parts, 1)
    counts = strip_counts(scene.kind_blur(largest=True), scene.tolerance / scene.overlap)
    strips, rims, nodes = strip_nodes(counts), rim_rows(scene, parts, steep), disc_nodes(8, 8)
    windows = lit_windows(scene, half_x, half_y)
    xs, ys = pixel_positions(scene.sensor)
    centres, known = _rows_of(scene, axes)

    def add(rows: tuple[int, int]) -> None:
        add_ruled(
            image,
            rows,
            windows,
            scene.rims.kind,
            centres,
            known,
            scene.pupils.level,
            parts,
            counts,
            strips,
            rims,
            nodes,
            xs,
            ys,
            scene.sensor.pixel,
            axes,
            table,
            law,
            bounds,
        )

    in_bands(add, windows)


def _add_sampled(image: Array, scene: Scene, radius: float, half_x: float, half_y: float, picture: Picture | None) -> None:
    """Add a disc of this radius round the origin of the target's coordinates, or a picture where the radius is 0."""
    texel, sums = 1.0, np.zeros((2, 2))
    if picture is not None:
        texel, sums = picture.texel, np.pad(picture.values.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    parts, steep = pixel_parts(scene)
    blur = scene.kind_blur(largest=True)
    counts = grid_counts(blur, scene.tolerance / scene.overlap / (1 if picture is None else 2.5))  # a picture has more edges than a dot
    if picture is None:
        counts = np.where(blur > LARGE_BLUR, 0, counts)
        finer = np.maximum(parts, spot_parts(scene.kind_blur(largest=False), scene.tolerance))
        parts = np.where(counts == 0, finer, parts)
    strips, chords, rims, nodes = strip_nodes(counts), chord_nodes(counts), rim_rows(scene, parts, steep), disc_nodes(8, 8)
    windows = lit_windows(scene, half_x, half_y)
    xs, ys = pixel_positions(scene.sensor)
    centres, known = _rows_of(scene, np.eye(2))

    def add(rows: tuple[int, int]) -> None:
        add_sampled(
            image,
            rows,
            windows,
            scene.rims.kind,
            centres,
            known,
            scene.pupils.level,
            parts,
            counts,
            strips,
            chords,
            rims,
            nodes,
            xs,
            ys,
            scene.sensor.pixel,
            radius,
            texel,
            sums,
        )

    in_bands(add, windows)
