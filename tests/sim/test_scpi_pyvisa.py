"""The simulated camera as PyVISA sees it: the laboratory world's own client, with its own reader of
IEEE 488.2 blocks.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import pyvisa
from pyvisa.constants import StatusCode
from pyvisa.resources import MessageBasedResource

from flflab.bench import Bench
from sim.serve import Served, serve, warm_up

WriteBench = Callable[..., Bench]


@pytest.fixture
def manager() -> Iterator[pyvisa.ResourceManager]:
    manager = pyvisa.ResourceManager("@py")
    yield manager
    manager.close()


def opened(
    manager: pyvisa.ResourceManager, served: Served, timeout_ms: int = 20_000
) -> MessageBasedResource:
    host, port = served.addresses["camera"]["address"].split(":")
    resource: Any = manager.open_resource(
        f"TCPIP0::{host}::{port}::SOCKET", read_termination="\n", write_termination="\n"
    )
    resource.timeout = timeout_ms
    return resource


@pytest.mark.ci
@pytest.mark.filterwarnings(
    "ignore:The beginning of the block:UserWarning"
)  # it wonders at seven fields before a block
def test_pyvisa_sets_exposes_and_reads_the_binary_block(
    write_bench_file: WriteBench, manager: pyvisa.ResourceManager
) -> None:
    with serve(write_bench_file()) as served:
        warm_up(served).join()
        camera = opened(manager, served)
        assert camera.query("*IDN?").count(",") == 3
        assert camera.query_ascii_values("EXP? MIN;EXP? MAX", separator=";") == [1e-5, 10]
        camera.write("ABOR;*RST;TARG:KIND white;EXP 0.004;GAIN 2")
        assert camera.query("*OPC?;SYST:ERR?") == '1;0,"No error"'
        camera.write("INIT")
        # PyVISA finds the block behind the fields by itself and checks its length.
        picture = np.array(
            camera.query_binary_values("FETC?", datatype="H", is_big_endian=False, chunk_size=4096)
        )
        assert picture.size == 240 * 180
        assert picture.max() <= 4095
        assert np.count_nonzero(picture > 1000) > 1000
        assert camera.query("FETC:COUN?;FETC:DROP?") == "0;0"
        camera.close()


def test_pyvisa_is_told_of_errors_and_of_a_lost_frame(
    write_bench_file: WriteBench, manager: pyvisa.ResourceManager
) -> None:
    with serve(write_bench_file(faults=[{"device": "camera", "fault": "lost-frame"}])) as served:
        camera = opened(manager, served)
        camera.write("EXP 100")
        assert camera.query("SYST:ERR?") == '-222,"Data out of range;EXP 100, allowed 1e-05 to 10"'
        camera.write("INIT")
        empty = camera.query_binary_values(
            "FETC?", datatype="B", expect_termination=True, data_points=0
        )
        assert list(empty) == []
        assert camera.query("SYST:ERR?").startswith('-230,"Data corrupt or stale')
        camera.close()


def test_pyvisa_runs_into_its_own_time_limit_where_nothing_answers(
    write_bench_file: WriteBench, manager: pyvisa.ResourceManager
) -> None:
    with serve(
        write_bench_file(faults=[{"device": "camera", "fault": "silence", "after": 1}])
    ) as served:
        camera = opened(manager, served, timeout_ms=300)
        assert camera.query("EXP?") == "0.01"
        with pytest.raises(pyvisa.VisaIOError) as told:
            camera.query("EXP?")
        assert told.value.error_code == StatusCode.error_timeout
        camera.close()
