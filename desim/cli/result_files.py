"""The files of a result that is a table with sentences, a figure and JSON: what `race` and `sensitivity` leave."""

import json
from pathlib import Path
from typing import Any, Protocol

from desim.cli.options import echo
from desim.config.trust import write_whole


class Presentable(Protocol):
    """A result with a table, a figure and a document."""

    def table(self) -> str:
        """Return the table and the sentences."""

    def document(self) -> dict[str, Any]:
        """Return the result as JSON-compatible values."""

    def plot(self) -> Any:
        """Return the figure."""


def present(result: Presentable, folder: Path, name: str, *, as_json: bool) -> None:
    """Print a result, and write it to NAME.json, NAME.txt and, if matplotlib is installed, to pictures of this name."""
    from desim.results.run_folder import can_plot

    text, table = json.dumps(result.document(), indent=2), result.table()
    write_whole(folder / f"{name}.json", f"{text}\n".encode())
    write_whole(folder / f"{name}.txt", f"{table}\n".encode())
    echo(text if as_json else table)
    if can_plot():
        from desim.analysis.drawing.plots import save

        for picture in save(result.plot(), folder / name):
            echo(f"wrote {picture}", err=True)
