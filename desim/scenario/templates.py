"""Templates of commented starting files: a scenario, or a user's own model or metric with a scenario that uses it.

NAME stands for the name of the module, the scenario and the metric, CLASS for the name of the class.
"""

import ast
import sys
from importlib.util import find_spec
from keyword import iskeyword
from types import MappingProxyType

_SCENARIO = """\
# One sentence that says what NAME is about.
# desim run NAME.toml          one run, and its metrics
# desim replay NAME.toml       a page that plays it
# desim sweep NAME.toml        the grid at the end of this file
# desim explain NAME.toml      what each imperfection costs
# All other keys and their defaults: desim keys, desim check NAME.toml
name = "NAME"
seed = 1
horizon = 30.0                                          # the run ends at the capture, or here, s

[team]
count = 8                                               # or positions = [[x, y], ...], m
box = [0.0, 20.0]                                       # bounds of the initial coordinates, m
speeds = { default = 1.0, last = 2.0 }                  # m/s; or one number, or one per pursuer

[evader]
box = [8.0, 12.0]                                       # m
speed = 0.9                                             # m/s
strategy = { kind = "pure_evasion" }                    # desim keys evader.strategy

[protocol]
kind = "sap"                                            # desim protocols
schedule = { kind = "poisson", rate = 5.0 }             # 1/s per pursuer

[announce]
start = "announced"                                     # first actions travel over the network, as all later ones
heartbeat = 0.1                                         # s between repetitions of the last announcement

[network]
range = inf                                             # m
latency = { kind = "constant", value = 0.05 }           # s, one way
loss = { kind = "bernoulli", p = 0.05 }

[record]
messages = true                                         # needed for the age of information and pictures of messages

[sweep]
reps = 20                                               # runs of each configuration

[sweep.grid]
"network.latency.value" = [0.0, 0.1, 0.5]               # s
"network.loss.p" = [0.0, 0.3]
"""

_PROTOCOL = '''\
"""The protocol CLASS, for scenario files and scripts.

desim run NAME.toml --allow-import               a run with it
desim sweep NAME.toml --allow-import             a comparison with sap on the same seeds
desim protocols NAME:CLASS --allow-import        its parameters and traits
"""

from collections.abc import Iterator

from desim.config.model import Probability
from desim.pursuit.team.agent import Agent
from protocols.rule import LearningRule, argmax, current_action


class CLASS(LearningRule):
    """Take the best action or, with some probability, keep the present one.

    Every field is a key of the table `protocol`. `schedule` and `utility` are inherited.
    """

    inertia: Probability = 0.3
    """Probability of no change, in [0, 1]."""

    def actions(self, me: Agent) -> Iterator[int]:
        """Yield an action at each turn of a pursuer: 0 to be inactive, j to chase evader j.

        Local variables are the memory of the pursuer. Use only what `Agent` offers: a pursuer knows nothing else. Draw
        from `me.rng` only.
        """
        while True:
            utilities = self.utilities(me)  # of each action that it may choose, s
            keeps = me.rng.random() < self.inertia
            yield current_action(me, utilities) if keeps else argmax(utilities)
'''

_LATENCY = '''\
"""The latency model CLASS, for scenario files and scripts.

desim run NAME.toml --allow-import               a run with it
desim sweep NAME.toml --allow-import             the grid of its parameters
"""

import numpy as np

from desim.config.model import Probability, Time, Value
from desim.kernel.core.link_context import LinkContext


class CLASS(Value):
    """Most messages are fast; now and then one is slow, for each receiver independently.

    Every field is a key of the table `network.latency`.
    """

    fast: Time = 0.02
    """One-way latency of most messages, s."""
    slow: Time = 0.5
    """One-way latency of a slow message, s."""
    share: Probability = 0.1
    """Probability of a slow message, in [0, 1]."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> np.ndarray:
        """Return the (k,) latencies of one transmission to the k receivers `context.dst`, s.

        `context` also has `src`, `now`, `size` and `distances`. Draw from `rng` only.
        """
        return np.where(rng.random(len(context.dst)) < self.share, self.slow, self.fast)
'''

_EVADER = '''\
"""The evasion strategy CLASS, for scenario files and scripts.

desim replay NAME.toml --allow-import            a page that plays a run with it
desim sweep NAME.toml --allow-import             the grid of its parameters
"""

from cmath import rect
from math import radians
from typing import Annotated

import numpy as np
from pydantic import Field

from desim.config.model import Value
from desim.pursuit.evaders.observation import EvaderObservation


class CLASS(Value):
    """Flee from the nearest pursuer at an angle.

    Every field is a key of the table `evader.strategy`.
    """

    angle: Annotated[float, Field(ge=-180, le=180, strict=True)] = 30.0
    """Angle to the left of the straight line away from the nearest pursuer, degrees."""

    def __call__(self, state: EvaderObservation, rng: np.random.Generator) -> complex:
        """Return the heading, a complex number of length at most 1; 0 stands still.

        `state.offsets` are the (n,) vectors, m, to the evader from each of the n pursuers that it senses.
        `state.nearest` is the index of the nearest of them, or -1 if there are none. Draw from `rng` only.
        """
        if state.nearest < 0:
            return 0j
        away = complex(state.offsets[state.nearest])
        return rect(1.0, radians(self.angle)) * away / abs(away) if away else 0j
'''

_METRIC = '''\
"""The metric NAME, for scenario files, options and scripts.

desim run NAME.toml --allow-import                           a run in which it is measured
desim run FILE --metric NAME:NAME --allow-import             the same of any scenario
desim sweep FILE --metric NAME:NAME --allow-import           its mean in each configuration
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


NAME = Metric(longest_pause, "s", "between two decisions of a pursuer")
'''

_USER_SCENARIO = """\
# A scenario that uses NAME.py, which lies beside it. All other keys: desim keys
name = "NAME"
seed = 1
horizon = 30.0                                          # s
team.count = 8
"""

_USES = MappingProxyType(
    {
        "protocol": """\

[protocol]
kind = "NAME:CLASS"
inertia = 0.3
schedule = { kind = "poisson", rate = 5.0 }             # 1/s per pursuer

[sweep]
reps = 20                                               # runs of each configuration

[sweep.grid]
"protocol.kind" = ["sap", "NAME:CLASS"]                 # differences are from the first
"network.latency.value" = [0.0, 0.1]                    # s
""",
        "latency": """\

[network.latency]
kind = "NAME:CLASS"
share = 0.1

[sweep]
reps = 20                                               # runs of each configuration

[sweep.grid]
"network.latency.share" = [0.0, 0.1, 0.5]
""",
        "evader": """\

[evader.strategy]
kind = "NAME:CLASS"
angle = 30.0                                            # degrees

[sweep]
reps = 20                                               # runs of each configuration

[sweep.grid]
"evader.strategy.angle" = [0.0, 30.0, 60.0]             # degrees
""",
        "metric": """\

[record]
metrics = ["NAME:NAME"]

[sweep]
reps = 20                                               # runs of each configuration

[sweep.grid]
"network.latency.value" = [0.0, 0.1]                    # s
""",
    }
)
_MODULES = MappingProxyType({"protocol": _PROTOCOL, "latency": _LATENCY, "evader": _EVADER, "metric": _METRIC})
TEMPLATES = ("scenario", *_MODULES)
"""The names of the templates."""


def starting_files(template: str, name: str) -> dict[str, str]:
    """Return the text of each starting file by file name, the scenario file last.

    Args:
        template: one of `TEMPLATES`.
        name: the name of the scenario and of the module; an identifier.

    Raises:
        ValueError: if the name is not an identifier; for any template but "scenario", also if an installed module has
            this name or the code of the template uses it.
    """
    if not name.isidentifier() or iskeyword(name):
        raise ValueError(f"{name!r} should be an identifier: letters, digits and _, my_{template} for instance")
    if template == "scenario":
        return {f"{name}.toml": _SCENARIO.replace("NAME", name)}
    module = _MODULES[template]
    if _is_installed(name):
        raise ValueError(f"{name!r} is the name of an installed module, which would hide {name}.py; choose another")
    if name in _names_in(module):
        raise ValueError(f"{name!r} is the name of a function or class that {name}.py uses; choose another")
    texts = {f"{name}.py": module, f"{name}.toml": _USER_SCENARIO + _USES[template]}
    return {file: text.replace("NAME", name).replace("CLASS", _class_name(name)) for file, text in texts.items()}


def _is_installed(name: str) -> bool:
    """Return whether an installed module of this name would hide one in the folder of a scenario."""
    if name in sys.stdlib_module_names:
        return True
    spec = find_spec(name)
    return spec is not None and spec.origin is not None


def _names_in(module: str) -> set[str]:
    """Return the names that the source of a module imports, defines or reads."""
    nodes = list(ast.walk(ast.parse(module)))
    defined = {each.name for each in nodes if isinstance(each, ast.alias | ast.FunctionDef | ast.ClassDef)}
    return defined | {each.id for each in nodes if isinstance(each, ast.Name)}


def _class_name(name: str) -> str:
    """Return the name of a class for a module: my_rule becomes MyRule."""
    camel = "".join(part[:1].upper() + part[1:] for part in name.split("_"))
    return camel if camel.isidentifier() and not iskeyword(camel) else name
