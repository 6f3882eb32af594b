"""Drivers that another package brings: found by entry points, opened like any other, refused in a
sentence where the package is at fault, as where a maker's library does not load.
"""

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

import drivers
from drivers.cameras import genicam, gphoto2, pylon
from drivers.registry import AXES
from flflab.errors import CommunicationError, InputError, InterlockError, LimitError
from sim.registry import AXES as SIMULATED

ACME = '''
from dataclasses import dataclass, field
import numpy as np
from pydantic import Field
from drivers.camera_commands import Setup, Taken
from drivers.registry import AxisDriver, CameraDriver
from flflab.bench import LENGTH
from flflab.description import Description

class Keys(Description):
    """``socket``: which one."""
    socket: int = Field(ge=1)

class CameraKeys(Description):
    """None."""

class Stage:
    resolution, measured = 1e-3, True
    def __init__(self, limits, home):
        self.travel, self.home, self.place, self.homed = limits, home, 0.0, False
    def start_home(self): self.place, self.homed = self.home, True
    def start_move(self, position): self.place = position
    def position(self): return self.place
    def reading(self): return self.place if self.homed else None
    def is_busy(self): return False
    def is_homed(self): return self.homed
    def stop(self): pass
    def faults(self): return ()
    def warnings(self): return ()
    def identity(self): return "ACME stage"
    def serial(self): return ""
    def close(self): pass

class Eye:
    exposure_limits, offered_exposures, gain_limits = (1e-5, 1.0), (), (1.0, 1.0)
    def __init__(self): self.setup = Setup(1e-2, 1.0, "Mono12", 4095, 64.0, 0.3, 1.0)
    def prepare(self, exposure_s, gain): self.exposure_s = exposure_s
    def arm(self): pass
    def trigger(self): pass
    def exposing(self): return None
    def fetch(self): return Taken(np.full((3, 4), 70, np.uint16), 1e-2, 1.0, 1.0, "Mono12")
    def reset(self): pass
    def identity(self): return "ACME eye"
    def close(self): pass

def open_axis(name, axis, keys, share):
    return Stage(axis.limits, axis.limits[1 if axis.homes_up else 0])

def stop_axis(name, axis, keys, share):
    return lambda: False

def open_camera(address, keys, share):
    return Eye()

AXIS = AxisDriver("stage", "Keys", LENGTH, ("socket",), package="acme", spells=str.lower)
EYE = CameraDriver("stage.CameraKeys", "stage.open_camera", package="acme")
'''


@pytest.fixture
def acme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package of somebody else's, installed."""
    site = tmp_path / "site"
    (site / "acme").mkdir(parents=True)
    (site / "acme" / "__init__.py").write_text("")
    (site / "acme" / "stage.py").write_text(ACME)
    info = site / "acme_stages-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-stages\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(
        "[flflab.axes]\nacme = acme.stage:AXIS\nzaber = acme.stage:EYE\n"
        "torn = acme.stage:MISSING\nother = acme.stage:EYE\n"
        "[flflab.cameras]\nacme = acme.stage:EYE\n"
        "[flflab.simulators]\ntorn = acme.stage:MISSING\n"
    )
    monkeypatch.syspath_prepend(str(site))
    for name in ("acme", "acme.stage"):
        monkeypatch.delitem(sys.modules, name, raising=False)


@pytest.fixture
def bench(root: Path, tmp_path: Path, acme: None) -> Callable[..., Path]:
    """Writes the built-in bench with that package's stages and camera, each axis changed."""

    def write(**changes: Any) -> Path:
        source = root / "examples" / "benches" / "simulated.yaml"
        bench = yaml.safe_load(source.read_text(encoding="utf-8"))
        bench["optics"] = str((source.parent / bench["optics"]).resolve())
        for number, axis in enumerate(bench["axes"].values(), start=1):
            axis.pop("device")
            axis.pop("microstep")
            axis |= {"driver": "acme", "address": "RACK-7", "socket": number} | changes
        bench |= {name: {"driver": "manual"} for name in ("iris", "target")}
        bench["camera"] = {"driver": "acme", "address": "EYE-1"}
        file = tmp_path / "bench.yaml"
        file.write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
        return file

    return write


def test_stages_and_a_camera_of_another_package_keep_every_rule(
    bench: Callable[..., Path],
) -> None:
    with drivers.connect(bench()) as connected:
        connected.home()
        connected.array_stage.move_to(20.0).wait()
        with pytest.raises(LimitError, match="0 mm to 50 mm"):
            connected.array_stage.move_to(60.0)
        with pytest.raises(InterlockError, match=r"at least 0\.3 mm"):
            connected.sensor_stage.move_to(19.9)
        connected.camera.prepare(1e-2)
        assert connected.camera.grab().picture.shape == (3, 4)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"socket": None}, r"bench\.yaml:\d+: axes\.main_lens_stage\.socket"),
        ({"socket": 2}, "array_stage is the same stage as main_lens_stage, acme at rack-7"),
        ({"driver": "acne"}, "there is no driver 'acne' here; there are zaber, .*, acme"),
        ({"driver": "torn"}, r"torn, which acme-stages 1\.2 adds to .* cannot be loaded"),
        ({"driver": "other"}, "is of kind CameraDriver; AxisDriver is due"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_it_is_said(
    bench: Callable[..., Path], changes: dict[str, Any], says: str
) -> None:
    with pytest.raises(InputError, match=says):
        drivers.connect(bench(**changes))


def test_no_package_replaces_a_driver_that_is_built_in(acme: None) -> None:
    assert AXES["zaber"].module == "zaber"
    assert list(AXES).count("zaber") == 1
    assert "acme" in AXES
    assert "acme" not in SIMULATED
    with pytest.raises(InputError, match=r"acme-stages 1\.2 adds to flflab\.simulators"):
        SIMULATED["torn"]


@pytest.mark.parametrize("library", ["harvesters", "gphoto2", "pypylon"])
def test_a_library_that_does_not_load_is_refused_with_its_own_reason(
    library: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    why = "libpython3.11.so.1.0: cannot open shared object file"

    class Broken:
        def find_spec(self, name: str, path: object, target: object = None) -> None:
            if name.partition(".")[0] == library:
                raise ImportError(why)

    for name in [name for name in sys.modules if name.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [Broken(), *sys.meta_path])
    openers = {
        "harvesters": lambda: genicam.open_camera("", genicam.GenicamKeys.model_construct(), None),
        "gphoto2": lambda: gphoto2.GphotoLink(""),
        "pypylon": lambda: pylon.open_camera("", pylon.PylonKeys.model_construct(), None),
    }
    with pytest.raises(CommunicationError, match=re.escape(why)):
        openers[library]()
