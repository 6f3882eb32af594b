"""The bench on which a driver of axes is tried: the built-in one, one of whose axes it drives, with
a small sensor and fast stages.
"""

from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.registry import AXES
from flflab.bench import ANGLE
from flflab.built_in import Kind, built_in, simulated_bench

AXIS = "axis"  # what the tried axis is called
CLOCK = 50  # times faster than a real bench
TIMEOUT_S = 5.0  # for an answer, on a busy computer
LINEAR = "sensor_stage"  # whose place in the bench a driver of lengths gets
TURNING = {
    "moves": "array.roll",
    "zero_uncertainty": "0.01 deg",
    "limits": ["-10 deg", "10 deg"],
    "speed": "5 deg/s",
    "home_towards": "-roll",
}


def asked_for(config: pytest.Config) -> bool:
    """Whether a driver or a bench is to be tried."""
    return bool(config.getoption("--flflab-axis") or config.getoption("--flflab-bench"))


def write_bench(config: pytest.Config, folder: Path) -> Path:
    """Write the bench file for the driver that the command line names.

    Raises:
        pytest.UsageError: there is no such driver, or its own keys are no mapping.
    """
    driver: Any = config.getoption("--flflab-axis")
    keys: Any = config.getoption("--flflab-keys")
    if driver not in AXES:
        raise pytest.UsageError(
            f"there is no driver '{driver}' of axes here; there are {', '.join(AXES)}: install the"
            " package that brings it"
        )
    optics, bench = _read(built_in(Kind.CAMERA)), _read(simulated_bench())
    optics["sensor"] |= {"resolution": [64, 48], "pixel": "20 um"}
    _write(folder / "camera.yaml", optics)
    bench["optics"] = "camera.yaml"
    bench["simulated"]["clock"] = CLOCK
    for axis in bench["axes"].values():
        axis["timeout"] = TIMEOUT_S
    own = {"driver": driver, "address": "simulated", **_keys(keys)}
    if AXES[driver].counts is ANGLE:
        bench["axes"][AXIS] = TURNING | own
    else:
        place = bench["axes"].pop(LINEAR)
        for key in ("device", "microstep"):  # its former driver's own
            del place[key]
        bench["axes"][AXIS] = place | own
    return _write(folder / "bench.yaml", bench)


def _keys(given: str) -> dict[str, Any]:
    try:
        keys = yaml.safe_load("{" + given.strip().removeprefix("{").removesuffix("}") + "}")
    except yaml.YAMLError as error:
        raise pytest.UsageError(f"--flflab-keys {given!r}: no YAML ({error})") from error
    return keys


def _read(file: Path) -> dict[str, Any]:
    return yaml.safe_load(file.read_text(encoding="utf-8"))


def _write(file: Path, data: dict[str, Any]) -> Path:
    file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return file
