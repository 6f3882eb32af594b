"""The descriptions that come with flflab, one or more of every kind."""

from enum import StrEnum
from importlib.resources import files
from pathlib import Path


class Kind(StrEnum):
    """What can be begun from a built-in file."""

    CAMERA = "camera"
    BENCH = "bench"
    STUDY = "study"
    SCENE = "scene"
    TARGET = "target"
    CALIBRATION = "calibration"
    REQUIREMENTS = "requirements"


BUILT_IN = {
    Kind.CAMERA: "cameras/osinski.yaml",
    Kind.BENCH: "benches/real.yaml",
    Kind.STUDY: "studies/first.yaml",
    Kind.SCENE: "scenes/bars.yaml",
    Kind.TARGET: "targets/bars.yaml",
    Kind.CALIBRATION: "studies/calibration.yaml",
    Kind.REQUIREMENTS: "requirements/osinski.yaml",
}


def built_in(kind: Kind) -> Path:
    """Where the description lies that a new file of a kind begins from."""
    return _built_in_file(BUILT_IN[kind])


def simulated_bench() -> Path:
    """Where the simulated bench lies that commands use without ``--bench``."""
    return _built_in_file("benches/simulated.yaml")


def full_bench() -> Path:
    """Where the simulated bench lies that turns the array about three axes, too."""
    return _built_in_file("benches/full.yaml")


def _built_in_file(name: str) -> Path:
    return Path(str(files("flflab") / "builtin" / name))
