"""What a bench answers to other programs of its user while one drives it: where everything stands,
what is done, the last frame. Nothing moves.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.owner import ask_owner
from flflab.errors import DeviceError, FlflabError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from drivers.bench import ConnectedBench

WHERE, LAST = "where", "last"


def answers(bench: "ConnectedBench") -> Mapping[str, Callable[[], bytes]]:
    """The questions and what answers them, from any thread."""
    return {
        WHERE: lambda: json.dumps(standing_of(bench)).encode(),
        LAST: lambda: _last_frame(bench),
    }


def standing_of(bench: "ConnectedBench") -> dict[str, Any]:
    """Where every axis stands and whether it moves, what iris and target are, what is done now;
    None of what nobody knows.
    """
    axes: dict[str, Any] = {}
    for name, axis in bench.axes.items():
        try:
            axes[name] = {
                "reading": axis.position() if axis.is_homed() else None,
                "moving": axis.is_moving(),
            }
        except FlflabError as error:
            axes[name] = {"reading": None, "moving": None, "fault": str(error)}
    settings: dict[str, Any] = {}
    for name, setting in (("iris", bench.iris), ("target", bench.target)):
        try:
            settings[name] = setting.value()
        except DeviceError:
            settings[name] = None
    return {"axes": axes, **settings, "doing": bench.doing}


def _last_frame(bench: "ConnectedBench") -> bytes:
    """A line of JSON on the last frame, then its pixels; empty where there is none yet."""
    frame = getattr(bench.camera, "last", None)
    if frame is None:
        return b""
    facts = {
        "shape": frame.picture.shape, "exposure_s": frame.exposure_s, "number": frame.number,
        "timestamp": frame.timestamp,
    }  # fmt: skip
    return json.dumps(facts).encode() + b"\n" + frame.picture.astype("<u2").tobytes()


def ask_where(bench_file: Path) -> dict[str, Any] | None:
    """``standing_of`` as the program that drives a bench says; None where none of this user's does.
    Errors as ``ask_owner``.
    """
    said = ask_owner(bench_file, WHERE)
    return json.loads(said) if said else None


def ask_for_last_frame(
    bench_file: Path,
) -> tuple[dict[str, Any], "npt.NDArray[np.uint16]"]:
    """The last frame of the program that drives a bench, and its facts.

    Raises:
        DeviceError: no program of this user drives it, or none was taken yet.
    """
    import numpy as np

    said = ask_owner(bench_file, LAST)
    if said is None:
        raise DeviceError(
            f"{bench_file}: no program of yours drives this bench, so there is no last frame; take"
            " one without --last"
        )
    if not said:
        raise DeviceError(f"{bench_file}: the program that drives this bench has no frame yet")
    head, _, pixels = said.partition(b"\n")
    facts = json.loads(head)
    return facts, np.frombuffer(pixels, "<u2").astype(np.uint16).reshape(facts["shape"])
