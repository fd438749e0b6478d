"""The progress bar of many runs, shown on a terminal and in a notebook, but not in a pipe."""

import sys
from time import time
from typing import TYPE_CHECKING, Any

from tqdm.auto import tqdm as tqdm_of_output  # for a terminal or a notebook

from desim.config.escaping import escaped

if TYPE_CHECKING:
    from tqdm import tqdm


def progress(total: int | None, label: str, unit: str) -> "tqdm[Any]":
    """Return a progress bar, to be used in a `with` statement; `total` is None if the number of steps is not known."""
    in_notebook = "ipykernel.zmqshell" in sys.modules  # the output streams of a notebook are not a terminal
    # None: tqdm shows the bar only on a terminal.
    bar: tqdm[Any] = tqdm_of_output(total=total, desc=escaped(label), unit=unit, disable=False if in_notebook else None)
    return bar


def advance(bar: "tqdm[Any]", steps: int) -> None:
    """Advance a bar by some steps; the time until the first of them, in which workers start, does not count.

    Otherwise the estimate of the remaining time would assume that workers start anew for each run.
    """
    if not bar.n and not bar.disable:
        bar.initial, bar.start_t = steps, time()
        bar.last_print_n, bar.last_print_t = steps, bar.start_t
    bar.update(steps)
