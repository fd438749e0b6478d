"""Build a page for each module of `desim` and `protocols` from the docstrings, to be read in a browser."""

import warnings
from pathlib import Path
from pkgutil import iter_modules

import click
import networkx as nx
import pdoc

import desim
import protocols


def specifications() -> list[str]:
    """Return the names for pdoc: the packages, and the modules in them, which are not in their `__all__`."""
    packages = (desim, protocols)
    inner = [f"{package.__name__}.{each.name}" for package in packages for each in iter_modules(package.__path__)]
    return [*(package.__name__ for package in packages), *inner]


def build(folder: Path) -> None:
    """Write the pages.

    Raises:
        Warning: if anything in a docstring or an annotation cannot be shown.
    """
    nx.Graph.__class_getitem__ = classmethod(lambda graph, _: graph)  # its stubs know nx.Graph[int], networkx does not
    for package in (desim, protocols):  # they import a name when it is asked for, which pdoc does not do
        for name in package.__all__:
            setattr(package, name, getattr(package, name))
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
