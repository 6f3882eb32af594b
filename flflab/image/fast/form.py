"""One flat target without tilt in closed forms: its maps along and across its direction, how finely
its microlenses are formed, and the picture in bands of rows.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.image.bands import in_bands
from flflab.image.effects.motion import Motion
from flflab.image.fast.columns import add_by_columns
from flflab.image.fast.dots import add_dots
from flflab.image.fast.lines import LINE, SHARP, Lines, Sampling, add_pixel_by_pixel
from flflab.image.fast.profile import EVEN, profile_of
from flflab.image.fast.share import STEEP, share_table
from flflab.image.landing import linearised
from flflab.image.microlenses import Lenses, outside
from flflab.image.scene import Plane, Scene
from flflab.optics.camera import pixel_positions
from flflab.targets import Bars, Chirp, Edge, FourDot, Target, White

Array = npt.NDArray[np.float64]

UPRIGHT = 10.0  # times the tolerance: pixels by which a turned column may be off at the edge
KEPT = 0.7  # of the tolerance, by the rules below
# Measured, root mean square of white: n strips leave STRIPS_LEAVE blur (1 + blur / 18) / n^2, the
# first factor at most 1; an edge a tenth. One strip leaves SHARP_LEAVES blur (pixels).
STRIPS_LEAVE = 0.07
OF_AN_EDGE = 0.1
SHARP_LEAVES = 0.04
FALLOFF_LEAVES = 9e-3  # over the square of the strips
FEWEST = 4  # strips, where one is not enough
FINE = 1e-4  # tolerance below which pixels on narrow vignetting edges are cut into more parts
TABLE_LEAVES = 1e-3  # of a vignetting edge, over the power 3/2 of its width in pixels
FINEST = 6e-5  # tolerance that tables keep of what is seen in a blur through a vignetting edge
DOTS_LEAVE = 2.5e-2  # over the blur, up to WIDE pixels, and the square of a pixel's parts
DOTS_SHARP_LEAVE = 0.03  # over the square of the blur, seen through the middle of the pupil
WIDE, WIDEST = 2.5, 2000.0  # pixels: a wider blur is formed like this one
PIECE = 16  # rows between two looks whether anybody waits; columns share work among all


@dataclass(frozen=True)
class Upright:
    """A target before the microlenses that see it, ready to be formed.

    Attributes:
        target: what is pictured.
        lenses: ``MICROLENS`` records of those that light the sensor.
        lines: their maps, ``LINE`` records.
        how: the sampling of each microlens.
        by_columns: whether the target varies along the sensor's columns alone.
        by_rows: whether it varies along its rows alone.
        tabulated: width in pixels from which on a vignetting edge is read from a table; pixels on
            narrower ones are cut into parts.
    """

    target: Target
    lenses: Lenses
    lines: Lines
    how: tuple[Sampling, ...]
    by_columns: bool
    by_rows: bool
    tabulated: float


def upright(
    scene: Scene, plane: Plane, lenses: Lenses, tolerance: float, *, defocus: bool, pixel: float
) -> Upright:
    """Prepare a target.

    Args:
        scene: the scene.
        plane: which of its targets.
        lenses: the microlenses that light the sensor, made for the plane's distance.
        tolerance: root mean square of the error over lit pixels, of white.
        defocus: whether rays through one pixel differ.
        pixel: side over which a pixel gathers light, mm; 0 for its centre alone.
    """
    lines = lines_of(scene, plane, lenses)
    if isinstance(plane.target, White):
        for name in ("origin", "sensor", "pupil"):
            lines[name] = 0.0
    if not defocus:
        lines["pupil"] = lines["across_pupil"] = 0.0
    weighted = scene.falloff is not None
    smear = _smear(scene.motion, plane)
    half_height = plane.target.height / 2 if isinstance(plane.target, Bars) else math.inf
    blur = blur_of(lines, scene.camera.sensor.pixel)
    width = 2 * np.abs(lenses["slope"]) / scene.camera.sensor.pixel
    small = outside(lenses) < STEEP * scene.camera.sensor.pixel
    how = tuple(
        Sampling(
            strips_for(float(one), plane.target, tolerance, weighted),
            parts_for(plane.target, tolerance, float(one), float(edge), bool(least)),
            pixel,
            smear,
            half_height,
            weighted,
        )
        for one, edge, least in zip(blur, width, small, strict=True)
    )
    allowed = UPRIGHT * tolerance * scene.camera.sensor.pixel / outside(lenses).max(initial=1e-9)
    askew, across = (float(np.abs(lines[name]).max(initial=0.0)) for name in ("sin", "cos"))
    bounded = half_height < math.inf
    by_columns = (bounded and askew <= allowed) or isinstance(plane.target, White)
    by_rows = bounded and across <= allowed
    tabulated = tabulated_from(plane.target, tolerance, float(blur.max(initial=0.0)))
    return Upright(plane.target, lenses, lines, how, by_columns, by_rows, tabulated)


def lines_of(scene: Scene, plane: Plane, lenses: Lenses) -> Lines:
    """The maps of microlenses to a target, along its direction and across, to first order round
    each microlens's middle ray.
    """
    landing = linearised(lenses, plane, scene.distortion)
    along = np.array([1.0, 0.0])
    if isinstance(plane.target, Edge):
        along = np.array([math.cos(plane.target.angle), math.sin(plane.target.angle)])
    across = np.array([-along[1], along[0]])
    by_sensor, by_pupil = along @ landing.by_sensor, along @ landing.by_pupil
    sign = np.where(lenses["scale"] != 0.0, np.sign(lenses["scale"]), np.sign(lenses["spread"]))
    vector = np.where(lenses["scale"][:, None] != 0.0, by_sensor, by_pupil) * sign[:, None]
    length = np.hypot(*vector.T)
    towards = np.where(length[:, None] > 0, vector / np.maximum(length, 1e-300)[:, None], along)
    sideways = np.stack([-towards[:, 1], towards[:, 0]], axis=1)
    lines = np.zeros(len(lenses), LINE)
    lines["origin"], lines["across"] = landing.origin @ along, landing.origin @ across
    lines["sensor"] = (by_sensor * towards).sum(axis=1)
    lines["pupil"] = (by_pupil * towards).sum(axis=1)
    lines["across_sensor"] = ((across @ landing.by_sensor) * sideways).sum(axis=1)
    lines["across_pupil"] = ((across @ landing.by_pupil) * sideways).sum(axis=1)
    lines["cos"], lines["sin"] = towards.T
    back = np.where(np.abs(towards[:, 0]) >= np.abs(towards[:, 1]), *towards.T) < 0
    for name in ("sensor", "pupil", "across_sensor", "across_pupil", "cos", "sin"):
        lines[name][back] *= -1  # the same map, counted the other way
    return lines


def blur_of(lines: Lines, pixel: float) -> Array:
    """Diameter on the sensor of the blur of a point, pixels; infinite where a micro-image sees one
    place.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        found = 2 * np.abs(lines["pupil"] / lines["sensor"]) / pixel
    return np.where(lines["pupil"] == 0.0, 0.0, found)


def strips_for(blur: float, target: Target, tolerance: float, weighted: bool) -> int:
    """How many strips across the pupil a tolerance takes, for a blur in pixels."""
    allowed = KEPT * tolerance
    if isinstance(target, FourDot):
        return 1 if DOTS_SHARP_LEAVE * blur**2 <= allowed else FEWEST
    if isinstance(target, White) or SHARP_LEAVES * blur <= allowed:
        return max(FEWEST, math.ceil(math.sqrt(FALLOFF_LEAVES / allowed))) if weighted else 1
    blur = min(blur, WIDEST)
    leaves = STRIPS_LEAVE * min(1.0, blur) * (1 + blur / 18)
    if isinstance(target, Edge):  # fewer pixels see it
        leaves *= min(1.0, OF_AN_EDGE * (1 + blur / 4))
    leaves += FALLOFF_LEAVES if weighted else 0.0
    return min(max(math.ceil(math.sqrt(leaves / allowed)), FEWEST), 1024)


def tabulated_from(target: Target, tolerance: float, blur: float) -> float:
    """Width in pixels from which on a table of shares keeps a tolerance on a vignetting edge; lines
    in a blur need parts of pixels at the finest ones.
    """
    if not isinstance(target, White) and blur > SHARP and tolerance < FINEST:
        return math.inf
    return max(STEEP, (TABLE_LEAVES / (KEPT * tolerance)) ** (2 / 3))


def parts_for(target: Target, tolerance: float, blur: float, edge: float, small: bool) -> int:
    """Parts of a pixel's side: everywhere for dots, else where one point does not stand for it.

    Args:
        target: what is formed.
        tolerance: root mean square, of white.
        blur: of a point, pixels.
        edge: width of the vignetting edge, pixels.
        small: whether the whole micro-image is.
    """
    if isinstance(target, FourDot):
        leaves = DOTS_LEAVE / min(max(blur, SHARP), WIDE)
        return min(max(math.ceil(math.sqrt(leaves / (KEPT * tolerance))), 2), 32)
    if isinstance(target, White):
        return 16 if tolerance <= FINE else 6
    if edge < STEEP:
        least = 8 if tolerance < FINE else 4
        return 16 if small or edge < 1 / 16 else max(math.ceil(1 / edge), least)
    return 2


def add_upright(image: Array, scene: Scene, made: Upright) -> None:
    """Add the light of a prepared target to a picture."""
    if made.by_rows:
        sensor, light = scene.camera.sensor, np.zeros(image.shape[::-1])
        sensor = replace(sensor, resolution=sensor.resolution[::-1], offset=sensor.offset[::-1])
        seen = replace(scene, camera=replace(scene.camera, sensor=sensor))
        add_upright(light, seen, _mirrored(made))
        image += light.T
        return
    target, lenses = made.target, made.lenses
    profile = EVEN
    if isinstance(target, Bars | Chirp | Edge):
        profile = profile_of(target)
    places = pixel_positions(scene.camera.sensor)
    tables = share_tables(lenses, scene.camera.sensor.pixel, made)
    one_by_one = add_by_columns if made.by_columns else add_pixel_by_pixel

    def form(first: int, last: int) -> Iterator[None]:
        for index in range(len(lenses)):
            lens, line, how = lenses[index], made.lines[index], made.how[index]
            top, bottom = max(int(lens["first_row"]), first), min(int(lens["end_row"]), last)
            for row in range(top, bottom, image.shape[0] if made.by_columns else PIECE):
                rows = row, bottom if made.by_columns else min(row + PIECE, bottom)
                if isinstance(target, FourDot):
                    add_dots(
                        image, lens, line, target.centres, target.diameter / 2, tables[index],
                        places, rows, how,
                    )  # fmt: skip
                else:
                    one_by_one(image, lens, line, profile, tables[index], places, rows, how)
                yield

    in_bands(form, image.shape[0])


def _mirrored(made: Upright) -> Upright:
    """What varies along rows, with rows and columns exchanged."""
    lenses, lines = made.lenses.copy(), made.lines.copy()
    for name in ("x", "direction_x", "slant_x", "first_column", "end_column"):
        other = name.replace("_x", "_y").replace("column", "row") if name != "x" else "y"
        lenses[name], lenses[other] = made.lenses[other], made.lenses[name]
    lines["cos"], lines["sin"] = made.lines["sin"], made.lines["cos"]
    for name in ("across_sensor", "across_pupil"):
        lines[name] *= -1
    return replace(made, lenses=lenses, lines=lines, by_columns=True, by_rows=False)


def share_tables(lenses: Lenses, pixel: float, made: Upright) -> list[Array]:
    """A table of shares for each microlens, shared by equal ones; none where the vignetting edge is
    narrow, or pixels are cut into parts wherever one lies.
    """
    known: dict[tuple[float, float, float], Array] = {}
    found: list[Array] = []
    for lens, sampling in zip(lenses, made.how, strict=True):
        wide, reach = abs(float(lens["slope"])), float(lens["reach"])
        if 2 * wide < made.tabulated * pixel:
            found.append(np.zeros(0))
            continue
        key = wide, reach, sampling.pixel
        if key not in known:
            known[key] = share_table(wide, reach, sampling.pixel)
        found.append(known[key])
    return found


def _smear(motion: Motion | None, plane: Plane) -> float:
    """Width of the box that moves as much as the target does along its direction during the
    exposure, mm.
    """
    if motion is None or math.isinf(plane.distance):
        return 0.0
    angle = plane.roll + (plane.target.angle if isinstance(plane.target, Edge) else 0.0)
    along = np.array([math.cos(angle), math.sin(angle)])
    drift, vibration = float(along @ motion.drift), float(along @ motion.vibration)
    return math.sqrt(drift**2 + 6 * vibration**2)
