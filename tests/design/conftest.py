from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from flflab.design.requirements import Requirements, read_requirements

Wanted = Callable[..., Requirements]


@pytest.fixture
def described(root: Path) -> Callable[..., dict[str, Any]]:
    """The example's requirements as data, with whole sections replaced."""
    text = (root / "examples/requirements/osinski.yaml").read_text(encoding="utf-8")
    return lambda **sections: {**yaml.safe_load(text), **sections}


@pytest.fixture
def wanted(tmp_path: Path, described: Callable[..., dict[str, Any]]) -> Wanted:
    """Requirements like the example's on a small grid, with whole sections replaced."""

    def make(**sections: Any) -> Requirements:
        file = tmp_path / "requirements.yaml"
        given: dict[str, Any] = {
            "search": {"configurations": 20000, "focus_steps": 9, "epsilon": 0},
            **sections,
        }
        file.write_text(yaml.safe_dump(described(**given)), encoding="utf-8")
        return read_requirements(file)

    return make
