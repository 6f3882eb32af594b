"""Rules of the tree itself: short files, paths that exist, nothing of one machine, built-ins equal
to the examples.
"""

import re
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

LONGEST = 450
REASON = "longer than 450 lines because"


@pytest.fixture(scope="module")
def files(root: Path) -> list[Path]:
    """Every file git tracks or would track; in an unpacked archive, every file outside dot
    folders.
    """
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode == 0:
        return [root / line for line in listed.stdout.splitlines() if (root / line).is_file()]
    return [
        path
        for path in root.rglob("*")
        if path.is_file() and not any(part[0] == "." for part in path.relative_to(root).parts)
    ]


def test_a_long_file_says_at_its_head_why(files: list[Path]) -> None:
    for file in (file for file in files if file.suffix == ".py"):
        lines = file.read_text(encoding="utf-8").splitlines()
        assert len(lines) <= LONGEST or any(REASON in line for line in lines[:10]), (
            f"{file}: {len(lines)} lines and no reason"
        )


def test_no_picture_that_a_command_wrote_lies_in_the_tree(root: Path, files: list[Path]) -> None:
    assert [
        str(file.relative_to(root))
        for file in files
        if file.suffix in {".npy", ".h5", ".dng"} or file.stat().st_size > 2**20
    ] == []


def test_tests_are_no_package(files: list[Path]) -> None:
    assert [file for file in files if file.name == "__init__.py" and "tests" in file.parts] == []


def test_only_the_entry_points_run_when_started_as_a_file(root: Path, files: list[Path]) -> None:
    starters = {
        str(file.relative_to(root))
        for file in files
        if file.suffix == ".py" and "\nif __name__ ==" in file.read_text("utf-8")
    }
    assert starters <= {"quickstart.py"} | {
        name for name in starters if name.startswith("benchmarks")
    }


def configured_paths(root: Path) -> list[str]:
    """Files and folders that pyproject.toml, .ci/run, the citation and the README's links name."""
    settings: dict[str, Any] = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    tool = settings["tool"]
    paths: list[str] = [
        *tool["hatch"]["build"]["targets"]["wheel"]["packages"],
        *tool["pyright"]["include"],
    ]
    paths += [*tool["pytest"]["ini_options"]["testpaths"], *tool["importlinter"]["root_packages"]]
    paths += [settings["project"]["readme"], *settings["project"]["license-files"]]
    paths += [name.removesuffix("/**") for name in tool["ruff"]["lint"]["per-file-ignores"]]
    for file in ("README.md", "CONTRIBUTING.md", "docs/index.md"):
        links = re.findall(
            r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", (root / file).read_text(encoding="utf-8")
        )
        paths += [str(Path(file).parent / link) for link in links]
    paths += re.findall(r"\$PWD/([\w.-]+)", (root / ".ci/run").read_text(encoding="utf-8"))
    return paths


def test_every_path_named_in_configuration_and_links_exists(root: Path) -> None:
    assert [path for path in configured_paths(root) if not (root / path).exists()] == []


def test_every_module_named_in_the_import_contracts_exists(root: Path) -> None:
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    contracts: list[dict[str, Any]] = settings["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["id"] == "flflab-layers")
    names = [f"flflab.{name}" for layer in layers for name in re.findall(r"\w+", layer)]
    for contract in contracts:
        for key in ("modules", "source_modules"):
            names += [name for name in contract.get(key, []) if "*" not in name]
    places = [root.joinpath(*name.split(".")) for name in names]
    assert [
        str(place) for place in places if not (place.is_dir() or place.with_suffix(".py").is_file())
    ] == []


def test_the_tree_names_no_machine(root: Path, files: list[Path]) -> None:
    foreign = re.compile(r"(?<![\w.$~}])/(?:tmp|work|home|root|Users|opt)/\w|[A-Z]:\\Users")
    for file in files:
        if (
            file.suffix in {".png", ".npy", ".h5", ".dng", ".tiff"}
            or file == Path(__file__).resolve()
        ):
            continue
        found = foreign.search(file.read_text(encoding="utf-8"))
        assert found is None, f"{file.relative_to(root)}: {found and found.group()}"


def test_the_built_in_files_are_the_examples(root: Path) -> None:
    built_in, examples = root / "flflab" / "builtin", root / "examples"
    names = {path.relative_to(built_in) for path in built_in.rglob("*.yaml")}
    assert names
    shown = {path.relative_to(examples) for path in examples.rglob("*.yaml")}
    for_reading = {name for name in shown if name.parts[0] == "scenes" and name not in names}
    assert names == shown - for_reading
    for name in names:
        assert (built_in / name).read_bytes() == (examples / name).read_bytes(), name


def test_the_version_is_the_same_everywhere(root: Path) -> None:
    version = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "version"
    ]
    assert yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))["version"] == version
    assert f"## {version}" in (root / "CHANGELOG.md").read_text(encoding="utf-8")
