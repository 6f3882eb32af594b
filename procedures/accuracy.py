"""How sure the MTF of a point is after the frames taken so far: measured in a thread while the
bench goes on.
"""

import math
import threading
import time
from concurrent.futures import Future
from typing import Any

import numpy as np
import numpy.typing as npt

from drivers.base import CameraDevice, Status
from flflab.bench import Bench
from flflab.measurement.contrast.curve import fit_contrast
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.sequential import Look, frames_due
from flflab.record import Recording
from flflab.study import Study
from procedures.devices import Triggered
from procedures.steps import WHITE, CaptureUntil

Array = npt.NDArray[np.float64]


class Accuracy:
    """Measures the uncertainty that recorded frames have reached, and says how many there should
    be.

    The lattice of a configuration is sought in its white frames as soon as they are there, while
    other things move.

    Args:
        study: what is taken.
        bench: on what.
        camera: whose noise counts.
        recording: where the frames are.
        places: of the recorded frames by their keys; grows.
    """

    name = "accuracy"
    parent = None

    def __init__(
        self,
        study: Study,
        bench: Bench,
        camera: CameraDevice,
        recording: Recording,
        places: dict[str, int],
    ) -> None:
        self._study, self._optics, self._camera = study, bench.optics, camera
        self._wavelength = bench.description.mean_wavelength
        self._floor = bench.description.measurement_floor.contrast
        self._recording, self._places = recording, places
        self._lattices: dict[int, Future[Lattice]] = {}
        self.looks: dict[int, tuple[Look, ...]] = {}
        self._latest: tuple[int, Look, bool] | None = None

    def look_at(self, step: CaptureUntil, frames: int) -> Triggered:
        """The measurement of a point's first frames, as something to trigger."""
        return Triggered(
            f"accuracy of c{step.configuration.index}", lambda: self._look(step, frames)
        )

    def seen(self, step: CaptureUntil) -> int:
        """How many frames of a point the last look took in; 0 before the first."""
        looks = self.looks.get(step.configuration.index)
        return looks[-1].frames if looks else 0

    def due(self, step: CaptureUntil) -> int:
        """How many frames a point should have; the least before it was looked at, or in a
        rehearsal.
        """
        looks = self.looks.get(step.configuration.index)
        return frames_due(looks, step.mtf_standard_uncertainty, step.most) if looks else step.least

    def read(self) -> dict[str, Any]:
        """What the last look gave."""
        index, look, enough = self._latest or (-1, Look(0, 0.0), False)
        now = time.time()
        values = {
            "accuracy_of": index,
            "frames": look.frames,
            "mtf_standard_uncertainty": look.uncertainty,
            "enough": enough,
        }
        return {key: {"value": value, "timestamp": now} for key, value in values.items()}

    def describe(self) -> dict[str, Any]:
        """What ``read`` returns."""
        kinds = {
            "accuracy_of": "integer",
            "frames": "integer",
            "mtf_standard_uncertainty": "number",
            "enough": "boolean",
        }
        return {
            key: {"source": "analysis", "dtype": kind, "shape": []} for key, kind in kinds.items()
        }

    def seek_lattice(self, index: int) -> None:
        """Begin to seek a configuration's lattice in its white frames; nothing where that was
        begun, or in a rehearsal, which has none.
        """
        if index not in self._lattices and f"c{index}/{WHITE}/0" in self._places:
            found = self._lattices[index] = Future[Lattice]()
            white, frames = self._mean(f"c{index}/{WHITE}/")
            threading.Thread(
                target=self._seek,
                args=(index, white, frames, found),
                name=f"lattice of c{index}",
                daemon=True,
            ).start()

    def _seek(self, index: int, white: Array, frames: int, found: Future[Lattice]) -> None:
        try:
            camera = self._study.configurations[index].camera(self._optics)
            found.set_result(lattice_behind(camera, white, self._noise.of_mean(frames)))
        except Exception as error:
            found.set_exception(error)

    def _look(self, step: CaptureUntil, frames: int) -> Status:
        status = Status(
            f"measure the uncertainty of {frames} frames of"
            f" c{step.configuration.index}/{step.target}"
        )
        index, camera = step.configuration.index, step.configuration.camera(self._optics)
        self.seek_lattice(index)
        mean, _ = self._mean(f"c{index}/{step.target}/", frames)

        def measure() -> None:
            try:
                lattice = self._lattices[index].result()
                noise = self._noise.of_mean(frames)
                distance = step.configuration.distance
                curve = fit_contrast(
                    mean,
                    lattice,
                    camera,
                    self._study.bars,
                    distance,
                    noise,
                    wavelength=self._wavelength,
                )
                look = Look(frames, math.hypot(float(curve.uncertainty.max()), self._floor))
                self.looks[index] = (*self.looks.get(index, ()), look)
                self._latest = (index, look, look.uncertainty <= step.mtf_standard_uncertainty)
            except Exception as error:
                status.complete(error)
            else:
                status.complete()

        threading.Thread(target=measure, name=f"accuracy of c{index}", daemon=True).start()
        return status

    @property
    def _noise(self) -> SensorNoise:
        camera = self._camera
        return SensorNoise(
            camera.dn_per_electron, camera.read_noise_dn, camera.offset_dn, float(camera.full_scale)
        )

    def _mean(self, point: str, frames: int | None = None) -> tuple[Array, int]:
        """Mean of the first recorded frames of a point, and their number."""
        places = [
            self._places[key]
            for key in sorted((key for key in self._places if key.startswith(point)), key=_repeat)
        ][:frames]
        total = np.zeros(self._recording.picture(places[0]).shape)
        for place in places:
            total += self._recording.picture(place)
        return total / len(places), len(places)


def _repeat(key: str) -> int:
    return int(key.rpartition("/")[2])
