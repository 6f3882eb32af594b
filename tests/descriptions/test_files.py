# longer than 450 lines because one subject's sentences of behaviour stand together
"""Camera, bench and study files: what is wrong is refused with file, line, field, what was given
and what is allowed.
"""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest

from flflab.bench import read_bench
from flflab.description import load
from flflab.errors import InputError
from flflab.files.camera import CameraDescription, read_camera
from flflab.image.scene_file import read_scene
from flflab.optics.camera import Substrate
from flflab.optics.focus import blur
from flflab.optics.resolution import central_smms
from flflab.study import focused_sensor, read_study
from flflab.wheel import unlike_the_wheel

EXAMPLES = Path(__file__).parents[2] / "examples"
CAMERA = EXAMPLES / "cameras" / "osinski.yaml"
BENCH = EXAMPLES / "benches" / "simulated.yaml"
STUDY = EXAMPLES / "studies" / "first.yaml"


def changed(source: Path, folder: Path, old: str, new: str) -> tuple[Path, int]:
    """A copy with one replacement, and the line it stands on."""
    text = source.read_text(encoding="utf-8")
    assert text.count(old) >= 1
    place = text.index(old)
    file = folder / source.name
    file.write_text(
        (text[:place] + new + text[place + len(old) :]).replace(
            "../cameras/", f"{EXAMPLES / 'cameras'}/"
        ),
        encoding="utf-8",
    )
    return file, text[:place].count("\n") + 1


CAMERA_FAULTS = [
    (
        "f_number: 4",
        "distortion: {radial: [1e-4, 0, 0]}\n  f_number: 4",
        "main_lens.distortion.radial.0",
        "0.0001 given; a number and 1/mm^2 is due, such as '1e-6 1/mm^2'",
    ),
    (
        "f_number: 4",
        "distortion: {radial: [1e-4 1/mm^2, 1e-6 1/mm^2, 0]}\n  f_number: 4",
        "main_lens.distortion.radial.1",
        "'1e-6 1/mm^2' given; a number and 1/mm^4 is due",
    ),
    (
        "f_number: 4",
        "distortion: {radial: [nan 1/mm^2, 0, 0]}\n  f_number: 4",
        "main_lens.distortion.radial.0",
        "a number and 1/mm^2 is due",
    ),
    (
        "focal_length: 0.917 mm",
        "focal_length: [1 mm, 0 mm]",
        "microlens_array.focal_length.1",
        "0 mm is no focal length",
    ),
    ("pitch: 400 um", "pitch: 400", "microlens_array.pitch", "has no unit"),
    (
        "pitch: 400 um",
        "pitsch: 400 um",
        "microlens_array.pitsch",
        "there is no such field, did you mean pitch? allowed here: layout, count, pitch",
    ),
    ("pitch: 400 um", "pitch: 400 deg", "microlens_array.pitch", "unit of angle"),
    ("pitch: 400 um", "pitch: -400 um", "microlens_array.pitch", "greater than 0"),
    ("f_number: 4", "f_number: four", "main_lens.f_number", "a number is due here, not 'four'"),
    (
        "f_number: 4",
        "f_number: yes",
        "main_lens.f_number",
        "yes, no, true and false are no number; give a number",
    ),
    ("count: [25, 25]", "count: [25, on]", "microlens_array.count.1", "are no number"),
    ("layout: square", "layout: round", "microlens_array.layout", "'square' or 'hexagonal'"),
    (
        "minimum_illumination: 0.5",
        "minimum_illumination: 1.5",
        "useful.minimum_illumination",
        "less than or equal to 1",
    ),
    (
        "count: [25, 25]",
        "count: [25]",
        "microlens_array.count",
        "fewer values than are due here: [25]",
    ),
    (
        "count: [25, 25]",
        "count: [25, 25, 1]",
        "microlens_array.count",
        "more values than are allowed here: [25, 25, 1]",
    ),
    (
        "count: [25, 25]",
        "count: 25",
        "microlens_array.count",
        "values in brackets are due here, [..., ...], not 25",
    ),
    (
        "count: [25, 25]",
        "count: [1000000, 25]",
        "microlens_array.count",
        "less than or equal to 1000, not 1000000",
    ),
    ("pixel: 1.66 um", "pixel: nan um", "sensor.pixel", "not a quantity"),
    (
        "pitch: 400 um",
        "pitch: 400 mm",
        "microlens_array.pitch",
        "is 400 mm, more than the whole sensor of 6.08224 mm x 4.56168 mm",
    ),
    (
        "pitch: 400 um",
        "pitch: [0.4 mm, 400 mm]",
        "microlens_array.pitch",
        "is 400 mm, more than the whole sensor",
    ),
    (
        "pixel: 1.66 um",
        "pixel: 1.66 mm",
        "sensor.pixel",
        "is 1.66 mm, more than the 0.4 mm from microlens to microlens",
    ),
    (
        "resolution: [3664, 2748]",
        "resolution: [60000, 60000]",
        "sensor.resolution",
        "60,000 x 60,000 are more pixels than any sensor has; at most 500,000,000 are allowed",
    ),
    (
        "f_number: 4",
        "f_number: 1e308",
        "main_lens.f_number",
        "1e+308 is no size that a thing has; 0 and 1e-15 to 1e+12 are allowed",
    ),
    (
        "distance: 61.15 mm",
        "distance: 1e308 mm",
        "sensor.distance",
        "1e+308 is no size that a thing has",
    ),
    (
        "aperture: 336 um",
        "aperture: 1e-300 um",
        "microlens_array.aperture",
        "1e-303 is no size that a thing has",
    ),
]


@pytest.mark.parametrize(
    "sensor",
    ["[1, 250]\n  pixel: 1.6 um", "[2, 3]\n  pixel: 400 um"],
    ids=["one microlens", "a pixel each"],
)
def test_the_smallest_cameras_are_cameras(sensor: str, tmp_path: Path) -> None:
    file, _ = changed(CAMERA, tmp_path, "[3664, 2748]  # columns, rows\n  pixel: 1.66 um", sensor)
    assert read_camera(file).array.pitch == (0.4, 0.4)


@pytest.mark.parametrize(
    ("old", "new", "field", "says"), CAMERA_FAULTS, ids=[fault[1] for fault in CAMERA_FAULTS]
)
def test_a_wrong_camera_field_is_refused_by_line_and_name(
    old: str, new: str, field: str, says: str, tmp_path: Path
) -> None:
    file, line = changed(CAMERA, tmp_path, old, new)
    with pytest.raises(InputError) as refusal:
        read_camera(file)
    assert f"{file}:{line}: {field}" in str(refusal.value)
    assert says in str(refusal.value)


def test_a_missing_field_is_named_with_the_line_of_its_section(tmp_path: Path) -> None:
    file, line = changed(CAMERA, tmp_path, "  pixel: 1.66 um\n", "")
    with pytest.raises(InputError, match=r"sensor\.pixel: this field is missing") as refusal:
        read_camera(file)
    assert f"{file}:{line - 2}:" in str(refusal.value)


def test_a_sensor_before_the_array_is_refused_on_the_line_of_its_distance(tmp_path: Path) -> None:
    file, line = changed(CAMERA, tmp_path, "distance: 61.15 mm", "distance: 59 mm")
    with pytest.raises(
        InputError, match=rf":{line}: sensor\.distance: .*the sensor lies behind the array"
    ):
        read_camera(file)


def test_a_rule_between_fields_is_told_on_the_line_of_the_one_it_begins_with(
    tmp_path: Path,
) -> None:
    file, line = changed(STUDY, tmp_path, "draws: 1000", "draws: 200")
    with pytest.raises(InputError, match=rf"first\.yaml:{line}: draws: draws is 200, but"):
        read_study(file, read_camera(CAMERA))
    file, line = changed(BENCH, tmp_path, "limits: [0 mm, 25 mm]", "limits: [25 mm, 0 mm]")
    with pytest.raises(
        InputError, match=rf":{line}: axes\.main_lens_stage\.limits: limits are 25 mm to 0 mm"
    ):
        read_bench(file)


def test_a_unit_of_another_size_is_named_on_the_line_of_its_number(tmp_path: Path) -> None:
    file, line = changed(CAMERA, tmp_path, "focal_length: 0.917 mm", "focal_length: 0.917 um")
    said = rf":{line}: microlens_array\.focal_length: .* was 0\.917 mm meant"
    with pytest.raises(InputError, match=said):
        read_camera(file)


def test_a_field_given_twice_is_refused(tmp_path: Path) -> None:
    file, line = changed(CAMERA, tmp_path, "  f_number: 4\n", "  f_number: 4\n  f_number: 2\n")
    with pytest.raises(InputError, match=f"{line + 1}: the field 'f_number' is given twice"):
        read_camera(file)


def test_all_faults_are_told_at_once(tmp_path: Path) -> None:
    file, _ = changed(CAMERA, tmp_path, "f_number: 4", "f_number: 0")
    file.write_text(
        file.read_text(encoding="utf-8").replace("pitch: 400 um", "pitch: 400"), encoding="utf-8"
    )
    with pytest.raises(InputError) as refusal:
        read_camera(file)
    assert len(str(refusal.value).splitlines()) == 2


def test_a_missing_or_broken_file_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_camera(tmp_path / "absent.yaml")
    broken = tmp_path / "broken.yaml"
    broken.write_text("main_lens: {focal_length: [", encoding="utf-8")
    with pytest.raises(InputError, match=r"broken\.yaml:1: not YAML"):
        read_camera(broken)
    broken.write_text("- 1", encoding="utf-8")
    with pytest.raises(InputError, match="a mapping of fields is due"):
        read_camera(broken)
    broken.write_text("# nothing yet\n", encoding="utf-8")
    with pytest.raises(
        InputError,
        match=(
            r"broken\.yaml:1: the file is empty; fields are due, `flflab new` writes a file to"
            r" begin from$"
        ),
    ):
        read_camera(broken)


def test_what_cannot_be_read_is_told_without_repeating_its_path(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    for place in (tmp_path / "absent.yaml", tmp_path / "file" / "camera.yaml", tmp_path):
        with pytest.raises(
            InputError, match=r"cannot be read \(\w[\w ]*\); give the path of a YAML file$"
        ) as refusal:
            read_camera(place)
        assert str(refusal.value).count(str(place)) == 1


@pytest.mark.parametrize(("encoding", "line"), [("utf-16", 1), ("latin-1", 3)])
def test_a_file_in_another_encoding_is_told_to_be_saved_as_utf_8(
    tmp_path: Path, encoding: str, line: int
) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text("# camera\nmain_lens:\n  pitch: 400 µm\n", encoding=encoding)
    with pytest.raises(
        InputError, match=rf"camera\.yaml:{line}: not text in UTF-8; save the file as UTF-8$"
    ):
        read_camera(file)


def test_an_array_may_be_given_by_radius_and_index_or_by_numerical_aperture(tmp_path: Path) -> None:
    file, _ = changed(
        CAMERA,
        tmp_path,
        "focal_length: 0.917 mm",
        "radius_of_curvature: 422 um\n  refractive_index: 1.46",
    )
    assert read_camera(file).array.focal_lengths[0] == pytest.approx(0.422 / 0.46)
    file, _ = changed(CAMERA, tmp_path, "focal_length: 0.917 mm", "numerical_aperture: 0.18")
    assert read_camera(file).array.focal_lengths[0] == pytest.approx(
        0.168 / 0.18 * (1 - 0.18**2) ** 0.5
    )


def test_figures_that_disagree_are_said_in_one_sentence(tmp_path: Path) -> None:
    file, _ = changed(
        CAMERA,
        tmp_path,
        "focal_length: 0.917 mm",
        "focal_length: 0.917 mm\n  numerical_aperture: 0.25",
    )
    (remark,) = load(file, CameraDescription).remarks()
    assert (
        "by numerical_aperture and aperture is 0.6507 mm; 0.917 mm by focal_length was used"
        in remark
    )


BENCH_FAULTS = [
    (
        "minimum_gap: 0.3 mm",
        "calibrated: yesterday",
        "calibrated",
        "'yesterday' is no day; write it as 2026-11-29",
    ),
    (
        "minimum_gap: 0.3 mm",
        "workmanship: {microlens_position: 0.3}",
        "workmanship.microlens_position",
        "has no unit",
    ),
    (
        "minimum_gap: 0.3 mm",
        "workmanship: {microlens_position: 30 um}",
        "workmanship.microlens_position",
        "less than or equal to 0.02",
    ),
    (
        "minimum_gap: 0.3 mm",
        "workmanship: {lens_position: 0.3 um}",
        "workmanship.lens_position",
        "allowed here: microlens_position, aperture_decentre, microlens_focal_length,",
    ),
    (
        "minimum_gap: 0.3 mm",
        "workmanship: {microlens_focal_length: -1 %}",
        "workmanship.microlens_focal_length",
        "greater than or equal to 0",
    ),
    (
        "minimum_gap: 0.3 mm",
        "measurement_floor: {position: 0.02 um}",
        "measurement_floor.position",
        "'0.02 um' given; a number of pixels is due, such as '0.02 px'",
    ),
    (
        "minimum_gap: 0.3 mm",
        "measurement_floor: {radius: 0.05}",
        "measurement_floor.radius",
        "0.05 given; a number of pixels is due",
    ),
    (
        "minimum_gap: 0.3 mm",
        "measurement_floor: {contrast: 2}",
        "measurement_floor.contrast",
        "less than 0.5",
    ),
    (
        "minimum_gap: 0.3 mm",
        "light: {}",
        "light",
        "neither of wavelength and spectrum given; one of them is due",
    ),
    (
        "minimum_gap: 0.3 mm",
        "light: {wavelength: 550 nm, spectrum: [[450 nm, 1]]}",
        "light",
        "both of wavelength and spectrum given",
    ),
    (
        "minimum_gap: 0.3 mm",
        "light: {wavelength: 550 um}",
        "light.wavelength",
        "550000 nm given; light has a wavelength from 100 nm to 20 um",
    ),
    (
        "minimum_gap: 0.3 mm",
        "light: {spectrum: [[450 nm, 0.2], [550, 0.6]]}",
        "light.spectrum.1.0",
        "has no unit",
    ),
    (
        "minimum_gap: 0.3 mm",
        "light: {spectrum: [[450 nm, 0]]}",
        "light.spectrum.0.1",
        "greater than 0",
    ),
    (
        "minimum_gap: 0.3 mm",
        "light: {spectrum: [[450 nm, 1], [450 nm, 2]]}",
        "light",
        "a wavelength twice",
    ),
    (
        "minimum_gap: 0.3 mm",
        "wavelength: 550 nm",
        "wavelength",
        "there is no such field",
    ),
    (
        "zero_uncertainty: 1 um",
        "zero_uncertainty: 1",
        "axes.main_lens_stage.zero_uncertainty",
        "has no unit",
    ),
    (
        "limits: [0 mm, 25 mm]",
        "limits: [25 mm, 0 mm]",
        "axes.main_lens_stage",
        "the first must be below the second",
    ),
    ("moves: array.z", "moves: array.y", "axes.array_stage.moves", "'array.z'"),
    ("moves: array.z", "moves: main_lens.z", "(file)", "two axes move main_lens.z"),
    ("minimum_gap: 0.3 mm", "minimal_gap: 0.3 mm", "minimal_gap", "there is no such field"),
    ("clock: 20", "clock: -1", "simulated.clock", "greater than 0"),
    (
        "faults: []",
        "faults: [boom]",
        "simulated.faults.0",
        "fields are due here (device, fault, after), not 'boom'",
    ),
    ("truths: {}", "truths: none", "simulated.truths", "fields are due here, not 'none'"),
    (
        "camera:\n  driver: scpi\n  address: simulated",
        "camera: scpi",
        "camera",
        "fields are due here (driver, address, serial), not 'scpi'",
    ),
    ("clock: 20", "clock: true", "simulated.clock", "are no number"),
    ("sign: 1", "sign: yes", "axes.main_lens_stage.sign", "are no number"),
    ("truths: {}", "truths: {iris.scale: no}", "simulated.truths.iris.scale", "are no number"),
    (
        "limits: [0 mm, 25 mm]",
        "limits: [-1e308 mm, 25 mm]",
        "axes.main_lens_stage.limits.0",
        "-1e+308 is no size that a thing has",
    ),
]


@pytest.mark.parametrize(
    ("old", "new", "field", "says"), BENCH_FAULTS, ids=[fault[1] for fault in BENCH_FAULTS]
)
def test_a_wrong_bench_field_is_refused_by_name(
    old: str, new: str, field: str, says: str, tmp_path: Path
) -> None:
    file, _ = changed(BENCH, tmp_path, old, new)
    with pytest.raises(InputError) as refusal:
        read_bench(file)
    assert field in str(refusal.value)
    assert says in str(refusal.value)


def test_axes_that_home_towards_each_other_are_refused(tmp_path: Path) -> None:
    file, _ = changed(BENCH, tmp_path, "home_towards: +z", "home_towards: -z")
    file.write_text(
        file.read_text(encoding="utf-8")
        .replace("zero: 40 mm", "zero: 40 mm")
        .replace(
            "    limits: [0 mm, 50 mm]\n    speed: 10 mm/s\n    home_towards: -z\n  sensor_stage",
            "    limits: [0 mm, 50 mm]\n    speed: 10 mm/s\n    home_towards: +z\n  sensor_stage",
        ),
        encoding="utf-8",
    )
    with pytest.raises(InputError, match="home towards each other"):
        read_bench(file)


def test_a_bench_without_its_camera_file_says_which(tmp_path: Path) -> None:
    file, line = changed(BENCH, tmp_path, "optics: ../cameras/osinski.yaml", "optics: nowhere.yaml")
    with pytest.raises(InputError, match=f":{line}: optics: there is no camera file"):
        read_bench(file)


def test_a_scene_takes_yes_and_no_where_they_answer_a_question_only(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    text = (
        f"camera: {CAMERA}\nplanes: [{{target: white, distance: 500 mm}}]\nfalloff: no\nsensor:"
        " {bits: %s}\n"
    )
    scene.write_text(text % "12", encoding="utf-8")
    assert read_scene(scene).scene.falloff is None
    scene.write_text(text % "yes", encoding="utf-8")
    with pytest.raises(
        InputError,
        match=r"scene\.yaml:4: sensor\.bits: yes, no, true and false are no number; give a number",
    ):
        read_scene(scene)


STUDY_FAULTS = [
    (
        "{kind: four-dot, diam",
        "{kind: [four-dot], diam",
        "['four-dot'] is not a target; allowed: four-dot",
    ),
    ("distance: 507 mm", "distance: 507", "has no unit"),
    ("reference: 1", "reference: 12", "allowed: 0 to 6"),
    ("diameter: 1 mm", "diameter: 1", "has no unit"),
    ("kind: bars", "kind: stripes", "stripes"),
    ("f_number: [2.8, 4, 5.6]", "f_number: []", "the list is empty; give at least one entry"),
    ("distance: 507 mm", "distance: 301 mm, array: 55 mm, sensor: 50 mm", "behind the array"),
    (
        "name: first",
        "name: first study",
        "a name of letters, digits, - and _ is due, for it names folders, not 'first study'",
    ),
    ("distance: 507 mm", "distance: 0 mm", "greater than 0"),
    ("distance: 507 mm", "distance: 507 mm, array: -60 mm", "greater than 0"),
    ("f_number: [2.8, 4, 5.6]", "f_number: yes", "a number is due here, not True"),
    ("draws: 1000", "draws: 1000.5", "a whole number is due here, not 1000.5"),
    ("draws: 1000", "draws: 399", "at least 440"),
    ("reference: 1", "reference: yes", "reference: yes, no, true and false are no number"),
    ("significance: 0.05", "significance: 0.01", "at least 2200"),
    ("significance: 0.05", "significance: 1e-308", "greater than or equal to 0.0001"),
    (
        "f_number: [2.8, 4, 5.6]",
        "f_number: [2.8, 4e300, 5.6]",
        "configurations.0.f_number.1: 4e+300 is no size that a thing has",
    ),
]


@pytest.mark.parametrize(
    ("old", "new", "says"), STUDY_FAULTS, ids=[fault[1] for fault in STUDY_FAULTS]
)
def test_a_wrong_study_field_is_refused(old: str, new: str, says: str, tmp_path: Path) -> None:
    file, line = changed(STUDY, tmp_path, old, new)
    with pytest.raises(InputError, match=r"first\.yaml:\d+: ") as refusal:
        read_study(file, read_camera(CAMERA))
    assert says in str(refusal.value)
    del line


def test_a_study_of_more_configurations_than_anybody_takes_is_refused_before_they_are_made(
    tmp_path: Path,
) -> None:
    many = [2 + k / 100 for k in range(101)]
    file, _ = changed(
        STUDY,
        tmp_path,
        "f_number: [2.8, 4, 5.6], distance: 507 mm",
        f"f_number: {many}, distance: {[f'{500 + k} mm' for k in many]}, yaw: 0 deg, pitch:"
        f" {[f'{k / 100} deg' for k in range(10)]}",
    )
    with pytest.raises(
        InputError,
        match=(
            r"first\.yaml:3: configurations: .* makes 102014 configurations; at most 100000 are"
            r" allowed"
        ),
    ):
        read_study(file, read_camera(CAMERA))


def test_a_grid_is_every_f_number_with_every_distance() -> None:
    study = read_study(STUDY, read_camera(CAMERA))
    assert [(c.f_number, c.distance) for c in study.configurations] == [
        (2.8, 507.0),
        (4.0, 507.0),
        (5.6, 507.0),
        (4.0, 490.0),
        (4.0, 530.0),
        (4.0, 500.0),
        (4.0, 515.0),
    ]
    assert len({c.sensor for c in study.configurations[:3]}) == 1


@pytest.mark.parametrize(("array", "distance"), [(60.0, 506.7016), (60.0, 900.0), (55.0, 299.9)])
def test_the_refocused_sensor_sees_a_traced_point_sharply(array: float, distance: float) -> None:
    camera = read_camera(CAMERA)
    sensor = focused_sensor(camera, array, distance)
    landed = []
    for m in (-0.3, 0.0, 0.4):
        slope = m / distance - m / 50.0
        q = m + slope * array
        landed.append(q + (slope - q / 0.917) * (sensor - array))
    assert max(landed) - min(landed) < 1e-12


@pytest.mark.parametrize("side", ["sensor", "main lens"])
def test_a_glass_plate_moves_the_refocused_sensor(side: Literal["sensor", "main lens"]) -> None:
    camera = read_camera(CAMERA)
    glazed = replace(camera, array=replace(camera.array, substrate=Substrate(0.3, 1.5, side)))
    sensor = focused_sensor(glazed, 60.0, 506.7016)
    moved = replace(glazed, sensor=replace(glazed.sensor, distance=sensor))
    assert float(blur(central_smms(moved), 1 / 506.7016)) == pytest.approx(0.0, abs=1e-12)


def test_no_sensor_position_focuses_an_image_between_the_array_and_its_focus() -> None:
    with pytest.raises(InputError, match="no sensor position"):
        focused_sensor(read_camera(CAMERA), 60.0, 300.0)


def test_a_study_of_other_targets_than_the_simulated_wheel_holds_is_told(tmp_path: Path) -> None:
    bench, same = read_bench(BENCH), read_study(STUDY, read_bench(BENCH).optics)
    other = read_study(changed(STUDY, tmp_path, "spacing: 8 mm", "spacing: 4 mm")[0], bench.optics)
    assert unlike_the_wheel(same, bench) == []
    [sentence] = unlike_the_wheel(other, bench)
    assert "four-dot target with spacing 8.0 instead of 4.0 (mm)" in sentence
    assert (
        unlike_the_wheel(
            replace(other, description=other.description.model_copy(update={"targets": ["bars"]})),
            bench,
        )
        == []
    )
    moved = bench.description.model_copy(
        update={"target": bench.description.target.model_copy(update={"address": "/dev/ttyUSB0"})}
    )
    assert unlike_the_wheel(other, replace(bench, description=moved)) == []


def test_a_distortion_is_read_and_the_model_says_that_it_leaves_it_out(tmp_path: Path) -> None:
    file, _ = changed(
        CAMERA,
        tmp_path,
        "f_number: 4",
        "f_number: 4\n  distortion: {radial: [2e-4 1/mm^2, -3e-6 1/mm^4, 0],"
        " tangential: [1e-5 1/mm, 0]}",
    )
    found = read_camera(file).main_lens.distortion
    assert found is not None
    assert (found.radial, found.tangential) == ((2e-4, -3e-6, 0.0), (1e-5, 0.0))
    assert "left out: the model is of first order" in load(file, CameraDescription).remarks()[0]


def test_what_a_bench_states_of_its_lenses_floor_and_light_is_read_in_the_units_used_inside(
    tmp_path: Path,
) -> None:
    # as the comments of the built-in file give them
    text = BENCH.read_text(encoding="utf-8").replace("../cameras/", f"{EXAMPLES / 'cameras'}/")
    for key in ("workmanship", "measurement_floor", "light"):
        assert text.count(f"# {key}: ") == 1
        text = text.replace(f"# {key}: ", f"{key}: ")
    (tmp_path / "bench.yaml").write_text(text, encoding="utf-8")
    found = read_bench(tmp_path / "bench.yaml").description
    made, floor = found.workmanship, found.measurement_floor
    assert (made.microlens_position, made.aperture_decentre) == pytest.approx((3e-4, 1e-4))
    assert (made.microlens_focal_length, made.microlens_brightness) == pytest.approx((0.01, 0.01))
    assert made.scale == pytest.approx(1e-5)
    assert (floor.contrast, floor.position, floor.radius) == (0.002, 0.02, 0.05)
    assert found.mean_wavelength == pytest.approx(550e-6)


def test_the_weights_of_a_spectrum_add_up_to_one(tmp_path: Path) -> None:
    file, _ = changed(
        BENCH,
        tmp_path,
        "minimum_gap: 0.3 mm",
        "minimum_gap: 0.3 mm\nlight: {spectrum: [[600 nm, 3], [450 nm, 1]]}",
    )
    description = read_bench(file).description
    assert description.spectrum is not None
    assert description.spectrum.wavelengths == pytest.approx((450e-6, 600e-6))
    assert description.spectrum.weights == pytest.approx((0.25, 0.75))
    assert description.mean_wavelength == pytest.approx(562.5e-6)
    assert read_bench(BENCH).description.spectrum is None
