"""The execution of many runs by a command: options such as --jobs, and the messages if a run fails."""

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

from desim.cli.options import JOBS, MIX_VERSIONS, TIMEOUT
from desim.cli.output import FAILED, echo, fail
from desim.config.file_names import STORE

if TYPE_CHECKING:
    from desim.study.store.store import Store
    from desim.study.workers.workers import Workers

CLUSTER = click.option(
    "--cluster",
    metavar="tcp://...",
    help="Run on the workers of a Dask scheduler (the extra `cluster`). Any client that reaches its port can run code"
    " there: use a trusted network, or TLS (tls://...).",
)


@dataclass(frozen=True)
class Execution:
    """Who performs the runs of a command, and how long a run may take."""

    jobs: int
    cluster: str | None
    timeout: float | None
    """The wall time of a run, s, after which it counts as failed; None = no limit."""
    mix_versions: bool

    @property
    def executor(self) -> int | str:
        """The number of workers of this machine, or the address of a scheduler."""
        return self.jobs if self.cluster is None else self.cluster

    @contextmanager
    def workers(self, store: "Store", runs: int | None = None) -> Iterator["Workers"]:
        """Yield the workers; end the program as `failures_told` does, or if no scheduler answers.

        Args:
            store: the store to which the runs are added.
            runs: the largest number of runs; None: it is not known.
        """
        from desim.config.number_texts import counted
        from desim.study.workers.executors import workers_for

        def kept() -> str:
            count, failed = len(store) - store.failed_runs, store.failed_runs
            text = f"{counted(count, 'finished run')} {'is' if count == 1 else 'are'} in {store.path}"
            has_report = failed and store.path.name == STORE  # `desim report` reads no store of another name
            folder = shlex.quote(str(store.path.parent))
            return f"{text}; `desim report {folder}` shows the traceback" if has_report else text

        with failures_told(kept):
            try:
                connected = workers_for(self.executor, runs, self.timeout)
            except ValueError:
                fail(f"{self.cluster}: no scheduler answers: an address is for instance tcp://192.168.0.5:8786")
            with connected as workers:
                yield workers


def executing(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of an `Execution`, which it receives as the argument `execution`."""

    @JOBS
    @CLUSTER
    @TIMEOUT
    @MIX_VERSIONS
    @wraps(command)
    def with_execution(
        *args: Any, jobs: int, cluster: str | None, timeout: float | None, mix_versions: bool, **options: Any
    ) -> None:
        command(*args, execution=Execution(jobs, cluster, timeout, mix_versions), **options)

    return with_execution


@contextmanager
def failures_told(kept: Callable[[], str]) -> Iterator[None]:
    """End the program with a sentence, not a traceback, if a run fails or has no value that a mean needs.

    An interrupt receives a note on how to resume.

    Args:
        kept: returns which runs are kept, and where.
    """
    from desim.study.sweeps.metric_values import NoMeanError
    from desim.study.sweeps.sweep import RunError

    try:
        yield
    except KeyboardInterrupt as error:
        error.add_note(f"{kept()}; the same command resumes")
        raise
    except RunError as error:
        echo(f"{error}\n{kept()}", err=True)
        sys.exit(FAILED)
    except NoMeanError as error:
        fail(f"{error}\n{kept()}")
