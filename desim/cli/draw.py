"""`desim draw`: pictures of a recorded run, or of a scenario that is run for them."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from desim.cli.options import ALLOW_IMPORT, SEED, SET, echo, fail
from desim.cli.recorded import SOURCE, result_of
from desim.config.file_names import PICTURE_SUFFIXES, files

if TYPE_CHECKING:
    from desim.simulation.run import Result


@click.group()
def draw() -> None:
    """Draw a run: a DIR written by `desim run -o DIR`, or a scenario FILE, which is run first."""


def _load_run(source: Path, seed: int | None, overrides: tuple[str, ...]) -> "Result":
    """Return the run in a folder or of a scenario file, with an index that speeds up repeated reads."""
    from desim.analysis.trace_index import trace_index

    return trace_index(result_of(source, seed, overrides))


def _output_files(source: Path, out: Path | None, name: str, kinds: Sequence[str], usual: Sequence[str]) -> list[Path]:
    """Return the files of a picture: those of `out`, by default in the folder of the run or the working directory.

    End the program if the suffix of `out` is wrong.
    """
    if out is None:
        return [source / f"{name}{each}" if source.is_dir() else Path(f"{source.stem}.{name}{each}") for each in usual]
    try:
        return files(out, kinds, usual)
    except ValueError as error:
        fail(f"--out {error}")


def _write_files(make: Callable[[], Any], *paths: Path) -> None:
    """Write the files of a picture and print their paths and sizes; end the program if that fails."""
    try:
        paths[0].parent.mkdir(parents=True, exist_ok=True)
        make()
    except ModuleNotFoundError as error:
        fail(f"a picture needs {error.name}: pip install 'pursuit-desim[plot]'")
    except ValueError as error:
        fail(str(error))
    except OSError as error:
        fail(f"--out {paths[0]}: cannot be written: {error.strerror}")
    for path in paths:
        echo(f"{path}: {path.stat().st_size / 1000:,.0f} kB")


OUT = click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    help="Output file; its suffix sets the format; default: in DIR, or in the working directory for a FILE.",
)
FROM = click.option(
    "--from", "begin", type=click.FloatRange(min=0), help="Start of the window, s; default: the start of the run."
)


class _Pursuers(click.ParamType[tuple[int, ...]]):
    """Numbers of pursuers: 0,3,17."""

    name = "i,j,..."

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        try:
            return tuple(int(each) for each in str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} should be numbers separated by commas, e.g. 0,3,17", param, ctx)


@draw.command()
@SOURCE
@OUT
@FROM
@click.option(
    "--to",
    "end",
    type=click.FloatRange(min=0),
    help="End of the window, s; default: the latest end with which messages are easy to tell apart.",
)
@click.option(
    "--pursuers",
    type=_Pursuers(),
    help="Pursuers from top to bottom; default: all, or the six with the most changes of action in a team of more than"
    " ten.",
)
@click.option("--width", type=click.FloatRange(min=4, max=200), default=17.0, show_default=True, help="Width, cm.")
@SEED
@ALLOW_IMPORT
@SET
def spacetime(
    source: Path,
    out: Path | None,
    begin: float | None,
    end: float | None,
    pursuers: tuple[int, ...] | None,
    width: float,
    seed: int | None,
    overrides: tuple[str, ...],
) -> None:
    """Draw a line per pursuer and an arrow per message: SVG and PNG, or the format of --out (SVG, PNG or PDF)."""
    paths = _output_files(source, out, "spacetime", PICTURE_SUFFIXES, PICTURE_SUFFIXES[:2])

    def make() -> None:
        from desim.analysis.plots import save
        from desim.view.spacetime import spacetime as drawn

        figure = drawn(_load_run(source, seed, overrides), begin, end, pursuers, width)
        for path in paths:
            save(figure, path, dpi=200)

    _write_files(make, *paths)


@draw.command()
@SOURCE
@OUT
@SEED
@ALLOW_IMPORT
@SET
def perfetto(source: Path, out: Path | None, seed: int | None, overrides: tuple[str, ...]) -> None:
    """Write a timeline for https://ui.perfetto.dev, which displays it without uploading it."""
    (path,) = _output_files(source, out, "trace.perfetto", [".json"], [".json"])

    def make() -> None:
        from desim.view.perfetto import write

        write(_load_run(source, seed, overrides), path)

    _write_files(make, path)


@draw.command()
@SOURCE
@OUT
@FROM
@click.option("--to", "end", type=click.FloatRange(min=0), help="End of the window, s; default: the end of the run.")
@click.option(
    "--speed",
    type=click.FloatRange(min=0, min_open=True),
    default=1.0,
    show_default=True,
    help="Simulated seconds per second of the animation.",
)
@click.option("--fps", type=click.IntRange(1, 50), default=20, show_default=True, help="Frames per second.")
@SEED
@ALLOW_IMPORT
@SET
def gif(
    source: Path,
    out: Path | None,
    begin: float | None,
    end: float | None,
    speed: float,
    fps: int,
    seed: int | None,
    overrides: tuple[str, ...],
) -> None:
    """Animate the pursuit in plan view as a GIF, for slides."""
    (path,) = _output_files(source, out, "pursuit", [".gif"], [".gif"])

    def make() -> None:
        from desim.view.animation import animate

        animate(_load_run(source, seed, overrides), path, begin=begin or 0.0, end=end, speed=speed, fps=fps)

    _write_files(make, path)
