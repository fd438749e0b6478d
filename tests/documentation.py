"""Build a page for each module of `desim` and `protocols` from the docstrings, to be read in a browser."""

import warnings
from pathlib import Path
from pkgutil import iter_modules

import click
import networkx as nx
import pdoc

import desim


def specifications() -> list[str]:
    """Return what pdoc is to look at: what is below `desim` as well, which is not in its `__all__`."""
    return ["desim", *(f"desim.{each.name}" for each in iter_modules(desim.__path__)), "protocols"]


def build(folder: Path) -> None:
    """Write the pages.

    Raises:
        Warning: if anything in a docstring or an annotation cannot be shown.
    """
    nx.Graph.__class_getitem__ = classmethod(lambda graph, _: graph)  # its stubs know nx.Graph[int], networkx does not
    for name in desim.__all__:  # imported when it is asked for, which pdoc does not do
        setattr(desim, name, getattr(desim, name))
    pdoc.render.configure(docformat="google")
    with warnings.catch_warnings(action="error"):
        pdoc.pdoc(*specifications(), output_directory=folder)


@click.command(help=__doc__)
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
def main(folder: Path) -> None:
    """Build them in a folder."""
    build(folder)


if __name__ == "__main__":
    main()
