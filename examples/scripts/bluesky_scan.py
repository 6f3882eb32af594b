"""The bench under your own bluesky: a scan of the sensor, printed as it goes, its frames in a file
that any program opens.

    python bluesky_scan.py my-bench.yaml

Without a bench file it runs on the simulated bench. Documents go to scan.jsonl, frames to the
folder frames.
"""

import json
import sys
from pathlib import Path
from urllib.parse import urlparse
from urllib.request import url2pathname

import h5py
from bluesky import RunEngine
from bluesky import plans as bp
from bluesky.callbacks.best_effort import BestEffortCallback

import flflab as ff

BENCH = (
    sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1] / "benches" / "simulated.yaml"
)

documents = []
table = BestEffortCallback()
table.disable_plots()  # without this line it draws what the hints name

with ff.connect(BENCH) as bench:
    bench.home()
    bench.go(main_lens_z=0, array_z=60, sensor_z=61.2, target_z=-510, f_number=4, target="white")
    bench.detector.folder = Path("frames")
    bench.detector.prepare(2e-3)

    engine = RunEngine({})
    engine.subscribe(table)
    engine.subscribe(lambda name, document: documents.append((name, document)))
    engine(bp.scan([bench.detector], bench.sensor_stage, 18.7, 18.8, 3))

Path("scan.jsonl").write_text(
    "".join(json.dumps({"name": name, "doc": document}) + "\n" for name, document in documents)
)
resource = next(document for name, document in documents if name == "stream_resource")
file = Path(url2pathname(urlparse(resource["uri"]).path))
with h5py.File(file) as opened:
    frames = opened[resource["parameters"]["dataset"]][:]
print(f"{len(frames)} frames of {frames.shape[2]} x {frames.shape[1]} pixels in {file.name}")
