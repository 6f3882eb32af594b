"""A disk that takes no more, at any byte: one sentence, and every frame handed over before the one
on the way is in the record, once.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from flflab.record import read_documents, read_run

LIMITS = 30
WRITER = """
import json, os, resource, signal, sys
from pathlib import Path
import numpy as np
from flflab.errors import RecordError
from flflab.record import Recording

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write beyond the limit then fails as on a full disk
chance = np.random.default_rng(21)
for trial in range(int(sys.argv[2])):
    folder = Path(sys.argv[1]) / str(trial)
    folder.mkdir()
    limit = int(chance.integers(2_000, 420_000))
    if os.fork() == 0:
        recording = Recording(folder, 40, (60, 80))
        recording.document("start", {"uid": "s", "axes": []})
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        said = {"recorded": 0, "error": ""}
        try:
            for number in range(40):
                place = recording.frame(np.full((60, 80), number, np.uint16))
                recording.document("stream_datum", {"indices": {"start": place, "stop": place + 1}})
                worlds = {f"world_{element}_z_mm": 0.0 for element in ("main_lens", "array", "sensor", "target")}
                event = {"point": f"c0/bars/{number}", "configuration": 0, "target": "bars", "repeat": number, "iris": 4.0,
                         "exposure_s": 0.01, "gain": 1.0, "saturated": 0, "number": number, **worlds}
                recording.document("event", {"time": 0.0, "data": event})
                said["recorded"] += 1
        except RecordError as error:
            said["error"] = str(error)
        try:
            recording.close()
        except RecordError:
            pass  # what was not written cannot be written now either
        os.write(1, (json.dumps(said) + "\\n").encode())
        os._exit(0)
    os.wait()
"""  # noqa: E501


@pytest.mark.ci
@pytest.mark.skipif(sys.platform == "win32", reason="limits the size of files the POSIX way")
def test_a_full_disk_is_one_sentence_and_loses_nothing_recorded_before(tmp_path: Path) -> None:
    command = [sys.executable, "-c", WRITER, str(tmp_path), str(LIMITS)]
    trials = [
        json.loads(line)
        for line in subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout.splitlines()
    ]
    assert len(trials) == LIMITS
    refused = 0
    for trial, said in enumerate(trials):
        if said["recorded"] < 40:
            refused += 1
            assert said["error"].count("\n") == 0
            assert str(tmp_path / str(trial)) in said["error"], said
            assert said["error"].endswith(
                "could not be written (File too large); make room before you go on"
            )
        documents = read_documents(tmp_path / str(trial))
        events = [document for name, document in documents if name == "event"]
        # One may be on its way when the disk is full; the last one may be whole though its writer
        # was told otherwise.
        assert len(events) - said["recorded"] in (-1, 0, 1)
        if events:
            run = read_run(tmp_path / str(trial))
            sure = run.frames[: said["recorded"]]
            assert [int(run.picture(frame).min()) for frame in sure] == list(range(len(sure)))
    assert refused > LIMITS / 2
    assert np.ptp([said["recorded"] for said in trials]) > 20
