"""`desim play`: a page on which the user changes the keys of a scenario and sees the run after each change."""

import os
import webbrowser
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread

import click

from desim.cli.options import PATH, TIMEOUT, is_import_allowed, overriding
from desim.cli.output import echo, making
from desim.cli.sources import source_of


@click.command()
@click.argument("file", type=PATH, required=False)
@click.option("--no-browser", is_flag=True, help="Print the address only; do not open a browser.")
@TIMEOUT
@overriding
def play(file: Path | None, no_browser: bool, timeout: float | None, overrides: tuple[str, ...]) -> None:
    """Change the keys of a scenario FILE on a page, and compare each run with a run that you have pinned.

    Without a FILE, the page shows the example `relay`. The page is served to this machine only. Ctrl-C ends the
    server, and so does closing the page. A run takes at most 30 s, unless --timeout says otherwise.
    """
    from desim.scenario.examples import example
    from desim.scenario.toml import read_source
    from desim.study.workers.workers import Processes
    from desim.view.pages.play_page import play_page
    from desim.view.pages.play_server import PlayServer
    from desim.view.pages.playground import Playground
    from desim.view.pages.session import Session

    path = example("relay") if file is None else file
    source_of(path, overrides)  # ends the program if the file or an override is invalid
    limit = {} if timeout is None else {"timeout": timeout}
    playground = Playground(read_source(path, allow_import=is_import_allowed()), path, overrides, **limit)
    with making("page to play with"):
        play_page(playground)
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
    """Write a page that redirects to an address, and return the address of that page.

    The address has a secret token, so it must not be on the command line of the browser, which other users of the
    machine can see. They cannot read the folder.
    """
    path = folder / "play.html"
    path.write_text(f'<meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
    return path.as_uri()
