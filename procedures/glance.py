"""What the frames of a run show, in words for who watches it: now and then one is measured in a
thread while the bench goes on.
"""

import math
import threading
import time

import numpy as np
import numpy.typing as npt

from drivers.base import CameraDevice
from flflab.bench import Bench
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.measure import measure
from flflab.measurement.sensor.noise import SensorNoise
from flflab.study import Configuration, Study
from flflab.targets import Texture
from procedures.devices import Picture
from procedures.steps import WHITE

EVERY_S = 5.0  # faster nobody reads
SHARE = 0.2  # of the time, at most: the bench, its record and a simulated camera want the cores


class Glance:
    """Measures the last frame, unless another is being measured or one was just now; the frames
    passed over are measured after the run.

    Args:
        study: what is taken.
        bench: on what.
        camera: whose noise counts.
        every_s: least time from the beginning of one measurement to the next, s.
        share: largest part of the time that goes to measuring.
    """

    def __init__(
        self,
        study: Study,
        bench: Bench,
        camera: CameraDevice,
        every_s: float = EVERY_S,
        share: float = SHARE,
    ) -> None:
        self._study, self._optics, self._camera, self._every, self._share = (
            study,
            bench.optics,
            camera,
            every_s,
            share,
        )
        self._began, self._took, self._looked_at = -math.inf, 0.0, ""
        self._thread: threading.Thread | None = None
        self.said = ""

    def look_at(self, picture: Picture | None) -> None:
        """Begin to measure a frame; it never fails, what cannot be measured is what it says."""
        now = time.monotonic()
        if picture is None or not 0 <= picture.shot.configuration < len(self._study.configurations):
            return
        if self._thread is not None and self._thread.is_alive():
            return
        if picture.shot.key == self._looked_at or now - self._began < max(
            self._every, self._took / self._share
        ):
            return
        self._began, self._looked_at = now, picture.shot.key
        self._thread = threading.Thread(
            target=self._measure, args=(picture,), name="glance", daemon=True
        )
        self._thread.start()

    def wait(self) -> None:
        """Until the frame at hand is measured."""
        if self._thread is not None:
            self._thread.join()

    def _measure(self, picture: Picture) -> None:
        key = picture.shot.key
        try:
            words = self._words(
                picture.frame.picture,
                key.split("/")[1],
                self._study.configurations[picture.shot.configuration],
            )
        except Exception as error:  # a program that ends takes its threads' helpers away, too
            words = str(error) or type(error).__name__
        self.said, self._took = f"{key} shows {words}", time.monotonic() - self._began

    def _words(
        self, frame: npt.NDArray[np.uint16], target: str, configuration: Configuration
    ) -> str:
        camera, device = configuration.camera(self._optics), self._camera
        noise = SensorNoise(
            device.dn_per_electron, device.read_noise_dn, device.offset_dn, float(device.full_scale)
        )
        if target == WHITE:
            found = lattice_behind(camera, frame, noise)
            return (
                f"micro-images {found.pitch_px:.2f} px apart, bright fields"
                f" {2 * found.inside_radius_px:.1f} px wide"
            )
        if target == Texture.kind:
            return "a texture, whose depth map is made after the run"
        shown = {one.kind: one for one in self._study.targets}[target]
        seen = measure(frame, camera, shown, configuration.distance, noise)
        if seen["dots"]:
            return f"{' '.join(str(dot['views']) for dot in seen['dots'])} views"
        if not seen["mtf"]:
            return str(seen["remarks"][-1])
        middle = seen["mtf"][len(seen["mtf"]) // 2]
        return f"a contrast of {middle['contrast']:.3f} at {middle['cycles_per_mm']:.2g} cycles/mm"
