# longer than 450 lines because one subject's sentences of behaviour stand together
"""Names, keys, exit codes and files of the command line, which others script against."""

import json
import re
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Run = Callable[..., Any]
EXAMPLES = Path(__file__).parents[2] / "examples"
OTHER = "give a place you may write in"
OSINSKI = EXAMPLES / "cameras" / "osinski.yaml"
REQUIREMENTS = EXAMPLES / "requirements" / "osinski.yaml"


def test_model_has_every_key_of_the_contract(flflab: Run) -> None:
    told = flflab(
        "model", OSINSKI, "--distance", "506.7 mm", "--distance", "infinity", "--json"
    ).json
    keys = (
        "arrangement sharp_distance_mm image_pitch_mm overlap overlap_mm in_exit_pupil"
        " touching_f_number useful_pixels"
    )
    assert set(f"{keys} depth_of_field_mm stereo microlenses distances reasons".split()) <= set(
        told
    )
    assert set(told["stereo"]) >= {"nearest_mm", "farthest_mm", "angle_deg", "field_angle_deg"}
    lens = "index centre_mm image_centre_mm inside_mm outside_mm useful_mm marginal_angle_deg"
    assert set(lens.split()) <= set(told["microlenses"][0])
    distance = (
        "distance_mm image_distance_mm arrangement virtual_depth magnification blur_mm views elr"
        " elr_by_views mtf"
    )
    assert all(set(distance.split()) <= set(one) for one in told["distances"])
    assert set(told["distances"][0]["mtf"]) >= {
        "cycles_per_mm",
        "contrast_paper",
        "mtf_pixel",
        "mtf",
    }
    assert len(told["distances"][0]["mtf"]["mtf"]) == 101
    assert told["distances"][0]["views"]["sensor"]["chief"] == 5
    assert told["sharp_distance_mm"] == pytest.approx(506.7016, abs=5e-5)


def test_what_is_null_has_a_reason(flflab: Run) -> None:
    told = flflab("model", OSINSKI, "--distance", "infinity", "--json").json
    assert told["distances"][0]["distance_mm"] is None
    assert any("distance_mm" in key for key in told["reasons"])
    assert told["stereo"]["farthest_mm"] is None
    assert any("farthest_mm" in key for key in told["reasons"])


@pytest.mark.ci
def test_an_image_is_written_in_units_of_the_white_level_and_measured_again(
    flflab: Run, small_camera: Path, tmp_path: Path
) -> None:
    picture = tmp_path / "white.npy"
    paraxial = (
        "--effects",
        "defocus,vignetting,overlap,pixel",
    )  # fall-off would dim the axis and shift what is measured
    told = flflab(
        "image",
        small_camera,
        "--target",
        "white",
        "--distance",
        "506.7 mm",
        *paraxial,
        "--json",
        "-o",
        picture,
    ).json
    assert set(told) == {"effects", "error_estimate", "time_ms"}
    assert set(told["effects"][0]) == {"name", "on", "size", "bound", "why", "ms"}
    image = np.load(picture)
    assert image.dtype == np.float64
    assert image.shape == (560, 760)
    assert image[279:281, 379:381] == pytest.approx(np.ones((2, 2)), abs=1e-9)
    assert (
        json.loads(picture.with_suffix(".json").read_text(encoding="utf-8"))["error_estimate"]
        == told["error_estimate"]
    )
    measured = flflab(
        "measure", picture, "--camera", small_camera, "--target", "white", "--json"
    ).json
    lattice = measured["lattice"]
    assert set(lattice) >= {
        "layout",
        "pitch_px",
        "angle_deg",
        "origin_px",
        "centres_px",
        "inside_radius_px",
        "outside_radius_px",
    }
    assert lattice["pitch_px"] == pytest.approx(0.4 * (1 + 1.15 / 60) / 1.66e-3, rel=1e-5)
    assert lattice["origin_px"] == pytest.approx([379.5, 279.5], abs=0.01)
    assert lattice["outside_radius_px"] == pytest.approx(318.517 / 2 / 1.66, abs=0.05)


@pytest.mark.parametrize("content", ['{"camera": "R12", "frames": 4}', "[1, 2]", "no JSON"])
def test_a_picture_does_not_take_the_place_of_a_file_that_is_no_ground_truth(
    flflab: Run, small_camera: Path, tmp_path: Path, content: str
) -> None:
    beside = tmp_path / "camera.json"
    beside.write_text(content, encoding="utf-8")
    ended = flflab("image", small_camera, "--distance", "506.7 mm", "-o", tmp_path / "camera.png")
    assert (ended.code, ended.out, ended.err.count("\n")) == (1, "", 1)
    assert ended.err.startswith(
        f"flflab: {beside}: the picture's ground truth goes into a file of this name"
    )
    assert beside.read_text(encoding="utf-8") == content
    assert not (tmp_path / "camera.png").exists()


def test_a_picture_is_taken_again_and_its_last_line_names_both_files(
    flflab: Run, small_camera: Path, tmp_path: Path
) -> None:
    picture, beside = tmp_path / "white.png", tmp_path / "white.json"
    for distance in (506.7, 400.0):
        ended = flflab(
            "image",
            small_camera,
            "--target",
            "white",
            "--distance",
            f"{distance} mm",
            "--explain",
            "-o",
            picture,
        )
        assert ended.code == 0
        assert ended.out.splitlines()[-1].startswith(f"{picture}: error below ")
        assert ended.out.splitlines()[-1].endswith(f"; ground truth in {beside}")
        assert json.loads(beside.read_text(encoding="utf-8"))["planes"][0][
            "distance_mm"
        ] == pytest.approx(distance)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("a.bmp", "files ending in .npy"),
        ("no/a.png", "there is no folder"),
        ("file/a.png", "there is no folder"),
    ],
)
def test_where_no_picture_can_be_written_is_told_before_anything_is_read(
    flflab: Run, tmp_path: Path, name: str, says: str
) -> None:
    (tmp_path / "file").write_bytes(b"")
    ended = flflab("image", "nowhere.yaml", "--distance", "506.7 mm", "-o", tmp_path / name)
    assert (ended.code, ended.err.count("\n")) == (1, 1), ended.err
    assert says in ended.err


@pytest.mark.skipif(sys.platform == "win32", reason="limits the size of files the POSIX way")
def test_where_only_the_ground_truth_fails_the_picture_is_said_to_be_written(
    flflab: Run, small_camera: Path, tmp_path: Path
) -> None:
    import resource

    asked = "image", small_camera, "--target", "black", "--distance", "506.7 mm", "-o"
    assert flflab(*asked, tmp_path / "before.png").code == 0  # kernels are compiled and kept
    limit, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, ((tmp_path / "before.png").stat().st_size, hard))
    try:
        ended = flflab(*asked, tmp_path / "a.png")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    assert (ended.code, ended.err.count("\n")) == (1, 1), ended.err
    assert f"{tmp_path / 'a.json'}: cannot be written (File too large)" in ended.err
    assert f"the picture itself, {tmp_path / 'a.png'}, is written" in ended.err
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "before.png").read_bytes()
    assert not (tmp_path / "a.json").exists()


@pytest.mark.parametrize(
    "command",
    [
        ("model", OSINSKI, "--figures"),
        ("design", REQUIREMENTS, "--out"),
        ("accuracy", "model", "--out"),
    ],
)
def test_a_folder_that_cannot_be_made_is_told_before_anything_is_computed(
    flflab: Run, tmp_path: Path, command: tuple[object, ...]
) -> None:
    (tmp_path / "file").touch()
    for place, why in (
        (tmp_path / "file", "File exists"),
        (tmp_path / "file" / "a", "Not a directory"),
    ):
        ended = flflab(*command, place)
        said = f"flflab: {command[-1]} {place}: the folder cannot be made ({why}); give another\n"
        assert (ended.code, ended.out, ended.err) == (1, "", said)


@pytest.mark.skipif(sys.platform == "win32", reason="limits the size of files the POSIX way")
def test_a_figure_that_does_not_fit_on_the_disk_is_told_in_a_sentence_and_leaves_nothing(
    flflab: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import resource

    # the limit would cut compiled sources of what is imported here first, for every later program
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    limit, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(
        resource.RLIMIT_FSIZE, (15_000, hard)
    )  # the table on standard output is shorter, a figure longer
    try:
        ended = flflab("model", OSINSKI, "--figures", tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    assert (ended.code, ended.err.count("\n")) == (1, 1), ended.err
    assert ended.err.startswith(
        f"flflab: {tmp_path / 'figure-1.png'}: cannot be written (File too large)"
    )
    assert list(tmp_path.iterdir()) == []


def test_noise_comes_from_the_seed_alone(flflab: Run, small_camera: Path, tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("a.png", "b.png", "c.png")]
    for file, seed in zip(files, (1, 1, 2), strict=True):
        assert (
            flflab(
                "image",
                small_camera,
                "--target",
                "four-dot",
                "--distance",
                "506.7 mm",
                "--seed",
                seed,
                "-o",
                file,
            ).code
            == 0
        )
    first, again, other = (file.read_bytes() for file in files)
    assert first == again
    assert first != other


@pytest.mark.parametrize("width", [72, 60])
def test_on_a_narrow_terminal_the_explanation_is_whole_and_no_wider(
    width: int,
    flflab: Run,
    small_camera: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", str(width))
    ended = flflab(
        "image",
        small_camera,
        "--target",
        "white",
        "--distance",
        "500 mm",
        "--explain",
        "-o",
        tmp_path / "white.npy",
    )
    table = re.sub(r"\x1b\[[\d;]*m", "", ended.out).split("Not in this scene")[0]
    assert max(map(len, table.splitlines())) == width
    assert "\u2026" not in table


def test_a_scene_file_names_its_camera_and_explains_itself(
    flflab: Run, small_camera: Path, tmp_path: Path
) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        f"camera: {small_camera.name}\nplanes: [{{target: black, distance: 500 mm}}]\nstray_light:"
        " 1 %\n",
        encoding="utf-8",
    )
    ended = flflab("image", "--scene", scene, "--explain", "-o", tmp_path / "scene.npy")
    assert ended.code == 0
    assert all(len(line) <= 100 for line in ended.out.splitlines() if str(tmp_path) not in line)
    assert "1 % of all light" in ended.out or "0.01 of all light" in ended.out
    scene.write_text("planes: [{target: black, distance: 500 mm}]\nfog: 1\n", encoding="utf-8")
    assert (
        f"{scene}:2: fog: there is no such field"
        in flflab("image", "--scene", scene, "-o", tmp_path / "scene.npy").err
    )


@pytest.mark.parametrize("distance", ["-1000 mm", "0 mm", "-1 m"])
def test_a_distance_behind_the_lens_is_refused_in_the_same_words_in_a_scene_and_on_the_command_line(
    flflab: Run, small_camera: Path, tmp_path: Path, distance: str
) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        f"camera: {small_camera.name}\nplanes: [{{target: black, distance: {distance}}}]\n",
        encoding="utf-8",
    )
    words = f"{distance}: a distance in front of the main lens is above 0 mm, or infinity\n"
    told = flflab("image", "--scene", scene, "-o", tmp_path / "a.npy")
    assert told.err == f"flflab: {scene}:2: planes.0.distance: {words}"
    assert (
        flflab("image", small_camera, f"--distance={distance}", "-o", tmp_path / "a.npy").err
        == f"flflab: --distance {words}"
    )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("model", "nowhere.yaml"), "cannot be read"),
        (("model", OSINSKI, "--distance", "500"), "--distance '500' has no unit"),
        (("image", OSINSKI, "--distance", "500", "-o", "x.npy"), "--distance '500' has no unit"),
        (
            ("image", OSINSKI, "--distance", "500 mm", "--time-budget", "5", "-o", "x.npy"),
            "--time-budget '5' has no unit",
        ),
        (
            ("measure", "x.png", "--camera", OSINSKI, "--distance", "500"),
            "--distance '500' has no unit",
        ),
        (("align", "--overlap", "50"), "--overlap '50' has no unit"),
        (
            ("bench", "snap", "--live", "--bench", "x.yaml", "--exposure", "5"),
            "--exposure '5' has no unit",
        ),
        (("model", OSINSKI, "--distance", "-5 mm"), "above 0 mm"),
        (
            ("image", OSINSKI, "--target", "stripes", "--distance", "500 mm", "-o", "x.npy"),
            "stripes",
        ),
        (
            ("image", OSINSKI, "--distance", "500 mm", "--tolerance", "2", "-o", "x.npy"),
            "tolerance: 2 of white",
        ),
        (
            ("image", OSINSKI, "--distance", "500 mm", "--time-budget", "1 us", "-o", "x.npy"),
            "cannot be kept",
        ),
        (
            ("image", OSINSKI, "--distance", "1e300 m", "-o", "x.npy"),
            "up to 1e+12 mm is allowed, or infinity",
        ),
        (
            ("image", OSINSKI, "--distance", "500 mm", "--wavelength", "5 mm", "-o", "x.npy"),
            "from 100 nm to 20 um",
        ),
        (
            ("image", OSINSKI, "--distance", "500 mm", "--wavelength", "10 nm", "-o", "x.npy"),
            "--wavelength 10 nm: light has",
        ),
        (
            ("image", OSINSKI, "--distance", "500 mm", "--effects", "fog", "-o", "x.npy"),
            "there is no 'fog'",
        ),
        (("measure", "nowhere.png", "--camera", OSINSKI), "nowhere.png"),
        (("compare", "nowhere", "--camera", OSINSKI), "nowhere"),
        (("plan", "nowhere.yaml"), "cannot be read"),
        (("report", "nowhere"), "nowhere"),
    ],
    ids=lambda value: " ".join(map(str, value))[-40:] if isinstance(value, tuple) else "",
)
def test_what_cannot_be_done_is_one_sentence_and_exit_1(
    flflab: Run, arguments: tuple[object, ...], says: str
) -> None:
    ended = flflab(*arguments)
    assert ended.code == 1
    assert says in ended.err
    assert "Traceback" not in ended.err
    assert ended.err.startswith("flflab: ")


@pytest.mark.parametrize(
    ("words", "quoted"),
    [
        ("model camera.yaml --distance 507 mm", '--distance "507 mm"'),
        ("model camera.yaml --distance=507 mm", '--distance="507 mm"'),
        ("align --overlap -20 um", '--overlap "-20 um"'),
        ("bench snap --exposure 5e-3 s --live --bench x.yaml", '--exposure "5e-3 s"'),
        ("bench move ring -.5 deg --bench x.yaml", '"-.5 deg"'),
    ],
)
def test_a_quantity_that_was_given_as_two_words_is_told_to_go_into_quotes(
    flflab: Run, words: str, quoted: str
) -> None:
    ended = flflab(*words.split())
    assert ended.code == 2
    assert ended.err.endswith(f"; a number and its unit go into quotes: {quoted}\n")


def test_a_unit_that_was_taken_for_a_file_is_told_to_go_into_quotes_too(flflab: Run) -> None:
    ended = flflab("image", "--target", "bars", "--distance", "507", "mm", "-o", "x.npy")
    assert ended.code == 1
    assert ended.err.endswith('; a space before the unit wants quotes: --distance "507 mm"\n')


@pytest.mark.parametrize(
    "words", ["model one.yaml two.yaml", "model one.yaml mm", "model one.yaml two.yaml 3 m2"]
)
def test_of_quotes_nothing_is_said_where_a_word_is_too_many_for_another_reason(
    flflab: Run, words: str
) -> None:
    assert "quotes" not in flflab(*words.split()).err


def test_the_version_is_that_of_the_package(flflab: Run) -> None:
    assert flflab("--version") == (0, f"flflab {version('flflab')}\n", "")


@pytest.mark.parametrize("words", [(), ("model",), ("bench",), ("bench", "snap")], ids=" ".join)
def test_help_has_a_short_name(flflab: Run, words: tuple[str, ...]) -> None:
    short, long = (flflab(*words, option) for option in ("-h", "--help"))
    assert (short.code, short.out) == (0, long.out)
    assert long.out.startswith("Usage: ")


@pytest.mark.parametrize(
    "arguments",
    [
        ("nonsense",),
        ("model",),
        ("model", OSINSKI, "--nonsense"),
        ("image", OSINSKI),
        ("image", OSINSKI, "--distance", "500 mm", "--seed", "-4", "-o", "x.npy"),
        (
            "image",
            "--scene",
            OSINSKI.parents[1] / "scenes/dark.yaml",
            "--target",
            "bars",
            "-o",
            "x.npy",
        ),
        (
            "image",
            OSINSKI,
            "--distance",
            "500 mm",
            "--tolerance",
            "0.002",
            "--time-budget",
            "9 s",
            "-o",
            "x.npy",
        ),
    ],
)
def test_wrong_usage_is_exit_2_and_leaves_no_file(
    flflab: Run, arguments: tuple[object, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert flflab(*arguments).code == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["camera", "bench", "study"])
def test_new_writes_a_copy_that_can_be_used_and_never_overwrites(
    flflab: Run, kind: str, tmp_path: Path
) -> None:
    file = tmp_path / f"{kind}.yaml"
    assert flflab("new", kind, file).code == 0
    written = file.read_bytes()
    again = flflab("new", kind, file)
    assert (again.code, file.read_bytes()) == (1, written)
    assert "not overwritten" in again.err
    nowhere = flflab("new", kind, tmp_path / "no" / "such.yaml")
    assert (
        nowhere.err == f"flflab: {tmp_path / 'no/such.yaml'}: cannot be written (there is no folder"
        f" {tmp_path / 'no'}); {OTHER}\n"
    )


@pytest.mark.full
def test_a_new_bench_and_a_new_study_can_be_planned(flflab: Run, tmp_path: Path) -> None:
    flflab("new", "bench", tmp_path / "bench.yaml", "--simulated")
    flflab("new", "study", tmp_path / "study.yaml")
    planned = flflab("plan", tmp_path / "study.yaml", "--bench", tmp_path / "bench.yaml")
    assert planned.code == 0
    assert "the gap is kept on the way" in " ".join(planned.out.split())


@pytest.mark.parametrize(
    ("section", "fault"),
    [("simulated: 3", "fields are due here"), ("simulated: {clock: fast}", "clock: ")],
    ids=["no fields", "a field"],
)
def test_a_bench_file_is_refused_with_its_own_lines_also_where_another_seed_is_given(
    section: str, fault: str, flflab: Run, tmp_path: Path
) -> None:
    text = (
        (EXAMPLES / "benches" / "simulated.yaml")
        .read_text(encoding="utf-8")
        .partition("simulated:\n")[0]
    )
    file = tmp_path / "bench.yaml"
    file.write_text(
        text.replace("../cameras/osinski.yaml", str(OSINSKI)) + section + "\n", encoding="utf-8"
    )
    ended = flflab(
        "sweep",
        EXAMPLES / "studies" / "first.yaml",
        "--bench",
        file,
        "--seed",
        2,
        "--out",
        tmp_path / "run",
    )
    line = 1 + text.count("\n")
    assert ended.code == 1
    assert f"{file}:{line}: simulated" in ended.err
    assert fault in ended.err


@pytest.mark.parametrize("command", ["sweep", "align"])
def test_a_fault_of_a_driver_names_the_operators_file_also_where_another_seed_is_given(
    command: str, flflab: Run, tmp_path: Path
) -> None:
    text = (EXAMPLES / "benches" / "simulated.yaml").read_text(encoding="utf-8")
    file = tmp_path / "bench.yaml"
    file.write_text(
        text.replace("../cameras/osinski.yaml", str(OSINSKI)).replace(
            "driver: zaber", "driver: zabre", 1
        ),
        encoding="utf-8",
    )
    line = 1 + text[: text.index("driver: zaber")].count("\n")
    study = [EXAMPLES / "studies" / "first.yaml"] if command == "sweep" else []
    ended = flflab(command, *study, "--bench", file, "--seed", 2, "--out", tmp_path / "run")
    assert ended.code == 1
    assert ended.err.startswith(
        f"flflab: {file}:{line}: axes.main_lens_stage.driver: there is no driver 'zabre' here"
    )
