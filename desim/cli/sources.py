"""The scenario of a command: a file, changed by options such as --set. An invalid scenario ends the program."""

from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from desim.cli.options import is_import_allowed
from desim.cli.output import echo, fail
from desim.cli.usage import is_file, metric_option
from desim.config.file_names import STORE, TRACE

if TYPE_CHECKING:
    from desim.scenario.overrides import Source
    from desim.scenario.scenario import Scenario


def source_of(
    file: Path,
    overrides: tuple[str, ...],
    metrics: tuple[str, ...] = (),
    grid: tuple[str, ...] = (),
    design: str | None = None,
    folder: Path | None = None,
) -> "tuple[Source, Scenario]":
    """Return the tables of a scenario file with the values of --metric, --grid and --design, and the scenario of them.

    Modules and files that the scenario names are looked up in `folder`; None: the folder of `file`. Print warnings, and
    end the program if the scenario is invalid; see `valid`.
    """
    from desim.scenario.overrides import ScenarioError
    from desim.scenario.toml import looked_up_in, read_source

    try:
        source = read_source(file, overrides, allow_import=is_import_allowed())
        source = source if folder is None else looked_up_in(source, folder)
        for setting in grid:
            source.vary(setting)
        if design is not None:
            _set_design(source, design)
        add_metrics(source, metrics)
    except ScenarioError as error:
        fail(_of_results(file) or str(error))
    except OSError as error:
        fail(f"{file}: cannot be read: {error.strerror}{_instead_of(file)}")
    return source, valid(source)


def added_metrics(metric: str) -> tuple[str, ...]:
    """Return the metric of -y if it is added to those of the scenario: an installed one or a MODULE:FUNCTION.

    Any other metric is built in, or the scenario file names it already.
    """
    from desim.scenario.named_metrics import installed_metrics

    return (metric,) if ":" in metric or metric in installed_metrics() else ()


def _set_design(source: "Source", text: str) -> None:
    """Set the method and the size of `sweep.design`; the other keys of the design remain.

    Raises:
        ScenarioError: if the text is not METHOD:SIZE.
    """
    from desim.scenario.overrides import ScenarioError
    from desim.scenario.sweep_table import design_of

    present = source.at(["sweep", "design"])
    try:
        table = design_of(text)
    except ValueError as error:
        raise ScenarioError(f"--design {text}: {error}") from None
    source.set("sweep.design", (present if isinstance(present, dict) else {}) | table, f"--design {text}")


def _instead_of(file: Path) -> str:
    """Return what to give instead of a scenario file that cannot be read, as the end of a message; "" if unknown."""
    from desim.config.suggestion import did_you_mean
    from desim.scenario.examples import examples

    if file.is_dir():
        scenarios = sorted(file.glob("*.toml"))
        return f"; a file in it is {scenarios[0]}" if scenarios else "; a scenario is one file, NAME.toml"
    with_suffix = file.with_suffix(".toml")
    if with_suffix != file and is_file(with_suffix):
        return f", did you mean {with_suffix}?"
    if file.stem in examples() and file.parent == Path():
        return f"; an example: `desim examples {file.stem}` writes {file.stem}.toml, which then can be run"
    beside = [path.name for path in file.parent.glob("*.toml")] if file.parent.is_dir() else []
    if file.parent.is_dir() and file.suffix != ".toml":
        # A name without a suffix is taken for that of a folder, and one with a suffix for that of a file.
        beside += [path.name for path in file.parent.iterdir() if path.is_dir() != bool(file.suffix)]
    return did_you_mean(file.name, beside) or did_you_mean(file.stem, beside)


def _of_results(file: Path) -> str:
    """Return the error about a file that belongs to recorded results; "" if it does not."""
    folder = file.parent
    if file.suffix == ".toml" or not any((folder / name).exists() for name in (TRACE, STORE)):
        return ""
    scenario = folder / "scenario.toml"
    is_record = file.name == "run.json" and (folder / TRACE).exists()  # `desim run --from` repeats no sweeps
    how = f"run --from {quote(str(file))}` repeats the run" if is_record else f"plot {quote(str(folder))}` draws them"
    beside = f"; their scenario is {scenario}" if scenario.exists() else ""
    return f"{file}: belongs to the results in the folder {folder}, and is no scenario{beside}; `desim {how}"


def add_metrics(source: "Source", metrics: tuple[str, ...]) -> None:
    """Add to `record.metrics` of a scenario the metrics of --metric that are not built in, nor in it already.

    End the program if a metric does not exist or is not numeric. A MODULE:FUNCTION is imported and checked later, when
    the scenario is validated.
    """
    if not metrics:
        return
    from desim.analysis.measuring import check_numeric
    from desim.analysis.metrics import METRICS
    from desim.scenario.named_metrics import installed_metrics

    present = source.at(["record", "metrics"])
    present = [] if present is None else present
    texts = [text for text in present if isinstance(text, str)] if isinstance(present, list) else []
    of_file = {text.rpartition(":")[2] for text in texts}
    for metric in metrics:
        try:
            if ":" not in metric:
                check_numeric(metric, [*installed_metrics(), *of_file])
        except ValueError as error:
            fail(f"{metric_option()} {metric}: {error}, and MODULE:FUNCTION")
    added = [name for name in metrics if name not in METRICS and name not in of_file]
    if added and isinstance(present, list) and isinstance(table := source.tables.setdefault("record", {}), dict):
        table["metrics"] = [*present, *added]
        for k, name in enumerate(added, len(present)):
            source.origins["record", "metrics", k] = f"{metric_option()} {name}"


def shown_metrics(scenario: "Scenario", metrics: tuple[str, ...], usual: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Return the names of the metrics to show, each once.

    They are the metrics of --metric or, without this option, `usual` and the metrics of the scenario.
    """
    names = tuple(dict.fromkeys(metric.rpartition(":")[2] for metric in metrics))
    return names or (*usual, *(metric.name for metric in scenario.record.metrics))


def valid(source: "Source") -> "Scenario":
    """Return the validated scenario of a source; print warnings, and end the program if it is invalid."""
    from desim.scenario.checks import warnings
    from desim.scenario.overrides import ScenarioError
    from desim.scenario.toml import validate

    try:
        scenario = validate(source)
    except ScenarioError as error:
        fail(str(error))
    if scenario.record.metrics:
        from desim.analysis.measuring import users_metrics

        for k in range(len(scenario.record.metrics)):  # one more each time, so that metric k has the error
            try:
                users_metrics(scenario.record.metrics[: k + 1])
            except ValueError as error:
                fail(f"{source.where(('record', 'metrics', k))}: record.metrics.{k}: {error}")
    for key, why in warnings(scenario):
        place = tuple(int(part) if part.isdigit() else part for part in key.split("."))
        echo(f"warning: {source.where(place)}: {key}: {why}", err=True)
    return scenario


def protocol_of(text: str, option: str) -> Any:
    """Return the protocol that an option names as KIND, MODULE:NAME, FILE.py:NAME, or { kind = ..., ... }.

    A module is an installed one, or lies in the working folder or in that of the file. End the program if the protocol
    is invalid, or is code and --allow-import is missing.
    """
    from desim.scenario.overrides import ScenarioError, Source
    from desim.scenario.scenario import Scenario
    from desim.scenario.toml import validate

    folder, name = Path(), text
    file, colon, attribute = text.rpartition(":")
    if colon and file.endswith(".py"):
        folder, name = Path(file).parent, f"{Path(file).stem}:{attribute}"
    source = Source(option, {}, Scenario, folder=folder, allow_import=is_import_allowed())
    try:
        source.override(f"protocol={name}", f"{option} {text}")
        return validate(source).protocol
    except ScenarioError as error:
        fail(str(error))
