"""Information without a run: `desim check`, `schema`, `keys`, `metrics`, `protocols`."""

import json
import re
from pathlib import Path

import click

from desim.cli import completion
from desim.cli.options import ALLOW_IMPORT, FILE, limited, out_to, overriding
from desim.cli.output import echo, fail, making
from desim.cli.plot import picture_paths, write_picture
from desim.cli.sources import protocol_of, source_of
from desim.cli.usage import is_file


@click.command()
@FILE
@click.option("--plot", "draws", is_flag=True, help="Also draw the measured links: latency, loss or signal over time.")
@out_to("Output file of --plot: .svg, .png or .pdf. Default: FILE.links as SVG and PNG in the working directory.")
@limited
@overriding
def check(file: Path, draws: bool, out: Path | None, overrides: tuple[str, ...]) -> None:
    """Validate a scenario, and its grid if it has one, and print it with every default filled in."""
    from desim.scenario.toml import dump

    if out is not None and not draws:
        raise click.UsageError("--out is an option of --plot")
    source, scenario = source_of(file, overrides)
    if scenario.sweep.grid:
        from desim.scenario.overrides import ScenarioError
        from desim.study.plan.configurations import check_grid

        try:
            check_grid(source)
        except ScenarioError as error:
            fail(str(error))
    if draws:
        paths = picture_paths(file, out, "trajectory", "links")
        with making("picture"):
            from desim.analysis.drawing.plots import save
            from desim.view.pictures.link_traces import link_traces

            figure = link_traces(scenario)
            write_picture(lambda: [save(figure, path, dpi=200) for path in paths], paths, err=True)
    echo(dump(scenario), end="")
    echo(f"{file} is valid", err=True)


@click.command()
def schema() -> None:
    """Print the JSON schema of scenario files, for editors."""
    from desim.config.json_numbers import to_json
    from desim.scenario.scenario import Scenario
    from desim.scenario.toml import BASE_DESCRIPTION
    from desim.scenario.toml_errors import BASE

    json_schema = Scenario.model_json_schema()
    json_schema["properties"][BASE] = {"type": "string", "title": "Base", "description": BASE_DESCRIPTION}
    echo(json.dumps(to_json(json_schema), indent=2))


@click.command()
@click.argument("key", required=False)
def keys(key: str | None) -> None:
    """List keys of scenario files with defaults, units and kinds: all, or those of a KEY like network.latency.gamma."""
    from desim.cli.description import KindMissingError, described, described_at
    from desim.scenario.scenario import Scenario
    from desim.scenario.toml import BASE_DESCRIPTION
    from desim.scenario.toml_errors import BASE

    base = f"{BASE}: {BASE_DESCRIPTION}"
    if key == BASE:
        echo(base)
        return
    try:
        if key is None:
            title, *lines = described(Scenario, "scenario")
            echo("\n".join([title, f"    {base}", *lines]))
        else:
            place = re.sub(r"\.\d+\b", "", key).split(".")  # fault.0.start is described as fault.start
            echo("\n".join(described_at(place, Scenario)))
    except ValueError as error:
        if is_file(str(key)):
            fail(
                f"{key}: is a file: `desim check {key}` prints it with all keys; a KEY is network.latency for instance"
            )
        if isinstance(error, KindMissingError):
            fail(str(error))
        table, _, last = str(key).rpartition(".")
        similar_keys = _similar_keys(last)
        similar_keys.sort(key=lambda dotted: not dotted.startswith(f"{table}."))  # those in the same table first
        hint = f"; did you mean {' or '.join(similar_keys[:3])}?" if similar_keys else ""
        fail(f"{error}{hint}")


def _similar_keys(word: str) -> list[str]:
    """Return the outermost keys of scenarios whose last part is a word or its synonym, or else is similar."""
    from desim.config.key_index import homes_of
    from desim.config.key_suggestions import WORDS_FOR_KEYS, spelled_as_key
    from desim.scenario.scenario import Scenario

    if word == "kind":  # selects a model, and is not described: the error lists the kinds
        return []
    word = spelled_as_key(word)
    matches = homes_of(word, Scenario)
    if word in WORDS_FOR_KEYS and all(match.place[-1] != word for match in matches):
        matches = homes_of(WORDS_FOR_KEYS[word], Scenario)
    return list(dict.fromkeys(match.dotted for match in matches))


@click.command()
@click.argument("only", metavar="[NAME]", required=False)
def metrics(only: str | None) -> None:
    """List the metrics, or the one called NAME, with units and whether more is better or worse."""
    from desim.analysis.metrics import METRICS, Summary, with_unit
    from desim.config.field_docs import docs_of
    from desim.config.suggestion import did_you_mean
    from desim.scenario.named_metrics import installed_metrics

    docs, installed = docs_of(Summary), installed_metrics()
    if only is not None and only not in {*METRICS, *installed}:
        close = did_you_mean(only, [*METRICS, *installed])
        fail(f"there is no metric {only!r}{close}; `desim metrics` lists them, and `desim keys` the keys of scenarios")
    for name, metric in METRICS.items():
        if only not in {None, name}:
            continue
        first_line = (metric.of.__doc__ or "").partition("\n")[0]
        text = docs.get(name) or first_line.removeprefix("Return ") or metric.note
        sign = f" More is {metric.more_is}." if metric.more_is else ""
        text = f": {text[:1].upper()}{text[1:].removesuffix('.')}.{sign}" if isinstance(text, str) else ""
        echo(f"{with_unit(name, metric.unit)}{text}")
    for name, point in installed.items():
        if only in {None, name}:
            echo(f"{name}: {point.value}")


@click.command()
@click.argument("only", metavar="[KIND]", required=False, shell_complete=completion.protocols)
@ALLOW_IMPORT
def protocols(only: str | None) -> None:
    """List the installed protocols with parameters; for a KIND (or module:name), print its parameters and traits."""
    from pydantic import BaseModel

    from desim.cli.description import described, described_traits, summary
    from desim.config.key_suggestions import suggestion
    from desim.config.named_code import definition_of
    from desim.scenario.scenario import PROTOCOLS

    choices = PROTOCOLS.choices()
    if only is None:
        described_models: set[type[BaseModel]] = set()  # models shared by several protocols are described once
        for kind, model in choices.items():
            echo("\n".join(described(model, kind, described_models=described_models)) + "\n")
        return
    if only not in choices and ":" not in only:
        allowed = f"allowed: {', '.join(choices)}, and module:name"
        fail(f"there is no protocol {only!r}{suggestion(only, [*choices])}; {allowed}")
    protocol = choices[only].model_construct() if only in choices else protocol_of(only, "desim protocols")
    is_model = isinstance(protocol, BaseModel)
    lines = described(type(protocol), only) if is_model else [f"{only}: {summary(definition_of(protocol))}"]
    echo("\n".join([*lines, *described_traits(PROTOCOLS.traits.of(protocol))]) + "\n")
