"""The commands that write files to start from: `desim examples` and `desim new`."""

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click

from desim.cli import completion
from desim.cli.options import PATH
from desim.cli.output import echo, fail
from desim.config.whole_files import write_new
from desim.scenario.templates import TEMPLATES, starting_files


@click.command()
@click.argument("name", required=False, shell_complete=completion.examples)
@click.argument("target", metavar="[FILE|DIR]", type=PATH, default=Path())
def examples(name: str | None, target: Path) -> None:
    """List the example scenarios, or copy the one called NAME, with the files that it names, to FILE or into DIR.

    Without FILE or DIR, the example is copied to the working directory. Nothing is overwritten.
    """
    from desim.scenario.examples import copy_example, first_sentence
    from desim.scenario.examples import examples as all_examples

    if name is None:
        for example, path in all_examples().items():
            echo(f"{example}: {first_sentence(path)}")
        return
    with _writing():
        written = copy_example(name, target)
    _show(written, f"desim run {shlex.quote(str(written[0]))}")


@click.command()
@click.argument("what", type=click.Choice(TEMPLATES))
@click.argument("name")
def new(what: str, name: str) -> None:
    """Write a commented starting file, ready to run, to the working directory.

    A scenario is NAME.toml. A protocol, latency model, evasion strategy or metric is NAME.py with a NAME.toml that uses
    it and a test_NAME.py that checks it. Nothing is overwritten.
    """
    with _writing():
        texts = starting_files(what, name)
        write_new({Path(file): text.encode() for file, text in texts.items()})
    trust = "" if what == "scenario" else " --allow-import"
    check = "" if what == "scenario" else f"\ncheck it: python test_{name}.py"
    _show([*map(Path, texts)], f"desim run {name}.toml{trust}{check}")


@contextmanager
def _writing() -> Iterator[None]:
    """End the program if files cannot be written, or the given name is invalid or unknown."""
    try:
        yield
    except ValueError as error:
        fail(str(error))
    except OSError as error:
        fail(f"{error.filename}: cannot be written: {error.strerror}")


def _show(written: Sequence[Path], command: str) -> None:
    """Print the paths of new files, and the command that runs the scenario among them."""
    echo("\n".join([*(f"wrote {path}" for path in written), f"run it: {command}"]))
