"""Runs in the formats of other programs. An exporter writes one format; the suffix of the file chooses it.

An exporter is a function of the result of a run and a path, or a frozen model that is called like one. The attributes
in `ExporterTraits` give it a suffix. Built-in exporters, those of other distributions (entry points of the group
`desim.exporters`) and those that a user names as "module:Name" are chosen and called alike.
"""

from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

from pydantic import Field, ValidationError

from desim.config.answers import wrong_answer
from desim.config.arguments import Argument, naming_arguments, run_argument, value_text
from desim.config.choice import OneOf
from desim.config.error_texts import text_of
from desim.config.extras import missing
from desim.config.fresh import fresh_copy
from desim.config.model import Flag, Value
from desim.config.python_numbers import as_python
from desim.config.suggestion import did_you_mean
from desim.config.traits import Traits, kind_of
from desim.config.whole_files import replacing
from desim.results.run_folder import StreamedResult
from desim.simulation.run import Result
from desim.view.formats.foxglove import Mcap
from desim.view.formats.pcapng import Pcapng
from desim.view.formats.perfetto import Perfetto
from desim.view.formats.trace_table import Csv, Parquet

ARGUMENTS = ("result", "file")
"""The arguments of an exporter."""


class ExporterTraits(Traits):
    """The optional attributes of an exporter, in addition to `__call__(result, file)`.

    The call writes the file, and returns the number of items in it, or None.
    """

    suffix: Annotated[str, Field(pattern=r"^\.[^/]+$")] | None = None
    """The end of the names of its files, in lower case, for instance ".edges"; None: any."""
    items: Annotated[str, Field(min_length=1)] = "items"
    """The noun of the counted items in the plural, such as "rows"; one item is "1 row"."""
    streams: Flag = False
    """Whether it reads `result.trace` once, in order, and no more than it has to. A recorded trace is then read from
    its file event by event, and may be longer than the memory; without a run.json, `result.scenario` is None."""
    requires: tuple[str, str] | None = None
    """A package that it imports, and the extra of desim that installs it; the error of a failed import names both."""


EXPORTERS = OneOf(Csv, Parquet, Pcapng, Mcap, Perfetto, group="desim.exporters", takes=ARGUMENTS, traits=ExporterTraits)


class _Chosen(Value):
    """An exporter, as a table, a name or a callable object chooses it."""

    exporter: Annotated[Any, EXPORTERS]


def suffixes() -> dict[str, str]:
    """Return the suffixes of all exporters that have a kind, and the kind of each."""
    pairs = ((kind, ExporterTraits.of(model).suffix) for kind, model in EXPORTERS.choices().items())
    return {suffix: kind for kind, suffix in pairs if suffix is not None}


FILE = Argument("the path of a file", (str, PathLike), MappingProxyType({}))
"""Checks the argument `file` of `export`."""


def exporter_for(file: Path, exporter: Any = None, *, allow_import: bool = False, **parameters: Any) -> Any:
    """Return the exporter that writes a file.

    Args:
        file: the path of the file.
        exporter: an exporter, its kind, "module:Name" or a table with a kind; None: the suffix of the file chooses it.
        allow_import: whether "module:Name" may import a module that is not an entry point.
        **parameters: the parameters of an exporter that is given by its kind or by the suffix.

    Raises:
        ValueError: if the file has the wrong suffix, there is no such exporter, or it has no such parameters.
    """
    if exporter is None:
        by_suffix = suffixes()
        suffix = max((suffix for suffix in by_suffix if file.name.lower().endswith(suffix)), key=len, default=None)
        if suffix is None:
            *other_suffixes, last = by_suffix
            raise ValueError(f"{file}: should end in {', '.join(other_suffixes)} or {last}")
        exporter = by_suffix[suffix]
    if isinstance(exporter, str):
        exporter = {"kind": exporter, **parameters}
    try:
        context = {"allow_import": allow_import, "folder": Path.cwd()}
        chosen: Any = _Chosen.model_validate({"exporter": exporter}, context=context).exporter
    except ValidationError as error:
        raise ValueError(_reason(error, exporter)) from error
    expected_suffix = ExporterTraits.of(chosen).suffix
    if expected_suffix is not None and not file.name.lower().endswith(expected_suffix):
        raise ValueError(f"{file}: should end in {expected_suffix} for the exporter {kind_of(chosen)}")
    return chosen


def _reason(error: ValidationError, exporter: Any) -> str:
    """Return the text of the first error in the choice of an exporter."""
    first = error.errors()[0]
    name = exporter["kind"] if isinstance(exporter, dict) and "kind" in exporter else value_text(exporter)
    key = ".".join(str(part) for part in first["loc"][1:] if part != name)  # `loc` is "exporter", the kind, the key
    if first["type"] == "union_tag_invalid":
        kinds = list(EXPORTERS.choices())
        return f"there is no exporter {name}{did_you_mean(name, kinds)}; there are {', '.join(kinds)} and module:Name"
    if first["type"] == "extra_forbidden":
        return f"the exporter {name} has no parameter {key!r}"
    return f"exporter {name}: {f'{key}: ' if key else ''}{text_of(first)}"


@naming_arguments
def export(result: Result | StreamedResult, file: str | PathLike[str], exporter: Any = None) -> int | None:
    """Write a run to a file, and return the number of its rows, packets, messages or other items.

    Use it to read a run in another program; `desim.open` reads a run that desim has written to a folder. The file is
    written under another name, and replaces an older file at the end.

    Args:
        result: the result of the run, or of `desim.results.run_folder.streamed(folder)`.
        file: the path of the file; without an `exporter`, its suffix chooses one: see `suffixes`.
        exporter: an exporter, its kind or "module:Name", for instance `Csv(events=("Decided",))`.

    Raises:
        TypeError: if `result` is not the result of a run; the message says what to write instead.
        ValueError: if the file has another suffix, the messages that a .pcapng needs were not recorded, or an exporter
            returns no number of items; an older file then stays.
        ImportError: if a package that the format needs is not installed.
        OSError: if the file cannot be written.
    """
    FILE.check(file, "export")
    file = Path(file)
    if not hasattr(result, "trace"):  # any object with a trace may be exported
        run_argument(Result, StreamedResult).check(result, "export")
    chosen = exporter_for(file, exporter, allow_import=True)
    required = ExporterTraits.of(chosen).requires
    with replacing(file) as part, fresh_copy({"exporter": chosen}) as copied:  # an exporter may have state
        if part != file:  # not a device or a pipe
            part.unlink()  # so that an exporter that writes nothing is noticed
        try:
            count = copied["exporter"](result, part)
        except ModuleNotFoundError as error:
            if required is None or (error.name or "").partition(".")[0] != required[0]:
                raise
            raise ImportError(missing(*required)) from None
        if not part.exists():
            raise ValueError(f"the exporter {kind_of(chosen)} should write the file that it is given, {part}")
        if not is_count(count):
            raise wrong_answer("an exporter should return the number of items in the file, or None", count, chosen)
    return None if count is None else int(count)


def is_count(answer: Any) -> bool:
    """Return whether an exporter may return this: a number of items, of any kind of integer, or None."""
    count = as_python(answer)
    return count is None or (type(count) is int and count >= 0)
