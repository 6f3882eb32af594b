"""The first-order model against exact rays through real thick lenses: where it holds to 1 %, and
where not.

What is left between them is what first order leaves out: the aberrations of main lens and
microlens, and a stop that does not lie in the main lens's principal plane.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from flflab.accuracy.lenses import MAIN_LENSES
from flflab.accuracy.thick import scaled
from flflab.accuracy.thick_camera import Setting, ThickCamera, aim, build
from flflab.optics.focus import blur, marginal_angle, microlens_limits, virtual_depth
from flflab.optics.smms import image_offset, sensor_crossing
from flflab.whole_file import write_csv

Array = npt.NDArray[np.float64]

FOCAL_LENGTH, PITCH, PIXEL = (
    50.0,
    0.4,
    0.00166,
)  # mm: the main lens, the array and the sensor of the paper
SHARE = 0.01  # of its scale that a difference may be for the model to hold
ACROSS = np.linspace(-1, 1, 9)  # of an aperture: rays that find how wide a blur is


@dataclass(frozen=True)
class Quantity:
    """One thing the model says: its name, the unit of its values, and in words what a difference is
    held against.
    """

    name: str
    unit: str
    against: str


@dataclass(frozen=True)
class Comparison:
    """A quantity by the model and by exact rays, and the largest difference at which the model
    holds; arrays of one shape.
    """

    model: Array
    exact: Array
    limit: Array

    @property
    def excess(self) -> Array:
        """|exact - model| over the limit: up to 1 the model holds; nan where no ray gets
        through.
        """
        return np.abs(self.exact - self.model) / self.limit


@dataclass(frozen=True)
class Sweep:
    """Settings along one or two axes with every quantity compared.

    Attributes:
        lens: name of the main lens.
        varied: what varies, as in ``Setting``: one name, or f_number and field.
        setting: the settings.
        comparisons: by name of the quantity.
    """

    lens: str
    varied: tuple[str, ...]
    setting: Setting
    comparisons: dict[str, Comparison]


QUANTITIES = (
    Quantity("micro-image centre", "mm", "the pitch of the micro-images"),
    Quantity("outside radius", "mm", "the outside radius"),
    Quantity("inside radius", "mm", "the outside radius"),
    Quantity("view position", "mm", "the pitch of the micro-images"),
    Quantity("virtual depth", "1", "the virtual depth"),
    Quantity("marginal angle", "rad", "the angle"),
    Quantity("blur", "mm", "one pixel, all of it: a blur of nothing has no percentage"),
)
F_NUMBERS = np.geomspace(2.0, 22.0, 17)
FIELDS = np.linspace(0.0, 10.0, 17)
TYPICAL = Setting(
    scaled(MAIN_LENSES["plano-convex"], FOCAL_LENGTH), f_number=4.0, field=3.0
)  # of the lines, the main lens changed
LINES: dict[str, Array] = {
    "distance": np.linspace(420.0, 660.0, 25),
    "gap": np.linspace(1.03, 1.45, 22),
    "aperture": np.geomspace(0.03, 0.4, 21),
}


def compare(setting: Setting) -> dict[str, Comparison]:
    """Every quantity compared, by name.

    The target's point is the one whose light through the middle of the stop goes to the microlens's
    centre. Its views are looked at through microlenses so far to both sides that their chief rays
    cross the stop half way out; the virtual depth is that of their parallax.
    """
    camera = build(setting)
    smms, vergence = camera.smms, camera.vergence
    y, half_stop, half_lens = smms.centre_x, smms.lens_aperture / 2, smms.aperture / 2
    pitch = SHARE * PITCH * smms.image_scale
    centre = aim(camera, y, q=y, m=0 * y)
    corners = np.sort(
        [aim(camera, y, q=y + i * half_lens, m=j * half_stop).s for i in (-1, 1) for j in (-1, 1)],
        axis=0,
    )
    point, aside = -y / (smms.distance * vergence), image_offset(smms, vergence) * half_stop / 2
    below, above = (aim(camera, y + step, q=y + step, o=point).s for step in (-aside, aside))
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = 1 / np.abs((above - below) / (2 * aside) - 1)
    compared = (
        Comparison(y * smms.image_scale, centre.s, pitch),
        Comparison(smms.outside_radius, (corners[3] - corners[0]) / 2, SHARE * smms.outside_radius),
        Comparison(smms.inside_radius, (corners[2] - corners[1]) / 2, SHARE * smms.outside_radius),
        Comparison(sensor_crossing(smms, half_stop / 2, y + aside, y + aside), above, pitch),
        Comparison(virtual_depth(smms, vergence), depth, SHARE * virtual_depth(smms, vergence)),
        Comparison(
            marginal_angle(smms), _marginal_angle(camera, centre.s), SHARE * marginal_angle(smms)
        ),
        Comparison(blur(smms, vergence), _blur(camera, point), np.full_like(y, PIXEL)),
    )
    return {
        quantity.name: comparison for quantity, comparison in zip(QUANTITIES, compared, strict=True)
    }


def _blur(camera: ThickCamera, point: Array) -> Array:
    """Width on the sensor of what reaches it of a target point through the narrower of the two
    stops, mm.
    """
    smms = camera.smms
    limits = microlens_limits(smms, camera.vergence)
    return np.ptp([through(camera, limits, share, o=point)[0] for share in ACROSS], axis=0)


def _marginal_angle(camera: ThickCamera, place: Array) -> Array:
    """Opening of the cone on a place of the sensor, rad, in the air before it."""
    smms = camera.smms
    limits = smms.aperture * np.abs(smms.kappa) <= smms.lens_width
    low, high = (through(camera, limits, share, s=place)[1] for share in (-1.0, 1.0))
    return np.abs(high - low)


def through(
    camera: ThickCamera, by_microlens: npt.NDArray[np.bool_], share: float, **wanted: Array
) -> tuple[Array, Array]:
    """Landing places and angles of rays at a share of the half width of the stop that limits, and
    with one more condition.
    """
    smms = camera.smms
    one = aim(camera, smms.centre_x, q=smms.centre_x + share * smms.aperture / 2, **wanted)
    other = aim(camera, smms.centre_x, m=share * smms.lens_aperture / 2, **wanted)
    return np.where(by_microlens, one.s, other.s), np.where(by_microlens, one.angle, other.angle)


def sweep_model(tell: Callable[[str], None]) -> tuple[Sweep, ...]:
    """Compare every main lens over f-number and field height in focus, and along distance, gap and
    microlens aperture.

    Args:
        tell: is told what is being done.
    """
    sweeps: list[Sweep] = []
    for name, lens in MAIN_LENSES.items():
        tell(name)
        fitted = scaled(lens, FOCAL_LENGTH)
        over = Setting(fitted, F_NUMBERS[:, None], FIELDS[None, :])
        sweeps.append(Sweep(name, ("f_number", "field"), over, compare(over)))
        for varied, values in LINES.items():
            along = replace(TYPICAL, lens=fitted, **{varied: values})
            sweeps.append(Sweep(name, (varied,), along, compare(along)))
    return tuple(sweeps)


def write_sweeps(sweeps: Sequence[Sweep], file: Path) -> None:
    """Write every comparison as CSV, one row a camera and quantity; ``excess`` is the difference
    over the limit.
    """
    units = {quantity.name: quantity.unit for quantity in QUANTITIES}
    cameras = ("f_number", "field_mm", "array_mm", "gap_mm", "microlens_aperture_mm", "distance_mm")
    rows: list[list[object]] = [
        [
            "lens",
            "varied",
            *cameras,
            "quantity",
            "unit",
            "model",
            "exact",
            "limit",
            "excess",
            "holds",
        ]
    ]
    for sweep in sweeps:
        camera = build(sweep.setting)
        smms = camera.smms
        f_number = smms.lens_focal / smms.lens_aperture
        columns = [
            column.ravel()
            for column in (
                f_number,
                smms.centre_x,
                smms.distance,
                smms.gap,
                smms.aperture,
                1 / camera.vergence,
            )
        ]
        for name, one in sweep.comparisons.items():
            for *where, model, exact, limit, excess in zip(
                *columns,
                one.model.ravel(),
                one.exact.ravel(),
                one.limit.ravel(),
                one.excess.ravel(),
                strict=True,
            ):
                told = [f"{value:.8g}" for value in (model, exact, limit, excess)]
                place = [f"{value:.6g}" for value in where]
                rows.append(
                    [
                        sweep.lens,
                        "+".join(sweep.varied),
                        *place,
                        name,
                        units[name],
                        *told,
                        int(excess <= 1),
                    ]
                )
    write_csv(file, rows)
