"""What is to be formed of one flat target: the pupils, and where on the target every ray through
them ends.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.image.effects.motion import Motion
from flflab.image.geometry.pupil import Pupils, camera_pupils
from flflab.image.geometry.rays import is_straight, linearised
from flflab.image.geometry.rim import Rims, find_rims
from flflab.image.geometry.tiles import blur_of, counts_needed, cut, holding, middles, windows_of
from flflab.image.scene import ALL, Plane, Scene
from flflab.optics.camera import Camera, Sensor

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

MAP_SHARE = 0.2  # of the tolerance, for each way in which a map is not linear


@dataclass(frozen=True)
class Setup:
    """A camera before one target, as a list of entries: each is a microlens, or a part of its
    micro-image.

    Within an entry the ray from the sensor point e (mm from the micro-image's centre) through the
    pupil point t ends on the target, in the target's own axes, at origin + by_pupil t + by_sensor
    e.

    Attributes:
        sensor: the sensor.
        pupils: the sensor side of every entry; N entries.
        origin: mm on the target (rad where it is at infinity), shape (N, 2).
        by_pupil: the same per unit of pupil, shape (N, 2, 2).
        by_sensor: the same per mm on the sensor, shape (N, 2, 2).
        by_motion: the same per mm that the target moves across the axis, shape (N, 2, 2).
        window: the part of the sensor an entry may light: first column, column after the last,
            first row, row after the last; (N, 4).
        rims: the kinds of rims of the micro-images.
        blur: diameter on the sensor of the blur of a point, pixels, shape (N,).
        crooked: entries in which rays through one sensor point end elsewhere than any linear map
            says, by more than the tolerance allows; shape (N,).
        tolerance: largest error asked for.
        overlap: how many micro-images reach a sensor point, at least 1; the errors of their strips
            add up.
        pixel_width: side of the square over which a pixel gathers light, mm; 0 for its centre
            alone.
        falloff: whether rays count by cos^4 of their slopes at the sensor.
        motion: of the target during the exposure, where it is to be formed with the light instead
            of moment by moment.
        moments: parts of the exposure's even drift and of the vibration's amplitude at moments of
            equal shares, shape (2, M); None for the whole exposure.
    """

    sensor: Sensor
    pupils: Pupils
    origin: Array
    by_pupil: Array
    by_sensor: Array
    by_motion: Array
    window: Whole
    rims: Rims
    blur: Array
    crooked: npt.NDArray[np.bool_]
    tolerance: float
    overlap: float
    pixel_width: float
    falloff: bool = False
    motion: Motion | None = None
    moments: Array | None = None

    def seen_from(self, x: float, y: float) -> "Setup":
        """The same with the target's coordinates counted from (x, y)."""
        return replace(self, origin=self.origin - np.array([x, y]))

    def kind_blur(self, largest: bool) -> Array:
        """The largest or smallest blur among the entries of each kind of rim, pixels; 0 where a
        kind has none.
        """
        found = np.full(len(self.rims.width), -math.inf if largest else math.inf)
        (np.maximum if largest else np.minimum).at(found, self.rims.kind, self.blur)
        found[np.bincount(self.rims.kind, minlength=len(found)) == 0] = 0.0
        return found

    def reaching(self, wanted: npt.NDArray[np.bool_]) -> "Setup":
        """The entries in whose windows there are wanted pixels, [row, column]."""
        entries = np.flatnonzero(holding(wanted, self.window))
        return self.of(entries, self.window[entries])

    def of(self, entries: Whole, windows: Whole) -> "Setup":
        """Some of the entries, any number of times each, within these windows."""
        return replace(
            self,
            pupils=self.pupils.of(entries),
            origin=self.origin[entries],
            by_pupil=self.by_pupil[entries],
            by_sensor=self.by_sensor[entries],
            by_motion=self.by_motion[entries],
            window=windows,
            rims=replace(self.rims, kind=self.rims.kind[entries]),
            blur=self.blur[entries],
            crooked=self.crooked[entries],
        )


def make_setup(
    scene: Scene, plane: Plane, tolerance: float, effects: frozenset[str] = ALL
) -> Setup:
    """Set up a scene's camera before one of its planes; microlenses that light no pixel are left
    out.

    Raises:
        InputError: the distortion folds the picture over, or a tilted plane or array reaches too
            far.
    """
    sensor = scene.camera.sensor
    pupils = camera_pupils(scene.camera, 1 / plane.distance, scene.scatter)
    slope = np.where(np.abs(pupils.slope) < 1e-6 * sensor.pixel, 0.0, pupils.slope)
    pupils = replace(pupils, slope=slope if "vignetting" in effects else np.zeros_like(slope))
    if "defocus" not in effects:
        pupils = replace(pupils, lens_spread=np.zeros_like(slope), spread=np.zeros_like(slope))
    windows = windows_of(sensor, pupils, "overlap" in effects)
    overlap = max(1.0, _coverage(scene.camera, pupils)) if "overlap" in effects else 1.0
    seen = np.flatnonzero((windows[:, 0] < windows[:, 1]) & (windows[:, 2] < windows[:, 3]))
    pupils, windows = pupils.of(seen), windows[seen]
    rims = find_rims(pupils, sensor.pixel)
    crooked, middle = np.zeros(len(seen), dtype=np.bool_), np.zeros((len(seen), 2))
    if not is_straight(plane, scene.distortion):
        counts, crooked = counts_needed(
            sensor, pupils, windows, plane, scene.distortion, MAP_SHARE * tolerance
        )
        entries, windows = cut(windows, counts)
        pupils, crooked, rims = (
            pupils.of(entries),
            crooked[entries],
            replace(rims, kind=rims.kind[entries]),
        )
        middle = middles(sensor, pupils, windows)[0]
    landing = linearised(pupils, plane, scene.distortion, middle)
    return Setup(
        sensor=sensor,
        pupils=pupils,
        origin=landing.origin,
        by_pupil=landing.by_pupil,
        by_sensor=landing.by_sensor,
        by_motion=landing.by_motion,
        window=windows,
        rims=rims,
        blur=blur_of(landing.by_pupil, landing.by_sensor, sensor.pixel),
        crooked=crooked,
        tolerance=tolerance,
        overlap=overlap,
        pixel_width=sensor.pixel if "pixel" in effects else 0.0,
        falloff=scene.falloff is not None,
        motion=scene.motion,
    )


def _coverage(camera: Camera, pupils: Pupils) -> float:
    """How many micro-images reach a sensor point on average."""
    row = math.sqrt(3) / 2 if camera.array.layout == "hexagonal" else 1.0
    cell = (
        camera.array.pitch[0]
        * camera.array.pitch[1]
        * row
        * (camera.sensor.distance / camera.array.distance) ** 2
    )
    return math.pi * float(np.max(pupils.outside)) ** 2 / cell
