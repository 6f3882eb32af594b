"""The four top-level packages: what the wheel holds, what they may import, and whether they are
ours.
"""

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from flflab.house import stranger_among_packages

OURS = {"flflab", "drivers", "procedures", "sim"}
ASK = (
    "from flflab.house import stranger_among_packages as ask; import json; print(json.dumps(ask()))"
)


def build_wheel(root: Path, folder: Path) -> Path:
    command = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        str(folder),
        str(root),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def wheel(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_wheel(root, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, unpacked as an installer would."""
    folder = tmp_path_factory.mktemp("installed")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def ask_in(*search_path: Path) -> str | None:
    """What a fresh interpreter with only these folders, in this order, answers."""
    paths = [str(folder) for folder in search_path]
    code = f"import sys; sys.path[:0] = {paths!r}; {ASK}"
    done = subprocess.run(
        [sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def test_the_wheel_holds_exactly_the_four_packages_with_their_types_and_built_ins(
    wheel: Path,
) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == OURS
    assert {f"{package}/py.typed" for package in OURS} <= set(names)
    assert any(name.startswith("flflab/builtin/") and name.endswith(".yaml") for name in names)


def test_the_packages_of_this_environment_are_ours() -> None:
    assert stranger_among_packages() is None


def test_an_installation_of_the_wheel_is_in_order(installed: Path) -> None:
    assert ask_in(installed) is None


def test_a_package_of_the_same_name_found_first_is_named_in_one_sentence(
    installed: Path, tmp_path: Path
) -> None:
    stranger = tmp_path / "drivers"
    stranger.mkdir()
    (stranger / "__init__.py").touch()
    sentence = ask_in(tmp_path, installed)
    assert sentence is not None
    assert str(stranger / "__init__.py") in sentence
    assert "'drivers'" in sentence


def test_a_missing_package_is_named_in_one_sentence(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(
            tmp_path,
            [name for name in archive.namelist() if not name.startswith(("sim/", "procedures/"))],
        )
    code = (
        f"import sys; sys.path[:] = [{str(tmp_path)!r}] + [p for p in sys.path if 'site-packages'"
        f" not in p]; {ASK}"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=True
    )
    assert "'procedures', a part of flflab, is missing" in json.loads(done.stdout)


def test_another_project_writing_over_a_package_is_named_in_one_sentence(
    wheel: Path, tmp_path: Path
) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    (tmp_path / "drivers" / "__init__.py").write_text("version = '0.1.0'\n", encoding="utf-8")
    sentence = ask_in(tmp_path)
    assert sentence is not None
    assert "wrote over it" in sentence
    assert str(tmp_path / "drivers") in sentence


def test_the_import_contracts_are_kept(root: Path) -> None:
    code = (
        "import sys; from importlinter.cli import lint_imports;"
        " sys.exit(lint_imports(no_cache=True))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
