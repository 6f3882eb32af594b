"""PlenoptiCam's calibration on one white picture: ``PYTHON benchmarks/peer_plenopticam.py WHITE.npy
CENTRES.npy``.

``bench_measure.py --plenopticam PYTHON`` starts it under an interpreter that has PlenoptiCam;
nothing here needs flflab. Version 0.9.3 does not install by ``pip install plenopticam`` under
Python 3.11 (2026-11-22): it pins pyinstaller 4.10, which is for Python below 3.11. Beside flflab's
own packages it does not start: by way of depthy it imports ``scipy.misc.face``, gone since SciPy
1.12. What works, wheels only:

    python3.11 -m venv ENV ENV/bin/pip install --only-binary :all: "numpy<2" "scipy<1.12"
    scikit-image imageio requests "colour-demosaicing<0.2.6" ENV/bin/pip install --no-deps
    plenopticam==0.9.3 depthy color-space-converter color-matcher==0.4.0

Writes the centres (x, y), shape (n, 2), and prints one line of JSON: seconds of wall and processor,
and what it took for the pitch in px.
"""

import contextlib
import io
import json
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np


def main() -> None:
    """Calibrate; an error of PlenoptiCam's is what this ends with."""
    warnings.simplefilter("ignore")
    from plenopticam.cfg import PlenopticamConfig  # pyright: ignore[reportMissingImports]
    from plenopticam.lfp_calibrator import LfpCalibrator, PitchEstimator  # pyright: ignore[reportMissingImports]
    from plenopticam.misc import PlenopticamStatus  # pyright: ignore[reportMissingImports]

    white = np.load(sys.argv[1]).astype(np.float64)
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        settings: Any = PlenopticamConfig()
        settings.params[settings.cal_meth] = "area"
        settings.params[settings.cal_meta] = str(Path(folder) / "calibration.json")
        status: Any = PlenopticamStatus()
        size: Any = PitchEstimator(white, settings, status)
        size.main()
        started, before, says = time.perf_counter(), time.process_time(), ""
        try:
            LfpCalibrator(white, settings, status).main()
        except (IndexError, ValueError, TypeError, ZeroDivisionError) as error:
            says = f"{type(error).__name__}: {error}"
        wall, used = time.perf_counter() - started, time.process_time() - before
    found = np.array(
        [place[:2] for place in settings.calibs.get(settings.mic_list) or []], dtype=np.float64
    ).reshape(-1, 2)
    np.save(sys.argv[2], found[:, ::-1])
    print(
        json.dumps(
            {
                "wall": wall,
                "processor": used,
                "size_px": int(size.M),
                "says": says or (str(status.stat_var) if status.error else ""),
            }
        )
    )


if __name__ == "__main__":
    main()
