"""`desim break`: the search for what breaks a protocol."""

import json
import shlex
import sys
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from desim.cli.options import FILE, GRID, JOBS, JSON, PATH, SEED, TIMEOUT, out_to, overriding
from desim.cli.output import echo, fail, folder_for, make_folder, storing, write
from desim.cli.sources import protocol_of, source_of
from desim.cli.usage import options_given, problem
from desim.config.file_names import PICTURE_SUFFIXES
from desim.config.whole_files import write_whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from desim.scenario.overrides import Source
    from desim.scenario.properties import Property
    from desim.scenario.scenario import Scenario
    from desim.study.breaking.loss_table import FatalLosses, MessageFate
    from desim.study.breaking.search import Violation

VIOLATED = 4
"""Exit code if a violation was found."""
OF_CASES = ("runs", "features", "guided", "budget", "grid")
"""The options that only a search among random cases has."""
OF_LOSSES = ("fates", "delay", "seeds")
"""The options that only a search among lost messages has."""
LEAD = 0.1
"""Time from the start of the space-time diagram to the violation, s."""


@click.command("break")
@FILE
@click.option(
    "--property",
    "text",
    metavar="TEXT",
    help='What should hold, such as "idle at most 2 in total against centralised", or the name of a property of the'
    " file; default: the first one of the file.",
)
@click.option("--protocol", metavar="KIND", help="The protocol to break; default: that of the file.")
@click.option("-n", "--runs", type=click.IntRange(1, 100_000), default=200, show_default=True, help="Cases to run.")
@click.option("--feature", "features", multiple=True, metavar="NAME", help="A feature of cases; default: all.")
@click.option("--guided", is_flag=True, help="Make half of the cases from those with the least margins up to now.")
@click.option(
    "--losses",
    type=click.IntRange(1, 4),
    metavar="K",
    help="Instead of random cases, try all choices of at most K lost, late or repeated messages.",
)
@click.option(
    "--fate",
    "fates",
    multiple=True,
    type=click.Choice(["lost", "late", "twice"]),
    help="With --losses: what becomes of a message; may be repeated. Default: lost, and late with --delay.",
)
@click.option(
    "--delay",
    type=click.FloatRange(0.0, min_open=True),
    metavar="SECONDS",
    help="With --losses: the time by which messages are late, and after which they arrive once more.",
)
@click.option("--seeds", type=click.IntRange(1, 1000), default=1, show_default=True, help="With --losses: seeds.")
@click.option(
    "--budget",
    type=click.FloatRange(0.0, min_open=True),
    metavar="SECONDS",
    help="Begin no further cases after this wall time, that before an interruption included.",
)
@click.option(
    "--keep",
    type=PATH,
    metavar="DIR",
    help="A folder of found cases: they are run first, and what is found is added.",
)
@out_to("Folder of the results; default: out/NAME/break.")
@GRID
@SEED
@JOBS
@TIMEOUT
@JSON
@overriding
def break_(
    file: Path,
    text: str | None,
    protocol: str | None,
    runs: int,
    features: tuple[str, ...],
    guided: bool,
    losses: int | None,
    fates: "tuple[MessageFate, ...]",
    delay: float | None,
    seeds: int,
    budget: float | None,
    keep: Path | None,
    out: Path | None,
    grid: tuple[str, ...],
    seed: int | None,
    jobs: int,
    timeout: float | None,
    as_json: bool,
    overrides: tuple[str, ...],
) -> None:
    """Search for the smallest scenario in which a protocol violates a property.

    Faults and other imperfections are added to the scenario at random; -g adds further keys. After an interruption the
    same command goes on where it stopped (not with --losses).
    """
    from desim.study.breaking.search import checked_property

    _check_options(losses)
    source, scenario = source_of(file, overrides, grid=grid)
    folder = folder_for(scenario, None) / "break" if out is None else out
    make_folder(folder)
    root = scenario.seed if seed is None else seed
    try:
        if protocol is not None:
            scenario = scenario.with_({"protocol": protocol_of(protocol, "--protocol")})
        prop = checked_property(_chosen_property(text, scenario, file.parent), scenario)
        search = _Search(scenario, prop, root, file, folder, keep, jobs, timeout, as_json)
        with storing(folder):
            if keep is not None:
                search.run_kept(keep)
            if losses is None:
                vary = _varied_keys(source, scenario, grid)
                search.try_cases(runs, vary, features, inf if budget is None else budget, guided=guided)
            else:
                search.try_losses(losses, seeds, fates, inf if delay is None else delay)
    except ValueError as error:
        # Without --property, a wrong property is in the file.
        fail(problem(error, vary="grid", **({} if text is None else {"property": "text"})))


def _check_options(losses: int | None) -> None:
    """Raise a usage error if the command line has an option of the search that is not performed."""
    for option in options_given(OF_LOSSES if losses is None else OF_CASES).values():
        raise click.UsageError(f"{option} is only used {'with' if losses is None else 'without'} --losses")


def _varied_keys(source: "Source", scenario: "Scenario", grid: tuple[str, ...]) -> "dict[str, Sequence[Any]]":
    """Return the keys of --grid with their values, without those of [sweep.grid] in the file."""
    options = [f"--grid {setting}" for setting in grid]
    keys = scenario.sweep.grid
    return {key: values for key, values in keys.items() if source.where(("sweep", "grid", key)) in options}


def _chosen_property(text: str | None, scenario: "Scenario", folder: Path) -> "Property":
    """Return the property of the scenario that a text names, or that the text states; without a text, the first one.

    Functions that the text names are looked up in `folder`, as those of the file are.

    Raises:
        ValueError: if there is no text, and the scenario has no properties; or if the text states no property.
    """
    from desim.scenario.properties import property_of

    by_label = {prop.label: prop for prop in scenario.properties}
    if text is None and not by_label:
        example = '--property "idle at most 2 in total against centralised"'
        raise ValueError(f"the scenario has no properties: give one, for instance {example}")
    return scenario.properties[0] if text is None else by_label.get(text) or property_of(text, folder=folder)


@dataclass(frozen=True)
class _Search:
    """A search for what breaks a protocol; prints what it has found, writes it to a folder, and ends the program."""

    scenario: "Scenario"
    prop: "Property"
    root: int
    """The root seed."""
    file: Path
    """The file of the scenario, beside which the code that it names is found."""
    folder: Path
    """The folder of the results."""
    keep: Path | None
    """The folder of kept cases; None: no case is kept."""
    jobs: int
    timeout: float | None
    as_json: bool

    @property
    def smallest(self) -> Path:
        """The file of the smallest violation; its replay and its picture differ in the suffix."""
        return self.folder / "smallest.toml"

    def run_kept(self, keep: Path) -> None:
        """Run the kept cases of the protocol and the property, and end the program if one still fails.

        With several jobs, cases run in worker processes: a case that ends its process then does not end the program.
        """
        from desim.study.breaking.found import told_text
        from desim.study.breaking.judging import CaseJudge
        from desim.study.workers.executors import workers_for

        lines: list[str] = []
        for file in sorted(keep.glob("*.toml")):
            _, case = source_of(file, (), folder=self.file.parent)
            is_of_protocol = case.protocol_name == self.scenario.protocol_name
            if not is_of_protocol or self.prop.text not in [prop.text for prop in case.properties]:
                continue
            with workers_for(self.jobs, timeout=self.timeout) as workers:
                case_run = CaseJudge(self.prop, workers)(case, case.seed)
            verdict, failure = case_run.verdict, case_run.failure
            verb = "fails" if failure else "holds" if verdict.holds else "violates"
            lines.append(f"kept: {file}: {verb}: {told_text(verdict, failure, self.prop)}")
            echo(lines[-1], err=self.as_json)
            if not verdict.holds:
                lines.append("nothing else was searched: mend it, or move the file away")
                echo(lines[-1], err=self.as_json)
                violation = {"seed": case.seed, "verdict": verdict._asdict(), "failure": failure, "file": str(file)}
                # The smallest violation stays if it is this case, which an earlier search has found.
                if not (self.smallest.is_file() and _without_comment(self.smallest) == _without_comment(file)):
                    self._remove_earlier()
                as_text = self._write({"runs": 0, "violation": violation}, lines)
                if self.as_json:
                    echo(as_text)
                sys.exit(VIOLATED)

    def try_cases(
        self, runs: int, vary: "Mapping[str, Sequence[Any]]", features: "Sequence[str]", budget: float, *, guided: bool
    ) -> NoReturn:
        """Search among random cases, report what was found, and end the program."""
        from desim.study.breaking.case_log import FILE as CASES
        from desim.study.breaking.case_log import CaseLog
        from desim.study.breaking.found import protocols_text, scenario_text, search_text
        from desim.study.breaking.search import find_violation

        outcome = find_violation(
            self.scenario,
            self.prop,
            runs=runs,
            seed=self.root,
            vary=vary,
            features=list(features) or None,
            guided=guided,
            jobs=self.jobs,
            timeout=self.timeout,
            budget=budget,
            log=CaseLog(self.folder / CASES, self.prop),
        )
        texts = [search_text(outcome, self.prop)]
        document: dict[str, Any] = {"runs": outcome.runs, "seen": outcome.seen, "violation": None}
        self._remove_earlier()
        if (violation := outcome.violation) is not None:
            command = shlex.join(["desim", *sys.argv[1:]])
            text = scenario_text(violation, str(self.smallest), command, self.file.parent.absolute())
            self._write_smallest(text, violation.scenario.protocol_name, violation.seed)
            verdicts = violation.protocols(self.jobs, timeout=self.timeout)
            texts += ["", protocols_text(verdicts, self.prop), "", self._draw(violation.scenario, violation)]
            document["violation"] = {
                **violation.document(),
                "protocols": {k: v if isinstance(v, str) else v._asdict() for k, v in verdicts.items()},
                "file": str(self.smallest),
            }
        self._end(document, texts, is_violated=violation is not None)

    def try_losses(self, most: int, seeds: int, fates: "tuple[MessageFate, ...]", delay: float) -> NoReturn:
        """Try all choices of lost, late or repeated messages, report the fatal ones, and end the program."""
        from desim.study.breaking.found import told_text, with_comment
        from desim.study.breaking.losses import fatal_losses
        from desim.study.workers.batch import seeds_from

        scenario = self.scenario
        table = fatal_losses(
            scenario,
            self.prop,
            most=most,
            seeds=[self.root] if seeds == 1 else seeds_from(self.root, seeds),
            fates=fates,
            delay=delay,
            jobs=self.jobs,
            timeout=self.timeout,
        )
        texts = [table.text()]
        self._remove_earlier()
        if table.fatal:
            worst = min(table.fatal, key=lambda fatal: fatal.verdict.margin)
            broken = scenario.with_({"fault": [*scenario.fault, *worst.faults]})
            lines = [
                f'{scenario.protocol_name} breaks "{self.prop.text}" because of these messages:',
                *(f"  {fate}: {copy}" for copy, fate in zip(worst.messages, worst.fates, strict=True)),
                told_text(worst.verdict, worst.failure, self.prop),
            ]
            text = with_comment(broken, self.prop, worst.seed, lines, self.file.parent.absolute())
            self._write_smallest(text, broken.protocol_name, worst.seed)
            texts += ["", self._draw(broken, worst)]
        self._end(table.document(), texts, is_violated=bool(table.fatal or table.broken))

    def _remove_earlier(self) -> None:
        """Remove the smallest violation of an earlier search, unless this search has read it."""
        is_kept = self.keep is not None and self.keep.resolve() == self.folder.resolve()
        if not is_kept and self.smallest.resolve() != self.file.resolve():
            for suffix in (".toml", ".html", *PICTURE_SUFFIXES):
                self.smallest.with_suffix(suffix).unlink(missing_ok=True)

    def _write_smallest(self, text: str, protocol: str, seed: int) -> None:
        """Write the scenario of the smallest violation, and add it to the kept cases under a unique name."""
        from desim.config.data_files import content_hash

        write(text.encode(), self.smallest)
        if self.keep is not None:
            name = f"{protocol}-{self.prop.label[:40]}-{seed}-{content_hash(_without_comment(self.smallest))[:8]}.toml"
            write(text.encode(), self.keep / name.replace(":", "-"))

    def _draw(self, scenario: "Scenario", violation: "Violation | FatalLosses") -> str:
        """Write the replay and the space-time diagram of a violation in a scenario; return their paths as text."""
        from desim.study.breaking.found import command_for

        where = f"scenario: {self.smallest}"
        if violation.failure:
            command = command_for("run", str(self.smallest), scenario, self.file.parent.absolute())
            return f"{where}\nno replay, as the run fails: {command}"
        from desim.config.extras import naming_extras
        from desim.results.run_folder import can_plot
        from desim.simulation.run import run
        from desim.view.pages.replay import replay_page

        result, at = run(scenario.with_({"record.messages": True}), violation.seed), violation.verdict.at
        page = self.smallest.with_suffix(".html")
        try:
            with naming_extras():
                write(replay_page(result).encode(), page)
            texts = [where, f"replay:   {page}#t={at:g}"]
        except ModuleNotFoundError as error:  # the violation is worth more than its page
            texts = [where, f"no replay: {error}"]
        if can_plot():
            from desim.analysis.drawing.plots import save
            from desim.view.pictures.spacetime import spacetime

            pictures = save(spacetime(result, begin=max(at - LEAD, 0.0)), self.smallest.with_suffix(""))
            texts += [f"picture:  {picture}" for picture in pictures[:1]]
        return "\n".join(texts)

    def _end(self, document: dict[str, Any], texts: list[str], *, is_violated: bool) -> NoReturn:
        """Print the result, write it to the folder, and end the program."""
        as_text = self._write(document, texts)
        echo(as_text if self.as_json else "\n".join(texts))
        sys.exit(VIOLATED if is_violated else 0)

    def _write(self, document: dict[str, Any], texts: list[str]) -> str:
        """Write the result to the folder; return its document as JSON."""
        from desim.config.json_numbers import to_json

        document = {"property": self.prop.text, "unit": self.prop.unit} | document
        as_text = json.dumps(to_json(document), indent=2)
        write_whole(self.folder / "break.json", f"{as_text}\n".encode())
        write_whole(self.folder / "break.txt", ("\n".join(texts) + "\n").encode())
        return as_text


def _without_comment(file: Path) -> bytes:
    """Return the text of a file of a violation without its comment, which names the command that found it."""
    return file.read_bytes().partition(b"\n\n")[2]
