"""The descriptions that come with flflab: a bench, its camera, two studies, requirements."""

from enum import StrEnum
from importlib.resources import files
from pathlib import Path


class Kind(StrEnum):
    """What can be begun from a built-in file."""

    CAMERA = "camera"
    BENCH = "bench"
    STUDY = "study"
    CALIBRATION = "calibration"
    REQUIREMENTS = "requirements"


BUILT_IN = {
    Kind.CAMERA: "cameras/osinski.yaml",
    Kind.BENCH: "benches/simulated.yaml",
    Kind.STUDY: "studies/first.yaml",
    Kind.CALIBRATION: "studies/calibration.yaml",
    Kind.REQUIREMENTS: "requirements/osinski.yaml",
}


def built_in(kind: Kind) -> Path:
    """Where a built-in description lies."""
    return Path(str(files("flflab") / "builtin" / BUILT_IN[kind]))
