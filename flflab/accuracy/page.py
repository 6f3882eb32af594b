"""An accuracy page: one HTML file that needs nothing else, a sentence under every picture, readable
on screen and on paper.
"""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from flflab.whole_file import write_whole


@dataclass(frozen=True)
class Picture:
    """A picture as a data URI, what it is in a few words, and the sentence that says what to read
    from it.
    """

    image: str
    name: str
    says: str


@dataclass(frozen=True)
class Table:
    """A caption, headings and rows of cells."""

    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Section:
    """A heading with text, then pictures (``wide`` ones alone in their row, others two in a row),
    then tables.
    """

    heading: str
    paragraphs: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    wide: bool = False
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True)
class Page:
    """A page: what it answers, the answer in a few sentences, the evidence, and where it came
    from.
    """

    title: str
    answers: tuple[str, ...]
    sections: tuple[Section, ...]
    made: str


def write_page(page: Page, file: Path) -> None:
    """Write a page.

    Raises:
        InputError: the file cannot be written.
    """
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(
        files("flflab.accuracy").joinpath("page.html.jinja").read_text(encoding="utf-8")
    )
    write_whole(file, template.render(page=page))
