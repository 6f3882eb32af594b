"""Random cameras, studies and benches for trials of the verdict: focused light field cameras of
many sizes, and how sure their benches are.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flflab.bench import Bench, read_bench
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful
from flflab.optics.focus import magnification
from flflab.optics.resolution import central_smms
from flflab.study import ConfigurationsDescription, Study, StudyDescription, expand
from flflab.targets import Bars, FourDot

BENCH = Path(__file__).parents[1] / "examples" / "benches" / "full.yaml"


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is anywhere alike."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


@dataclass(frozen=True)
class Drawn:
    """A camera focused on a target at ``distance`` mm, ``images`` micro-images across its sensor,
    virtual depth v.
    """

    camera: Camera
    distance: float
    images: float
    v: float


def drawn_camera(rng: np.random.Generator) -> Drawn:
    """A sensible camera: main lens 25 to 100 mm, pitch 0.1 to 0.6 mm, pixels 1.5 to 12 um, array
    before or behind the lens's image.
    """
    while True:
        focal, f_number = rng.uniform(25, 100), log_uniform(rng, 2, 8)
        distance = focal * log_uniform(rng, 6, 40)
        pitch, pixel, v = (
            log_uniform(rng, 0.1, 0.6),
            log_uniform(rng, 0.0015, 0.012),
            rng.uniform(2, 5.5),
        )
        aperture, size = pitch * rng.uniform(0.75, 1.0), rng.uniform(0.75, 1.02)
        behind = (
            1 if rng.random() < 0.6 else -1
        )  # the array behind the main lens's image, or before it
        share = (
            (size * pitch - aperture / v) * f_number / focal
        )  # b/L by the width of the micro-images
        length = 1 / (1 / focal - 1 / distance) / (1 - behind * v * share)
        gap = share * length
        images = v + rng.uniform(3, 5)
        width = round(images * pitch / pixel)
        bright = (size * pitch - 2 * aperture / v) / pixel
        if not (
            0 < share < 0.08 and gap > 0.45 and length > 0 and 200 <= width <= 620 and bright >= 24
        ):
            continue
        layout = "hexagonal" if rng.random() < 0.5 else "square"
        first = 1 / (1 / gap + behind / (v * gap))
        several = layout == "hexagonal" and rng.random() < 0.35
        kinds = (
            (first, first * rng.uniform(1.01, 1.03), first * rng.uniform(0.97, 0.99))
            if several
            else (first,)
        )
        count = round(images) + 3
        array = MicrolensArray(
            layout,
            (count, count + 2),
            (pitch, pitch),
            aperture,
            kinds,
            length,
            ((0, 1, 2), (2, 0, 1)) if several else ((0,),),
        )
        sensor = Sensor((width, round(width * rng.uniform(0.75, 1.0))), pixel, length + gap)
        return Drawn(
            Camera(
                MainLens(focal, f_number),
                array,
                sensor,
                useful=Useful(float(rng.choice([0.0, 0.5]))),
            ),
            distance,
            images,
            v,
        )


def defocused(drawn: Drawn, blur_px: float) -> float:
    """The distance, mm, at which the camera as drawn has so much blur; negative on the other
    side.
    """
    smms = central_smms(drawn.camera)
    length, gap, focal = float(smms.distance), float(smms.gap), float(smms.lens_focal)
    w = (
        (float(smms.kappa) + blur_px * drawn.camera.sensor.pixel / float(smms.aperture))
        * length
        / gap
    )
    return length / (1 / w - 1 + length / focal)


def drawn_study(rng: np.random.Generator, drawn: Drawn) -> Study:
    """Two grids of settings, dots and bars that suit the camera."""
    camera, mm = drawn.camera, "{:.4f} mm".format
    f, at, n = (
        round(camera.main_lens.f_number, 3),
        mm(drawn.distance),
        round(camera.main_lens.f_number * rng.uniform(1.1, 1.3), 3),
    )
    v_gap, deg = drawn.v * camera.gap, "{:.3f} deg".format
    blur = rng.uniform(0.7, 2.0)
    while (
        min(defocused(drawn, side * blur) for side in (-1, 1)) <= 0
    ):  # so blurred it would be beyond infinity
        blur *= 0.8
    grids: list[dict[str, Any]] = [
        {
            "f_number": f,
            "distance": [at, *(mm(defocused(drawn, side * blur)) for side in (-1, 1))],
            "focused_at": at,
        },
        {"f_number": [f, n], "distance": at},
        {
            "f_number": f,
            "distance": at,
            "array": [mm(camera.array.distance + s * 0.05 * v_gap) for s in (-1, 1)],
        },
        {"f_number": f, "distance": at, "main_lens": [mm(s * 0.04 * v_gap) for s in (-1, 1)]},
        {
            "f_number": f,
            "distance": at,
            "yaw": [deg(0), deg(rng.uniform(-0.3, 0.3))],
            "pitch": deg(rng.uniform(-0.2, 0.2)),
        },
        {"f_number": f, "distance": at, "roll": [deg(0), deg(rng.uniform(-2, 2))]},
    ]
    picked = [grids[k] for k in sorted(rng.choice(len(grids), 2, replace=False))]
    described = [ConfigurationsDescription.model_validate(one) for one in picked]
    description = StudyDescription(name="drawn", configurations=described, draws=1000)
    scale = float(magnification(central_smms(camera), 1 / drawn.distance))
    step = (
        float(camera.array.pitch[0]) * drawn.distance / camera.array.distance
    )  # a microlens's pitch on the target
    bright = 2 * float(central_smms(camera).inside_radius) / camera.sensor.pixel
    dot = rng.uniform(5, min(14, 0.4 * bright)) * camera.sensor.pixel / scale
    spacing = max((drawn.images - drawn.v - 1) * rng.uniform(0.6, 1.0) * step, 1.5 * dot)
    width, height = (
        step * images * rng.uniform(0.6, 1.1) for images in (drawn.images, drawn.images)
    )
    frequency = (
        max(1.5 / bright, 0.03) * scale / camera.sensor.pixel,
        rng.uniform(0.3, 0.55) * scale / camera.sensor.pixel,
    )
    return Study(
        description,
        expand(description, camera),
        FourDot(dot, spacing),
        Bars(frequency, width, height),
    )


def drawn_bench(rng: np.random.Generator, drawn: Drawn) -> Bench:
    """The whole bench with zeros that suit the camera, stages and optics 0.3 to 3 times as sure as
    the example's.
    """
    bench = read_bench(BENCH)
    zeros = {
        "main_lens.z": -10.0,
        "array.z": drawn.camera.array.distance - 20,
        "sensor.z": drawn.camera.sensor.distance + 20,
    }
    zeros["target.z"] = -drawn.distance - 75
    axes = {
        name: axis.model_copy(
            update={
                "zero": zeros.get(axis.moves, 0.0),
                "zero_uncertainty": axis.zero_uncertainty * log_uniform(rng, 0.3, 3),
                "scale_uncertainty": axis.scale_uncertainty * log_uniform(rng, 0.3, 3),
            }
        )
        for name, axis in bench.description.axes.items()
    }
    doubt = bench.description.optics_uncertainty
    shares = (
        "main_lens_focal_length",
        "f_number",
        "microlens_focal_length",
        "microlens_aperture",
        "pitch",
    )
    sizes = {
        name: 0.0 if rng.random() < 0.5 else log_uniform(rng, 0.0003, 0.003) for name in shares
    }
    turned = {
        name: getattr(doubt, name) * log_uniform(rng, 0.3, 3)
        for name in ("array_roll", "array_tilt")
    }
    description = bench.description.model_copy(
        update={"axes": axes, "optics_uncertainty": doubt.model_copy(update=sizes | turned)}
    )
    return replace(bench, description=description, optics=drawn.camera)
