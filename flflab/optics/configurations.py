"""Many configurations in one call: the properties of a camera with a centred, untilted, uniform
square array, as arrays.

What ``solution`` says of one camera and one target distance, for a million: no loops over
configurations, no pictures of rays. Lengths in mm. Sources: as at the functions of ``focus``,
``useful``, ``views`` and ``resolution`` that hold for one.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.optics.contrast import disc_transfer

Array = npt.NDArray[np.float64]
_CHUNK = 1 << 14
ARRANGEMENTS = ("keplerian", "galilean", "afocal")
_ROUNDOFF = 8 * np.finfo(np.float64).eps


@dataclass(frozen=True)
class Configurations:
    """Configurations, every field one number or an array of shape (n,); lengths in mm.

    Attributes:
        lens_focal: focal length of the main lens.
        f_number: f-number of the main lens.
        array_distance: main lens to array.
        gap: array to sensor.
        focal: focal length of the microlenses.
        pitch: pitch of the array.
        aperture: clear aperture of the microlenses.
        distance: main lens to target; infinity is allowed.
        pixel: pixel size.
        columns: microlenses in the row.
        pixels: pixels in a sensor row.
        minimum_illumination: least relative illumination of a useful pixel.
        cycles_per_mm: frequency on the target at which contrast is asked for.
    """

    lens_focal: npt.ArrayLike
    f_number: npt.ArrayLike
    array_distance: npt.ArrayLike
    gap: npt.ArrayLike
    focal: npt.ArrayLike
    pitch: npt.ArrayLike
    aperture: npt.ArrayLike
    distance: npt.ArrayLike
    pixel: npt.ArrayLike = 1.66e-3
    columns: int = 25
    pixels: int = 3664
    minimum_illumination: float = 0.5
    cycles_per_mm: npt.ArrayLike = 1.0


@dataclass(frozen=True)
class Properties:
    """Properties of configurations, each of shape (n,); nan nowhere: what does not exist is
    infinite or 0 as said.

    Attributes:
        arrangement: index into ``ARRANGEMENTS``.
        sharp_vergence: 1/D of the sharp distance, 1/mm; negative where no real target is sharp,
            infinite in the exit pupil.
        overlap: of neighbouring total fields, mm; negative for a gap.
        useful_width: of a micro-image, mm; 0 where nothing is useful.
        virtual_depth: of the target.
        magnification: of the target.
        blur: of the target, mm.
        near_vergence: 1/D of the near end of the depth of field round the sharp distance, 1/mm.
        far_vergence: the same at the far end; 0 where it reaches infinity, above ``near_vergence``
            where nothing real is sharp.
        stereo_near: 1/D of the nearest distance that two chief views share, 1/mm; infinite for a
            Galilean camera, 0 where none is.
        stereo_far: 1/D of the farthest one; 0 where it is unbounded, infinite where there is none.
        useful_pixels: of the row.
        elr: effective lateral resolution of the row, eq. (3); infinite where the virtual depth is
            0.
        elr_by_views: the same by the mean number of chief views; infinite where that is below 1.
        contrast: the mtf at ``cycles_per_mm``.
        views: chief views of the target's point on the axis, along the row.
    """

    arrangement: npt.NDArray[np.int8]
    sharp_vergence: Array
    overlap: Array
    useful_width: Array
    virtual_depth: Array
    magnification: Array
    blur: Array
    near_vergence: Array
    far_vergence: Array
    stereo_near: Array
    stereo_far: Array
    useful_pixels: Array
    elr: Array
    elr_by_views: Array
    contrast: Array
    views: Array


def solve_configurations(given: Configurations, threads: int | None = None) -> Properties:
    """All properties of all configurations; a million take about a second on two cores and some 200
    MiB.

    Args:
        given: the configurations, fields broadcast against one another.
        threads: how many at once; as many as there are processors unless told.

    Raises:
        InputError: a length is not positive and finite (the target's distance may be infinite),
            named with its value.
    """
    names = [
        field.name
        for field in fields(given)
        if field.name not in ("columns", "pixels", "minimum_illumination")
    ]
    arrays: list[Array] = []
    for name in names:
        value = np.asarray(getattr(given, name), dtype=np.float64)
        wrong = ~(value > 0) if name == "distance" else ~((value > 0) & np.isfinite(value))
        if name == "cycles_per_mm":
            wrong = ~((value >= 0) & np.isfinite(value))
        if np.any(wrong):
            raise InputError(
                f"configurations: {name} is {value[wrong].flat[0]:g}; a number above 0 is due"
            )
        arrays.append(value)
    if given.columns < 1 or given.pixels < 1 or not 0 <= given.minimum_illumination <= 1:
        raise InputError(
            f"configurations: columns {given.columns}, pixels {given.pixels} (1 or more are due) or"
            f" minimum_illumination {given.minimum_illumination:g} (a share from 0 to 1 is due) is"
            " out of range"
        )
    pitch, aperture = np.broadcast_arrays(
        arrays[names.index("pitch")], arrays[names.index("aperture")]
    )
    if np.any(aperture > pitch * (1 + 1e-9)):
        wide = aperture > pitch * (1 + 1e-9)
        raise InputError(
            f"configurations: aperture is {aperture[wide].flat[0]:g} mm; the pitch,"
            f" {pitch[wide].flat[0]:g} mm, at most is allowed"
        )
    shape = np.broadcast_shapes(*(array.shape for array in arrays))
    size = int(np.prod(shape))
    flat = [
        (
            array.reshape(-1)
            if array.shape == shape
            else np.broadcast_to(array, shape).reshape(-1)
            if array.ndim
            else array
        )
        for array in arrays
    ]
    kinds = {
        field.name: np.empty(size, dtype=np.int8 if field.name == "arrangement" else np.float64)
        for field in fields(Properties)
    }

    def solve(start: int) -> None:
        part = slice(start, min(start + _CHUNK, size))
        numbers = dict(
            zip(names, (array[part] if array.ndim else array for array in flat), strict=True)
        )
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for name, value in properties_of(
                numbers, given.columns, given.pixels, given.minimum_illumination
            ).items():
                kinds[name][part] = value

    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        list(pool.map(solve, range(0, size, _CHUNK)))
    return Properties(**{name: value.reshape(shape) for name, value in kinds.items()})  # pyright: ignore[reportArgumentType]


def properties_of(
    given: dict[str, Array], columns: int, pixels: int, least: float
) -> dict[str, Array]:
    """The properties by name, of numbers by the names of ``Configurations``; nothing is checked.

    Letters as in the model: F, A, L, b, f, p, d, V = 1/D, x = L (V - 1/F + 1/L), kappa = 1 + b/L -
    b/f. Only numpy's functions are used, so that anything that stands for an array goes through.
    """
    F, L, b, f, p, d = (
        given[name]
        for name in ("lens_focal", "array_distance", "gap", "focal", "pitch", "aperture")
    )
    pixel, V = given["pixel"], 1 / given["distance"]
    A, ratio = F / given["f_number"], b / L
    bend = 1 / F - 1 / L
    x, kappa = L * (V - bend), 1 + ratio - b / f
    size, steep = np.abs(x), np.abs(kappa)
    w_m, w_q = A * ratio, d * steep
    narrow = np.minimum(w_m, w_q)
    h, P = (w_m + w_q) / 2, p * (1 + ratio)
    u = (
        np.maximum(np.minimum(h - least * narrow, P - h), 0.0)
        if columns > 1
        else h - least * narrow
    )
    useful = (P - h >= 0) | (columns == 1)
    microlens = d < A * size
    enlarged = np.where(microlens, b * V / size, steep * L * V)
    sharp_x = ratio / kappa
    blur = np.abs(kappa * x - ratio) * np.minimum(A, d / size)
    depth = np.abs(x / (1 - x)) / ratio
    first, last = _depth_of_field(kappa, ratio, A, d, pixel, bend, L)
    per_shift = np.where(microlens, ratio / size, steep)
    reach = np.minimum(
        np.maximum(A * size, d) / 2,
        np.where(per_shift > 0, u / np.where(per_shift > 0, per_shift, 1.0), np.inf),
    )
    R_u = _useful_pixels(u, P, pixel, columns, pixels) * useful
    lit = _lit_columns(P, pixels * pixel / 2, columns)
    mean = np.minimum(2 * reach / p, lit)
    half = reach / p * (1 + _ROUNDOFF) + _ROUNDOFF
    # Columns are centred: an odd number has one on the axis, an even one has two half a pitch
    # beside it.
    views = 2 * np.floor(half) + 1 if columns % 2 else 2 * np.floor(half + 0.5)
    frequency = given["cycles_per_mm"] / enlarged
    contrast = np.where(
        np.isfinite(frequency),
        np.abs(np.sinc(frequency * pixel) * disc_transfer(blur, frequency)),
        0.0,
    )
    edge = pixels * pixel / 2 - (lit - 1) / 2 * P
    outer = np.minimum(np.where(lit == columns, h - least * narrow, u), edge)
    near, far = _stereo(kappa, bend, p / _stereo_base(A, u / ratio, outer / ratio, lit), L)
    return {
        "arrangement": np.where(b == f, 2, np.where(b > f, 0, 1)),
        "sharp_vergence": bend + sharp_x / L,
        "overlap": 2 * h - P,
        "useful_width": 2 * u,
        "virtual_depth": depth,
        "magnification": enlarged,
        "blur": blur,
        "near_vergence": last,
        "far_vergence": first,
        "stereo_near": np.where(useful, near, 0.0),
        "stereo_far": np.where(useful, far, np.inf),
        "useful_pixels": R_u,
        "elr": np.where(depth > 0, R_u / depth, np.inf),
        "elr_by_views": np.where((mean >= 1) & useful, R_u / mean, np.inf),
        "contrast": np.where(given["cycles_per_mm"] == 0, 1.0, contrast),
        "views": np.where(useful, np.minimum(views, lit), 0.0),
    }


def _depth_of_field(
    kappa: Array, ratio: Array, A: Array, d: Array, c: Array, bend: Array, L: Array
) -> tuple[Array, Array]:
    """(far, near) vergences of the piece of |kappa x - b/L| <= c max(1/A, |x|/d) that holds the
    sharp x = (b/L)/kappa.

    Piece by the main lens: (b/L -+ c/A)/kappa. By the microlens: (b/L)/(kappa +- c/d), without an
    end where |kappa| <= c/d.
    """
    steep = np.abs(kappa)
    by_lens, by_microlens = c / A, c / d
    inner = np.minimum((ratio - by_lens) / steep, ratio / (steep + by_microlens))
    outer = np.maximum(
        (ratio + by_lens) / steep,
        np.where(steep > by_microlens, ratio / (steep - by_microlens), np.inf),
    )
    low, high = np.where(kappa > 0, inner, -outer), np.where(kappa > 0, outer, -inner)
    return np.maximum(bend + low / L, 0.0), bend + high / L


def _lit_columns(P: Array, half: Array, columns: int) -> Array:
    """Micro-images of the row whose centre lies on the sensor, of half width ``half``."""
    reached = half / P * (1 + _ROUNDOFF)
    on_sensor = 2 * np.floor(reached) + 1 if columns % 2 else 2 * np.floor(reached + 0.5)
    return np.minimum(on_sensor, columns)


def _stereo_base(A: Array, side: Array, outer: Array, lit: Array) -> Array:
    """Width of the main lens over which two micro-images side by side can share a point; 0 where
    there are no two.

    ``side`` is the half width that a micro-image uses, ``outer`` that of the outermost ones away
    from the others.
    """
    inner, last = np.minimum(A / 2, side), np.minimum(A / 2, outer)
    base = np.where(lit >= 4, inner + np.maximum(inner, last), inner + last)
    return np.where(lit >= 3, base, np.where(lit == 2, 2 * last, 0.0))


def _stereo(kappa: Array, bend: Array, least: Array, L: Array) -> tuple[Array, Array]:
    """(nearest, farthest) vergences with |x| >= ``least`` on the side of focus; see
    ``resolution.stereo``.
    """
    edge = bend + np.where(kappa < 0, -least, least) / L
    near, far = np.where(kappa < 0, edge, np.inf), np.where(kappa < 0, 0.0, np.maximum(edge, 0.0))
    none = (near <= 0) | (kappa == 0) | ~np.isfinite(edge)
    return np.where(none, 0.0, near), np.where(none, np.inf, far)


def _useful_pixels(u: Array, P: Array, pixel: Array, columns: int, pixels: int) -> Array:
    """Pixels of a row whose centre lies in some useful interval, counted micro-image by micro-image
    from the axis outwards.
    """
    total = np.zeros(np.broadcast_shapes(u.shape, P.shape, pixel.shape))
    per_pitch, width, middle = P / pixel, u / pixel, (pixels - 1) / 2
    for number in range((columns + 1) // 2):
        place = middle + (number + (0.0 if columns % 2 else 0.5)) * per_pitch
        if number and np.all(place > pixels - 0.5):
            break
        first, last = (
            np.maximum(np.ceil(place - width), 0.0),
            np.minimum(np.floor(place + width), pixels - 1.0),
        )
        count = np.where(place <= pixels - 0.5, np.maximum(last - first + 1, 0.0), 0.0)
        total += count if columns % 2 and number == 0 else 2 * count
    return total
