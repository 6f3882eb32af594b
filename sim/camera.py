"""The simulated camera: exposes the world, draws what it shows, answers docs/scpi-camera.md.

The light: ``electrons_per_second`` reach a pixel at white level of the optics as described; another
configuration gets them in the ratio of the irradiances at white level. At gain 1 a full well is
full scale. The noise of a frame depends on the seed, the state of the world, exposure, gain and how
many frames of just that went before since ``*RST``: a point measured again gives the same frames.
"""

import math
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.effects.hot_pixels import HotPixels
from flflab.image.effects.quantisation import Quantisation
from flflab.image.effects.read_noise import ReadNoise
from flflab.image.effects.saturation import Saturation
from flflab.image.render import render_light
from flflab.image.sensor.exposure import white_irradiance
from flflab.image.sensor.random_numbers import noise_key
from flflab.image.sensor.response import SensorResponse, digitise
from flflab.optics.camera import Camera
from flflab.simulated_light import chosen, falloff_of, light_scenes, require_affordable
from flflab.targets import Target
from sim.faults import Faults
from sim.scpi import (
    BlockError,
    Handler,
    ScpiError,
    decimal,
    limits_or,
    name_among,
    no_parameters,
    number_within,
)
from sim.world import Scene, World, sharp_distance

EXPOSURE = (1e-5, 10.0)  # s
GAIN = (1.0, 16.0)
READOUT = 0.05  # s
BUFFER = 4  # frames
PICTURES = 4  # noise-free pictures kept
COARSE = 16  # pixels of a warm-up's coarse ones, each way


@dataclass(frozen=True)
class Exposure:
    """One exposure: number, start and duration in s of simulated time, gain, and the scene at its
    middle.
    """

    number: int
    start: float
    duration: float
    gain: float

    @property
    def ready(self) -> float:
        """When its frame has been read out, s."""
        return self.start + self.duration + READOUT


class SimulatedCamera:
    """A camera that looks at the world."""

    def __init__(self, world: World, faults: Faults) -> None:
        """Switch on with start-up settings."""
        self.faults = faults
        self.failures: list[str] = []
        self._world, self._light = world, world.bench.description.simulated
        self._falloff = falloff_of(world.bench)
        self._format = f"MONO{self._light.bits}"
        self._lock = threading.RLock()
        self._drawing = threading.Lock()
        self._pictures: dict[tuple[object, ...], npt.NDArray[np.float64]] = {}
        self._reference = white_irradiance(world.optics, self._falloff)
        self.reset()

    def reset(self) -> None:
        """``*RST``."""
        with self._lock:
            self._exposure_time, self._gain = 0.01, 1.0
            self._running: Exposure | None = None
            self._buffer: deque[Exposure | None] = deque()
            self._number = self._dropped = 0
            self._repeats: dict[tuple[object, ...], int] = {}

    def power_up(self) -> None:
        """Power was lost."""
        self.reset()

    def idle_at(self) -> float:
        """When the exposure under way has been read out."""
        with self._lock:
            return self._running.ready if self._running else -np.inf

    def warm_up(self) -> None:
        """Draw and digitise a few pixels of every target as the bench stands, so that all that a
        first frame needs is compiled before.
        """
        now = self._world.scene(self._world.clock.now())
        camera, distance = (
            now.camera or self._world.optics,
            now.distance or sharp_distance(self._world.optics),
        )
        columns, rows = camera.sensor.resolution
        middle = replace(camera.sensor, resolution=(32, 32))
        coarse = replace(
            camera.sensor,
            resolution=(math.ceil(columns / COARSE), math.ceil(rows / COARSE)),
            pixel=camera.sensor.pixel * COARSE,
        )
        for target in self._world.targets.values():
            picture = self._drawn(replace(camera, sensor=middle), target, distance)
            if not picture.any():  # dots stand elsewhere
                picture = self._drawn(replace(camera, sensor=coarse), target, distance)
            digitise(picture, 1000.0, self.response(1.0), noise_key("warm-up"))

    @property
    def commands(self) -> Mapping[str, Handler]:
        """See docs/scpi-camera.md."""
        sensor, light = self._world.optics.sensor, self._light
        facts = {
            "SENSor:SIZE?": f"{sensor.resolution[0]},{sensor.resolution[1]}",
            "SENSor:PITCh?": decimal(sensor.pixel),
            "SENSor:BITS?": str(light.bits),
            "SENSor:FULL?": str(2**light.bits - 1),
            "SENSor:NOISe?": decimal(light.read_noise_electrons),
            "SENSor:OFFSet?": decimal(light.black_level),
            "SENSor:WELL?": decimal(light.full_well_electrons),
            "SENSor:READout?": decimal(READOUT),
            "FORMat?": f'"{self._format}"',
            "FORMat:CATalog?": f'"{self._format}"',
        }
        return {header: _fact(answer) for header, answer in facts.items()} | {
            "SENSor:CONVersion?": self._conversion,
            "FORMat": self._set_format,
            "EXPosure": self._set_exposure,
            "EXPosure?": lambda words, ended: limits_or(words, self._exposure_time, *EXPOSURE),
            "EXPosure:BUSY?": self._exposing,
            "GAIN": self._set_gain,
            "GAIN?": lambda words, ended: limits_or(words, self._gain, *GAIN),
            "INITiate": self._start,
            "FETCh?": self._fetch,
            "FETCh:COUNt?": self._count,
            "FETCh:DROPped?": self._read_dropped,
            "ABORt": self._abort,
        }

    def _conversion(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        return decimal(1 / self.response(self._gain).quantisation.dn_per_electron)

    def _set_exposure(self, parameters: Sequence[str], ended: threading.Event) -> str:
        with self._lock:
            self._refuse_while_exposing("EXP")
            self._exposure_time = number_within(parameters, "EXP", *EXPOSURE)
        return ""

    def _exposing(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        with self._lock:
            now = self._world.clock.now()
            return str(
                int(
                    self._running is not None and now < self._running.start + self._running.duration
                )
            )

    def _set_gain(self, parameters: Sequence[str], ended: threading.Event) -> str:
        with self._lock:
            self._refuse_while_exposing("GAIN")
            self._gain = number_within(parameters, "GAIN", *GAIN)
        return ""

    def _set_format(self, parameters: Sequence[str], ended: threading.Event) -> str:
        with self._lock:
            self._refuse_while_exposing("FORM")
            name_among(parameters, "FORM", [self._format])
        return ""

    def _refuse_while_exposing(self, what: str) -> None:
        self._look()
        if self._running:
            raise ScpiError(-221, f"{what} while an exposure runs, allowed after it or after ABOR")

    def _start(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        with self._lock:
            self._look()
            if self._running:
                raise ScpiError(-213, "INIT while an exposure runs, allowed after it")
            self._number += 1
            self._running = Exposure(
                self._number, self._world.clock.now(), self._exposure_time, self._gain
            )
        return ""

    def _abort(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        with self._lock:
            self._look()
            if self._running:
                self._number -= 1
            self._running = None
            self._buffer.clear()
        return ""

    def _count(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        with self._lock:
            self._look()
            return str(len(self._buffer))

    def _read_dropped(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        with self._lock:
            self._look()
            return str(self._dropped)

    def _look(self) -> None:
        """Put the exposure that has ended since into the buffer."""
        if not self._running or self._world.clock.now() < self._running.ready:
            return
        if self.faults.loses_frame():
            self._dropped += 1
            self._buffer.append(None)
        else:
            self._buffer.append(self._running)
        if len(self._buffer) > BUFFER:
            self._dropped += self._buffer.popleft() is not None
        self._running = None

    def _fetch(self, parameters: Sequence[str], ended: threading.Event) -> bytes:
        no_parameters(parameters)
        try:
            exposure, picture, dropped = self.next_frame(ended)
        except ScpiError as error:
            with self._lock:
                raise BlockError(
                    error.number, error.detail, f"0,0,0,0,0,0,{self._dropped},#10".encode()
                ) from error
        rows, columns = picture.shape
        pixels = picture.astype("<u2").tobytes()
        facts = (
            decimal(number)
            for number in (
                exposure.number,
                exposure.start,
                exposure.duration,
                exposure.gain,
                columns,
                rows,
                dropped,
            )
        )
        size = str(len(pixels))
        return f"{','.join(facts)},#{len(size)}{size}".encode() + pixels

    def next_frame(self, ended: threading.Event) -> tuple[Exposure, npt.NDArray[np.uint16], int]:
        """Wait for the oldest frame not yet fetched: its exposure, its numbers in DN, and how many
        were dropped so far.

        Raises:
            ScpiError: there is none.
        """
        with self._lock:
            self._look()
            awaited = self._running if not self._buffer else None
        if awaited:
            self._world.clock.wait_until(awaited.ready, ended)
        with self._lock:
            self._look()
            if not self._buffer:
                if awaited:
                    raise ScpiError(-230, "the exposure was aborted, INIT starts another")
                raise ScpiError(-214, "FETC? with no exposure, allowed after INIT")
            exposure = self._buffer.popleft()
            if exposure is None:
                raise ScpiError(-230, "the frame was lost, INIT starts another")
            scene = self._world.scene(exposure.start + exposure.duration / 2)
            key = (*scene.state, exposure.duration, exposure.gain)
            repeat = self._repeats.get(key, -1) + 1
            self._repeats = {key: repeat}
            dropped = self._dropped
        try:
            return exposure, self._develop(exposure, scene, repeat), dropped
        except InputError as error:
            raise ScpiError(-200, f"{error}, INIT starts another exposure") from error

    def _develop(self, exposure: Exposure, scene: Scene, repeat: int) -> npt.NDArray[np.uint16]:
        """The frame in DN."""
        picture = self._picture(scene)
        electrons = 0.0
        if scene.camera:
            white = white_irradiance(scene.camera, self._falloff) / self._reference
            white *= self._world.lamp(scene)
            electrons = self._light.electrons_per_second * exposure.duration * white
        key = noise_key(
            self._world.seed, "frame", scene.state, exposure.duration, exposure.gain, repeat
        )
        response = self.response(exposure.gain)
        if self._light.hot_pixels:
            more = self._light.hot_electrons_per_second * exposure.duration
            hot = HotPixels(self._light.hot_pixels, more, self._world.seed)
            response = replace(response, hot_pixels=hot)
        return digitise(picture, electrons, response, key)

    def _picture(self, scene: Scene) -> npt.NDArray[np.float64]:
        """The scene without noise in units of white level; drawn once for a state of the world."""
        with self._drawing:
            if scene.state not in self._pictures:
                columns, rows = self._world.optics.sensor.resolution
                if scene.camera is None or scene.distance is None:
                    picture = np.zeros((rows, columns))
                else:
                    picture = self._drawn(scene.camera, scene.target, scene.distance)
                kept = list(self._pictures.items())[1 - PICTURES :]
                self._pictures = dict([*kept, (scene.state, picture)])
            return self._pictures[scene.state]

    def _drawn(self, camera: Camera, target: Target, distance: float) -> npt.NDArray[np.float64]:
        """The light of all lines of the spectrum, with the effects that the frame's accuracy calls
        for.

        Raises:
            InputError: it would take too long.
        """
        weighted = list(light_scenes(self._world.bench, camera, target, distance))
        parts = [(scene, chosen(self._world.bench, scene)) for scene, _ in weighted]
        require_affordable(parts)
        drawn = np.zeros(camera.sensor.resolution[::-1])
        for (scene, choice), (_, weight) in zip(parts, weighted, strict=True):
            drawn += weight * render_light(scene, choice.tolerance, choice.formed).image
        return np.maximum(drawn, 0.0)  # sums of strips leave a rounding error below black

    def response(self, gain: float) -> SensorResponse:
        """The sensor at a gain."""
        light = self._light
        numbers = 2**light.bits - 1 - light.black_level
        return SensorResponse(
            quantisation=Quantisation(
                light.bits, gain * numbers / light.full_well_electrons, light.black_level
            ),
            saturation=Saturation(light.full_well_electrons),
            read_noise=ReadNoise(light.read_noise_electrons),
        )


def _fact(answer: str) -> Handler:
    def tell(parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        return answer

    return tell
