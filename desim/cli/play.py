"""`desim play`: a page on which the keys of a scenario are changed and each run is seen at once."""

import os
import webbrowser
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread

import click

from desim.cli.options import ALLOW_IMPORT, SET, TIMEOUT, echo, is_import_allowed, making, source_of


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False)
@click.option("--no-browser", is_flag=True, help="Print the address only; do not open a browser.")
@TIMEOUT
@ALLOW_IMPORT
@SET
def play(file: Path | None, no_browser: bool, timeout: float | None, overrides: tuple[str, ...]) -> None:
    """Change the keys of a scenario FILE on a page, and see each run beside one that is pinned.

    Without a FILE, the example `relay` is played with. The page is served to this machine only. Ctrl-C ends the
    server, and so does closing the page. A run takes at most 30 s, unless --timeout says otherwise.
    """
    from desim.scenario.examples import example
    from desim.scenario.toml import read
    from desim.study.workers import Processes
    from desim.view.play import Playground, Session
    from desim.view.play_server import PlayServer, page

    path = example("relay") if file is None else file
    source_of(path, overrides)  # ends the program if they are not valid
    limit = {} if timeout is None else {"timeout": timeout}
    playground = Playground(read(path, allow_import=is_import_allowed()), path, overrides, **limit)
    with making("page to play with"):
        page(playground)
    workers = Processes(os.cpu_count() or 1, kept=True)
    with PlayServer(Session(playground, workers)) as server, TemporaryDirectory(prefix="desim-") as folder:
        try:
            server.session.warm_up()
            echo(f"{server.address}\nserved to this machine only, until Ctrl-C or until the page is closed")
            if not no_browser:
                Thread(target=webbrowser.open, args=(_door(Path(folder), server.address),), daemon=True).start()
            server.serve_until_closed()
        finally:
            workers.stop()


def _door(folder: Path, address: str) -> str:
    """Write a page that leads to an address, and return the address of that page.

    Other users of the machine see the command line of the browser, but not what is in the folder.
    """
    path = folder / "play.html"
    path.write_text(f'<meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
    return path.as_uri()
