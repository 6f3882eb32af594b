"""A target named on the command line: a kind, a YAML file, or a picture."""

from pathlib import Path

from flflab.files.target import load_target, target_from
from flflab.targets import Target


def read_target(given: str) -> Target:
    """A target by kind (its defaults), by YAML file, or a picture 20 mm wide by its file.

    Raises:
        InputError: neither a kind nor a file that describes a target.
    """
    file = Path(given)
    if file.suffix in (".yaml", ".yml"):
        return load_target(file)
    if file.suffix:
        return target_from({"kind": "picture", "file": str(file), "width": "20 mm"})
    return target_from(given)
