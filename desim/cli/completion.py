"""Shell completion of keys, kinds of protocols and names of examples, without slow imports.

A shell runs the program on every press of Tab. The keys are therefore kept in the cache folder of the user after their
first use, until the source or an installed kind changes.
"""

import os
from contextlib import suppress
from importlib.metadata import entry_points
from pathlib import Path

import click

from desim.config.packages import check_visible, package_folder
from desim.config.whole_files import write_whole


def keys(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Return the completions KEY= and KEY.kind=KIND that begin with the incomplete word."""
    cache, state = _cache_folder() / "keys.txt", _state()
    lines = cache.read_text(encoding="utf-8").split("\n") if cache.is_file() else []
    if lines[:1] != [state]:
        lines = [state, *all_completions()]
        with suppress(OSError):  # without a cache, the next press of Tab takes as long as this one
            cache.parent.mkdir(parents=True, exist_ok=True)
            write_whole(cache, "\n".join(lines).encode())
    return _matching(lines[1:], incomplete)


def all_completions() -> list[str]:
    """Return the keys of scenarios in the form of --set, sorted: KEY= and, for a key with kinds, KEY.kind=KIND."""
    from desim.config.key_index import all_keys
    from desim.scenario.scenario import Scenario

    completions = set[str]()
    for key in all_keys(Scenario):
        table = "fault.0" if key.dotted == "fault" else key.dotted  # --set needs the index of a fault
        completions |= {f"{key.dotted}=", *(f"{table}.kind={kind}" for kind in key.kinds)}
    return sorted(completions)


def _cache_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "desim"


def _state() -> str:
    """Return a line that changes with the source of desim and with the kinds of other distributions."""
    sources = [path for package in ("desim", "protocols") for path in package_folder(package).rglob("*.py")]
    points = entry_points()
    groups = sorted(group for group in points.groups if group.startswith("desim."))
    installed = [f"{group}:{name}" for group in groups for name in sorted(points.select(group=group).names)]
    return " ".join([str(package_folder("desim")), str(max(path.stat().st_mtime_ns for path in sources)), *installed])


def protocols(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Return the kinds of the installed protocols that begin with the incomplete word."""
    check_visible("protocols")
    from protocols import KINDS

    group = "desim.protocols"
    return _matching([*KINDS[group], *(point.name for point in entry_points(group=group))], incomplete)


def examples(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Return the names of the example scenarios that begin with the incomplete word."""
    from desim.scenario.examples import examples as all_examples

    return _matching([*all_examples()], incomplete)


def _matching(words: list[str], incomplete: str) -> list[str]:
    return sorted(word for word in words if word.startswith(incomplete))
