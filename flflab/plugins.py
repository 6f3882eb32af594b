"""What other packages add by entry points: drivers and simulators, found by name when a bench file
asks for one.
"""

from collections.abc import Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from flflab.errors import InputError

Kind = TypeVar("Kind")


class WithPlugins(Mapping[str, Kind]):
    """What is built in by name, and what entry points of a group add; a name that is built in stays
    what it is.

    Args:
        built_in: by name.
        group: of the entry points, ``flflab.axes``.
        kind: what an entry point has to be.
    """

    def __init__(self, built_in: Mapping[str, Kind], group: str, kind: type[Kind]) -> None:
        self._built_in, self._group, self._kind = built_in, group, kind

    def __getitem__(self, name: str) -> Kind:
        """What has this name.

        Raises:
            KeyError: nothing has.
            InputError: a package has it, and cannot be loaded, or it is something else.
        """
        if name in self._built_in:
            return self._built_in[name]
        for entry in entry_points(group=self._group, name=name):
            return self._loaded(entry)
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        added = [entry.name for entry in entry_points(group=self._group)]
        return iter(dict.fromkeys([*self._built_in, *added]))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def _loaded(self, entry: EntryPoint) -> Kind:
        whose = f"{entry.dist.name} {entry.dist.version}" if entry.dist else "another package"
        try:
            found = entry.load()
        except Exception as error:  # whatever a package of others does while it loads
            raise InputError(
                f"{entry.name}, which {whose} adds to {self._group}, cannot be loaded"
                f" ({type(error).__name__}: {error}); see that package"
            ) from error
        if not isinstance(found, self._kind):
            raise InputError(
                f"{entry.name}, which {whose} adds to {self._group}, is of kind"
                f" {type(found).__name__}; {self._kind.__name__} is due"
            )
        return found
