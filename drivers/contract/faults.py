"""Every axis of a bench that is simulated, under faults: after each a recovery or one sentence, a
bench that is whole, and no lie.
"""

import contextlib
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.contract.soak import AWAY_S, LATE_S, Soak
from flflab.bench import fields_of, read_bench
from sim import faults
from sim.registry import AXES

CLOCK = 10  # times faster than a real bench
TIMEOUT_S = 0.3  # for an answer: most faults are one that does not come
REAL = "faults are planted in simulated instruments only: give every axis `address: simulated`"


def hurried(bench_file: Path, folder: Path) -> Path:
    """The same bench with a fast clock and little patience."""
    described = read_bench(bench_file)
    data = fields_of(described)
    data["optics"] = str((bench_file.parent / data["optics"]).resolve())
    data["simulated"] = (data.get("simulated") or {}) | {"clock": CLOCK}
    for axis in data["axes"].values():
        axis["timeout"] = TIMEOUT_S
    file = folder / "bench.yaml"
    file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return file


def test_after_every_fault_the_bench_is_whole(
    bench_file: Path, tmp_path: Path, pytestconfig: pytest.Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many as asked for, by chance but seeded."""
    axes = read_bench(bench_file).description.axes.values()
    assert all(axis.address == "simulated" for axis in axes), REAL
    if not any(AXES[axis.driver].faults for axis in axes):
        pytest.skip("the simulators of these axes know no faults")
    monkeypatch.setattr(faults, "LATE_S", LATE_S)
    monkeypatch.setattr(faults, "AWAY_S", AWAY_S)
    with contextlib.closing(Soak(hurried(bench_file, tmp_path), pty=False, seed=1)) as soak:
        count: Any = pytestconfig.getoption("--flflab-faults")
        soak.run(count)
