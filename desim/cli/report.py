"""`desim report`: a page about a sweep."""

from pathlib import Path

import click

from desim.cli.options import STORE, refuse, storing


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="The page; default: report.html in DIR.")
def report(folder: Path, out: Path | None) -> None:
    """Make a page about a sweep: of a DIR that `desim sweep -o DIR` or `desim explain -o DIR` wrote."""
    from desim.view.report import Study
    from desim.view.report import report as page_of

    path = out or folder / "report.html"
    try:
        with storing(folder):
            study = Study.read(folder, STORE)
        page = page_of(study).encode()
    except ModuleNotFoundError as error:
        refuse(f"a report needs {error.name}: pip install 'pursuit-desim[plot]'")
    except ValueError as error:
        refuse(str(error))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(page)
    except OSError as error:
        refuse(f"{path}: cannot be written: {error.strerror}")
    groups = study.result.groups
    click.echo(f"{path}: {len(groups)} configurations, {study.runs:,} runs, {len(page) / 1000:,.0f} kB")
