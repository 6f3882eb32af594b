"""Sentences that users read use the field's words, not the house's own."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PRIVATE = re.compile(
    r"\b(told|untold|held against|hold[s]? \w+ against|so many as|gone on with|unless told"
    r"|told apart|hangs? on|hangs? together|as far off)\b"
)


def sentences(file: Path) -> Iterator[tuple[int, str]]:
    """String constants of a file that hold a space and are no docstrings, with their lines."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    docs = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Constant) and isinstance(node.value, str)):
            continue
        if " " in node.value and id(node) not in docs:
            yield node.lineno, node.value


@pytest.mark.parametrize("package", ["flflab", "procedures"])
def test_messages_have_no_private_words(package: str, root: Path) -> None:
    found = [
        f"{file.relative_to(root)}:{line}: {text}"
        for file in sorted((root / package).rglob("*.py"))
        for line, text in sentences(file)
        if PRIVATE.search(text)
    ]
    assert found == []


def test_pages_have_no_private_words(root: Path) -> None:
    pages = [
        root / "README.md",
        *sorted((root / "docs").glob("*.md")),
        *sorted((root / "flflab").rglob("*.jinja")),
    ]
    found = [
        f"{page.relative_to(root)}:{number}: {line.strip()[:120]}"
        for page in pages
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        if PRIVATE.search(line)
    ]
    assert found == []


@pytest.mark.parametrize(
    ("sentence", "private"),
    [
        ("none of 500 simulated benches deviates this much", False),
        ("the pictures told 40 % of it", True),
        ("the camera is held against its model", True),
    ],
)
def test_the_rule_knows_private_words(sentence: str, private: bool) -> None:
    assert bool(PRIVATE.search(sentence)) is private
