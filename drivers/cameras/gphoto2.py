"""A tethered camera through libgphoto2: its f-number, shutter and speed as it offers them, the raw
file of every exposure.

python-gphoto2 2.6 (extra ``gphoto2``) brings libgphoto2 2.5.34, whose list of cameras says which
can be set and released. Tried against libgphoto2's own virtual PTP camera; no real body was.
"""

import contextlib
import math
import re
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import Field

from drivers.camera_commands import SensorKeys, Setup, Taken
from drivers.raw_file import taken_from
from flflab.description import Description, Time
from flflab.errors import CommunicationError, DeviceError, InputError, LimitError
from flflab.files.raw import RAW, read_raw

Answer = TypeVar("Answer")
SHUTTER, SPEED, F_NUMBER = (
    "shutterspeed",
    ("iso", "isospeed"),
    ("f-number", "aperture"),
)  # names of settings in libgphoto2
SAME = 0.01  # a choice is taken for what was asked when it is this close: 1/60 s for 0.0167 s
JPEG = b"\xff\xd8"
SIBLING_S = 2.0  # how long the raw file may come after its JPEG


class GphotoKeys(SensorKeys):
    """The keys of a tethered camera.

    ``full_scale``: white level of its raw files, DN. ``iso_at_gain_1``: the speed that counts as
    gain 1. ``settings``: what else is set on opening, by libgphoto2's names, such as
    ``imagequality: NEF (Raw)``. ``timeout``: how long a file may come after the exposure;
    ``quiet``: how long after a file a second one would show that somebody else released the shutter
    too.
    """

    full_scale: Annotated[int, Field(gt=0, le=65535)]
    iso_at_gain_1: Annotated[float, Field(gt=0)] = 100.0
    settings: dict[str, str] = {}
    timeout: Annotated[Time, Field(gt=0)] = 15.0
    quiet: Annotated[Time, Field(ge=0)] = 0.2


class GphotoIrisKeys(Description):
    """The iris of a tethered camera has no keys of its own; its address is the camera's."""


class GphotoLink:
    """One body on one port; any thread may ask, one at a time. After a fault the next question
    opens it anew.

    Args:
        address: a port as ``gphoto2 --auto-detect`` prints it, ``usb:001,004``; empty for the only
            camera there is.

    Raises:
        CommunicationError: the library is missing, or no camera answers there.
    """

    def __init__(self, address: str) -> None:
        try:
            import gphoto2
        except ImportError as error:
            raise CommunicationError(
                f"driver gphoto2: python-gphoto2 cannot be loaded ({error}); where it is missing:"
                " pip install 'flflab[gphoto2]'"
            ) from error
        self.gp: Any = gphoto2
        self._address = address
        self._turn = threading.RLock()
        self._body: Any = None
        self.connections = 0
        self.ask("the model", lambda body: body.get_abilities().model)

    def __str__(self) -> str:
        return f"camera at {self._address or 'the only port'}"

    def ask(self, what: str, question: Callable[[Any], Answer]) -> Answer:
        """What the body answers.

        Raises:
            CommunicationError: libgphoto2 reports an error; the body is opened anew next time.
        """
        with self._turn:
            try:
                return question(self._opened())
            except self.gp.GPhoto2Error as error:
                self.close()
                raise CommunicationError(
                    f"{self}: asked for {what}, got libgphoto2's error {error.code},"
                    f" {error.string}; check cable, battery, that the camera is on, and that no"
                    " other program holds it"
                ) from error

    def choices(self, *names: str) -> tuple[str, list[str]]:
        """The first setting of these names that the body has, and what it offers; empty where it
        has none.
        """
        for name in names:
            if (
                widget := self.ask(
                    f"setting {name}", lambda body, name=name: self._widget(body, name)
                )
            ) is not None:
                return name, [widget.get_choice(place) for place in range(widget.count_choices())]
        return "", []

    def value(self, name: str) -> str:
        """What a setting is."""
        return str(
            self.ask(f"setting {name}", lambda body: body.get_single_config(name).get_value())
        )

    def set(self, name: str, value: str) -> None:
        """Set a setting and read it back: a body may take a value and ignore it.

        Raises:
            DeviceError: it did not become that.
        """

        def change(body: Any) -> None:
            widget = body.get_single_config(name)
            widget.set_value(value)
            body.set_single_config(name, widget)

        self.ask(f"{name} {value}", change)
        if (now := self.value(name)) != value:
            raise DeviceError(
                f"{self}: asked for {name} {value}, it stays at {now}; see that the mode dial is at"
                " M and the lens lets it"
            )

    def close(self) -> None:
        """Let go of the body."""
        with self._turn:
            if self._body is not None:
                with contextlib.suppress(self.gp.GPhoto2Error):
                    self._body.exit()
                self._body = None

    def _widget(self, body: Any, name: str) -> Any:
        """A setting; None where the body has no such one."""
        try:
            return body.get_single_config(name)
        except self.gp.GPhoto2Error as error:
            if error.code == self.gp.GP_ERROR_BAD_PARAMETERS:
                return None
            raise

    def _opened(self) -> Any:
        if self._body is None:
            body = self.gp.Camera()
            if self._address:
                ports = self.gp.PortInfoList()
                ports.load()
                body.set_port_info(ports[ports.lookup_path(self._address)])
            body.init()
            self._body = body
            self.connections += 1
        return self._body


class GphotoCamera:
    """A tethered body; satisfies ``CameraCommands``.

    Args:
        link: the body.
        keys: what the bench file says of it.

    Raises:
        CommunicationError: it does not answer.
        DeviceError: its shutter cannot be set, or it does not take one of the other settings.
    """

    def __init__(self, link: GphotoLink, keys: GphotoKeys) -> None:
        self._link, self._keys = link, keys
        self._begin()
        _, offered = link.choices(SHUTTER)
        self._exposures = {seconds: choice for choice in offered if (seconds := _seconds(choice))}
        if not self._exposures:
            raise DeviceError(
                f"{link}: its shutter cannot be set from here (it offers {offered}); see that the"
                " mode dial is at M"
            )
        self._speed, offered = link.choices(*SPEED)
        self._gains = {
            float(choice) / keys.iso_at_gain_1: choice
            for choice in offered
            if re.fullmatch(r"\d+", choice) and int(choice)
        }
        self.exposure_limits = (min(self._exposures), max(self._exposures))
        self.offered_exposures = tuple(sorted(self._exposures))
        self.gain_limits = (min(self._gains), max(self._gains)) if self._gains else (1.0, 1.0)
        exposure = _seconds(link.value(SHUTTER)) or self.exposure_limits[0]
        gain = (
            float(link.value(self._speed)) / keys.iso_at_gain_1
            if self._gains and link.value(self._speed).isdigit()
            else 1.0
        )
        self._told(exposure, gain)

    def _begin(self) -> None:
        """On a connection: what the bench file sets, nothing told yet."""
        for name, value in self._keys.settings.items():
            self._link.set(name, value)
        self._connection = self._link.connections
        self._last = ("", "")
        self._given_up = False

    def prepare(self, exposure_s: float, gain: float) -> None:
        """Set shutter and speed to what the camera offers.

        Raises:
            LimitError: it does not offer this.
            DeviceError: it did not become what was asked.
        """
        exposure = nearest(self._link, "exposure", exposure_s, " s", self._exposures)
        chosen = nearest(self._link, "gain", gain, "", self._gains) if self._gains else 1.0
        self._link.set(SHUTTER, self._exposures[exposure])
        if self._gains:
            self._link.set(self._speed, self._gains[chosen])
        self._told(exposure, chosen)

    def arm(self) -> None:
        """Let the camera tell what it has to tell; the JPEG beside the last frame and a file given
        up are passed over.

        Raises:
            CommunicationError: it took pictures that nobody asked for.
        """
        self._link.ask("its model", lambda body: body.get_abilities())
        if (
            self._link.connections != self._connection
        ):  # the body was away: it may have forgotten everything
            self._begin()
            self.prepare(self.setup.exposure_s, self.setup.gain)
        unasked: list[str] = []
        while (event := self._event(1))[0] != self._link.gp.GP_EVENT_TIMEOUT:
            if file := self._file(event):
                if Path(file[1]).stem != Path(self._last[1]).stem and not self._given_up:
                    unasked.append(file[1])
                self._last = file
        self._given_up = False
        if unasked:
            raise CommunicationError(
                f"{self._link}: took {', '.join(unasked)} unasked, no frame; see who else releases"
                " the shutter"
            )

    def trigger(self) -> None:
        """Release the shutter."""
        self._given_up = True
        self._link.ask("a picture", lambda body: body.trigger_capture())

    def exposing(self) -> None:
        """Only its picture can tell."""

    def fetch(self) -> Taken:
        """Download the raw file.

        Raises:
            CommunicationError: none came, it is torn, or it was taken otherwise than asked.
        """
        patience = self.setup.exposure_s + self._keys.timeout
        deadline = time.monotonic() + patience
        frame, jpeg = None, ""
        while (left := deadline - time.monotonic()) > 0:
            file = self._file(self._event(math.ceil(1000 * min(left, 0.5))))
            if file is None or file == self._last:
                continue
            if Path(file[1]).stem != Path(self._last[1]).stem and (frame or jpeg):
                raise CommunicationError(
                    f"{self._link}: took {self._last[1]} and {file[1]} for one exposure, and nobody"
                    " knows which is its frame; see who else releases the shutter, then take it"
                    " again"
                )
            content, taken_at = self._download(*file)
            self._last = file
            if content.startswith(JPEG):
                jpeg, deadline = file[1], min(deadline, time.monotonic() + SIBLING_S)
            else:
                self._given_up = False
                frame, deadline = (file[1], content, taken_at), time.monotonic() + self._keys.quiet
        if frame:
            return self._developed(*frame)
        if jpeg:
            raise CommunicationError(
                f"{self._link}: delivered {jpeg} and no raw file; set its picture quality to raw"
            )
        raise CommunicationError(
            f"{self._link}: no file came within {patience:g} s; see that it focuses by hand and has"
            " room, then take it again"
        )

    def reset(self) -> None:
        """Let go of the body; the next question opens it anew."""
        self._link.close()

    def identity(self) -> str:
        """Model and version of the body as libgphoto2 tells them."""
        return self._link.ask("its model", lambda body: str(body.get_abilities().model))

    def close(self) -> None:
        """Let go of the body."""
        self._link.close()

    def _told(self, exposure_s: float, gain: float) -> None:
        self.setup: Setup = self._keys.setup(exposure_s, gain, "", self._keys.full_scale)

    def _event(self, milliseconds: int) -> tuple[int, Any]:
        kind, data = self._link.ask("an event", lambda body: body.wait_for_event(milliseconds))
        return kind, data

    def _file(self, event: tuple[int, Any]) -> tuple[str, str] | None:
        kind, data = event
        return (data.folder, data.name) if kind == self._link.gp.GP_EVENT_FILE_ADDED else None

    def _download(self, folder: str, name: str) -> tuple[bytes, float]:
        def download(body: Any) -> tuple[bytes, float]:
            file = body.file_get(
                folder, name, self._link.gp.GP_FILE_TYPE_NORMAL
            )  # its bytes live only as long as it does
            return bytes(file.get_data_and_size()), float(file.get_mtime())

        return self._link.ask(f"file {name}", download)

    def _developed(self, name: str, content: bytes, taken_at: float) -> Taken:
        ending = Path(name).suffix.lower()
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"frame{ending if ending in RAW else '.dng'}"
            file.write_bytes(content)
            try:
                raw = read_raw(file)
            except InputError as error:
                raise CommunicationError(
                    f"{self._link}: {name}, {len(content)} bytes, is no whole raw file; take the"
                    " picture again"
                ) from error
        return taken_from(
            raw, f"{self._link}: {name}", self.setup, self._keys.iso_at_gain_1, taken_at
        )


class GphotoIris:
    """The f-number of a tethered camera's lens; satisfies ``SettingCommands[float]``.

    Raises:
        DeviceError: the f-number cannot be set from here.
    """

    def __init__(self, link: GphotoLink) -> None:
        self._link = link
        self._name, offered = link.choices(*F_NUMBER)
        self._choices = {
            float(found[1]): choice
            for choice in offered
            if (found := re.fullmatch(r"f?/?(\d+(?:\.\d+)?)", choice))
        }
        if not self._choices:
            raise DeviceError(
                f"iris of {link}: its f-number cannot be set from here; fit a lens with contacts"
                " and turn the mode dial to M"
            )
        self.allowed = (min(self._choices), max(self._choices))

    def start(self, value: float) -> None:
        """Set an f-number that the lens offers.

        Raises:
            LimitError: it offers no such one.
        """
        self._link.set(
            self._name, self._choices[nearest(self._link, "f-number", value, "", self._choices)]
        )

    def is_busy(self) -> bool:
        """Never: setting it waits until it is there."""
        return False

    def value(self) -> float:
        """What the camera says it is."""
        now = self._link.value(self._name)
        return next((number for number, choice in self._choices.items() if choice == now), math.nan)

    def fault(self) -> str:
        """Nothing: what is not taken is refused at once."""
        return ""

    def stop(self) -> None:
        """Nothing: there is no change under way."""

    def identity(self) -> str:
        """Model of the body."""
        return self._link.ask("its model", lambda body: str(body.get_abilities().model))

    def close(self) -> None:
        """The body is let go of by the link."""


def nearest(who: object, what: str, asked: float, unit: str, choices: Mapping[float, str]) -> float:
    """The choice that is what was asked.

    Raises:
        LimitError: none is; with its neighbours.
    """
    found = min(choices, key=lambda number: abs(number - asked))
    if math.isclose(found, asked, rel_tol=SAME):
        return found
    below = max((number for number in choices if number < asked), default=found)
    above = min((number for number in choices if number > asked), default=found)
    raise LimitError(
        f"{who}: asked for {what} {asked:g}{unit}; the camera offers {below:g}{unit} and"
        f" {above:g}{unit} beside it, choose one"
    )


def _seconds(choice: str) -> float:
    """A shutter speed as cameras write it: ``1/50``, ``0.0200s``, ``2``; 0 for Bulb and the
    like.
    """
    found = re.fullmatch(r"(\d+(?:\.\d+)?)(?:/(\d+(?:\.\d+)?))?\s*s?", choice.strip())
    return float(found[1]) / float(found[2] or 1) if found else 0.0


def _link(address: str, share: Any) -> GphotoLink:
    return share(f"gphoto2 {address}", lambda: GphotoLink(address))


def open_camera(address: str, keys: GphotoKeys, share: Any) -> GphotoCamera:
    """Open a body."""
    return GphotoCamera(_link(address, share), keys)


def open_iris(address: str, keys: GphotoIrisKeys, share: Any) -> GphotoIris:
    """Open the lens of a body, on the camera's own connection."""
    return GphotoIris(_link(address, share))
