"""Live runs from Python: one, or several one after another."""

import asyncio
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager, suppress
from threading import Thread
from typing import Any, Literal, get_args

from desim.config.arguments import naming_arguments, scenario_argument, value_text
from desim.config.python_numbers import whole
from desim.kernel.core.seeds import seed_list, seed_of
from desim.live.lobby import LOCAL
from desim.live.namespaces import Places, namespaces
from desim.live.nursery import Nursery
from desim.live.referee import Referee
from desim.live.refusals import check_live
from desim.live.result import LiveResult
from desim.scenario.scenario import Scenario

LinkKind = Literal["drawn", "namespaces", "netem"]
"""How losses and latencies arise: drawn by the receivers, in one or several network namespaces, or made by netem."""


@naming_arguments
def run(
    scenario: Scenario,
    seed: int | None = None,
    *,
    hosts: Sequence[str] | None = None,
    links: LinkKind = "drawn",
    tell: Callable[[str], object] = print,
) -> LiveResult:
    """Run a scenario live: each pursuer in a process of its own, in real time, over UDP.

    Args:
        scenario: the experiment.
        seed: seed of every random stream; if None, the seed of the scenario.
        hosts: (N,) the host at which each pursuer listens; None: the loopback. On another host, start a process with
            the command that is passed to `tell`.
        links: how the links are made; see `LinkKind`.
        tell: called with sentences about the run as it goes on.

    Raises:
        ValueError: if the scenario cannot run live, or an argument is wrong.
        LiveError: if a process does not start, or a protocol raises an exception.
        NamespaceError: if network namespaces, or netem, cannot be used here.
    """
    return runs(scenario, [seed], hosts=hosts, links=links, tell=tell)[0]


def runs(
    scenario: Scenario,
    seeds: Sequence[int | None],
    *,
    at_once: int = 1,
    hosts: Sequence[str] | None = None,
    links: LinkKind = "drawn",
    tell: Callable[[str], object] = print,
    finished: Callable[[LiveResult], object] | None = None,
) -> list[LiveResult]:
    """Run a scenario live with several seeds, and return the results in their order.

    Args:
        scenario: the experiment.
        seeds: the seed of each run; None: that of the scenario.
        at_once: number of runs at the same time. More than one makes timers late if processors are few.
        hosts: as in `run`.
        links: as in `run`.
        tell: as in `run`.
        finished: called with each result at the end of its run.

    Raises:
        ValueError: as `run`.
        LiveError: as `run`.
        NamespaceError: as `run`.
    """
    scenario_argument(Scenario).check(scenario, "run")
    check_live(scenario)
    seeds, size = [None if seed is None else seed_of(seed) for seed in seed_list(seeds)], scenario.team.count
    if (at_once := whole(at_once, "at_once")) < 1:
        raise ValueError(f"at_once should be at least 1 (got {at_once})")
    if links not in get_args(LinkKind):
        raise ValueError(f"links should be {', '.join(map(repr, get_args(LinkKind)))} (got {value_text(links)})")
    functions: tuple[Any, ...] = (tell, tell if finished is None else finished)
    if not all(map(callable, functions)):
        raise ValueError(f"tell and finished should be functions (got {value_text(tell)} and {value_text(finished)})")
    untyped: Any = hosts  # callers without a type checker may give anything
    is_list = isinstance(untyped, Sequence) and not isinstance(untyped, str) and len(untyped) == size
    if hosts is not None and not (is_list and all(isinstance(host, str) and host for host in untyped)):
        raise ValueError(
            f"hosts should be the names or addresses of {size} hosts, one for each pursuer (got {value_text(hosts)})"
        )
    if hosts is not None and links != "drawn":
        raise ValueError('hosts have real links between them, so links should be "drawn"')
    with _places(scenario, links, hosts) as places:
        options: Any = {"hosts": places.hosts, "namespaces": places.namespaces, "draws": links != "netem"}
        return _play(scenario, seeds, at_once, finished, tell=tell, **options)


def _play(
    scenario: Scenario,
    seeds: Sequence[int | None],
    at_once: int,
    finished: Callable[[LiveResult], object] | None,
    **options: Any,
) -> list[LiveResult]:
    """Run a scenario live with several seeds, some at the same time; `options` are those of `Referee`."""

    async def play() -> list[LiveResult]:
        limit = asyncio.Semaphore(at_once)

        async def play_seed(seed: int | None) -> LiveResult:
            async with limit:
                result = await Referee(scenario, seed, **options).play(nursery)
                if finished is not None:
                    finished(result)
                return result

        async with Nursery() as nursery, asyncio.TaskGroup() as group:
            running = [group.create_task(play_seed(seed)) for seed in seeds]
        return [task.result() for task in running]

    return _run(play)  # type: ignore[no-any-return]


@contextmanager
def _places(scenario: Scenario, links: LinkKind, hosts: Sequence[str] | None) -> Iterator[Places]:
    if links == "drawn":
        yield Places([""] * scenario.team.count, list(hosts or [LOCAL] * scenario.team.count))
        return
    with namespaces(scenario, netem=links == "netem") as places:
        yield places


def _run(play: Callable[[], Any]) -> Any:
    """Run a coroutine to its end, also where an event loop is running, as in a notebook.

    The exception of a task is raised as it is. Ctrl-C cancels the coroutine, and waits until it has ended.
    """
    running: Future[Any] = Future()

    async def play_here() -> Any:
        running.set_result((asyncio.get_running_loop(), asyncio.current_task()))
        return await play()

    def run_here() -> Any:
        try:
            return asyncio.run(play_here())
        except BaseExceptionGroup as error:
            raise error.exceptions[0] from None

    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return run_here()
    outcome: Future[Any] = Future()

    def run_there() -> None:
        try:
            outcome.set_result(run_here())
        except BaseException as error:
            outcome.set_exception(error)

    try:
        Thread(target=run_there).start()
        return outcome.result()
    except BaseException:
        if not running.cancel():  # if this cancels it, `play_here` fails at its start
            loop, task = running.result()
            with suppress(RuntimeError):  # the loop has just been closed
                loop.call_soon_threadsafe(task.cancel)
            wait([outcome])
        raise
