"""The page stands alone, says what was found, and shows everything that was compared."""

import errno
import os
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from flflab.bench import Bench
from flflab.bench_uncertainty import LightDescription
from flflab.errors import InputError
from flflab.property_names import PROPERTY_NAMES
from flflab.record import Run
from flflab.report import write_report
from flflab.report.drawn import drawn_table
from flflab.report.overview import z_limit
from flflab.report.page import headline
from flflab.study import Study
from flflab.verdict.comparison import Comparison, Verdict
from flflab.verdict.evaluation import Evaluation

VOID = {"meta", "image", "img", "br", "use", "circle", "polygon", "path", "rect"}

GREEN = LightDescription.model_validate({"wavelength": "532 nm"})


class Page(HTMLParser):
    """Tags, references, ids and text of a page; complains where tags do not match."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.references: list[str] = []
        self.ids: list[str] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.references += [
            value or ""
            for name, value in attrs
            if name in ("src", "href", "xlink:href", "action", "data", "poster")
        ]
        self.ids += [value or "" for name, value in attrs if name == "id"]
        if tag not in VOID or (tag in ("circle", "path") and self._last_is_open(tag)):
            self._open.append(tag)

    def _last_is_open(self, tag: str) -> bool:
        text = self.get_starttag_text() or ""
        return not text.endswith("/>")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.references += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


@pytest.fixture(scope="module")
def source(
    evaluation: Evaluation,
    run: Run,
    study: Study,
    bench: Bench,
    tmp_path_factory: pytest.TempPathFactory,
) -> str:
    file = tmp_path_factory.mktemp("page") / "report.html"
    write_report(evaluation, run, study, bench, file)
    return file.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(source: str) -> Page:
    return Page(source)


def test_the_page_needs_no_other_file_and_runs_no_script(page: Page, source: str) -> None:
    assert page.references
    assert all(one.startswith(("data:image/", "#")) for one in page.references)
    assert page.tags.isdisjoint({"script", "link", "iframe", "object", "embed", "base"})
    assert "url(" not in source
    assert "@import" not in source
    assert source.startswith("<!DOCTYPE html>")


def test_the_page_uses_every_id_once_and_knows_every_id_it_uses(page: Page) -> None:
    assert len(page.ids) == len(set(page.ids))
    assert {one[1:] for one in page.references if one.startswith("#")} == set(page.ids)


def test_the_verdict_comes_first_with_its_numbers(page: Page, evaluation: Evaluation) -> None:
    body = page.text[page.text.index("flflab: a focused light field camera") :]
    assert body.index("The camera does what its model says.") < 200
    for verdict in evaluation.comparison.verdicts:
        shares = f"{100 * verdict.p_value:.3g} % {100 * verdict.threshold:.3g} %"
        assert f"{PROPERTY_NAMES[verdict.quantity]} {verdict.rows} {shares} agrees" in body
    assert "quantity values compared p-value reject below verdict" in body
    assert "exact for 12 of 12 dots (100.0 %)" in body
    assert "Signature" in body


def test_the_page_says_what_the_model_leaves_out(page: Page) -> None:
    assert "Not in the model: diffraction, aberrations" in page.text.replace(" :", ":")
    assert re.search(r"Airy diameter on the sensor is \d\.\d\d pixels", page.text)


def test_in_light_of_a_wavelength_diffraction_is_in_the_model(
    single: Evaluation, run: Run, study: Study, bench: Bench, tmp_path: Path
) -> None:
    green = replace(bench, description=bench.description.model_copy(update={"light": GREEN}))
    write_report(single, run, study, green, tmp_path / "report.html")
    text = Page((tmp_path / "report.html").read_text(encoding="utf-8")).text
    assert "diffraction in the contrast" in text
    assert "At 532 nm the Airy diameter" in text
    assert "must lie below the prediction" not in text
    assert "dots whose edges show it are fitted by waves" in text


def test_every_configuration_is_shown_with_its_frames_and_curves(
    page: Page, study: Study, source: str
) -> None:
    for setting in study.configurations:
        assert (
            f"Configuration {setting.index}: F/{setting.f_number:g}, D = {setting.distance:.1f} mm"
            in page.text
        )
        assert f'alt="MTF measured and predicted, configuration {setting.index}"' in source
    assert source.count("data:image/jpeg") == 2 * len(study.configurations)


def test_every_quantity_has_its_table_with_units(page: Page) -> None:
    for caption in (
        "number of views: 12 rows (views in comparison.csv)", "contrast (MTF): 12 rows (mtf in",
        "contrast read off pixels, eq. (2): 12 rows (contrast_paper in",
        "number of views: difference: 8 rows (difference_views in",
        "ratio of contrasts (MTF): 8 rows (ratio_mtf in",
    ):  # fmt: skip
        assert caption in page.text
    for heading in (
        "frequency, cycles/mm",
        "target D, mm",
        "blur, px",
        "exposure, ms",
        "angle, mrad",
        "uncertainty of the zero, \u00b5m",
    ):
        assert heading in page.text


def test_a_column_of_signed_values_is_not_headed_by_their_size(page: Page) -> None:
    assert "z farthest from 0" in page.text
    assert "largest |z|" not in page.text


def test_the_bench_and_the_provenance_are_there(page: Page, run: Run, bench: Bench) -> None:
    for name in (
        *bench.description.axes,
        run.folder.name,
        "2027-01-15 08:00:00 UTC",
        "numpy 2.4.6",
        "seed 7",
    ):
        assert name in page.text
    assert "Simulated bench: 7 of 7 devices" in page.text


def test_what_the_simulated_camera_decided_is_listed_as_the_run_recorded_it(run: Run) -> None:
    halo = {"name": "halo", "on": True, "size": 0.05, "unit": "of light", "bound": None, "why": "w"}
    drawing = {
        "target": "bars", "configurations": [0, 2], "tolerance": 3e-4, "path": "rays",
        "why_path": "a card", "effects": [halo], "absent": ["gamma"],
    }  # fmt: skip
    table = drawn_table(replace(run, start={**run.start, "simulated_light": [drawing]}))
    assert table is not None
    assert table.rows == (
        ("bars, 0, 2", "rays", "", "0.0003 of white", "", "a card"),
        ("", "halo", "on", "0.05 of light", "", "w"),
        ("", "gamma", "off", "", "", "the scene has none"),
    )
    assert drawn_table(replace(run, start={})) is None


def test_what_devices_say_is_text_and_never_markup(page: Page, source: str) -> None:
    assert "<script>alert" not in source
    assert "<script>alert('x')</script>" in page.text


def test_axis_and_driver_names_are_text_and_never_markup(
    single: Evaluation, run: Run, study: Study, bench: Bench, tmp_path: Path
) -> None:
    axes = dict(bench.description.axes)
    first = next(iter(axes))
    axes["<img src=x>"] = axes.pop(first).model_copy(update={"driver": "<b>&amp;"})
    named = replace(bench, description=bench.description.model_copy(update={"axes": axes}))
    write_report(single, run, study, named, tmp_path / "report.html")
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "x" not in page.references
    assert "<img src=x>" in page.text
    assert "<b>&amp;" in page.text


def test_a_rejected_comparison_says_so_and_which_quantity(
    single: Evaluation, run: Run, study: Study, bench: Bench, tmp_path: Path
) -> None:
    mtf, views = single.comparison.verdicts
    rejected = replace(
        views,
        accepted=False,
        p_value=0.02,
        sentence="number of views: 12 values do not agree with the model",
    )
    worse = replace(single, comparison=Comparison(single.comparison.rows, (mtf, rejected)))
    write_report(worse, run, study, bench, tmp_path / "report.html")
    source = (tmp_path / "report.html").read_text(encoding="utf-8")
    text = Page(source).text
    assert "The camera does not do what its model says: number of views disagrees." in text
    assert "12 2 % 2.5 % rejected" in text
    assert "does what its model says" not in text
    assert 'class="verdict rejected"' in source


def test_the_headline_names_up_to_three_properties_that_disagree(single: Evaluation) -> None:
    mtf, views = (replace(one, accepted=False) for one in single.comparison.verdicts)
    three = (mtf, replace(mtf, quantity="micro_images_mm"), views)
    worse = replace(single, comparison=Comparison(single.comparison.rows, three))
    assert headline(worse) == (
        "The camera does not do what its model says:"
        " contrast (MTF), fields and pitch, number of views disagree."
    )
    four = replace(worse, comparison=Comparison((), (*three, replace(mtf, quantity="light"))))
    assert headline(four).endswith(": 4 of 4 properties disagree.")


def test_views_missed_and_views_too_many_are_counted_and_drawn(
    single: Evaluation, run: Run, study: Study, bench: Bench, tmp_path: Path
) -> None:
    one = single.measured[0]
    dot = one.dots[0]
    taken = {tuple(index) for index in dot.indices.tolist()}
    other = next(
        k for k, index in enumerate(one.lattice.indices.tolist()) if tuple(index) not in taken
    )
    indices, places = dot.indices.copy(), dot.centres_px.copy()
    indices[0], places[0] = one.lattice.indices[other], one.lattice.centres_px[other]
    moved = replace(one, dots=(replace(dot, indices=indices, centres_px=places), *one.dots[1:]))
    write_report(replace(single, measured=(moved,)), run, study, bench, tmp_path / "report.html")
    source = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "1 predicted but not seen, 1 seen but not predicted." in Page(source).text
    assert source.count("<title>dot 0: predicted but not seen</title>") == 1
    assert source.count("<title>dot 0: seen but not predicted</title>") == 1


def test_an_unfinished_run_of_one_configuration_is_reported_as_such(
    single: Evaluation, run: Run, study: Study, bench: Bench, tmp_path: Path
) -> None:
    bright = replace(single, measured=(replace(single.measured[0], saturated=5),))
    write_report(bright, replace(run, stop=None), study, bench, tmp_path / "report.html")
    text = Page((tmp_path / "report.html").read_text(encoding="utf-8")).text
    assert "never ended properly" in text
    assert "5 in configuration 0" in text


def test_a_run_that_lost_its_end_says_which_frames_and_which_configurations_it_lacks(
    single: Evaluation, run: Run, study: Study, bench: Bench, tmp_path: Path
) -> None:
    cut = replace(run, stop=None, lost=("c1/bars/0", "c2/bars/0"))
    write_report(single, cut, study, bench, tmp_path / "report.html")
    text = Page((tmp_path / "report.html").read_text(encoding="utf-8")).text
    assert "The last 2 frames (c1/bars/0 and after) are not as they were recorded" in text
    assert "Not recorded or not admitted, and left out: configurations 1 and 2." in text


@pytest.mark.ci
def test_a_run_in_several_parts_says_when_and_why_it_was_cut(
    single: Evaluation, run: Run, study: Study, bench: Bench, tmp_path: Path
) -> None:
    interrupted = {
        "time": 1.8e9 + 20,
        "exit_status": "abort",
        "reason": "interrupted by the operator",
    }
    several = replace(
        run, cut=(interrupted, None), resumed=({"time": 1.8e9 + 30}, {"time": 1.8e9 + 40})
    )
    write_report(single, several, study, bench, tmp_path / "report.html")
    said = (
        "Recorded in 3 parts: cut at 2027-01-15 08:00:20 UTC (interrupted by the operator), resumed"
        " at 2027-01-15 08:00:30 UTC; cut off, resumed at 2027-01-15 08:00:40 UTC."
    )
    assert said in Page((tmp_path / "report.html").read_text(encoding="utf-8")).text
    write_report(single, run, study, bench, tmp_path / "report.html")
    assert "Recorded in" not in Page((tmp_path / "report.html").read_text(encoding="utf-8")).text


def test_a_report_that_cannot_be_written_is_refused_in_one_sentence(
    single: Evaluation, run: Run, study: Study, bench: Bench, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_report(single, run, study, bench, tmp_path / "missing" / "report.html")


def test_a_link_in_the_place_of_a_report_is_not_followed(
    single: Evaluation, run: Run, study: Study, bench: Bench, tmp_path: Path
) -> None:
    (tmp_path / "victim").write_text("mine", encoding="utf-8")
    (tmp_path / "report.html").symlink_to(tmp_path / "victim")
    write_report(single, run, study, bench, tmp_path / "report.html")
    assert (tmp_path / "victim").read_text(encoding="utf-8") == "mine"
    assert "</html>" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_report_that_finds_the_disk_full_leaves_the_older_one(
    single: Evaluation,
    run: Run,
    study: Study,
    bench: Bench,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "report.html").write_text("an older one", encoding="utf-8")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(InputError, match=r"report\.html: the disk is full"):
        write_report(single, run, study, bench, tmp_path / "report.html")
    assert {one.name: one.read_text(encoding="utf-8") for one in tmp_path.iterdir()} == {
        "report.html": "an older one"
    }


def test_the_first_screen_has_verdict_figure_kind_of_bench_next_step_and_signature(
    source: str,
) -> None:
    places = [
        source.index(part)
        for part in (
            '<section class="verdict', 'class="simulated">Simulated bench: 7 of 7',
            "Last calibration: none stated", "<b>Next.</b>", "<div>Signature</div>",
            "every property in standard uncertainties", 'class="contents"', 'id="verdicts"',
            'id="curves"', 'id="frames"',
        )
    ]  # fmt: skip
    assert places == sorted(places)


def test_contents_and_verdicts_lead_to_places_of_the_page(page: Page, source: str) -> None:
    links = re.findall(r'<a href="#([a-z]+)"', source)
    assert {"curves", "properties", "views", "frames", "provenance"} <= set(links)
    assert set(links) <= set(page.ids)


def test_every_frame_has_a_scale_bar_of_the_length_it_says(source: str, bench: Bench) -> None:
    frames = re.findall(r'<svg class="frame".*?</svg>', source, re.S)
    assert frames
    for frame in frames:
        length = re.search(r'class="scale" d="M[\d. ]+h([\d.]+)"', frame)
        said = re.search(r"([\d.]+) (mm|µm)</text>", frame)
        assert length
        assert said
        millimetres = float(said[1]) * (1 if said[2] == "mm" else 1e-3)
        assert float(length[1]) * bench.optics.sensor.pixel == pytest.approx(millimetres, rel=1e-3)


@pytest.mark.ci
def test_a_calibrated_bench_says_when(
    evaluation: Evaluation, run: Run, study: Study, bench: Bench, tmp_path: Path
) -> None:
    described = bench.description.model_copy(update={"calibrated": "2027-01-01"})
    file = tmp_path / "report.html"
    write_report(evaluation, run, study, replace(bench, description=described), file)
    text = file.read_text(encoding="utf-8")
    assert "Last calibration: 2027-01-01, 14 days before this run." in text


def test_the_limit_of_the_overview_is_that_of_the_farthest_of_independent_normal_numbers() -> None:
    verdict = Verdict("mtf", 46, 0.5, 500, 1.0, 0.00625, True, "")
    farthest = np.abs(np.random.default_rng(1).normal(size=(200_000, 46))).max(axis=1)
    share = float(np.mean(farthest > z_limit(verdict)))
    assert share == pytest.approx(0.00625, rel=0.1)
