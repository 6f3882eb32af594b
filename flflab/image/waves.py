"""Light of one wavelength: the scalar Fresnel image of one upright target through every microlens's
clipped, defocused pupil, by tables.

The transfer function of a pupil depends on how far a sensor point lies from its micro-image's
centre and in which direction, nothing else. So the image of a target along its direction, or of a
round dot, is tabulated at some distances and directions, and read between them. Light bends, but
none is lost: a picture of white is that of rays.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numba
import numpy as np
import numpy.typing as npt
from scipy.fft import irfft2
from scipy.special import j1

from flflab.errors import InputError
from flflab.image.bands import go_on, in_bands
from flflab.image.fast.form import Upright, add_upright, share_tables
from flflab.image.fast.lines import Lines, Sampling, seen_through
from flflab.image.fast.profile import Profile, mean_over_two, profile_of, stripe
from flflab.image.fast.share import look_up, share_over
from flflab.image.microlenses import Record
from flflab.image.scene import Scene
from flflab.optics.camera import pixel_positions
from flflab.optics.diffraction import pupil_transfer
from flflab.targets import Bars, Edge, FourDot, White

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

RADII, ANGLES = 16, 13  # of a table: from where nothing is clipped to the edge, from 0 to pi
LAST = 1 - 1e-4  # of the micro-image's radius: beyond it there is no pupil
STEPS = 16  # a pixel, along the target
TAIL = 48.0  # pixels; further from a target's end light is as dark, or as bright, as beyond
BLURRED = 120.0  # pixels; a wider blur leaves nothing fine that light could bend
DOT_STEPS = 4  # a pixel, of a dot's image
DOT_TAIL = 60.0  # pixels round a dot and its blur: its light falls as 1/r^3 and repeats itself
DOT_RADII = 32  # of a table of dots, whose tables are few
DOT_BLURRED = 24.0  # pixels; a dot of a wider blur is one of rays
ENDS = 12  # strips across the pupil where it sees an end of the target
FREQUENCIES = 96  # at which a transfer function is worked out, at least
ALIKE = 2e-3  # of their size: microlenses that differ by less share a table


@dataclass(frozen=True)
class Kind:
    """Microlenses with one pupil and one map to the target; lengths in mm on the sensor.

    Attributes:
        indices: which microlenses.
        slope: of the clipping edge, without sign.
        reach: radius of the shadow.
        blur: radius of the geometric blur, signed for the clipping edge's sign.
        cutoff: where the whole pupil's transfer ends, cycles/mm.
        sensor: target mm per mm.
    """

    indices: npt.NDArray[np.int64]
    slope: float
    reach: float
    blur: float
    cutoff: float
    sensor: float

    def radii(self, count: int) -> Array:
        """Distances from the micro-image's centre at which images are tabulated."""
        inner, outer = max(0.0, self.reach - self.slope), self.reach + self.slope
        return inner + (outer * LAST - inner) * np.linspace(0, 1, count)

    def transfer(self, radius: float, angle: Array, frequency: Array) -> ComplexArray:
        """Transfer functions at a distance from the centre, for angles between the direction to the
        sensor point and the frequency, cycles/mm.
        """
        off, clip = 0.0, 2.0
        if self.slope > 0:
            off, clip = radius / self.slope, self.reach / self.slope
        return pupil_transfer(
            2 * frequency / self.cutoff,
            frequency * self.blur,
            off * np.cos(angle),
            off * np.sin(angle),
            clip,
            rows=10,
        )


def add_with_waves(image: Array, scene: Scene, made: Upright, pixel: float) -> None:
    """Add the light of a prepared target in light of the scene's wavelength, without fall-off.

    Raises:
        InputError: the target is none of bars, chirp, edge, dots and white.
    """
    if isinstance(made.target, White):
        add_upright(image, scene, made)
        return
    if not isinstance(made.target, Bars | Edge | FourDot) or scene.diffraction is None:
        raise InputError(
            f"render: a {made.target.kind} in light of one wavelength cannot be formed; bars,"
            " chirp, edge, four-dot and white can, or leave the wavelength out"
        )
    side = scene.camera.sensor.pixel
    tables = share_tables(made.lenses, side, made)
    rays: list[int] = []
    for kind in kinds_of(made, scene.diffraction.wavelength):
        go_on()
        blurred = DOT_BLURRED if isinstance(made.target, FourDot) else BLURRED
        if 2 * abs(kind.blur) > blurred * side or kind.sensor == 0.0:
            rays += kind.indices.tolist()
        elif isinstance(made.target, FourDot):
            _add_dots(image, scene, made, kind, tables)
        else:
            _add_lines(image, scene, made, kind, tables, pixel)
    if rays:
        chosen = np.array(sorted(rays))
        part = replace(
            made,
            lenses=made.lenses[chosen],
            lines=made.lines[chosen],
            how=tuple(made.how[index]._replace(weighted=False) for index in chosen),
        )
        add_upright(image, scene, part)


def kinds_of(made: Upright, wavelength: float) -> list[Kind]:
    """Microlenses sorted by what their tables depend on, all but equal ones together."""
    lenses, lines = made.lenses, made.lines
    slope, reach = np.abs(lenses["slope"]), lenses["reach"]
    with np.errstate(divide="ignore", invalid="ignore"):
        blur = np.where(lines["sensor"] == 0.0, math.inf, lines["pupil"] / lines["sensor"])
    blur = np.where(lenses["slope"] < 0, -blur, blur)
    cutoff = 2 * np.abs(lenses["slant_spread"]) / wavelength
    scale = np.maximum(slope + reach, 1e-300)
    close = np.stack(
        [
            slope / scale,
            blur / scale,
            np.log(cutoff),
            lines["sensor"] / np.abs(lines["sensor"]).max(),
        ]
    )
    keys = np.rint(np.clip(close / ALIKE, -1e9, 1e9)).astype(np.int64).T
    _, which = np.unique(keys, axis=0, return_inverse=True)
    found: list[Kind] = []
    for number in range(int(which.max(initial=-1)) + 1):
        indices = np.flatnonzero(which.ravel() == number)
        means = (
            float(part[indices].mean()) for part in (slope, reach, blur, cutoff, lines["sensor"])
        )
        found.append(Kind(indices, *means))
    return found


def sideways(lines: Lines) -> Lines:
    """The maps across the target's direction, as if they lay along it."""
    turned = np.zeros_like(lines)
    turned["origin"], turned["sensor"] = lines["across"], lines["across_sensor"]
    turned["pupil"], turned["cos"], turned["sin"] = (
        lines["across_pupil"],
        -lines["sin"],
        lines["cos"],
    )
    return turned


def _add_lines(
    image: Array, scene: Scene, made: Upright, kind: Kind, tables: list[Array], pixel: float
) -> None:
    """Add the light of a target that varies along one direction."""
    if not isinstance(made.target, Bars | Edge):
        return
    profile = profile_of(made.target)
    side, first = scene.camera.sensor.pixel, int(kind.indices[0])
    places, light = line_table(kind, profile, made, first, side, pixel)
    xs_ys = pixel_positions(scene.camera.sensor)
    radii = kind.radii(RADII)
    steps = (places[0], 1 / (places[1] - places[0]), radii[0], 1 / max(radii[1] - radii[0], 1e-300))

    upward, how = sideways(made.lines), made.how[first]._replace(strips=ENDS, weighted=False)
    height = stripe(how.half_height if math.isfinite(how.half_height) else 1.0)
    how = how._replace(pixel=side)

    def form(top: int, bottom: int) -> Iterator[None]:
        for index in kind.indices:
            _read_lines(
                image, made.lenses[index], made.lines[index], upward[index], light, steps,
                kind.sensor, tables[index], xs_ys, (top, bottom), height, how,
            )  # fmt: skip
            yield

    in_bands(form, image.shape[0])


def line_table(
    kind: Kind, profile: Profile, made: Upright, first: int, side: float, pixel: float
) -> tuple[Array, Array]:
    """Images of a target along its direction, behind a pixel.

    Returns:
        Places, mm on the sensor from the image of the target's centre, shape (X,), and the images
            at distances and angles, shape (RADII, ANGLES, X).
    """
    scale, line = abs(kind.sensor), made.lines[first]
    ends = profile.pieces[[0, -1], 0] / scale
    margin = 2 * abs(kind.blur) + TAIL * side
    boundless = isinstance(made.target, Edge)
    low, high = ends[0] - margin, ends[1] + margin
    step = side / STEPS
    count = 1 << math.ceil(math.log2((high - low) / step * (4 if boundless else 1) + 1))
    places = low + step * np.arange(count)
    box, other = (pixel * scale * max(part) for part in ((abs(line["cos"]), abs(line["sin"])),) * 2)
    other = pixel * scale * min(abs(line["cos"]), abs(line["sin"]))
    smear = made.how[first].smear
    values = _sampled(profile, places * scale, math.hypot(box, smear), other)
    if boundless:  # a second edge far away closes the circle
        values[count // 2 :] = 1 - values[: count - count // 2]
    spectrum = np.fft.rfft(values)
    frequency = np.fft.rfftfreq(count, step)
    # Places rise with the target's own coordinate: against the sensor's where that is negative.
    turn = 0.0 if kind.sensor > 0 else math.pi
    angles = np.linspace(0, math.pi, ANGLES)
    nodes = np.linspace(
        0, kind.cutoff, max(FREQUENCIES, math.ceil(40 * abs(kind.blur) * kind.cutoff))
    )
    used = int(np.searchsorted(frequency, kind.cutoff))
    keep = min(count, math.ceil((high - low) / step) + 1)
    light = np.empty((RADII, ANGLES, keep))
    for place, radius in enumerate(kind.radii(RADII)):
        for index, angle in enumerate(angles):
            known = kind.transfer(float(radius), np.asarray(angle + turn), nodes)
            transfer = np.interp(frequency[:used], nodes, known.real) + 1j * np.interp(
                frequency[:used], nodes, known.imag
            )
            bent = np.zeros_like(spectrum)
            bent[:used] = spectrum[:used] * transfer
            light[place, index] = np.fft.irfft(bent, count)[:keep]
    return places[:keep], light


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sampled(profile: Profile, places: Array, box: float, other: float) -> Array:
    values = np.empty(places.size)
    for index in range(places.size):
        values[index] = mean_over_two(profile, places[index], box, other)[0]
    return values


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _read_lines(
    image: Array,
    lens: Record,
    line: Record,
    upward: Record,
    light: Array,
    steps: tuple[float, float, float, float],
    scale: float,
    table: Array,
    places: tuple[Array, Array],
    rows: tuple[int, int],
    height: Profile,
    how: Sampling,
) -> None:
    """Add the light of one microlens to some rows, from a table of images.

    Args:
        image: [row, column].
        lens: the microlens.
        line: its map to the target along its direction.
        upward: the same across it.
        light: the table.
        steps: first place and steps to the mm, first distance and steps to the mm.
        scale: target mm per mm on the sensor of the table.
        table: shares of the full cone, empty where pixels are cut into parts.
        places: x of the columns and y of the rows, mm.
        rows: first row, and row after the last.
        height: what the target is across its direction.
        how: how finely its ends are formed.
    """
    xs, ys = places
    last, side = light.shape[2] - 1, how.pixel
    reach = lens.reach + abs(lens.slope) + math.sqrt(0.5) * side
    near = abs(line.across_pupil) + abs(line.across_sensor) * side
    for row in range(max(rows[0], lens.first_row), min(rows[1], lens.end_row)):
        ey = ys[row] - lens.y
        for column in range(lens.first_column, lens.end_column):
            ex = xs[column] - lens.x
            squared = ex * ex + ey * ey
            if squared >= reach * reach:
                continue
            if table.size > 0:
                share = look_up(table, squared)
            else:
                share = share_over(ex, ey, side, lens.slope, lens.reach)
            up = line.across + line.across_sensor * (ey * line.cos - ex * line.sin)
            if share <= 0.0 or abs(up) - how.half_height >= near:
                continue
            if abs(up) - how.half_height > -near:
                share *= seen_through(lens, upward, height, ex, ey, side, how)[0]
            away = math.sqrt(squared)
            along = ex * line.cos + ey * line.sin
            place = ((line.origin + line.sensor * along) / abs(scale) - steps[0]) * steps[1]
            if place <= 0.0:
                continue
            place = min(place, last - 1e-9)
            at = int(place)
            part = place - at
            radius = min(max((away - steps[2]) * steps[3], 0.0), light.shape[0] - 1 - 1e-9)
            turn = math.acos(min(max(along / away, -1.0), 1.0)) if away > 0.0 else 0.0
            turn *= (light.shape[1] - 1) / math.pi
            ring, spoke = int(radius), min(int(turn), light.shape[1] - 2)
            out, aside = radius - ring, turn - spoke
            total = 0.0
            for i in range(2):
                for j in range(2):
                    weight = (out if i else 1.0 - out) * (aside if j else 1.0 - aside)
                    if weight > 0.0:
                        known = light[ring + i, spoke + j]
                        total += weight * (known[at] * (1.0 - part) + known[at + 1] * part)
            image[row, column] += lens.level * share * total


def _add_dots(image: Array, scene: Scene, made: Upright, kind: Kind, tables: list[Array]) -> None:
    """Add the light of round dots: their images turn with the direction to the sensor point."""
    target, side = made.target, scene.camera.sensor.pixel
    if not isinstance(target, FourDot):
        return
    radius = target.diameter / 2 / abs(kind.sensor)
    reach = radius + abs(kind.blur) + DOT_TAIL * side
    seeing = [index for index in kind.indices if _sees(made, index, target.centres, reach)]
    if not seeing:
        return
    light = dot_table(kind, radius, side)
    radii = kind.radii(DOT_RADII)
    steps = (side / DOT_STEPS, radii[0], 1 / max(radii[1] - radii[0], 1e-300))
    xs_ys = pixel_positions(scene.camera.sensor)

    def form(top: int, bottom: int) -> Iterator[None]:
        for index in seeing:
            _read_dots(
                image, made.lenses[index], made.lines[index], target.centres, light, steps,
                tables[index], xs_ys, (top, bottom), side,
            )  # fmt: skip
            yield

    in_bands(form, image.shape[0])


def _sees(made: Upright, index: int, centres: Array, reach: float) -> bool:
    """Whether any dot's image lies within reach (mm) of a microlens's light."""
    lens, line = made.lenses[index], made.lines[index]
    u = (centres[:, 0] - line["origin"]) / line["sensor"]
    v = (centres[:, 1] - line["across"]) / line["across_sensor"]
    return bool((np.hypot(u, v) < lens["reach"] + abs(lens["slope"]) + reach).any())


def dot_table(kind: Kind, radius: float, side: float) -> npt.NDArray[np.float32]:
    """Images of a dot of a radius (mm on the sensor) behind a pixel, for sensor points along x, at
    distances from the micro-image's centre; shape (DOT_RADII, rows, columns), the dot in the
    middle.
    """
    step = side / DOT_STEPS
    half = radius + abs(kind.blur) + DOT_TAIL * side
    count = 64 * math.ceil(half / step / 32)  # a length that is fast to transform
    # the picture is the same above and below the direction to the centre: a quarter tells all
    frequency = np.arange(count // 2 + 1) / (count * step)
    fx, fy = np.meshgrid(frequency, frequency)
    size, turn = np.maximum(np.hypot(fx, fy), 1e-9 / side), np.arctan2(fy, fx)
    spectrum = radius * j1(2 * math.pi * radius * size) / size / step**2
    spectrum *= np.sinc(fx * side) * np.sinc(fy * side)
    spectrum /= (np.sinc(fx * step) * np.sinc(fy * step)) ** 2  # what reading between samples takes
    used = size < kind.cutoff
    light = np.empty((DOT_RADII, count, count), dtype=np.float32)
    for index, away in enumerate(kind.radii(DOT_RADII)):
        bent = np.zeros(spectrum.shape, dtype=np.complex64)
        bent[used] = spectrum[used] * kind.transfer(float(away), turn[used], size[used])
        whole = np.concatenate([bent, bent[-2:0:-1]])
        light[index] = np.fft.fftshift(np.asarray(irfft2(whole, (count, count))))
    return light


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _read_dots(
    image: Array,
    lens: Record,
    line: Record,
    centres: Array,
    light: npt.NDArray[np.float32],
    steps: tuple[float, float, float],
    table: Array,
    places: tuple[Array, Array],
    rows: tuple[int, int],
    side: float,
) -> None:
    """Add the dots seen through one microlens to some rows, from a table of images; ``steps`` are
    the table's step, its first distance and its steps to the mm.
    """
    xs, ys = places
    middle = light.shape[1] // 2
    reach = (middle - 2) * steps[0]
    outer = lens.reach + abs(lens.slope) + math.sqrt(0.5) * side
    for dot in range(centres.shape[0]):
        u = (centres[dot, 0] - line.origin) / line.sensor
        v = (centres[dot, 1] - line.across) / line.across_sensor
        x, y = u * line.cos - v * line.sin + lens.x, u * line.sin + v * line.cos + lens.y
        for row in range(max(rows[0], lens.first_row), min(rows[1], lens.end_row)):
            if abs(ys[row] - y) >= reach:
                continue
            for column in range(lens.first_column, lens.end_column):
                dx, dy = xs[column] - x, ys[row] - y
                ex, ey = xs[column] - lens.x, ys[row] - lens.y
                away = math.hypot(ex, ey)
                if dx * dx + dy * dy >= reach * reach or away >= outer:
                    continue
                if table.size > 0:
                    share = look_up(table, away * away)
                else:
                    share = share_over(ex, ey, side, lens.slope, lens.reach)
                if share <= 0.0:
                    continue
                cos, sin = (ex / away, ey / away) if away > 0.0 else (1.0, 0.0)
                across = (dx * cos + dy * sin) / steps[0] + middle
                up = (dy * cos - dx * sin) / steps[0] + middle
                ring = min(max((away - steps[1]) * steps[2], 0.0), light.shape[0] - 1 - 1e-9)
                first = int(ring)
                seen = _between(light[first], up, across) * (1.0 - (ring - first))
                seen += _between(light[first + 1], up, across) * (ring - first)
                image[row, column] += lens.level * share * seen


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _between(known: npt.NDArray[np.float32], row: float, column: float) -> float:
    i, j = int(row), int(column)
    y, x = row - i, column - j
    above = known[i, j] * (1.0 - x) + known[i, j + 1] * x
    below = known[i + 1, j] * (1.0 - x) + known[i + 1, j + 1] * x
    return above * (1.0 - y) + below * y
