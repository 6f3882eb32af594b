"""The simulated camera behind a watched folder, by docs/folder-camera.md: takes requests away,
writes raw files as programs do.
"""

import json
import shutil
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from flflab.files.raw import write_raw
from flflab.image.bands import GivenUpError, given_up_when
from flflab.image.sensor.raw_picture import raw_picture
from sim.camera import SimulatedCamera
from sim.scpi import ScpiError, decimal
from sim.server import HangUpError

POLL = 0.01  # real seconds between looks into the folder
PAUSE = 0.03  # real seconds between the two halves of a file
ISO = 100  # at gain 1


class FolderLine:
    """A folder of its own for a camera, served until ``stop``, which takes the folder away."""

    def __init__(self, camera: SimulatedCamera) -> None:
        """Begin to look for requests.

        Raises:
            OSError: no folder can be made.
        """
        self.camera = camera
        self._folder = Path(tempfile.mkdtemp(prefix="flflab-camera-"))
        self._scratch = Path(tempfile.mkdtemp(prefix="flflab-sensor-"))
        self.address = str(self._folder)
        self._ended = threading.Event()
        self._thread = threading.Thread(
            target=self._serve, name=f"camera of {self.address}", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Wait for the thread and take the folder away."""
        self._ended.set()
        self._thread.join()
        for folder in (self._folder, self._scratch):
            shutil.rmtree(folder, ignore_errors=True)

    def _serve(self) -> None:
        last, faults = "", self.camera.faults
        request = self._folder / "request.json"
        while not self._ended.wait(POLL):
            if late := faults.late_answer():
                self._write(last, late)
            try:
                wanted = json.loads(request.read_text(encoding="utf-8"))
                request.unlink()
            except OSError:
                continue
            last = f"frame-{wanted['number']:06d}.dng"
            try:
                with given_up_when(lambda: self._ended.is_set() or request.exists()):
                    self._answer(last, wanted)
            except HangUpError:
                shutil.rmtree(self._folder, ignore_errors=True)
                return
            except (ScpiError, GivenUpError):  # no frame, and no way to say so
                continue

    def _answer(self, name: str, wanted: dict[str, Any]) -> None:
        """Expose and write the file, unless a fault is due."""
        camera, faults = self.camera, self.camera.faults
        faults.before(camera)
        commands = camera.commands
        for header, value in (("EXPosure", wanted["exposure_s"]), ("GAIN", wanted["gain"])):
            commands[header]([decimal(value)], self._ended)
        commands["INITiate"]([], self._ended)
        exposure, numbers, _ = camera.next_frame(self._ended)
        taken = raw_picture(
            numbers, camera.response(exposure.gain), None, exposure.duration, ISO * exposure.gain
        )
        write_raw(self._scratch / "frame.dng", taken)
        file = (self._scratch / "frame.dng").read_bytes()
        sent = faults.reply(file)
        if sent == file + file:
            self._write(name.replace("frame", "copy"), file)
            sent = file
        if sent is not None:
            self._write(name, sent)

    def _write(self, name: str, content: bytes) -> None:
        """Write as a tethering program does: in place, bit by bit."""
        with (self._folder / name).open("wb") as stream:
            stream.write(content[: len(content) // 2])
            stream.flush()
            time.sleep(PAUSE)
            stream.write(content[len(content) // 2 :])
