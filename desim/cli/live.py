"""`desim live`: a scenario in one process per pursuer, over UDP and in real time."""

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from desim.cli.options import COUNT, FILE, JSON, METRIC, PATH, SEED, out_to, overriding
from desim.cli.output import FAILED, RAISED, echo, fail, folder_for, make_folder, making
from desim.cli.result_files import show
from desim.cli.sources import shown_metrics, source_of
from desim.config.file_names import LIVE
from desim.config.whole_files import write_whole

if TYPE_CHECKING:
    from collections.abc import Sequence

    from desim.live.live_runs import LinkKind
    from desim.live.result import LiveResult
    from desim.scenario.scenario import Scenario


@click.command()
@FILE
@SEED
@click.option("-n", "--runs", type=COUNT, default=1, help="Number of runs, one after another; default: 1.")
@out_to("Folder for the trace, the metrics and pictures.")
@click.option(
    "--hosts",
    "hosts_file",
    type=PATH,
    metavar="FILE",
    help="A file with a host for each pursuer, one a line; default: the loopback. The command to start on another host"
    " is printed.",
)
@click.option("--namespaces", is_flag=True, help="Put each pursuer into a network namespace of its own (Linux, root).")
@click.option("--netem", is_flag=True, help="As --namespaces, with the links of `desim netem` in place of drawn ones.")
@click.option(
    "--compare", "compares", is_flag=True, help="Simulate the same runs, and print where both differ, with a figure."
)
@click.option("--join", "invitation", metavar="WORD", help="Be one pursuer of a run on another host (see --hosts).")
@METRIC
@JSON
@overriding
def live(
    file: Path,
    seed: int | None,
    runs: int,
    out: Path | None,
    hosts_file: Path | None,
    namespaces: bool,
    netem: bool,
    compares: bool,
    invitation: str | None,
    metrics: tuple[str, ...],
    as_json: bool,
    overrides: tuple[str, ...],
) -> None:
    """Run a scenario FILE live: each pursuer in a process of its own, over UDP, in real time.

    Exit code 3: a process was lost, which counts as a crash of its pursuer.
    """
    from desim.live.lobby import LiveError
    from desim.live.namespaces import NamespaceError
    from desim.live.refusals import NotLiveError

    _, scenario = source_of(file, overrides, metrics)
    if seed is not None:
        scenario = scenario.model_copy(update={"seed": seed})
    try:
        if invitation is not None:
            _join(scenario, invitation)
        links: LinkKind = "netem" if netem else "namespaces" if namespaces else "drawn"
        if hosts_file is not None and (compares or links != "drawn"):
            other = "--compare" if compares else "--netem" if netem else "--namespaces"
            raise click.UsageError(f"{other} needs all processes on this machine: leave out --hosts")
        if compares:
            _compare(scenario, runs, links, out, as_json=as_json)
        else:
            hosts = None if hosts_file is None else _hosts(hosts_file, scenario.team.count)
            _run(scenario, runs, links, hosts, out, metrics, as_json=as_json)
    except NotLiveError as error:
        fail(f"{file}: {error}")
    except (NamespaceError, ValueError) as error:
        fail(str(error))
    except LiveError as error:
        echo(str(error), err=True)
        sys.exit(RAISED)


def _run(
    scenario: "Scenario",
    count: int,
    links: "LinkKind",
    hosts: "Sequence[str] | None",
    out: Path | None,
    metrics: tuple[str, ...],
    *,
    as_json: bool,
) -> None:
    """Run a scenario live, and print the metrics and how the runs went."""
    from desim.analysis.measuring import summary
    from desim.analysis.metrics import plain
    from desim.analysis.tables import batch_table, run_table
    from desim.live.live_runs import runs
    from desim.study.workers.batch import seeds_from

    if out is not None:
        make_folder(out)
    seeds = [scenario.seed] if count == 1 else seeds_from(scenario.seed, count)
    start = time.perf_counter()
    results = runs(scenario, seeds, hosts=hosts, links=links, tell=lambda text: echo(text, err=True))
    wall_time = time.perf_counter() - start
    if out is not None:
        for result in results:
            _write(result, out if count == 1 else out / f"seed-{result.seed}")
    summaries = [summary(result) for result in results]
    if as_json:
        conducts = [result.conduct.document() for result in results]
        entries = [plain(numbers) | {"live": conduct} for numbers, conduct in zip(summaries, conducts, strict=True)]
        echo(json.dumps({"scenario": scenario.plain(), "runs": entries}, indent=2))
    else:
        shown = shown_metrics(scenario, metrics)
        table = run_table(scenario, summaries[0], wall_time, shown) if count == 1 else None
        echo(f"{table or batch_table(scenario, summaries, wall_time)}\n{conduct_lines(results)}")
    for result in results:
        for note in result.conduct.notes:
            echo(f"warning: seed {result.seed}: {note}", err=True)
    if note := overload(results):
        echo(f"warning: {note}", err=True)
    if out is not None:
        echo(f"wrote {out}", err=True)
    if any(result.conduct.ends for result in results):
        sys.exit(FAILED)


def _write(result: "LiveResult", folder: Path) -> None:
    """Write a run as `desim run` does, and how it went."""
    from desim.results import run_folder

    try:
        run_folder.write(result, folder)
        write_whole(folder / LIVE, (json.dumps(result.conduct.document(), indent=2) + "\n").encode())
    except OSError as error:
        fail(f"--out {error.filename or folder}: cannot be written: {error.strerror}")


def overload(results: "Sequence[LiveResult]") -> str:
    """Return a sentence if timers or deliveries were so late that results depend on the machine; "" if not."""
    from desim.live.agreement import GATE
    from desim.live.result import lateness_of

    p99 = {name: lateness_of(results, name).p99 for name in ("timers", "deliveries")}
    late = [f"{name} by {1e3 * time:.0f} ms or more" for name, time in p99.items() if time > GATE]
    if not late:
        return ""
    return f"late: 1 % of the {' and of the '.join(late)}: results depend on this machine; try again while it is idle"


def conduct_lines(results: "Sequence[LiveResult]") -> str:
    """Return how late timers and deliveries were, and what was dropped, as text."""
    from desim.kernel.core.portable_math import portable_sum
    from desim.live.result import lateness_of

    timers, deliveries, actions = (lateness_of(results, name) for name in ("timers", "deliveries", "orders"))
    drops = [int(portable_sum(counts)) for counts in zip(*(result.conduct.dropped for result in results), strict=True)]
    return (
        f"live: late by at most, in 50 %, 99 % and 100 %: timers {timers}, deliveries {deliveries}, actions {actions}\n"
        f"datagrams dropped: {drops[0]} malformed, {drops[1]} foreign, {drops[2]} replayed"
    )


def _compare(scenario: "Scenario", count: int, links: "LinkKind", out: Path | None, *, as_json: bool) -> None:
    """Run a scenario live and simulated, print the comparison, and draw it."""
    from desim.live.agreement import compare
    from desim.results.run_folder import can_plot

    if count < 2:
        raise click.UsageError("--compare needs several runs, such as -n 20")
    folder = folder_for(scenario, out)
    make_folder(folder)
    agreement = compare(scenario, count, links=links)
    show(agreement, as_json=as_json)
    if can_plot():
        with making("figure"):
            from desim.analysis.drawing.plots import save
            from desim.live.figure import agreement_figure

            for path in save(agreement_figure(agreement), folder / "live"):
                echo(f"wrote {path}", err=True)


def _hosts(file: Path, count: int) -> list[str]:
    """Return the hosts in a file, one a line for each pursuer; # begins a comment."""
    from desim.config.number_files import text_of_file
    from desim.live.sockets import resolved

    lines = enumerate((line.partition("#")[0].strip() for line in text_of_file(file).splitlines()), start=1)
    hosts = {number: line for number, line in lines if line}
    for number, host in hosts.items():
        try:
            resolved((host, 0))
        except OSError as error:
            fail(f"{file}, line {number}: {error}")
    if len(hosts) != count:
        fail(f"{file}: should have a host for each of the {count} pursuers, one a line (got {len(hosts)})")
    return list(hosts.values())


def _join(scenario: "Scenario", invitation: str) -> NoReturn:
    """Be one pursuer of a run whose referee is on another host; end the program with the exit code of the pursuer."""
    from desim.live.pursuer import play
    from desim.live.start import PursuerStart

    try:
        start = PursuerStart.invited(invitation, scenario)
    except ValueError as error:
        raise click.UsageError(f"--join: {error}") from error
    sys.exit(play(scenario, start))
