"""A second stop (cat-eye): a ring behind the main lens, such as the end of its barrel, that clips
the pupils of micro-images on one side, the more the farther they lie from the axis.

It dims a picture as it dims white: rays that it stops inside a blur count like the others.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np

from flflab.errors import InputError
from flflab.image.effects.effect import Array, Finishing, Formed, Record, parameter
from flflab.image.regime import Regime
from flflab.optics.camera import pixel_positions
from flflab.optics.discs import three_disc_area, two_disc_area

PARTS = 3  # of a pixel's side, where the ring clips


@dataclass(frozen=True)
class SecondStop(Finishing):
    """A round opening of ``diameter`` mm, centred ``distance`` mm behind the main lens."""

    distance: float = parameter(unit="mm", above=0)
    diameter: float = parameter(unit="mm", above=0)
    name = "second-stop"
    unit = "mm"
    lit_ns = 300  # areas of three discs in a part of the lit pixels

    def bound(self, regime: Regime) -> float:
        """It may stop all light."""
        return regime.brightest

    def why(self, regime: Regime) -> str:
        """Where it stands."""
        return f"a ring of {self.diameter:.3g} mm stands {self.distance:.3g} mm behind the lens"

    def apply(self, image: Array, formed: Formed) -> None:
        """Multiply every pixel by the share of white that passes.

        Raises:
            InputError: the ring stands behind the array.
        """
        camera = formed.camera
        array, gap = camera.array.distance, camera.sensor.distance - camera.array.distance
        if self.distance >= array:
            raise InputError(
                f"second stop: distance is {self.distance:g} mm; one below {array:g} mm, that of"
                " the microlens array, is due"
            )
        along = self.distance / array
        kept, whole = np.zeros_like(image), np.zeros_like(image)
        xs_ys = pixel_positions(camera.sensor)
        for lens in formed.lenses():
            by_pupil = lens["lens_spread"] * (1 - along) - along * gap * lens["slant_spread"]
            by_sensor = lens["lens_scale"] * (1 - along) + along * (1 - gap * lens["slant_scale"])
            middle = (lens["slant_x"] * self.distance, lens["slant_y"] * self.distance)
            ring = (*middle, float(by_pupil), float(by_sensor), self.diameter / 2)
            _add_shares(kept, whole, lens, ring, xs_ys, camera.sensor.pixel)
        np.divide(kept, whole, out=kept, where=whole > 0)
        image *= np.where(whole > 0, kept, 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add_shares(
    kept: Array,
    whole: Array,
    lens: Record,
    ring: tuple[float, float, float, float, float],
    places: tuple[Array, Array],
    side: float,
) -> None:
    """Add the shares of a microlens's full cone with the ring and without it. A ray of the pupil
    point t and the sensor point e, mm from the micro-image's centre, crosses the ring's plane at
    middle + by_pupil t + by_sensor e.
    """
    xs, ys = places
    middle_x, middle_y, by_pupil, by_sensor, radius = ring
    slope, pupil = max(abs(lens.slope), 1e-9), max(abs(by_pupil), 1e-9)
    signs = 1.0 if lens.slope >= 0 else -1.0, 1.0 if by_pupil >= 0 else -1.0
    reach = lens.reach + abs(lens.slope)
    for row in range(lens.first_row, lens.end_row):
        for column in range(lens.first_column, lens.end_column):
            ex, ey = xs[column] - lens.x, ys[row] - lens.y
            if math.hypot(ex, ey) >= reach + side:
                continue
            far = math.hypot(middle_x + by_sensor * ex, middle_y + by_sensor * ey)
            parts = 1 if far + pupil + abs(by_sensor) * side < radius else PARTS
            for index in range(parts * parts):
                x = ex + side * ((index % parts + 0.5) / parts - 0.5)
                y = ey + side * ((index // parts + 0.5) / parts - 0.5)
                away = math.hypot(x, y) / slope
                share = two_disc_area(1.0, lens.reach / slope, away) * lens.level / parts**2
                whole[row, column] += share
                if parts > 1 and share > 0.0:
                    share = three_disc_area(
                        0.0, 0.0, 1.0,
                        signs[0] * x / slope, signs[0] * y / slope, lens.reach / slope,
                        -signs[1] * (middle_x + by_sensor * x) / pupil,
                        -signs[1] * (middle_y + by_sensor * y) / pupil, radius / pupil,
                    ) * lens.level / parts**2  # fmt: skip
                kept[row, column] += share
