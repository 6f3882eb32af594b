"""What stands on a simulated bench's target wheel, held against what a study says it shows."""

from dataclasses import fields

from flflab.bench import Bench
from flflab.files.target import target_from
from flflab.study import Study


def unlike_the_wheel(study: Study, bench: Bench) -> list[str]:
    """What a simulated bench would show otherwise than the study has it, a sentence for each
    target.
    """
    if bench.description.target.address != "simulated":
        return []
    given = bench.description.simulated.targets
    found: list[str] = []
    for target in study.targets:
        shown = target_from(
            {"kind": target.kind} | given.get(target.kind, {}),
            f"{bench.file}: simulated.targets",
            bench.file.parent,
        )
        pairs = [
            (one.name, getattr(target, one.name), getattr(shown, one.name))
            for one in fields(target)
            if one.init
        ]
        different = [
            f"{name} {there} instead of {here}" for name, here, there in pairs if here != there
        ]
        if different:
            found.append(
                f"the simulated bench shows a {target.kind} target with {', '.join(different)}"
                f" (mm); give simulated.targets in {bench.file.name} what the study has, unless it"
                " is meant to differ"
            )
    return found
