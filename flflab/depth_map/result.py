"""A depth map: distance with its uncertainty at every place, total focus, and the cloud of
points.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.depth_map.files import write_depth_files
from flflab.depth_map.geometry import derivatives, distance_of, undistorted
from flflab.depth_map.page import depth_page, small_table
from flflab.depth_map.views import Grid
from flflab.optics.camera import Camera
from flflab.remark import Remark

Array = npt.NDArray[np.float64]

LENGTHS = ("focal_length", "array_distance", "gap")


@dataclass(frozen=True)
class DepthMap:
    """A depth map, indexed [row, col]: columns rise with the object's x, rows with its y.

    The map is a perspective picture from the main lens's centre. NaN where there is no value.

    Attributes:
        disparity: virtual disparity delta = b/a - b/L of every place.
        disparity_sigma: its standard uncertainty, without what ``covariance`` moves.
        shared: part of it, relative to the disparity, that all places share: the microlenses' mean
            focal length.
        views: number of microlenses that were compared.
        focus: total focus, in units of the white target's radiance.
        seen: which places two microlenses look at.
        grid: the places.
        camera: the camera.
        searched: nearest and farthest distance that was looked for, mm.
        covariance: of the camera's lengths in the order of ``LENGTHS``, mm^2, shape (3, 3); they
            move the whole map. None where it is not known.
        remarks: what a reader should know.
    """

    disparity: Array
    disparity_sigma: Array
    shared: float
    views: npt.NDArray[np.int16]
    focus: Array
    seen: npt.NDArray[np.bool_]
    grid: Grid
    camera: Camera
    searched: tuple[float, float]
    covariance: Array | None = None
    remarks: tuple[Remark, ...] = ()

    @property
    def distance(self) -> Array:
        """Main lens to object, mm."""
        return distance_of(self.disparity, self.camera)

    @property
    def sigma(self) -> Array:
        """Own standard uncertainty of the distance, mm; without what all places share."""
        slope = derivatives(self.disparity, self.camera).by_disparity
        return np.abs(slope) * self.disparity_sigma

    @property
    def density(self) -> float:
        """Share of the places that two microlenses see which have a value."""
        return float((np.isfinite(self.disparity) & self.seen).sum() / max(int(self.seen.sum()), 1))

    def common_sigma(self, disparity: float) -> float:
        """Standard uncertainty in mm that all places share, by the camera's lengths; 0 where none
        is stated.
        """
        if self.covariance is None:
            return 0.0
        at = derivatives(np.array(disparity), self.camera)
        slopes = np.array([at.by_focal_length, at.by_array_distance, at.by_gap], dtype=np.float64)
        return math.sqrt(float(slopes @ self.covariance @ slopes))

    def directions(self) -> tuple[Array, Array]:
        """Slopes (x, y) of the rays from the main lens's centre to the places: object (x, y) over
        distance; shapes (columns,) and (rows,), before distortion.
        """
        rows, columns = self.grid.shape
        scale = self.camera.sensor.pixel / self.camera.optical_distance
        x = self.grid.first[0] + self.grid.step * np.arange(columns)
        y = self.grid.first[1] + self.grid.step * np.arange(rows)
        return -scale * x.astype(np.float64), -scale * y.astype(np.float64)

    def points(self) -> Array:
        """The cloud: object x, y, distance z, own sigma of z in mm, and intensity; shape (n, 5)."""
        z = self.distance
        good = np.isfinite(z) & np.isfinite(self.focus)
        x, y = (part[good] for part in np.meshgrid(*self.directions()))
        slopes = undistorted(np.column_stack([x, y]), z[good], self.camera.main_lens)
        place = slopes * z[good][:, None]
        return np.column_stack([place, z[good], self.sigma[good], self.focus[good]])

    def summary(self) -> dict[str, Any]:
        """What ``depth.json`` holds; lengths in mm, None where there is no value."""
        has = np.isfinite(self.disparity)
        middle = float(np.median(self.disparity[has])) if has.any() else None
        figures: dict[str, Any] = {"distance_mm": None, "sigma_mm": None, "common_mm": None}
        slopes: dict[str, float] | None = None
        if middle is not None:
            at = derivatives(np.array(middle), self.camera)
            slopes = {
                "disparity": float(at.by_disparity),
                "focal_length": float(at.by_focal_length),
                "array_distance": float(at.by_array_distance),
                "gap": float(at.by_gap),
            }
            low, centre, high = np.quantile(self.distance[has], [0.01, 0.5, 0.99])
            figures = {
                "distance_mm": {"low": float(low), "median": float(centre), "high": float(high)},
                "sigma_mm": float(np.median(self.sigma[has])),
                "common_mm": None if self.covariance is None else self.common_sigma(middle),
            }
        camera = self.camera
        return {
            "schema": 1,
            "camera": {
                "focal_length_mm": camera.main_lens.focal_length,
                "f_number": camera.main_lens.f_number,
                "array_distance_mm": camera.optical_distance,
                "gap_mm": camera.optical_gap,
                "pixel_mm": camera.sensor.pixel,
            },
            "searched_mm": [self.searched[0], finite(self.searched[1])],
            "grid": {
                "rows": self.grid.shape[0],
                "columns": self.grid.shape[1],
                "first_px": list(self.grid.first),
                "step_px": self.grid.step,
            },
            "values": int(has.sum()),
            "density": self.density,
            **figures,
            "derivatives_at_median": slopes,
            "covariance_mm2": None if self.covariance is None else self.covariance.tolist(),
            "remarks": [note.sentence for note in self.remarks],
            "remark_codes": [note.code for note in self.remarks],
        }

    def save(self, folder: Path | str) -> list[Path]:
        """Write depth.tif, focus.png, cloud.ply, depth.json and depth.html into a folder.

        Raises:
            InputError: one cannot be written; then none is.
        """
        pages = {
            "distance_mm": self.distance,
            "sigma_mm": self.sigma,
            "disparity": self.disparity,
            "disparity_sigma": self.disparity_sigma,
            "views": np.where(np.isfinite(self.disparity), self.views, np.nan),
        }
        page = depth_page(self.distance, self.sigma, self.focus, self.directions(), self.summary())
        return write_depth_files(
            Path(folder), pages, self.focus, self.points(), self.summary(), page
        )

    def _repr_html_(self) -> str:
        return small_table(self.summary())


def finite(value: float) -> float | None:
    """The value, or None for infinity, which JSON does not know."""
    return value if math.isfinite(value) else None
