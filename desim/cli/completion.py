"""Shell completion of keys, kinds of protocols and names of examples, without slow imports.

A shell runs the program on every press of Tab, so the keys are read from `keys.txt`. A test compares `keys.txt` with
the models; if the environment variable RENEW is set, it first rewrites the file.
"""

from importlib.metadata import entry_points
from pathlib import Path

import click

from desim.config.packages import check_visible

KEYS = Path(__file__).with_name("keys.txt")
"""The file of the keys of scenarios, in the form of --set: KEY= and, for a key with kinds, KEY.kind=KIND."""


def keys(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Return the completions KEY= and KEY.kind=KIND that begin with a text."""
    return _matching(KEYS.read_text(encoding="utf-8").split(), incomplete)


def protocols(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Return the kinds of the installed protocols that begin with a text."""
    check_visible("protocols")
    from protocols import KINDS

    group = "desim.protocols"
    return _matching([*KINDS[group], *(point.name for point in entry_points(group=group))], incomplete)


def examples(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Return the names of the example scenarios that begin with a text."""
    from desim.scenario.examples import examples as all_examples

    return _matching([*all_examples()], incomplete)


def _matching(words: list[str], incomplete: str) -> list[str]:
    return sorted(word for word in words if word.startswith(incomplete))
