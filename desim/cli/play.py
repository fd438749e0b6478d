"""`desim play`: a page on which the keys of a scenario are changed and each run is seen at once."""

import os
import webbrowser
from pathlib import Path

import click

from desim.cli.options import ALLOW_IMPORT, SET, TIMEOUT, echo, is_import_allowed, making, source_of


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False)
@click.option("--no-browser", is_flag=True, help="Print the address only; do not open a browser.")
@TIMEOUT
@ALLOW_IMPORT
@SET
def play(file: Path | None, no_browser: bool, timeout: float | None, overrides: tuple[str, ...]) -> None:
    """Change the keys of a scenario FILE on a page, and see each run beside the one before.

    Without a FILE, the example `relay` is played with. The page is served to this machine only. Ctrl-C ends the
    server, and so does closing the page. A run takes at most 30 s, unless --timeout says otherwise.
    """
    from desim.scenario.examples import example
    from desim.scenario.toml import read
    from desim.study.workers import Processes
    from desim.view.play import Playground
    from desim.view.play_server import PlayServer, page

    path = example("relay") if file is None else file
    source_of(path, overrides)
    limit = {} if timeout is None else {"timeout": timeout}
    playground = Playground(read(path, allow_import=is_import_allowed()), path, overrides, **limit)
    with making("page to play with"):
        page(playground)
    workers = Processes(os.cpu_count() or 1)
    with PlayServer(playground, workers) as server:
        try:
            server.warm_up()
            echo(f"{server.address}\nserved to this machine only, until Ctrl-C or until the page is closed")
            if not no_browser:
                webbrowser.open(server.address)
            server.serve_until_closed()
        finally:
            workers.stop()
