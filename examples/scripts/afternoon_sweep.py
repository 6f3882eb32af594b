"""An afternoon on the bench: how does the brightness and the pitch of the micro-images change as
the sensor moves away from the array?

    python afternoon_sweep.py my-bench.yaml

Homes every axis, takes a white picture at four places of the sensor, and prints what the lattice of
micro-images says beside the model. Without a bench file it runs on the simulated bench.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import drivers
from drivers.base import wait_all
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.resolution import central_smms
from procedures.steps import home_steps

BENCH = (
    sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1] / "benches" / "simulated.yaml"
)
GAPS_MM = np.linspace(1.00, 1.30, 4)

with drivers.connect(BENCH) as bench:
    for step in home_steps(bench.described):  # array and sensor away from each other first
        wait_all(*(bench.axes[name].home() for name in step.axes), timeout=600)
    described = bench.described.description
    array, sensor = described.axis_of("array.z")[1], described.axis_of("sensor.z")[1]
    optics = bench.described.optics

    bench.array_stage.move_to(array.reading(optics.array.distance)).wait(120)
    bench.main_lens_stage.move_to(described.axis_of("main_lens.z")[1].reading(0.0)).wait(120)
    bench.iris.set(4.0).wait(60)
    bench.target.set("white").wait(60)
    noise = SensorNoise(
        bench.camera.dn_per_electron,
        bench.camera.read_noise_dn,
        bench.camera.offset_dn,
        bench.camera.full_scale,
    )

    print("gap, mm   pitch, px              model      total field, px        model")
    for gap in GAPS_MM:
        bench.sensor_stage.move_to(sensor.reading(optics.array.distance + gap)).wait(
            120
        )  # refused, were it nearer than the minimum gap
        bench.camera.prepare(exposure_s=2e-3)
        picture = bench.camera.grab().picture
        camera = replace(
            optics, sensor=replace(optics.sensor, distance=optics.array.distance + gap)
        )
        smms = central_smms(camera)
        pitch = float(optics.array.pitch[0] * smms.image_scale) / optics.sensor.pixel
        lattice = lattice_behind(camera, picture, noise)
        print(
            f"{gap:7.3f}   {lattice.pitch_px:9.4f} +- {lattice.pitch_uncertainty_px:.4f}  "
            f" {pitch:9.4f}   {2 * lattice.outside_radius_px:9.3f} +-"
            f" {2 * lattice.outside_uncertainty_px:.3f}  "
            f" {2 * float(smms.outside_radius) / optics.sensor.pixel:9.3f}"
        )
