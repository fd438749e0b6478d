"""The store and the files of `desim race` and `desim sensitivity`: a table with sentences, a figure and JSON."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from desim.cli.output import echo, storing
from desim.config.file_names import STORE
from desim.config.whole_files import write_whole

if TYPE_CHECKING:
    from desim.study.store.store import Store


class Presentable(Protocol):
    """A result with a table, a figure and a document."""

    def table(self) -> str:
        """Return the table and the sentences."""

    def document(self) -> dict[str, Any]:
        """Return the result as JSON-compatible values."""

    def plot(self) -> Any:
        """Return the figure."""


@contextmanager
def adding_to(folder: Path) -> Iterator["Store"]:
    """Yield the store of a folder, and say afterwards how many runs were added to it."""
    from desim.study.store.store import Store

    with storing(folder), Store(folder / STORE) as store:
        before = len(store)
        yield store
        echo(f"{store.added} runs were performed, {before} were already stored; store: {folder / STORE}", err=True)


def present(result: Presentable, folder: Path, name: str, *, as_json: bool) -> None:
    """Print a result, and write it to NAME.json, NAME.txt and, if matplotlib is installed, to pictures of this name."""
    from desim.results.run_folder import can_plot

    text, table = json.dumps(result.document(), indent=2), result.table()
    echo(text if as_json else table)
    with storing(folder):
        write_whole(folder / f"{name}.json", f"{text}\n".encode())
        write_whole(folder / f"{name}.txt", f"{table}\n".encode())
        if can_plot():
            from desim.analysis.drawing.plots import save

            for picture in save(result.plot(), folder / name):
                echo(f"wrote {picture}", err=True)
