"""The figures of a run: the paths of its players and its space-time diagram; needs matplotlib (the extra `plot`)."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from desim.config.arguments import naming_arguments, run_argument, value_text
from desim.config.extras import naming_extras
from desim.pursuit.core.events import Sampled
from desim.simulation.run import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from desim.analysis.drawing.plots import Axes, Style


@naming_extras()
@naming_arguments
def plot(
    result: Result,
    kind: Literal["trajectory", "spacetime"] = "trajectory",
    *,
    begin: float | None = None,
    end: float | None = None,
    pursuers: Sequence[int] | None = None,
    size: str | None = None,
    style: "Style" = None,
    ax: "Axes | None" = None,
) -> "Figure":
    """Draw a run and return the figure.

    The figure can be resized, `figure.set_size_inches(3.5, 2.5)`, and written with `figure.savefig(file)`. The figures
    of a sweep are those of `SweepResult.plot`.

    Args:
        result: the run.
        kind: trajectory: the paths of all players; spacetime: a line per pursuer and an arrow per message.
        begin: the start of the window of a space-time diagram, s; None = the start of the run.
        end: the end of the window, s; None = the end of the run, or earlier so that the messages stay legible.
        pursuers: the pursuers in a space-time diagram, from top to bottom; None = all, or in a large team the six with
            the most changes of action.
        size: the width and perhaps the height, such as "8.5cm" or "8.5cmx6cm"; None = the usual size of the kind.
        style: a style of matplotlib on top of that of desim: rcParams, or the name of a style.
        ax: the axes to draw on, for a figure of several panels; None = a figure of its own.

    Raises:
        TypeError: if `result` is not a run (the message says what to write), or `ax` is not one pair of axes.
        ModuleNotFoundError: if matplotlib is not installed; the message names the extra.
        ValueError: if positions (trajectory) or messages (spacetime) were not recorded, or an option is wrong.
    """
    run_argument(Result).check(result, "plot")
    from desim.analysis.drawing.trajectory import trajectory
    from desim.view.pictures.spacetime import spacetime

    if kind == "spacetime":
        return spacetime(result, begin, end, pursuers, size, style=style, ax=ax)
    if kind != "trajectory":
        raise ValueError(f"kind should be trajectory or spacetime, got {value_text(kind)}{_if_file(kind)}")
    if (begin, end, pursuers) != (None, None, None):
        raise ValueError("begin, end and pursuers are options of the kind spacetime")
    return trajectory(result, size, style=style, ax=ax)


def _if_file(kind: object) -> str:
    """Return the end of a message that says how a figure is written, if the name of a file was given as its kind."""
    is_file = isinstance(kind, str | PathLike) and Path(kind).suffix
    return f"; plot(result).savefig({str(kind)!r}) writes the figure" if is_file else ""


def html_picture(result: Result) -> str:
    """Return the paths as an HTML image; "" if positions were not recorded or matplotlib is missing."""
    if not result.trace.of(Sampled):
        return ""
    try:
        from desim.analysis.drawing.plots import html_image
    except ImportError:
        return ""
    return html_image(plot(result), "trajectories of the players")
