"""What a configuration is worth: the figures that requirements and objectives speak of, for many
configurations at once.

Everything comes from the model of ``flflab.optics.configurations``; within one side of focus views
grow and contrast falls with the distance from the array's conjugate, so what holds at both ends of
the depth holds in all of it.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.design.grid import Candidates
from flflab.design.requirements import Requirements
from flflab.optics.configurations import Configurations, Properties, solve_configurations

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Figures:
    """What requirements speak of, of n configurations, each of shape (n,); worst over the depth
    where it changes in it.

    Attributes:
        views: least number of chief views along the row.
        blur_px: largest blur, pixels.
        resolution: largest size of a pixel on the target, mm.
        contrast: least contrast at the frequency asked for; 1 where none is.
        width: least width seen with all its views, mm.
        light: marginal angle on the axis, rad.
    """

    views: Array
    blur_px: Array
    resolution: Array
    contrast: Array
    width: Array
    light: Array

    def kept(self, which: npt.NDArray[np.bool_]) -> "Figures":
        """Only those marked."""
        return Figures(**{field.name: getattr(self, field.name)[which] for field in fields(self)})

    def worst(self, other: "Figures") -> "Figures":
        """The worse of two, figure by figure."""
        return Figures(
            views=np.minimum(self.views, other.views),
            blur_px=np.maximum(self.blur_px, other.blur_px),
            resolution=np.maximum(self.resolution, other.resolution),
            contrast=np.minimum(self.contrast, other.contrast),
            width=np.minimum(self.width, other.width),
            light=np.minimum(self.light, other.light),
        )


def properties_at(
    given: Candidates, wanted: Requirements, distance: npt.ArrayLike, threads: int | None = None
) -> Properties:
    """The model's properties with the target at a distance, mm."""
    return solve_configurations(
        Configurations(
            lens_focal=given.lens_focal,
            f_number=given.f_number,
            array_distance=given.place,
            gap=given.gap,
            focal=given.focal,
            pitch=given.pitch,
            aperture=given.aperture,
            distance=distance,
            pixel=given.sensor.pixel,
            columns=given.array.count[0],
            pixels=given.sensor.resolution[0],
            minimum_illumination=wanted.minimum_illumination,
            cycles_per_mm=wanted.require.contrast.at if wanted.require.contrast else 0.0,
        ),
        threads,
    )


def figures_at(
    given: Candidates, wanted: Requirements, end: int, threads: int | None = None
) -> Figures:
    """The figures at the near (0) or the far (1) end of the depth.

    Where the array's conjugate, at which no view has depth, lies inside the depth, there are no
    views.
    """
    near, far = wanted.measure.depth
    conjugate = 1 / given.lens_focal - 1 / given.place
    one_side = (1 / near < conjugate) | (1 / far > conjugate)
    there = properties_at(given, wanted, (near, far)[end], threads)
    return Figures(
        views=np.where(one_side, np.minimum(there.views, seen_microlenses(given)), 0.0),
        blur_px=there.blur / given.sensor.pixel,
        resolution=given.sensor.pixel / there.magnification,
        contrast=there.contrast,
        width=seen_width(given, there, (near, far)[end]),
        light=marginal_angle(
            given.gap, given.place, given.lens_focal, given.f_number, given.focal, given.aperture
        ),
    )


def solve_figures(given: Candidates, wanted: Requirements, threads: int | None = None) -> Figures:
    """The figures of all candidates, worst over the depth."""
    return figures_at(given, wanted, 0, threads).worst(figures_at(given, wanted, 1, threads))


def objectives(
    given: Candidates, wanted: Requirements, figures: Figures, threads: int | None = None
) -> Array:
    """What is to be as large as possible, in the order of ``maximise``; shape (n, number of
    objectives).

    ``area`` is the measurement area, mm^2; ``elr`` the effective lateral resolution of the row in
    the middle of the depth by eq. (3), pixels; ``contrast`` the least in the depth; ``light`` the
    marginal angle, rad.
    """
    near, far = wanted.measure.depth
    middle = properties_at(given, wanted, 2 * near * far / (near + far), threads)
    columns = {
        "area": lambda: measurement_area(given, middle, wanted, threads),
        "elr": lambda: np.where(np.isfinite(middle.elr), middle.elr, 0.0),
        "contrast": lambda: figures.contrast,
        "light": lambda: figures.light,
    }
    return np.stack([columns[name]() for name in wanted.maximise], axis=1)


def seen_width(given: Candidates, there: Properties, distance: npt.ArrayLike) -> Array:
    """Width on the target, mm, in which a point has all the views it has on the axis: 2 (Y - r) D /
    L.

    r is the reach of a point's views on the array, half the mean number of views times the pitch; Y
    half the array that the sensor sees.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        views = np.where(
            np.isfinite(there.elr_by_views), there.useful_pixels / there.elr_by_views, 0.0
        )
    reach = np.where(views > 0, views, 1.0) * given.pitch / 2
    return np.maximum(2 * (half_seen(given) - reach) * np.asarray(distance) / given.place, 0.0)


def half_seen(given: Candidates) -> Array:
    """Half the width of the array that the sensor sees, mm."""
    half_sensor = (
        given.sensor.resolution[0] * given.sensor.pixel / 2 / (1 + given.gap / given.place)
    )
    return np.minimum(given.array.count[0] * given.pitch / 2, half_sensor)


def seen_microlenses(given: Candidates) -> Array:
    """How many microlenses of a row have the centre of their micro-image on the sensor."""
    per_half = half_seen(given) / given.pitch
    return 2 * np.floor(per_half) + 1 if given.array.count[0] % 2 else 2 * np.floor(per_half + 0.5)


def marginal_angle(
    gap: Any, place: Any, lens_focal: Any, f_number: Any, focal: Any, aperture: Any
) -> Any:
    """Full angle of the cone that lights the axial micro-image's centre, rad: 2 atan(g/b), g =
    min(d, A b/(L |kappa|))/2.

    Args:
        gap: b, mm.
        place: L, mm.
        lens_focal: of the main lens, mm; over the f-number it is A.
        f_number: of the main lens.
        focal: of the microlenses, mm.
        aperture: d, mm.
    """
    ratio = gap / place
    kappa = np.abs(1 + ratio - gap / focal)
    return 2 * np.arctan(np.minimum(aperture, lens_focal / f_number * ratio / kappa) / 2 / gap)


def measurement_area(
    given: Candidates, middle: Properties, wanted: Requirements, threads: int | None = None
) -> Array:
    """Depth of field at one pixel of blur, inside the stereo region, times its mean width by
    Simpson's rule; mm^2.
    """
    least = 1 / wanted.search.farthest
    first = np.minimum(
        middle.near_vergence, np.where(middle.stereo_near > 0, middle.stereo_near, 0.0)
    )
    last = np.maximum(np.maximum(middle.far_vergence, middle.stereo_far), least)
    some = (first > last) & np.isfinite(last)
    near, far = 1 / np.where(some, first, 1.0), 1 / np.where(some, last, 1.0)
    total = np.zeros(given.number)
    for distance, weight in ((near, 1 / 6), ((near + far) / 2, 4 / 6), (far, 1 / 6)):
        total += weight * seen_width(
            given, properties_at(given, wanted, distance, threads), distance
        )
    return np.where(some, total * (far - near), 0.0)
