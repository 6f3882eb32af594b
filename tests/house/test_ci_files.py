"""The CI files of the documentation are YAML, and run commands that flflab has."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from flflab.cli.app import app

PAGE = Path(__file__).parents[2] / "docs" / "bench-ci.md"


def block(kind: str) -> dict[str, Any]:
    found = re.search(rf"```yaml {kind}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert found is not None
    return dict(yaml.safe_load(found[1]))


def commands(kind: str) -> list[str]:
    if kind == "gitlab":
        return list(block(kind)["validate"]["script"])
    steps = block(kind)["jobs"]["validate"]["steps"]
    return [step["run"] for step in steps if "run" in step]


@pytest.mark.parametrize("kind", ["github", "gitlab"])
def test_the_ci_files_install_and_validate(kind: str) -> None:
    install, validate = commands(kind)
    assert install == "pip install ."
    words = shlex.split(validate)
    assert words[:2] == ["flflab", "validate"]
    told = CliRunner().invoke(app, ["validate", "--help"], env={"COLUMNS": "200"}).output
    assert {word for word in words if word.startswith("--")} <= set(re.findall(r"--[a-z]+", told))


def test_gitlab_is_given_the_file_that_the_command_writes() -> None:
    _, validate = commands("gitlab")
    reports = block("gitlab")["validate"]["artifacts"]["reports"]
    assert reports["junit"] == shlex.split(validate)[-1]
