"""Commands run as the console script runs them, in this process."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from flflab.cli import main


class Ended(NamedTuple):
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """Standard output as one JSON object."""
        return json.loads(self.out)


Run = Callable[..., Ended]


@pytest.fixture
def flflab(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    def run(*arguments: object) -> Ended:
        monkeypatch.setattr(sys, "argv", ["flflab", *map(str, arguments)])
        code: object = 0
        try:
            main()
        except SystemExit as ending:
            code = ending.code
        captured = capfd.readouterr()
        return Ended(int(str(code or 0)), captured.out, captured.err)

    return run


@pytest.fixture
def small_camera(tmp_path: Path) -> Path:
    """The built-in camera behind a sensor of 760 x 560 pixels."""
    text = (Path(__file__).parents[2] / "examples" / "cameras" / "osinski.yaml").read_text(
        encoding="utf-8"
    )
    file = tmp_path / "small.yaml"
    file.write_text(
        text.replace("[3664, 2748]", "[760, 560]").replace("count: [25, 25]", "count: [7, 7]"),
        encoding="utf-8",
    )
    return file
