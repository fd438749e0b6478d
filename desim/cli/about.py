"""What there is to know without a run: `desim check`, `schema`, `keys`, `protocols`."""

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import click

from desim.cli.options import ALLOW_IMPORT, FILE, SET, refuse, say, source_of

if TYPE_CHECKING:
    from pydantic import BaseModel


@click.command()
@FILE
@ALLOW_IMPORT
@SET
def check(file: Path, overrides: tuple[str, ...]) -> None:
    """Validate a scenario, and its grid if it has one, and print it with every default filled in."""
    from desim.scenario_file import dump

    source, scenario = source_of(file, overrides)
    if scenario.sweep.grid:
        from desim.source import ScenarioError
        from desim.study.configurations import cells

        try:
            cells(source)
        except ScenarioError as error:
            refuse(str(error))
    say(dump(scenario), end="")


@click.command()
def schema() -> None:
    """Print the JSON schema of scenario files, for editors."""
    from desim.scenario import Scenario

    document = json.dumps(Scenario.model_json_schema())
    strict = json.loads(document, parse_constant=str)  # infinity is a string, as in results
    say(json.dumps(strict, indent=2))


@click.command()
@click.argument("table", required=False)
def keys(table: str | None) -> None:
    """List the keys of scenario files with defaults, units and kinds: all, or those of a TABLE like network."""
    from desim.cli.description import described
    from desim.scenario import Scenario

    lines = list(described(Scenario, "scenario"))
    tops = [k for k, line in enumerate(lines) if re.match(r" {4}\w", line)]
    if table is not None:
        names = [re.split(r"\W", lines[k].strip())[0] for k in tops]
        if table not in names:
            refuse(f"there is no table {table!r}; allowed: {', '.join(names)}")
        first = tops[names.index(table)]
        lines = lines[first : next((k for k in tops if k > first), len(lines))]
    say("\n".join(lines))


@click.command()
def protocols() -> None:
    """List the installed protocols and their parameters."""
    from desim.cli.description import described
    from desim.scenario import PROTOCOLS

    known: set[type[BaseModel]] = set()  # what several may hold is described once
    for kind, protocol in PROTOCOLS.choices().items():
        say("\n".join(described(protocol, kind, known=known)) + "\n")
