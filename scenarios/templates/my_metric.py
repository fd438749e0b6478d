"""The metric my_metric, for scenario files, options and scripts.

desim run my_metric.toml --allow-import                            a run in which it is measured
desim run FILE --metric my_metric:my_metric --allow-import         the same of any scenario
desim sweep FILE --metric my_metric:my_metric --allow-import       its mean in each configuration
"""

from desim.analysis.metrics import Metric
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Decided
from desim.simulation.run import Result


def longest_pause(result: Result) -> float | None:
    """Return the longest time between two consecutive decisions of a pursuer, s; None if no pursuer paused.

    `result.trace` has the events of the run; the reference page "Events of a trace" lists their fields. The functions
    of `desim.analysis.metrics` are the built-in metrics.
    """
    last, longest = dict[int, int](), 0
    for event in result.trace.of(Decided):
        longest = max(longest, event.t - last.get(event.pursuer, event.t))
        last[event.pursuer] = event.t
    return longest / SECOND if longest else None


my_metric = Metric(longest_pause, "s", "between two decisions of a pursuer")
