"""The response of `desim` and of the studies in `scenarios` to interrupts, time-outs and a closed or full stdout.

Three further errors end the program without a traceback of desim:

- the end of a trace (`TraceEndError`), if the scenario asks for this error;
- a wrong answer of a user's model (`AnswerError`): the message names its file and line;
- an exception of a user's metric (`MetricError`): the message has the calls in the user's code.
"""

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from traceback import extract_tb, format_list
from typing import Any

import click

from desim.cli.output import RAISED, echo, fail
from desim.cli.usage import WORDS, advised, check_empty, check_hyphens
from desim.config.errors import AnswerError, MetricError
from desim.config.interrupts import exit_code, raising
from desim.config.packages import HiddenPackageError
from desim.simulation.watchdog import OUT_OF_MEMORY, TimedOut


def released(error: BaseException | None) -> None:
    """Release the objects that the calls of an exception and of earlier ones hold: its message needs memory, too."""
    while error is not None:
        error.__traceback__, error.__cause__, error.__context__, error = None, None, None, error.__context__


@contextmanager
def _ending_interrupted() -> Iterator[None]:
    """End the program if a signal interrupts the block, with a message and the exit code of the signal."""
    try:
        with raising():
            yield
    except KeyboardInterrupt as error:
        text = f"interrupted {error}".rstrip()
        try:
            notes = "; ".join(getattr(error, "__notes__", ()))
            echo(f"{text}: {notes}" if notes else text, err=True)
        finally:  # even if the terminal is closed
            raise click.exceptions.Exit(exit_code(error)) from None


class Program(click.Command):
    """A command with the exit codes that shells expect, such as 128 + the number of the signal that interrupts it.

    The message of an interrupt includes the notes of the exception; see `desim.cli.execution.failures_told`.
    """

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command."""
        with _ending_interrupted():
            return self._invoke(ctx)

    def _invoke(self, ctx: click.Context) -> Any:
        """Run the command; an error without a traceback of desim ends the program."""
        try:
            with warnings.catch_warnings():
                warnings.showwarning = lambda message, *_, **__: echo(f"warning: {message}", err=True)
                return super().invoke(ctx)
        except click.UsageError as error:  # raised by a command of the group, whose words `make_context` has kept
            raise advised(error, ctx.meta.get(WORDS, ()), ctx) from None
        except TimedOut as error:
            echo(f"--timeout: {error}", err=True)
            ctx.exit(RAISED)
        except MemoryError as error:
            released(error)
            echo(OUT_OF_MEMORY, err=True)
            ctx.exit(RAISED)
        except HiddenPackageError as error:
            fail(str(error))
        except AnswerError as error:
            echo(" ".join([str(error), *getattr(error, "__notes__", ())]), err=True)
            ctx.exit(RAISED)
        except MetricError as error:
            cause = error.__cause__
            calls = [] if cause is None else extract_tb(cause.__traceback__)[2:]  # the first two are in desim
            echo("".join([*format_list(calls), str(error)]), err=True)
            ctx.exit(RAISED)
        except ValueError as error:
            from desim.kernel.measured.playback import TraceEndError  # slow to import

            if not isinstance(error, TraceEndError):
                raise
            fail(str(error))

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """Return the context of the command; an error says what to type instead."""
        with _ending_interrupted():  # advice on a wrong option imports all commands
            return self._make_context(info_name, args, parent, **extra)

    def _make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None, **extra: Any
    ) -> click.Context:
        """Return the context of the command; an error says what to type instead."""
        words = tuple(args)  # parsing empties the list
        try:
            program = click.Context(self, info_name=info_name, parent=parent)
            check_hyphens(words, program)
            check_empty(words, program)
            context = super().make_context(info_name, args, parent, **extra)
        except click.UsageError as error:
            raise advised(error, words) from None
        context.meta[WORDS] = words
        return context

    def main(self, *args: Any, **options: Any) -> Any:
        """Run the command with the arguments of the program."""
        try:
            return super().main(*args, **options)
        except OSError as error:
            is_printing = extract_tb(error.__traceback__)[-1].filename == click.echo.__code__.co_filename
            if not is_printing:
                raise
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # so that the flush at exit succeeds
            fail(f"stdout: cannot be written: {error.strerror}")
