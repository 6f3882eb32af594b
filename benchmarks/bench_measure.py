"""Times of measuring a full frame of 3664 x 2748 pixels: ``python benchmarks/bench_measure.py
[--repeats N] [--plenopticam PYTHON]``.

Medians of warm calls, wall and processor seconds of all cores, next to what OpenCV and scikit-image
offer for the same. Their detectors get the frame as 8 bits; they find blobs or circles, neither a
lattice nor which dot is which. PlenoptiCam calibrates from the white frame, and from that binned,
once each, under an interpreter that has it: ``peer_plenopticam.py`` says how to get one.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from skimage.feature import blob_log, peak_local_max
from skimage.transform import hough_circle, hough_circle_peaks

from flflab.files.camera import read_camera
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.image.sensor.random_numbers import noise_key
from flflab.image.sensor.response import SensorResponse, digitise
from flflab.measurement.contrast.curve import fit_contrast
from flflab.measurement.dots.views import count_views
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.nominal import nominal_lattice
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.targets import Bars, Chirp, FourDot, Target, White

Frame = npt.NDArray[np.uint16]

CAMERA = Path(__file__).parents[1] / "examples" / "cameras" / "osinski.yaml"
DISTANCE, BLURRED = 506.7016, 494.0  # mm, in focus and with 2 px of blur
F_NUMBERS = (1.6, 2.8, 4.0, 8.0, 16.0)
ELECTRONS = 5000.0
SMALLER = 8  # scikit-image's detectors get the frame binned by this
BINNED = (1, 4, 10)  # PlenoptiCam's frames
NEAR_PX = 12.0  # of a micro-image's true centre, a twentieth of the pitch: found
PATIENCE = 600.0  # s


def sensor_noise() -> SensorNoise:
    """That of the frames below."""
    numbers = SensorResponse().quantisation
    read = SensorResponse().read_noise
    electrons = 0.0 if read is None else read.electrons
    return SensorNoise(
        numbers.dn_per_electron,
        electrons * numbers.dn_per_electron,
        numbers.offset_dn,
        numbers.full_scale,
    )


def frame(
    camera: Camera, target: Target, electrons: float = ELECTRONS, distance: float = DISTANCE
) -> Frame:
    """What the sensor reads before a target."""
    return digitise(
        render(one_plane(camera, target, distance)),
        electrons,
        SensorResponse(),
        noise_key("bench", target.kind),
    )


def row(name: str, call: Callable[[], str], repeats: int) -> None:
    """One line of the table; the call says what it found."""
    found, walls, used = call(), list[float](), list[float]()
    for _ in range(repeats):
        started, before = time.perf_counter(), time.process_time()
        found = call()
        walls.append(time.perf_counter() - started)
        used.append(time.process_time() - before)
    print(
        f"{name:52} {statistics.median(walls):7.3f} {statistics.median(used):7.3f}  {found}",
        flush=True,
    )


def lattice_rows(camera: Camera, repeats: int, plenopticam: str) -> Lattice:
    """Lattices at every f-number; that at F/4 is given back."""
    for f_number in F_NUMBERS:
        one = replace(camera, main_lens=replace(camera.main_lens, f_number=f_number))
        white = frame(one, White(), ELECTRONS / (2.5 if f_number < 2 else 1))
        row(f"lattice, F/{f_number:g}", partial(found_lattice, white, one), repeats)
        if f_number == 4.0:
            peers_on_white(white, repeats)
            for by in BINNED:
                plenopticam_row(white, nominal_lattice(camera, 1.0).centres_px, by, plenopticam)
    return lattice_behind(camera, frame(camera, White()), sensor_noise())


def found_lattice(white: Frame, camera: Camera) -> str:
    """What there is to say of it."""
    found = lattice_behind(camera, white, sensor_noise())
    pitch = found.pitch_uncertainty_px / found.pitch_px
    return (
        f"{len(found.centres_px)} micro-images, origin +- {np.max(found.origin_uncertainty_px):.5f}"
        f" px, pitch +- {pitch:.1e}, bright fields +- {found.inside_uncertainty_px:.4f} px"
    )


def eight_bits(picture: Frame) -> npt.NDArray[np.uint8]:
    """The frame as OpenCV's detectors want it, white at 220."""
    white = ELECTRONS * SensorResponse().quantisation.dn_per_electron
    return np.clip(picture * (220.0 / white), 0, 255).astype(np.uint8)


def blob_detector(smallest: float, largest: float) -> Any:
    """OpenCV's detector of bright blobs."""
    opencv: Any = cv2
    wanted = opencv.SimpleBlobDetector_Params()
    wanted.blobColor, wanted.minArea, wanted.maxArea, wanted.minDistBetweenBlobs = (
        255,
        smallest,
        largest,
        5,
    )
    wanted.filterByCircularity = wanted.filterByConvexity = wanted.filterByInertia = False
    return opencv.SimpleBlobDetector_create(wanted)


def peers_on_white(white: Frame, repeats: int) -> None:
    """OpenCV and scikit-image on the white frame at F/4."""
    picture = eight_bits(white)
    small = (
        picture[: 2748 // SMALLER * SMALLER, : 3664 // SMALLER * SMALLER]
        .reshape(2748 // SMALLER, SMALLER, -1, SMALLER)
        .mean((1, 3))
    )
    small = small / small.max()
    detector = blob_detector(5e3, 5e4)
    row("  cv2.SimpleBlobDetector", lambda: f"{len(detector.detect(picture))} blobs", repeats)

    def grid() -> str:
        opencv: Any = cv2
        found, _ = cv2.findCirclesGrid(
            picture, (15, 11), flags=opencv.CALIB_CB_SYMMETRIC_GRID, blobDetector=detector
        )
        return "15 x 11 circles" if found else "no grid of 15 x 11"

    row("  cv2.findCirclesGrid", grid, repeats)
    row(
        f"  skimage.feature.peak_local_max, 1/{SMALLER}",
        lambda: f"{len(peak_local_max(small, min_distance=10))} peaks",
        repeats,
    )
    row(
        f"  skimage.feature.blob_log, 1/{SMALLER}",
        lambda: f"{len(blob_log(small, 5, 9, 3, threshold=0.2))} blobs",
        max(1, repeats // 3),
    )

    def hough() -> str:
        edges = (small > 0.5).astype(np.float64)
        edges = np.abs(np.gradient(edges)[0]) + np.abs(np.gradient(edges)[1]) > 0
        found = hough_circle_peaks(
            hough_circle(edges, np.array([9])), np.array([9]), min_xdistance=10, min_ydistance=10
        )
        return f"{len(found[0])} circles"

    row(f"  skimage.transform.hough_circle, 1/{SMALLER}", hough, max(1, repeats // 3))


def plenopticam_row(white: Frame, true: npt.NDArray[np.float64], by: int, python: str) -> None:
    """PlenoptiCam on the white frame binned by so much: micro-images it finds, and how far from
    where they are.
    """
    name = f"  PlenoptiCam, 1/{by}"
    small = (
        white[: 2748 // by * by, : 3664 // by * by]
        .reshape(2748 // by, by, 3664 // by, by)
        .mean((1, 3))
    )
    with tempfile.TemporaryDirectory() as folder:
        given, got = Path(folder) / "white.npy", Path(folder) / "centres.npy"
        np.save(given, small)
        script = str(Path(__file__).with_name("peer_plenopticam.py"))
        try:
            ran = subprocess.run(
                [python, script, str(given), str(got)],
                capture_output=True,
                text=True,
                timeout=PATIENCE,
                check=False,
            )
            reason = (
                (ran.stderr.strip() or "no output").splitlines()[-1] if ran.returncode else None
            )
        except OSError as error:
            reason = str(error)
        if reason is not None:
            print(f"{name:52} {'-':>7} {'-':>7}  not run under {python}: {reason}", flush=True)
            return
        centres = np.load(got) * by + (by - 1) / 2
        said = json.loads(ran.stdout)
    found, off = 0, np.zeros((0, 2))
    if len(centres):
        away = np.hypot(*(true[:, None] - centres).transpose(2, 0, 1))
        near = away.min(axis=1) < NEAR_PX
        found, off = int(near.sum()), (centres[away.argmin(axis=1)] - true)[near]
    rms = f", rms {np.sqrt(np.mean(off**2)):.3f} px a coordinate" if found else ""
    takes = f"; takes them for {said['size_px'] * by} px wide" + (
        f"; {said['says']}" if said["says"] else ""
    )
    print(
        f"{name:52} {said['wall']:7.3f} {said['processor']:7.3f}  {found} of {len(true)}"
        f" micro-images{rms}{takes}",
        flush=True,
    )


def dot_rows(camera: Camera, lattice: Lattice, repeats: int) -> None:
    """Dots and views at F/4."""
    target, white = FourDot(), frame(camera, White())
    for distance, what in ((DISTANCE, ""), (BLURRED, ", 2 px of blur")):
        row(
            f"dots and views, F/4{what}",
            partial(
                found_dots,
                frame(camera, target, distance=distance),
                white,
                lattice,
                camera,
                distance,
            ),
            repeats,
        )
    picture, detector = eight_bits(frame(camera, target)), blob_detector(50, 400)
    row("  cv2.SimpleBlobDetector", lambda: f"{len(detector.detect(picture))} blobs", repeats)


def found_dots(
    picture: Frame, white: Frame, lattice: Lattice, camera: Camera, distance: float
) -> str:
    """What there is to say of it."""
    found = count_views(picture, lattice, camera, FourDot(), distance, sensor_noise())
    return (
        f"views {[dot.views for dot in found]}, z +-"
        f" {max(dot.uncertainty_mm[2] for dot in found):.3f} mm"
    )


def contrast_rows(camera: Camera, lattice: Lattice, repeats: int) -> None:
    """Contrast of all views at F/4."""
    for target in (Bars(), Chirp()):
        picture = frame(camera, target)

        def call(picture: Frame = picture, target: Bars = target) -> str:
            curve = fit_contrast(picture, lattice, camera, target, DISTANCE, sensor_noise())
            return (
                f"{len(curve.views)} views, {len(curve.contrast)} frequencies, +-"
                f" {curve.uncertainty.max():.5f}"
            )

        row(f"contrast of {target.kind}, every view, F/4", call, repeats)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument(
        "--plenopticam",
        default=sys.executable,
        metavar="PYTHON",
        help="an interpreter that has it; default: this one",
    )
    given = parser.parse_args()
    repeats = given.repeats
    print(
        f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; wall and processor seconds,"
        f" medians of {repeats}"
    )
    camera = read_camera(CAMERA)
    lattice = lattice_rows(camera, repeats, given.plenopticam)
    dot_rows(camera, lattice, repeats)
    contrast_rows(camera, lattice, repeats)


if __name__ == "__main__":
    main()
