"""The output of commands about many runs: their provenance, and a result as a table, JSON and a figure."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from desim.cli.output import echo, storing
from desim.config.file_names import STORE
from desim.config.number_texts import counted
from desim.config.whole_files import write_whole

if TYPE_CHECKING:
    from desim.study.store.store import Store


class Printable(Protocol):
    """A result with a table and a document."""

    def table(self) -> str:
        """Return the table and the sentences."""

    def document(self) -> dict[str, Any]:
        """Return the result as JSON-compatible values."""


class Presentable(Printable, Protocol):
    """A result that also has a figure."""

    def plot(self) -> Any:
        """Return the figure."""


@contextmanager
def adding_to(folder: Path) -> Iterator["Store"]:
    """Yield the store of a folder, and say afterwards how many runs were added to it."""
    from desim.study.store.store import Store

    with storing(folder), Store(folder / STORE) as store:
        stored_before = len(store)
        yield store
        performed = f"{counted(store.added, 'run')} performed"
        echo(f"{performed}, {stored_before:,} already stored; store: {folder / STORE}", err=True)


def record_command(store: "Store", into: Path, *made: Any, **more: Any) -> None:
    """Record how the runs of a store are performed: the command in the store, the provenance in the folder `into`.

    The other arguments are those of `desim.results.provenance.document`.
    """
    from desim.results import provenance

    store.note_command(str(Path.cwd()), sys.argv)
    provenance.write(into, provenance.document(*made, **more))


def show(result: Printable, *, as_json: bool) -> None:
    """Print a result as its table, or as JSON."""
    echo(json.dumps(result.document(), indent=2) if as_json else result.table())


def present(result: Presentable, folder: Path, name: str, *, as_json: bool, is_drawn: bool = True) -> None:
    """Print a result, and write it to NAME.json, NAME.txt and, if matplotlib is installed, to pictures of this name."""
    from desim.results.run_folder import can_plot

    show(result, as_json=as_json)
    with storing(folder):
        write_whole(folder / f"{name}.json", f"{json.dumps(result.document(), indent=2)}\n".encode())
        write_whole(folder / f"{name}.txt", f"{result.table()}\n".encode())
        if is_drawn and can_plot():
            from desim.analysis.drawing.plots import save

            for picture in save(result.plot(), folder / name):
                echo(f"wrote {picture}", err=True)
