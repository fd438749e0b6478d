"""The progress bar of many runs, shown on a terminal and in a notebook, but not in a pipe."""

import sys
from typing import TYPE_CHECKING, Any

from tqdm.auto import tqdm as bar_of_this_place

from desim.config.trust import escaped

if TYPE_CHECKING:
    from tqdm import tqdm


def progress(total: int, label: str, unit: str) -> "tqdm[Any]":
    """Return a progress bar, to be used in a `with` statement.

    Args:
        total: the number of steps; call `update` after each.
        label: the text before the bar.
        unit: the name of a step.
    """
    in_notebook = "ipykernel.zmqshell" in sys.modules  # the output streams of a notebook are not a terminal
    bar: tqdm[Any] = bar_of_this_place(
        total=total, desc=escaped(label), unit=unit, disable=False if in_notebook else None
    )
    return bar
