"""The page of `desim play` in a notebook, without its widget, which needs an extra and is slow to import."""

from typing import TYPE_CHECKING

from desim.config.arguments import naming_arguments, scenario_argument
from desim.config.extras import naming_extras
from desim.scenario.scenario import Scenario

if TYPE_CHECKING:
    from desim.view.pages.widget import PlayWidget


@naming_extras()
@naming_arguments
def play(scenario: Scenario, timeout: float = 30.0) -> "PlayWidget":
    """Return a widget for notebooks with controls for the keys and a replay; needs the extra `notebook`.

    Each change of a key runs the scenario again, with the same seed unless the seed is changed. A run that the user
    pins stays in the replay, drawn faint, for comparison.

    Args:
        scenario: the scenario before any change.
        timeout: the wall time after which a run is ended, s.

    Raises:
        TypeError: if `scenario` is not a scenario; the message says what to write instead.
        ModuleNotFoundError: if anywidget is not installed (the extra `notebook`).
    """
    scenario_argument(Scenario).check(scenario, "play")
    from desim.view.pages.widget import PlayWidget

    return PlayWidget(scenario, timeout)
