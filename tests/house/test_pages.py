"""Every page fits a telephone's screen and A4, and says so where more lies beyond its edge."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "flflab").rglob("page.html.jinja"))
NARROW = 360  # CSS pixels of a small telephone


def rules(source: str) -> list[str]:
    """What stands between braces in a page's style, outside wide screens' rules."""
    style = source[source.index("<style>") : source.index("</style>")]
    return re.findall(r"\{([^{}]*)\}", style)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_a_page_lays_itself_out_for_the_screen_and_for_a4(page: Path) -> None:
    source = page.read_text(encoding="utf-8")
    assert '<meta name="viewport" content="width=device-width' in source
    assert re.search(r"@page \{ size: A4;", source)
    assert re.search(r"h2[^{}]*\{[^{}]*break-after: avoid", source)  # no heading ends a sheet


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_no_column_of_a_page_is_wider_than_a_telephone(page: Path) -> None:
    for rule in rules(page.read_text(encoding="utf-8")):
        for columns in re.findall(r"grid-template-columns:([^;]*)", rule):
            least = re.findall(r"minmax\((\d+)(px|rem)", columns)
            assert all(int(size) * (16 if unit == "rem" else 1) <= NARROW for size, unit in least)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_wide_tables_scroll_and_show_that_they_do(page: Path) -> None:
    source = page.read_text(encoding="utf-8")
    if 'class="scroll"' in source:
        assert re.search(r"\.scroll[^{}]*\{[^{}]*overflow-x: auto", source)
        assert re.search(r"\.scroll[^{}]*\{[^{}]*no-repeat scroll", source)
