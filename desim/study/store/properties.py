"""The properties in a store of the sweep that it belongs to, such as its scenario and the code of its functions."""

import json
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any

from pydantic import Json

from desim.config.data_files import in_short
from desim.study.store.file import HINT, StoreError, StoreFile, adapter_of, naming_the_file

VERSIONS = "versions"
"""The property with the versions that computed the runs: a list of tables as from `environment.computing_versions`."""
Versions = dict[str, str]


class SweepProperties(StoreFile):
    """A store file with the methods that write and read the properties of the sweep; see `StoreFile`."""

    @property
    @naming_the_file
    def about(self) -> Mapping[str, str]:
        """The properties of the sweep that the store belongs to, as JSON texts by name, without `versions`."""
        return MappingProxyType({name: value for name, value in self.rows("about") if name != VERSIONS})

    @property
    @naming_the_file
    def versions(self) -> list[Versions]:
        """The versions of Python and of the packages that computed the runs; several if they were mixed."""
        stored = [value for _, value in self.rows("about", "WHERE name = ?", (VERSIONS,))]
        adapter = adapter_of(Annotated[list[Versions], Json])
        return [versions for value in stored for versions in self.read(adapter, "about", (VERSIONS, value), 1)]

    def check_versions(self, versions: Sequence[Versions], subject: str, *, mix: bool) -> None:
        """Raise StoreError if the runs were computed by other versions, unless these may be mixed.

        Args:
            versions: the versions that computed, or will compute, further runs.
            subject: the further runs, as the subject of the error message: "this is", "out/b.sqlite has".
            mix: whether runs of different versions may be in one store.
        """
        recorded = self.versions
        for other in versions:
            if recorded and other not in recorded and not mix:
                names = [name for name in recorded[-1] | other if recorded[-1].get(name) != other.get(name)]
                ours, others = (
                    ", ".join(f"{name} {differing.get(name, 'unknown')}" for name in names)
                    for differing in (recorded[-1], other)
                )
                raise StoreError(
                    f"{self.path}: has runs of {ours}, and {subject} {others}, so last digits may differ: mix them with"
                    f" --mix-versions (in Python mix_versions=True), or choose another folder (-o, in Python store=)"
                )

    @naming_the_file
    def record_versions(self, versions: Sequence[Versions], subject: str, *, mix: bool) -> None:
        """Record versions that compute runs of the store.

        Raises:
            StoreError: as `check_versions`.
        """
        if all(version in self.versions for version in versions):
            return
        with self.writing() as database:
            self.check_versions(versions, subject, mix=mix)
            recorded = self.versions
            all_versions = recorded + [version for version in versions if version not in recorded]
            database.execute("INSERT OR REPLACE INTO about VALUES (?, ?)", (VERSIONS, json.dumps(all_versions)))

    @naming_the_file
    def read_property(self, name: str, kind: Any) -> Any:
        """Return a property of the sweep, parsed from JSON and checked against a type.

        Raises:
            StoreError: if the property is missing, or has another type.
        """
        if name not in self.about:
            raise StoreError(f"{self.path}: is damaged: {name} is missing in about")
        return self.read(adapter_of(Annotated[kind, Json]), "about", (name, self.about[name]), 1)

    @naming_the_file
    def check_same(self, about: Mapping[str, str]) -> None:
        """Raise StoreError if a property of the sweep is recorded with another value."""
        recorded = self.about
        for name, value in about.items():
            if recorded.get(name, value) != value:
                difference = _made_by(name, self.read_property(name, Any), json.loads(value))
                raise StoreError(f"{self.path}: was made {difference}; {HINT}")

    @naming_the_file
    def record_properties(self, about: Mapping[str, str]) -> None:
        """Record the properties of the sweep.

        Raises:
            StoreError: if the store belongs to another sweep.
        """
        if about.items() <= self.about.items():
            return
        with self.writing() as database:
            self.check_same(about)
            database.executemany("INSERT OR IGNORE INTO about VALUES (?, ?)", about.items())


def _made_by(name: str, stored: Any, other: Any) -> str:
    """Return the end of the error message "was made ...": how a property of two sweeps, stored and other, differs."""
    if name == "format":
        return "by another version of desim"
    if name == "scenario":
        old, new = flat(stored), flat(other)
        keys = sorted(key for key in old.keys() | new.keys() if old.get(key) != new.get(key))
        pairs = [(key, *(in_short(values.get(key, "not there")) for values in (old, new))) for key in keys[:5]]
        texts = "; ".join(f"{key} was {was}, is {now}" for key, was, now in pairs)
        return f"by another scenario: {texts}"
    was, now = json.dumps(stored), json.dumps(other)
    is_source = name.startswith(("the code of ", "the content of "))
    return f"by another {'version' if is_source else 'sweep'}: {name} was {was}, is {now}"


def flat(node: Any, opens: Callable[[Any], bool] = lambda _: True, above: str = "") -> dict[str, Any]:
    """Return the values in nested tables and lists by dotted key.

    A table or list that is empty, or that `opens` rejects, counts as one value.
    """
    if not (isinstance(node, dict | list) and node and opens(node)):
        return {above.removesuffix("."): node}
    members = node.items() if isinstance(node, dict) else enumerate(node)
    return {key: member for name, value in members for key, member in flat(value, opens, f"{above}{name}.").items()}
