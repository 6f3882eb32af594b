"""What the model expects a bench to show, and how sure it can be: many draws of the errors of its
stages and its optics.

In focus the contrast falls whichever way a stage is off, so straight error bars would be wrong.
Every quantity is therefore computed for the nominal bench and for draws of its errors; mean,
spread, covariance between configurations and the null distribution of a verdict all follow from the
same draws.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench, Element
from flflab.lens_errors import EQUAL_LENSES, LensErrors
from flflab.optics.camera import Camera
from flflab.optics.contrast import transfer
from flflab.optics.light import Spectrum, lines_of
from flflab.optics.neighbours import neighbours_of
from flflab.optics.resolution import central_smms
from flflab.optics.smms import Smms, camera_smms, image_offset
from flflab.optics.useful import fields_of, in_useful, select, sensor_fields
from flflab.optics.views import chief_crossings, chief_view_indices

Array = npt.NDArray[np.float64]
ELEMENTS: tuple[Element, ...] = ("main_lens.z", "array.z", "sensor.z", "target.z")


@dataclass(frozen=True)
class OpticsFactors:
    """True over described sizes of the optics and the sensor, one value a draw, shape (n,)."""

    lens_focal: Array
    lens_aperture: Array
    focal: Array
    aperture: Array
    pitch: Array
    pixel: Array


@dataclass(frozen=True)
class OrderFactors:
    """What real lenses show over what the model of first order says, one value a draw, shape
    (n,).
    """

    contrast: Array
    widths: Array
    pitch: Array
    distance: Array


@dataclass(frozen=True)
class Errors:
    """Draws of everything that a bench file states an uncertainty for, the same in every
    configuration.

    Attributes:
        stages: zero error (mm) and scale error of the stage that moves each element, shape (n,)
            each.
        optics: of lens and array.
        attitude: roll, yaw and pitch of the array beyond those described, shape (n, 3), rad.
        target: the same of the target.
        order: what first order leaves out.
        lenses: how the microlenses differ from one another.
        dots: true over described lengths of the target of dots, shape (n,).
        bars: the same of the bars' target.
        expansion: true over described distances between the elements, by temperature, shape (n,).
    """

    stages: dict[Element, tuple[Array, Array]]
    optics: OpticsFactors
    attitude: Array
    target: Array
    order: OrderFactors
    lenses: LensErrors
    dots: Array
    bars: Array
    expansion: Array

    def of_the_stages_alone(self) -> "Errors":
        """The same draws with optics exactly as described and turned, of first order, all lenses
        equal.
        """
        return replace(as_described(len(self.attitude)), stages=self.stages)


@dataclass(frozen=True)
class Placement:
    """Where the elements stand in one configuration and how large they are, one value a draw, shape
    (n,), mm from the main lens.

    Attributes:
        distance: main lens to target.
        array: main lens to array.
        gap: array to sensor.
        optics: sizes over those described.
        dots: lengths of the target of dots over those described.
        bars: the same of the bars' target.
    """

    distance: Array
    array: Array
    gap: Array
    optics: OpticsFactors
    dots: Array
    bars: Array


def exact_optics(draws: int) -> OpticsFactors:
    """Optics as described, in every draw."""
    return OpticsFactors(*(np.ones(draws) for _ in fields(OpticsFactors)))


def as_described(draws: int) -> Errors:
    """No errors at all, in every draw."""
    still, straight = np.zeros(draws), np.zeros((draws, 3))
    stages = dict.fromkeys(ELEMENTS, (still, still))
    one = np.ones(draws)
    return Errors(
        stages,
        exact_optics(draws),
        straight,
        straight,
        first_order(draws),
        EQUAL_LENSES,
        one,
        one,
        one,
    )


def first_order(draws: int) -> OrderFactors:
    """Lenses as the model has them, in every draw."""
    return OrderFactors(*(np.ones(draws) for _ in fields(OrderFactors)))


def placements(bench: Bench, worlds: dict[Element, float], errors: Errors) -> Placement:
    """Where the elements stand if the stages are off by each draw of their errors.

    Args:
        bench: whose axes move the elements.
        worlds: nominal world z of each element, mm.
        errors: as from ``drawn_errors``.
    """
    z: dict[Element, Array] = {}
    for element in ELEMENTS:
        zero, scale = errors.stages[element]
        axis = bench.description.axis_of(element)
        reading = axis[1].reading(worlds[element]) if axis else 0.0
        sign = axis[1].sign if axis else 1
        z[element] = worlds[element] + zero + sign * scale * reading
    lens, far = z["main_lens.z"], errors.expansion
    return Placement(
        far * (lens - z["target.z"]),
        far * (z["array.z"] - lens),
        far * (z["sensor.z"] - z["array.z"]),
        errors.optics,
        errors.dots,
        errors.bars,
    )


def drawn_systems(system: Smms, camera: Camera, placement: Placement) -> Smms:
    """One system of a camera as it is in each draw, fields of shape (draws,); a glass plate keeps
    its share of the distances.
    """
    before, behind = (
        camera.optical_distance - camera.array.distance,
        camera.optical_gap - camera.gap,
    )
    optics = placement.optics
    return Smms(
        lens_focal=system.lens_focal * optics.lens_focal,
        lens_aperture=system.lens_aperture * optics.lens_aperture,
        distance=placement.array + before,
        gap=placement.gap + behind,
        focal=system.focal * optics.focal,
        aperture=system.aperture * optics.aperture,
        centre_x=system.centre_x * optics.pitch,
        centre_y=system.centre_y * optics.pitch,
    )


def contrast_draws(
    camera: Camera,
    placement: Placement,
    cycles_per_mm: Array,
    light: Spectrum | None = None,
    falloff: float = 0.0,
    longer: Array | float = 1.0,
    rise: Array | float = 0.0,
) -> Array:
    """Signed contrast of the views' bright fields for each draw, shape (draws, frequencies); see
    ``transfer`` for the fall-off. Light of several lines shows the mean of theirs.

    Microlenses are ``longer`` than those of the draw by this factor, and stand nearer to the sensor
    by ``rise`` mm, shape (draws, frequencies).
    """
    drawn = drawn_systems(central_smms(camera), camera, placement)
    columns = Smms(**{field.name: getattr(drawn, field.name)[:, None] for field in fields(Smms)})
    columns = replace(
        columns,
        focal=columns.focal * longer,
        distance=columns.distance + rise,
        gap=columns.gap - rise,
    )
    vergence, nu = 1 / placement.distance[:, None], cycles_per_mm / placement.bars[:, None]
    pixel = camera.sensor.pixel * placement.optics.pixel[:, None]
    parts = [
        weight * transfer(columns, vergence, pixel, nu, wavelength=wavelength, falloff=falloff)
        for wavelength, weight in lines_of(light)
    ]
    return np.sum(parts, axis=0)


def predicted_view_indices(
    camera: Camera, distance: float, points: Array
) -> list[npt.NDArray[np.int64]]:
    """Which microlenses see each point (x, y) mm of the target by a chief ray, one array of
    positions a point.
    """
    seen = sensor_fields(camera)
    return [chief_view_indices(seen, 1 / distance, point / distance) for point in points]


def view_draws(
    camera: Camera,
    placement: Placement,
    attitude: Array,
    points: Array,
    lenses: LensErrors = EQUAL_LENSES,
) -> npt.NDArray[np.int64]:
    """Number of chief views of each target point (x, y) mm for each draw, shape (draws, points).

    Args:
        camera: the nominal camera of the configuration.
        placement: where the elements stand, fields of shape (draws,).
        attitude: roll, yaw and pitch of the array beyond those described, shape (draws, 3), rad.
        points: positions on the target, shape (P, 2), mm.
        lenses: how the microlenses differ from one another.
    """
    smms = camera_smms(camera)
    draws = len(placement.distance)
    neighbours = neighbours_of(smms, camera, slack=0.05)
    counts = np.zeros((len(placement.distance), len(points)), dtype=np.int64)
    for column, point in enumerate(points):
        members = _candidates(smms, placement, attitude, point)
        needed = np.unique(np.concatenate([members, neighbours[members][neighbours[members] >= 0]]))
        counts[:, column] = _count(
            camera,
            select(smms, needed),
            _within(neighbours[needed], needed),
            placement,
            attitude,
            point,
            lenses.drawn(needed, draws) if lenses.differ else np.zeros((draws, len(needed), 5)),
        )
    return counts


def _candidates(
    smms: Smms, placement: Placement, attitude: Array, point: Array
) -> npt.NDArray[np.int64]:
    """Microlenses within reach of the point's light in any draw."""
    vergence = 1 / placement.distance
    first = Smms(**{field.name: getattr(smms, field.name)[:1] for field in fields(Smms)})
    optics = placement.optics
    x = image_offset(
        replace(first, distance=placement.array, lens_focal=first.lens_focal * optics.lens_focal),
        vergence,
    )
    stops = np.maximum(
        first.lens_aperture * optics.lens_aperture * np.abs(x), first.aperture * optics.aperture
    )
    reach = stops.max() / 2
    away = placement.array / placement.distance / optics.pitch
    low, high = (
        np.min(-point[:, None] * away * placement.dots, axis=1) - reach,
        np.max(-point[:, None] * away * placement.dots, axis=1) + reach,
    )
    centres = np.stack([smms.centre_x, smms.centre_y], axis=1)
    aside = np.abs(attitude[:, 0]).max() * np.hypot(*centres.T)[:, None]
    return np.flatnonzero(np.all((centres >= low - aside) & (centres <= high + aside), axis=1))


def _within(
    neighbours: npt.NDArray[np.int64], needed: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Neighbour indices renumbered within ``needed``; -1 for those outside it."""
    place = np.searchsorted(needed, neighbours).clip(0, max(len(needed) - 1, 0))
    return np.where((neighbours >= 0) & (needed[place] == neighbours), place, -1)


def _count(
    camera: Camera,
    smms: Smms,
    neighbours: npt.NDArray[np.int64],
    placement: Placement,
    attitude: Array,
    point: Array,
    own: Array,
) -> npt.NDArray[np.int64]:
    """Chief views in each draw among systems that are repeated once a draw, so that all draws are
    one array; ``own`` are the lenses' own errors, shape (draws, systems, 5).
    """
    draws, systems = len(placement.distance), len(smms.focal)
    if systems == 0:
        return np.zeros(draws, dtype=np.int64)
    optics = placement.optics

    def each(described: Array, factor: Array) -> Array:
        return np.tile(described, draws) * np.repeat(factor, systems)

    x, y = each(smms.centre_x, optics.pitch), each(smms.centre_y, optics.pitch)
    own_x, own_y, aside_x, aside_y, longer = own.reshape(-1, 5).T
    x, y = x + own_x + aside_x, y + own_y + aside_y
    roll, yaw, pitch = np.repeat(attitude, systems, axis=0).T
    x, y = np.cos(roll) * x - np.sin(roll) * y, np.sin(roll) * x + np.cos(roll) * y
    rise = (camera.array.tilt[0] + np.tan(yaw)) * x + (camera.array.tilt[1] + np.tan(pitch)) * y
    tiled = Smms(
        lens_focal=each(smms.lens_focal, optics.lens_focal),
        lens_aperture=each(smms.lens_aperture, optics.lens_aperture),
        distance=np.repeat(placement.array, systems)
        + camera.optical_distance
        - camera.array.distance
        + rise,
        gap=np.repeat(placement.gap, systems) + camera.optical_gap - camera.gap - rise,
        focal=each(smms.focal, optics.focal) * (1 + longer),
        aperture=each(smms.aperture, optics.aperture),
        centre_x=x,
        centre_y=y,
    )
    offsets = np.repeat(np.arange(draws) * systems, systems)[:, None]
    repeated = np.tile(neighbours, (draws, 1))
    seen = fields_of(tiled, np.where(repeated >= 0, repeated + offsets, -1), camera)
    distance = np.repeat(placement.distance, systems)
    angle = point * (np.repeat(placement.dots, systems) / distance)[:, None]
    centre = np.stack([tiled.centre_x, tiled.centre_y], axis=1)
    _, passes, landing = chief_crossings(tiled, 1 / distance, angle, centre, camera.aperture_shape)
    chief = passes & in_useful(seen, np.arange(len(distance)), landing)
    return chief.reshape(draws, systems).sum(axis=1)
