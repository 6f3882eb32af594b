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
from scipy.ndimage import map_coordinates
from scipy.special import j1

from flflab.image.bands import go_on, in_bands
from flflab.image.fast.form import Upright, add_upright, share_tables
from flflab.image.fast.lines import Sampling, seen_through
from flflab.image.fast.profile import EVEN, Profile, mean_over_two, profile_of
from flflab.image.fast.share import look_up, share_over
from flflab.image.microlenses import Record
from flflab.image.scene import Scene
from flflab.optics.camera import pixel_positions
from flflab.optics.diffraction import pupil_transfer
from flflab.targets import Bars, Edge, FourDot

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

RADII, ANGLES = 16, 13  # of a table: from where nothing is clipped to the edge, from 0 to pi
LAST = 1 - 1e-4  # of the micro-image's radius: beyond it there is no pupil
STEPS = 16  # a pixel, along the target
TAIL = 48.0  # pixels; further from a target's end light is as dark, or as bright, as beyond
BLURRED = 120.0  # pixels; a wider blur leaves nothing fine that light could bend
DOT_STEPS = 4  # a pixel, of a dot's image
DOT_PLACES = 8  # a pixel, from a dot's centre
DOT_TAIL = 60.0  # pixels round a dot and its blur: its light falls as 1/r^3 and repeats itself
DOT_RADII, DOT_ANGLES = 32, 25  # of a table of dots, whose tables are few
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


def add_with_waves(
    image: Array, scene: Scene, made: Upright, wavelength: float, pixel: float
) -> None:
    """Add the light of a prepared target in light of one wavelength (mm), without fall-off."""
    side = scene.camera.sensor.pixel
    tables = share_tables(made.lenses, side, made)
    rays: list[int] = []
    for kind in kinds_of(made, wavelength):
        go_on()
        blurred = DOT_BLURRED if isinstance(made.target, FourDot) else BLURRED
        if 2 * abs(kind.blur) > blurred * side or kind.sensor == 0.0:
            rays += kind.indices.tolist()
        else:
            _add_kind(image, scene, made, kind, tables, pixel)
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


def _add_kind(
    image: Array, scene: Scene, made: Upright, kind: Kind, tables: list[Array], pixel: float
) -> None:
    """Add the light of microlenses of one kind, read from a table of images."""
    side, target, first = scene.camera.sensor.pixel, made.target, int(kind.indices[0])
    centres, seeing = np.zeros((0, 2)), kind.indices.tolist()
    if isinstance(target, FourDot):
        radius, centres = target.diameter / 2 / abs(kind.sensor), target.centres
        reach = radius + abs(kind.blur) + DOT_TAIL * side
        seeing = [index for index in seeing if _sees(made, index, centres, reach)]
        if not seeing:
            return
        places, light = dot_table(kind, radius, side)
    elif isinstance(target, Bars | Edge):
        places, light = line_table(kind, profile_of(target), made, first, side, pixel)
    else:
        return
    xs_ys, radii = pixel_positions(scene.camera.sensor), kind.radii(len(light))
    steps = (places[0], 1 / (places[1] - places[0]), radii[0], 1 / max(radii[1] - radii[0], 1e-300))

    how = made.how[first]._replace(strips=ENDS, weighted=False, pixel=side)

    def form(top: int, bottom: int) -> Iterator[None]:
        for index in seeing:
            _read(
                image, made.lenses[index], made.lines[index], centres, light, steps,
                abs(kind.sensor), tables[index], xs_ys, (top, bottom), how,
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
    sides = sorted(pixel * scale * abs(line[name]) for name in ("cos", "sin"))
    wide = math.hypot(sides[1], made.how[first].smear)
    values = _sampled(profile, places * scale, wide, sides[0])
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


def _sees(made: Upright, index: int, centres: Array, reach: float) -> bool:
    """Whether any dot's image lies within reach (mm) of a microlens's light."""
    lens, line = made.lenses[index], made.lines[index]
    u = (centres[:, 0] - line["origin"]) / line["sensor"]
    v = (centres[:, 1] - line["across"]) / line["across_sensor"]
    return bool((np.hypot(u, v) < lens["reach"] + abs(lens["slope"]) + reach).any())


def dot_table(kind: Kind, radius: float, side: float) -> tuple[Array, Array]:
    """Images of a dot of a radius (mm on the sensor) behind a pixel.

    Returns:
        Places, mm from the dot's centre, shape (X,), and the images at distances of a sensor point
            from the micro-image's centre and angles to its direction, shape (DOT_RADII, DOT_ANGLES,
            X).
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
    places = np.arange(0.0, half - 2 * step, side / DOT_PLACES)
    turned = np.linspace(0, math.pi, DOT_ANGLES)[:, None]
    points = count // 2 + np.stack([np.sin(turned) * places, np.cos(turned) * places]) / step
    light = np.empty((DOT_RADII, DOT_ANGLES, len(places)))
    for index, away in enumerate(kind.radii(DOT_RADII)):
        bent = np.zeros(spectrum.shape, dtype=np.complex64)
        bent[used] = spectrum[used] * kind.transfer(float(away), turn[used], size[used])
        whole = np.concatenate([bent, bent[-2:0:-1]])
        seen = np.fft.fftshift(np.asarray(irfft2(whole, (count, count)), dtype=np.float64))
        light[index] = map_coordinates(seen, points, order=1)
    light[:, :, -1] = 0.0  # black beyond
    return places, light


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _read(
    image: Array,
    lens: Record,
    line: Record,
    centres: Array,
    light: Array,
    steps: tuple[float, float, float, float],
    scale: float,
    table: Array,
    places: tuple[Array, Array],
    rows: tuple[int, int],
    how: Sampling,
) -> None:
    """Add the light of one microlens to some rows, from a table of images.

    Args:
        image: [row, column].
        lens: the microlens.
        line: its map to the target.
        centres: of dots, mm on the target, shape (N, 2); none of a target along one direction.
        light: the table.
        steps: first place and steps to the mm, first distance and steps to the mm.
        scale: target mm per mm on the sensor of the table.
        table: shares of the full cone, empty where pixels are cut into parts.
        places: x of the columns and y of the rows, mm.
        rows: first row, and row after the last.
        how: how finely the target's ends are formed.
    """
    xs, ys = places
    side, near = how.pixel, abs(line.across_pupil) + abs(line.across_sensor) * how.pixel
    reach = lens.reach + abs(lens.slope) + math.sqrt(0.5) * side
    for row in range(max(rows[0], lens.first_row), min(rows[1], lens.end_row)):
        ey = ys[row] - lens.y
        for column in range(lens.first_column, lens.end_column):
            ex = xs[column] - lens.x
            away = math.sqrt(ex * ex + ey * ey)
            if away >= reach:
                continue
            along, aside = ex * line.cos + ey * line.sin, ey * line.cos - ex * line.sin
            u, v = line.origin + line.sensor * along, line.across + line.across_sensor * aside
            seen, beyond = 0.0, abs(v) - how.half_height
            if centres.shape[0] == 0 and beyond < near:
                seen = _known(light, steps, u / scale, away, along)
                if beyond > -near:
                    seen *= seen_through(lens, line, EVEN, ex, ey, side, how)[0]
            for dot in range(centres.shape[0]):
                dx, dy = (
                    (u - centres[dot, 0]) / line.sensor,
                    (v - centres[dot, 1]) / line.across_sensor,
                )
                far = math.sqrt(dx * dx + dy * dy)
                ahead = (dx * along + dy * aside) / far if far > 0.0 else 0.0
                seen += _known(light, steps, far, away, ahead)
            if seen != 0.0:
                if table.size > 0:
                    share = look_up(table, away * away)
                else:
                    share = share_over(ex, ey, side, lens.slope, lens.reach)
                image[row, column] += lens.level * share * seen


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _known(
    light: Array, steps: tuple[float, float, float, float], place: float, away: float, along: float
) -> float:
    """What a table says of a place on an image, for a sensor point that lies ``away`` from the
    micro-image's centre, ``along`` of it in the direction of the place.
    """
    place, last = (place - steps[0]) * steps[1], light.shape[2] - 1
    if place < 0.0 or (place > last and light[0, 0, last] == 0.0):
        return 0.0
    place = min(place, last - 1e-9)
    radius = min(max((away - steps[2]) * steps[3], 0.0), light.shape[0] - 1 - 1e-9)
    turn = math.acos(min(max(along / away, -1.0), 1.0)) if away > 0.0 else 0.0
    turn *= (light.shape[1] - 1) / math.pi
    at, ring, spoke = int(place), int(radius), min(int(turn), light.shape[1] - 2)
    part, out, aside, total = place - at, radius - ring, turn - spoke, 0.0
    for i in range(2):
        for j in range(2):
            weight = (out if i else 1.0 - out) * (aside if j else 1.0 - aside)
            if weight > 0.0:
                known = light[ring + i, spoke + j]
                total += weight * (known[at] * (1.0 - part) + known[at + 1] * part)
    return total
