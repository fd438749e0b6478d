"""`desim plot`: pictures of a recorded run or sweep, or of a scenario, which is run first."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from desim.cli.options import AGAINST, LABEL, SEED, Parsed, limited, out_to, overriding
from desim.cli.output import echo, fail, making, of_option
from desim.cli.recorded import SOURCE, is_recorded, labels_of, results_of
from desim.cli.usage import options_given
from desim.config.file_names import PICTURE_SUFFIXES, files

if TYPE_CHECKING:
    from desim.simulation.run import Result
    from desim.study.results.result import SweepResult

OF_RUNS: Mapping[str, Sequence[str]] = {
    "trajectory": ["size"],
    "spacetime": ["begin", "end", "pursuers", "size"],
    "film": ["begin", "end", "speed", "fps", "size"],
    "perfetto": [],
}
"""The kinds of pictures of a run, with the options of each kind; the first kind is the default."""
OF_SWEEPS: Mapping[str, Sequence[str]] = {
    "means": ["y", "x", "by", "against", "labels", "xlabel", "ylabel", "size"],
    "phase": ["y", "xlabel", "ylabel", "size"],
    "scatter": ["y", "size"],
    "contour": ["y", "size"],
}
"""The kinds of pictures of a sweep, with the options of each kind; `SweepResult.usual_kind` is the default."""
OF_MEANS = ("x", "by", "against", "labels", "xlabel", "ylabel")
"""The options that select means if --kind is absent."""
SUFFIXES = {"film": [".gif", ".mp4"], "perfetto": [".json"]}
"""The file suffixes of the kinds of pictures that are not diagrams."""
NAMES = {"perfetto": "trace.perfetto"}
"""The names of files, without suffix, of the kinds whose files are not named after them."""


def _ids(text: str) -> tuple[int, ...]:
    """Return the ids in a text; raise ValueError if it has another form."""
    return tuple(map(int, text.split(",")))


@click.command()
@SOURCE
@click.option(
    "--kind",
    type=click.Choice([*OF_RUNS, *OF_SWEEPS]),
    help="Of a run: trajectory (default), the paths of all players; spacetime, a line per pursuer and an arrow per"
    " message; film, a GIF or an MP4; perfetto, a timeline for https://ui.perfetto.dev. Of a sweep: means (default), a"
    " metric over a key; phase, a heat map of a metric over two keys; scatter (default of a design), a metric at each"
    " point over each key; contour, bands of a metric over two keys.",
)
@out_to(
    "Output file; its suffix sets the format: .svg, .png or .pdf for diagrams, .gif or .mp4 (the extra `film`) for"
    " films. Default: a file in DIR, or in the"
    " working directory for a FILE; diagrams as SVG and PNG. Names include the kind and the metric."
)
@click.option(
    "--size",
    metavar="WIDTH[xHEIGHT]",
    help="Size of a diagram in cm, mm or in, e.g. 8.5cm or 8.5cmx6cm; of a film also in px, e.g. 1920x1080px.",
)
@click.option("-y", "--y", metavar="METRIC", help="Of a sweep: the metric on the ordinate; default: active_time.")
@click.option("-x", "--x", metavar="KEY", help="The key on the abscissa; default: the first with several numbers.")
@click.option(
    "--by",
    multiple=True,
    metavar="KEY",
    help="Draw a line for each value of this key; can be repeated. The other keys make panels. Default: all keys but"
    " that of -x.",
)
@AGAINST
@LABEL
@click.option("--xlabel", metavar="TEXT", help="The label of the abscissa; between dollar signs, mathematics.")
@click.option("--ylabel", metavar="TEXT", help="The label of the ordinate.")
@click.option(
    "--from",
    "begin",
    type=click.FloatRange(min=0),
    help="Of a space-time diagram or a film: start of the window, s; default: the start of the run.",
)
@click.option(
    "--to",
    "end",
    type=click.FloatRange(min=0),
    help="End of the window, s; default: the end of the run, or earlier if a space-time diagram would show too many"
    " messages to be legible.",
)
@click.option(
    "--pursuers",
    type=Parsed("i,j,...", _ids, "pursuer ids separated by commas, e.g. 0,3,17"),
    help="Ids of the pursuers of a space-time diagram, from top to bottom; default: all, or the six with the most"
    " changes of action in a team of more than ten.",
)
@click.option(
    "--speed",
    type=click.FloatRange(min=0, min_open=True),
    default=1.0,
    show_default=True,
    help="Simulated seconds per second of a film.",
)
@click.option("--fps", type=click.IntRange(1, 50), default=20, show_default=True, help="Frames per second of a film.")
@SEED
@limited
@overriding
def plot(
    source: Path,
    kind: str | None,
    out: Path | None,
    seed: int | None,
    overrides: tuple[str, ...],
    **options: Any,
) -> None:
    """Draw a run or a sweep: a DIR written by `desim run -o DIR` or `desim sweep -o DIR`, or a scenario FILE.

    A scenario FILE is run first, once. In Python, the method `plot` of a result draws the same diagrams; films and
    Perfetto traces are in `desim.view`.
    """
    if not is_recorded(source):
        if kind in OF_SWEEPS:
            fail(f"--kind {kind} draws a sweep, which {source} is not: make one with `desim sweep {source} -o DIR`")
        kind = kind or next(iter(OF_RUNS))
    if kind is not None:  # `_draw` calls both functions, too; here they refuse a wrong option before the run
        _check_options(kind)
        picture_paths(source, out, kind, "")
    with making("picture"):
        result = results_of(source, seed, overrides)
        _draw(result, source, kind, out, options)


def _draw(
    result: "Result | SweepResult", source: Path, kind: str | None, out: Path | None, options: dict[str, Any]
) -> None:
    """Draw a result, and write the files; end the program if the kind of picture does not fit the result.

    Raises:
        ValueError: if the result lacks the data for the picture.
    """
    from desim.simulation.run import Result

    kinds = OF_RUNS if isinstance(result, Result) else OF_SWEEPS
    if kind is not None and kind not in kinds:
        noun, other = ("run", "sweep") if kinds is OF_RUNS else ("sweep", "run")
        fail(f"--kind {kind} draws a {other}, and {source} is a {noun}: choose {' or '.join(kinds)}")
    selects_means = bool(options_given(OF_MEANS))  # means are the first kind of a sweep
    default = next(iter(kinds)) if isinstance(result, Result) or selects_means else result.usual_kind
    kind = kind or default
    _check_options(kind)
    chosen_options = {name: options[name] for name in kinds[kind] if options[name] not in (None, ())}
    if isinstance(result, Result):
        _draw_run(result, kind, picture_paths(source, out, kind, NAMES.get(kind, kind)), chosen_options)
    else:
        _draw_sweep(result, kind, source, out, chosen_options)


def _draw_run(result: "Result", kind: str, paths: Sequence[Path], options: dict[str, Any]) -> None:
    from desim.analysis.trace_index import trace_index

    indexed = trace_index(result)

    def make() -> None:
        if kind == "film":
            from desim.view.pictures.animation import animate

            animate(indexed, paths[0], **options)
        elif kind == "perfetto":
            from desim.view.formats.perfetto import write

            write(indexed, paths[0])
        else:
            from desim.analysis.drawing.plots import save
            from desim.view.pictures.run_figure import plot

            figure = plot(indexed, kind, **options)  # type: ignore[arg-type]  # the option is one of its kinds
            for path in paths:
                save(figure, path, dpi=200)

    write_picture(make, paths)


def _draw_sweep(result: "SweepResult", kind: str, source: Path, out: Path | None, options: dict[str, Any]) -> None:
    from desim.analysis.drawing.plots import save
    from desim.study.results.figures import file_name
    from desim.study.results.tables import notes

    options_of_keys = {"x": [options["x"]] if "x" in options else [], "by": options.get("by", [])}
    for name, keys in options_of_keys.items():
        for key in keys:
            with of_option(name, key):
                result.values(key)  # raises an error if the sweep has no such key
    if "against" in options:
        options["against"] = dict(options["against"])
        with of_option("against", " ".join(f"{key}={value}" for key, value in options["against"].items())):
            result.references(options["against"])
    if "labels" in options:
        options["labels"] = labels_of(result, options["labels"])
    figure = result.plot(kind=kind, **options)  # type: ignore[arg-type]  # the option is one of its kinds
    name = file_name(kind, options.get("y"), options.get("against"))
    paths = picture_paths(source, out, kind, name)
    write_picture(lambda: [save(figure, path, dpi=200) for path in paths], paths)
    for note in notes(result, [options.get("y", "active_time")]):  # what the picture cannot show
        if note != result.start_rule:
            echo(note, err=True)


def _check_options(kind: str) -> None:
    """Raise a usage error if the command line has an option that this kind of picture lacks."""
    options_of_kinds = {**OF_RUNS, **OF_SWEEPS}
    names = {name: None for options in options_of_kinds.values() for name in options}
    for name, option in options_given(names).items():
        if name not in options_of_kinds[kind]:
            fitting = " and ".join(kind_name for kind_name, options in options_of_kinds.items() if name in options)
            raise click.UsageError(f"{option} is an option of {fitting}; this picture is of the kind {kind}")


def picture_paths(source: Path, out: Path | None, kind: str, name: str) -> Sequence[Path]:
    """Return the paths of a picture; by default in the folder of the results or, for a scenario, the working directory.

    `name` is the name of the files by default, without suffix. End the program if the suffix of `out` is wrong.
    """
    allowed = SUFFIXES.get(kind, PICTURE_SUFFIXES)
    default = allowed[:1] if kind == "film" else allowed[:2]  # a GIF; of a diagram, SVG and PNG
    if out is None:
        if not is_recorded(source):
            return [Path(f"{source.stem}.{name}{suffix}") for suffix in default]
        folder = source if source.is_dir() else source.parent
        return [folder / f"{name}{suffix}" for suffix in default]
    try:
        return files(out, allowed, default)
    except ValueError as error:
        fail(f"--out {error}")


def write_picture(make: Callable[[], object], paths: Sequence[Path], *, err: bool = False) -> None:
    """Write the files of a picture and print their paths and sizes; end the program if they cannot be written.

    Args:
        make: writes the files.
        paths: the paths of the files; they have the same folder, which is created if missing.
        err: whether to print to stderr.
    """
    try:
        replaced = [path for path in paths if path.exists()]
        paths[0].parent.mkdir(parents=True, exist_ok=True)
        make()
    except OSError as error:
        fail(f"{error.filename or paths[0]}: cannot be written: {error.strerror}")
    for path in paths:
        note = " (replaced)" if path in replaced else ""
        echo(f"wrote {path}: {path.stat().st_size / 1000:,.0f} kB{note}", err=err)
