# longer than 450 lines because a benchmark is one file
"""Random cameras on random benches through a validation without the wire: how often is an honest
one rejected, is a defect named.

``python benchmarks/bench_validation.py honest FIRST COUNT FILE`` adds a line of JSON a bench to
FILE, ``defect`` plants one defect in each, ``waves`` is honest in light of a wavelength that the
bench file states; ``table FILE ...`` prints what docs/report.md says. The hidden errors are drawn
here, by this file's own generator; the analysis knows only what the bench file states.
"""

import json
import math
import sys
import time
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench, Element, read_bench
from flflab.errors import FlflabError
from flflab.image.render import render
from flflab.image.scene import in_light, one_plane
from flflab.image.sensor.exposure import white_irradiance
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful
from flflab.optics.focus import magnification
from flflab.optics.resolution import central_smms
from flflab.study import Configuration, ConfigurationsDescription, Study, StudyDescription, expand
from flflab.targets import Bars, FourDot, Target, White
from flflab.verdict.diagnosis import not_told_apart
from flflab.verdict.evaluation import Evaluation, evaluate_measured
from flflab.verdict.prediction import ELEMENTS
from flflab.verdict.properties.measured import Measured, measure_pictures
from flflab.verdict.sources import attitude_uncertainty

Array = npt.NDArray[np.float64]
BENCH = Path(__file__).parents[1] / "examples" / "benches" / "full.yaml"
GAIN, READ_NOISE_E, OFFSET, FULL_SCALE, WHITE_E = 4095 / 12000, 3.0, 64.0, 4095.0, 8000.0
NOISE = SensorNoise(GAIN, READ_NOISE_E * GAIN, OFFSET, FULL_SCALE)
DEFECTS = {  # what the report should name, or something that cannot be told from it
    "lens": "focal length of the main lens", "focal": "focal length of the microlenses",
    "pitch": "pitch of the microlenses",
    "gap": "zero of sensor_stage", "iris": "aperture of the main lens (the f-number the other way)",
    "roll": "roll of the array",
}  # fmt: skip


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


def drawn_bench(rng: np.random.Generator, drawn: Drawn, wavelength: float | None) -> Bench:
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
        update={
            "axes": axes,
            "optics_uncertainty": doubt.model_copy(update=sizes | turned),
            "wavelength": wavelength,
        }
    )
    return replace(bench, description=description, optics=drawn.camera)


@dataclass(frozen=True)
class Truth:
    """What is hidden: errors of the stages, true over described sizes, turns of the array in
    rad.
    """

    zeros: dict[Element, float]
    scales: dict[Element, float]
    sizes: dict[str, float]
    turns: Array


def drawn_truth(rng: np.random.Generator, bench: Bench, defect: str | None) -> Truth:
    """Errors within what the bench file states; a defect comes on top, ten times that at least."""
    axes, doubt = (
        {
            element: found[1]
            for element in ELEMENTS
            if (found := bench.description.axis_of(element))
        },
        bench.description.optics_uncertainty,
    )
    stated = {
        "lens": doubt.main_lens_focal_length,
        "iris": doubt.f_number,
        "focal": doubt.microlens_focal_length,
    }
    stated |= {"aperture": doubt.microlens_aperture, "pitch": doubt.pitch}
    zeros = {element: rng.normal(0.0, axis.zero_uncertainty) for element, axis in axes.items()}
    scales = {element: rng.normal(0.0, axis.scale_uncertainty) for element, axis in axes.items()}
    sizes = {name: 1 + rng.normal(0.0, share) for name, share in stated.items()}
    attitude = attitude_uncertainty(bench)
    turns = rng.normal(0.0, 1.0, 3) * attitude
    side = float(rng.choice([-1.0, 1.0]))
    if defect == "gap":
        zeros["sensor.z"] += side * max(
            15 * axes["sensor.z"].zero_uncertainty, 0.01 * bench.optics.gap
        )
    elif defect == "roll":
        turns[0] += side * 10 * attitude[0]
    elif defect:
        sizes[defect] += side * max(
            10 * stated[defect], {"lens": 0.01, "focal": 0.02, "pitch": 0.01, "iris": 0.04}[defect]
        )
    return Truth(zeros, scales, sizes, turns)


def built(camera: Camera, truth: Truth) -> Camera:
    """The camera of a configuration as it really is, stages aside."""
    lens, array, sizes = camera.main_lens, camera.array, truth.sizes
    slopes = (array.tilt[0] + math.tan(truth.turns[1]), array.tilt[1] + math.tan(truth.turns[2]))
    return replace(
        camera,
        main_lens=replace(lens, focal_length=lens.focal_length * sizes["lens"],
        f_number=lens.f_number * sizes["iris"]),
        array=replace(
            array,
            aperture=min(array.aperture * sizes["aperture"], array.pitch[0] * sizes["pitch"]),
            focal_lengths=tuple(one * sizes["focal"] for one in array.focal_lengths),
            pitch=(array.pitch[0] * sizes["pitch"], array.pitch[1] * sizes["pitch"]),
            roll=array.roll + truth.turns[0], tilt=slopes,
        ),
    )  # fmt: skip


def seen(
    rng: np.random.Generator,
    configuration: Configuration,
    bench: Bench,
    study: Study,
    truth: Truth,
    wavelength: float | None,
) -> Measured:
    """One configuration, drawn with what is hidden and measured."""
    worlds: dict[Element, float] = {
        "main_lens.z": configuration.main_lens,
        "array.z": configuration.array + configuration.main_lens,
    }
    worlds |= {
        "sensor.z": configuration.sensor + configuration.main_lens,
        "target.z": configuration.main_lens - configuration.distance,
    }
    true = dict(worlds)
    for element, place in worlds.items():
        if found := bench.description.axis_of(element):
            true[element] = (
                place
                + truth.zeros[element]
                + found[1].sign * truth.scales[element] * found[1].reading(place)
            )
    camera, lens = built(configuration.camera(bench.optics), truth), true["main_lens.z"]
    camera = replace(
        camera,
        array=replace(camera.array, distance=true["array.z"] - lens),
        sensor=replace(camera.sensor, distance=true["sensor.z"] - lens),
    )
    lamp = 1 + rng.normal(0.0, bench.description.light_uncertainty)
    light = lamp * white_irradiance(camera) / white_irradiance(bench.optics)
    targets: tuple[Target, ...] = (White(), study.dots, study.bars)
    pictures = {
        target.kind: exposed(rng, camera, target, lens - true["target.z"], light, wavelength)
        for target in targets
    }
    noises = {target.kind: NOISE for target in targets}
    return measure_pictures(
        pictures,
        noises,
        configuration,
        worlds,
        study,
        bench.optics,
        wavelength=bench.description.mean_wavelength,
    )


def exposed(
    rng: np.random.Generator,
    camera: Camera,
    target: Target,
    distance: float,
    light: float,
    wavelength: float | None,
) -> Array:
    """A frame, DN."""
    tolerance = 3e-5 if target == White() else 5e-4 if wavelength is None else 1e-3
    drawn = np.maximum(
        render(in_light(one_plane(camera, target, distance), wavelength), tolerance=tolerance), 0.0
    )
    electrons = rng.poisson(drawn * WHITE_E * light) + rng.normal(0.0, READ_NOISE_E, drawn.shape)
    return np.clip(np.rint(electrons * GAIN + OFFSET), 0, FULL_SCALE)


def one_trial(seed: int, defect: bool, waves: bool) -> dict[str, Any]:
    """One random bench, validated: what was drawn, verdicts, suspects, failures."""
    rng = np.random.default_rng((seed, 2026))
    wavelength = float(rng.uniform(450e-6, 650e-6)) if waves else None
    drawn = drawn_camera(rng)
    bench, study = drawn_bench(rng, drawn, wavelength), drawn_study(rng, drawn)
    planted = list(DEFECTS)[seed % len(DEFECTS)] if defect else None
    truth = drawn_truth(rng, bench, planted)
    camera, array = drawn.camera, drawn.camera.array
    found: dict[str, Any] = {
        "seed": seed, "defect": planted, "wavelength": wavelength,
        "focal_length": camera.main_lens.focal_length,
        "f_number": camera.main_lens.f_number, "distance": drawn.distance, "layout": array.layout,
        "kinds": len(array.focal_lengths),
        "pitch": array.pitch[0], "pixel": camera.sensor.pixel, "gap": camera.gap,
        "array": array.distance, "virtual_depth": drawn.v,
        "resolution": camera.sensor.resolution,
        "behind_the_image": 1 / array.focal_lengths[0] > 1 / camera.gap,
        "settings": len(study.configurations),
    }  # fmt: skip
    start = time.process_time()
    try:
        measured = tuple(
            seen(rng, one, bench, study, truth, wavelength) for one in study.configurations
        )
        found["failures"] = [str(failure) for one in measured for failure in one.failures]
        found |= told(evaluate_measured(measured, study, bench, seed))
    except FlflabError as error:
        found["refused"] = str(error)
    except Exception:  # what a user would see as a traceback is what is looked for
        found["traceback"] = traceback.format_exc()
    return found | {"cpu_s": time.process_time() - start}


def told(run: Evaluation) -> dict[str, Any]:
    """What an evaluation says, in numbers."""
    comparison = run.comparison
    return {
        "p": {one.quantity: one.p_value for one in comparison.verdicts},
        "rejected": [one.quantity for one in comparison.verdicts if not one.accepted],
        "suspects": [
            (one.what, one.size, one.chi2, one.chi2_before, one.numbers) for one in run.suspects
        ],
        "named": [one.what for one in not_told_apart(run.suspects)],
        "z": {
            quantity: [round(row.z, 3) for row in comparison.rows if row.quantity == quantity]
            for quantity in dict.fromkeys(row.quantity for row in comparison.rows)
        },
        "counts": [
            (row.measured, row.predicted) for row in comparison.rows if row.quantity == "views"
        ],
        "odd": [
            str(row)
            for row in comparison.rows
            if not all(map(math.isfinite, (row.measured, row.uncertainty, row.predicted, row.z)))
        ],
    }


def table(files: list[str]) -> None:
    """Rejections, and how the p-values of each property are spread; of defects, which were
    named.
    """
    benches = [json.loads(line) for file in files for line in Path(file).read_text().splitlines()]
    judged = [one for one in benches if "p" in one]
    print(
        f"{len(benches)} benches, {sum('refused' in one for one in benches)} refused, "
        f"{sum('traceback' in one for one in benches)} tracebacks"
    )
    print(f"{sum(bool(one['rejected']) for one in judged)} of {len(judged)} rejected")
    for quantity in dict.fromkeys(quantity for one in judged for quantity in one["p"]):
        p = np.array([one["p"][quantity] for one in judged if quantity in one["p"]])
        fifths = np.histogram(p, np.linspace(0, 1, 6))[0].tolist()
        print(
            f"{quantity}: {len(p)}, below 0.05 {100 * np.mean(p < 0.05):.0f} %, median"
            f" {np.median(p):.2f}, fifths {fifths}"
        )
    planted = [one for one in judged if one["defect"]]
    if planted:
        named = sum(
            any(what.startswith(DEFECTS[one["defect"]]) for what in one["named"]) for one in planted
        )
        print(
            f"of {len(planted)} defects {sum(bool(one['rejected']) for one in planted)} rejected,"
            f" {named} named"
        )


def main() -> None:
    """See the file's head."""
    if sys.argv[1] == "table":
        table(sys.argv[2:])
        return
    what, first, count, file = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])
    for seed in range(first, first + count):
        line = json.dumps(one_trial(seed, what == "defect", what == "waves"))
        with file.open("a") as out:
            out.write(line + "\n")


if __name__ == "__main__":
    main()
