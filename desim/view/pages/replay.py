"""The replay of a run: one self-contained HTML page; equal runs give equal bytes."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from os import PathLike
from pathlib import Path

from desim.analysis.drawing import palette
from desim.analysis.trace_index import lacks_messages, messages, positions_known, trace_index
from desim.config.arguments import naming_arguments, run_argument
from desim.config.escaping import escaped
from desim.config.extras import naming_extras
from desim.config.whole_files import write_whole
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result
from desim.view.pages.headline import about, conditions, run_name
from desim.view.pages.replay_columns import ReplayData
from desim.view.pages.replay_data import replay_data
from desim.view.pages.replay_plane import is_falling

LARGE_TEAM = 1000
"""The number of pursuers from which on a replay is announced as large."""
SAMPLES = 0.05
"""Time between samples of positions, s, in a run for a replay if the scenario does not record positions."""
SCRIPTS = ("run", "walls", "state", "plane", "beliefs", "axis", "drag", "page")
"""The parts of the script, in one scope; while the page loads, each uses only the parts before it."""
HEIGHT = 760
"""The height of a replay in a notebook, in pixels of CSS."""


@dataclass(frozen=True, repr=False)
class Replay:
    """A page that plays a run: `desim.replay(result)` at the end of a cell shows it in a notebook."""

    page: str
    """The page as HTML; see `replay_page`."""
    name: str
    """The name of the run."""

    def write(self, path: str | Path) -> Path:
        """Write the page to a file, and return its path.

        Raises:
            OSError: if the file cannot be written.
        """
        write_whole(Path(path), self.page.encode())
        return Path(path)

    def __repr__(self) -> str:
        return f"<Replay of {escaped(self.name)}>"

    def _repr_html_(self) -> str:
        """Return a frame with the page, whose script has no access to the notebook."""
        look = f"width: 100%; height: {HEIGHT}px; border: 0"
        return f'<iframe srcdoc="{escape(self.page)}" sandbox="allow-scripts allow-downloads" style="{look}"></iframe>'


@naming_extras()
@naming_arguments
def replay(result: Result, ghost: Result | None = None) -> Replay:
    """Create the replay of a run, a page to show in a notebook or to save with `write`; needs jinja2 (extra `plot`).

    Args:
        result: the run.
        ghost: another run, drawn faint in the same plane, for example with the same seed and another latency; None = no
            other run.

    Raises:
        TypeError: if `result` or `ghost` is not the result of a run; the message says what to write instead.
        ModuleNotFoundError: if jinja2 is not installed; the message names the extra.
    """
    argument = run_argument(Result)
    file: object = ghost
    if isinstance(file, str | PathLike) and Path(file).suffix:
        raise TypeError(f"a ghost is another run, not a file: replay(result).write({str(file)!r}) writes the page")
    for value in (result,) if ghost is None else (result, ghost):
        argument.check(value, "replay")
    return Replay(replay_page(result, ghost), run_name(result))


def replay_page(result: Result, ghost: Result | None = None, *, on_part: Callable[[], object] = lambda: None) -> str:
    """Return a self-contained HTML page that plays a run; needs jinja2 (the extra `plot`); see `replay`.

    Args:
        result: the run.
        ghost: another run to compare it with, perhaps with other players or another duration; None = no other run. The
            players of the ghost and their trails are drawn faint in the same plane, and its number of active pursuers
            is a dashed line on the time axis.
        on_part: called after each part of the work, for a progress bar; see `desim.view.pages.replay_data.PARTS`.
    """
    from jinja2 import Environment

    result, ghost = trace_index(result), ghost and trace_index(ghost)
    page = Environment(autoescape=True, keep_trailing_newline=True).from_string(_file("replay.html"))
    data = replay_data(result, ghost, on_part)
    text = page.render(
        name=result.scenario.name,
        about=about(result),
        conditions=conditions(result.scenario),
        palette=palette,
        warnings=list(missing_recordings(result, ghost)),
        run=data,
        radio_shadows=_has_shadows(data),
        sight_walls=any("sight" in wall.blocks for wall in result.scenario.wall),
        mixed_walls=any(not {"sight", "motion"} <= {*wall.blocks} for wall in result.scenario.wall),
        style=_file("replay.css"),
        script="\n".join(_file(f"replay_{part}.js") for part in SCRIPTS),
    )
    on_part()
    return text


def _has_shadows(data: ReplayData) -> bool:
    """Return whether the page can draw shadows of radio: reception is known, and walls shorten or block it."""
    reception, factors = data["reception"], [wall["factor"] for wall in data["walls"] or ()]
    is_shortened = reception["radius"] is not None and any(factor != 1.0 for factor in factors)
    return reception["known"] and (is_shortened or None in factors)


def _file(name: str) -> str:
    return files("desim.view.pages").joinpath(name).read_text(encoding="utf-8")


def with_recordings(scenario: Scenario) -> Scenario:
    """Return a copy of a scenario that records what a replay needs: messages and positions.

    If the scenario records positions already, the time between samples is kept; otherwise it is `SAMPLES`. Estimates
    are recorded if they have covariances.
    """
    record, has_covariances = scenario.record, scenario.sensing.has_covariances
    update = {"messages": True, "trajectory": record.trajectory or SAMPLES, "estimates": has_covariances}
    return scenario.model_copy(update={"record": record.model_copy(update=update)})


def size_warning(scenario: Scenario) -> str | None:
    """Return a warning if the run of a scenario, and its replay, are likely to be very large; None if not."""
    if (count := scenario.team.count) < LARGE_TEAM:
        return None
    return (
        f"{count:,} pursuers: each announcement to all is {count - 1:,} messages. The run and its page may take "
        "minutes and tens of megabytes; a smaller team.count, a shorter horizon or a finite network.range reduce them"
    )


def missing_recordings(result: Result, ghost: Result | None = None) -> Iterator[str]:
    """Yield a warning for each part of the replay of a run, and of its ghost, that cannot be shown."""
    if not positions_known(result):
        yield (
            "Positions were not recorded: players and links are shown at the initial positions throughout. Set "
            "record.trajectory to a time greater than 0 s."
        )
    if not is_falling(result.scenario.network):
        yield "Links are not shown: the reception probability does not decrease monotonically with the distance."
    if lacks_messages(result):
        yield (
            f"Messages were not recorded: neither the {messages(result).sent:,} messages sent nor the beliefs are "
            "shown. Set record.messages = true."
        )
    if ghost is not None and not positions_known(ghost):
        yield "Positions of the other run were not recorded: its players are shown at the initial positions throughout."
