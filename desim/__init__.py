"""desim simulates multi-robot relay pursuit that is negotiated over an imperfect network.

```python
from desim import load, run, summary

result = run(load("scenarios/relay.toml"), seed=7)
print(summary(result))
```

This package exports the parts of a scenario and the functions for scripts, such as `run` and `sweep`. Protocols and
schedules are in the package `protocols`.
"""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from desim.config.errors import WORDINGS
from desim.config.exports import homes_of_exports, missing_export
from desim.config.extras import naming_extras
from desim.config.html import PICTURES
from desim.config.packages import (
    ENVIRONMENTS,
    KINDS_OF,
    MARGINS,
    check_visible,
    explain_hidden_packages,
    package_folder,
)

if TYPE_CHECKING:
    from desim.adapters.wrap import wrap as wrap
    from desim.analysis.measuring import summary as summary
    from desim.analysis.properties import judge as judge
    from desim.config.data_files import open_data as open_data
    from desim.kernel.clock_sync import TwoWay as TwoWay
    from desim.kernel.core.trace_file import TraceFile as TraceFile
    from desim.kernel.fates import fates as fates
    from desim.kernel.measured.models import LatencyTrace as LatencyTrace
    from desim.kernel.measured.models import LossTrace as LossTrace
    from desim.kernel.measured.models import SignalTrace as SignalTrace
    from desim.kernel.models.access import Aloha as Aloha
    from desim.kernel.models.access import Csma as Csma
    from desim.kernel.models.access import CsmaCa as CsmaCa
    from desim.kernel.models.access import SlottedAloha as SlottedAloha
    from desim.kernel.models.access import Tdma as Tdma
    from desim.kernel.models.clock_skew import ClockSkew as ClockSkew
    from desim.kernel.models.coherence import Coherence as Coherence
    from desim.kernel.models.common_losses import CommonCause as CommonCause
    from desim.kernel.models.fault_plans import RandomCrashes as RandomCrashes
    from desim.kernel.models.fault_plans import RandomFaults as RandomFaults
    from desim.kernel.models.faults import Crash as Crash
    from desim.kernel.models.faults import Fault as Fault
    from desim.kernel.models.faults import Jamming as Jamming
    from desim.kernel.models.faults import MessageFault as MessageFault
    from desim.kernel.models.faults import Partition as Partition
    from desim.kernel.models.graphs import Complete as Complete
    from desim.kernel.models.graphs import Edge as Edge
    from desim.kernel.models.graphs import Edges as Edges
    from desim.kernel.models.graphs import Grid as Grid
    from desim.kernel.models.graphs import Link as Link
    from desim.kernel.models.graphs import Ring as Ring
    from desim.kernel.models.graphs import Star as Star
    from desim.kernel.models.interference import CaptureEffect as CaptureEffect
    from desim.kernel.models.interference import Collision as Collision
    from desim.kernel.models.interference import LoRaInterference as LoRaInterference
    from desim.kernel.models.interference import Sinr as Sinr
    from desim.kernel.models.latency import Constant as Constant
    from desim.kernel.models.latency import Empirical as Empirical
    from desim.kernel.models.latency import Gamma as Gamma
    from desim.kernel.models.latency import Lognormal as Lognormal
    from desim.kernel.models.latency import Propagation as Propagation
    from desim.kernel.models.latency import ShiftedExponential as ShiftedExponential
    from desim.kernel.models.latency import Uniform as Uniform
    from desim.kernel.models.latency_by_link import LatencyMatrix as LatencyMatrix
    from desim.kernel.models.latency_by_link import PerPair as PerPair
    from desim.kernel.models.links import Links as Links
    from desim.kernel.models.loss import Bernoulli as Bernoulli
    from desim.kernel.models.loss import ByDistance as ByDistance
    from desim.kernel.models.loss import Correlated as Correlated
    from desim.kernel.models.loss import FourState as FourState
    from desim.kernel.models.loss import GilbertElliott as GilbertElliott
    from desim.kernel.models.medium import Bitrate as Bitrate
    from desim.kernel.models.medium import LoRa as LoRa
    from desim.kernel.models.netem import Netem as Netem
    from desim.kernel.models.reception import Disk as Disk
    from desim.kernel.models.reception import LogDistance as LogDistance
    from desim.kernel.models.reception import Nakagami as Nakagami
    from desim.kernel.models.reception import QuasiUnitDisk as QuasiUnitDisk
    from desim.kernel.models.reception import Rice as Rice
    from desim.kernel.models.transport import BestEffort as BestEffort
    from desim.kernel.models.transport import Coded as Coded
    from desim.kernel.models.transport import Reliable as Reliable
    from desim.kernel.stepped_network import SteppedNetwork as SteppedNetwork
    from desim.kernel.stepped_networks import SteppedNetworks as SteppedNetworks
    from desim.kernel.walls.wall import Wall as Wall
    from desim.learning.make import env as env
    from desim.learning.make import parallel_env as parallel_env
    from desim.pursuit.byzantine.lies import Equivocate as Equivocate
    from desim.pursuit.byzantine.lies import Liar as Liar
    from desim.pursuit.byzantine.lies import RandomLies as RandomLies
    from desim.pursuit.byzantine.lies import ReplayAttack as ReplayAttack
    from desim.pursuit.byzantine.lies import Selective as Selective
    from desim.pursuit.byzantine.lies import Silent as Silent
    from desim.pursuit.byzantine.lies import Slander as Slander
    from desim.pursuit.byzantine.lies import Spoof as Spoof
    from desim.pursuit.evaders.evasion import ConstantHeading as ConstantHeading
    from desim.pursuit.evaders.evasion import Diffusion as Diffusion
    from desim.pursuit.evaders.evasion import Listener as Listener
    from desim.pursuit.evaders.evasion import MaxMin as MaxMin
    from desim.pursuit.evaders.evasion import PureEvasion as PureEvasion
    from desim.pursuit.evaders.evasion import Still as Still
    from desim.pursuit.evaders.evasion import VoronoiVertex as VoronoiVertex
    from desim.pursuit.evaders.evasion import WeightedFlee as WeightedFlee
    from desim.pursuit.evaders.evasion import Zigzag as Zigzag
    from desim.pursuit.evaders.recorded import RecordedMotion as RecordedMotion
    from desim.pursuit.evaders.recorded import RelayNode as RelayNode
    from desim.pursuit.motion.dynamics import Acceleration as Acceleration
    from desim.pursuit.motion.dynamics import TurnRate as TurnRate
    from desim.pursuit.motion.environment import Environment as Environment
    from desim.pursuit.motion.flow import AffineFlow as AffineFlow
    from desim.pursuit.motion.flow import GyreFlow as GyreFlow
    from desim.pursuit.motion.flow import HarmonicFlow as HarmonicFlow
    from desim.pursuit.motion.flow import RecordedFlow as RecordedFlow
    from desim.pursuit.motion.flow import SteadyFlow as SteadyFlow
    from desim.pursuit.motion.guidance import ConstantBearing as ConstantBearing
    from desim.pursuit.motion.guidance import PurePursuit as PurePursuit
    from desim.pursuit.sensing.noise import PositionNoise as PositionNoise
    from desim.pursuit.sensing.noise import RangeBearingNoise as RangeBearingNoise
    from desim.pursuit.sensing.sensing import Sensing as Sensing
    from desim.pursuit.sensing.tracking import AlphaBeta as AlphaBeta
    from desim.pursuit.sensing.tracking import Kalman as Kalman
    from desim.pursuit.team.announcements import Announcements as Announcements
    from desim.pursuit.team.trust import Accusations as Accusations
    from desim.pursuit.team.trust import Plausible as Plausible
    from desim.pursuit.team.trust import Reputation as Reputation
    from desim.pursuit.team.trust import Trimmed as Trimmed
    from desim.scenario.examples import examples as examples
    from desim.scenario.players import Evader as Evader
    from desim.scenario.players import Team as Team
    from desim.scenario.scenario import Capture as Capture
    from desim.scenario.scenario import Clocks as Clocks
    from desim.scenario.scenario import Motion as Motion
    from desim.scenario.scenario import Recording as Recording
    from desim.scenario.scenario import Scenario as Scenario
    from desim.scenario.toml import load as load
    from desim.simulation.run import Result as Result
    from desim.simulation.run import run as run
    from desim.study.ablation.explain import explain as explain
    from desim.study.breaking.losses import fatal_losses as fatal_losses
    from desim.study.breaking.search import find_violation as find_violation
    from desim.study.comparing.bench import bench as bench
    from desim.study.comparing.control import controlled as controlled
    from desim.study.selection.race import race as race
    from desim.study.sensitivity.analysis import sensitivity as sensitivity
    from desim.study.sweeps.folder import compare as compare
    from desim.study.sweeps.folder import open as open  # noqa: A004 - called as `desim.open`
    from desim.study.sweeps.listing import ls as ls
    from desim.study.sweeps.status import status as status
    from desim.study.sweeps.sweep import sweep as sweep
    from desim.view.formats.export import export as export
    from desim.view.pages.notebook import play as play
    from desim.view.pages.replay import replay as replay
    from desim.view.pictures.run_figure import plot as plot


def _imported_later(module: str, name: str) -> Callable[..., Any]:
    """Return a function that calls a function of a module; the module is imported at the first call."""

    def call(*arguments: Any, **options: Any) -> Any:
        return getattr(import_module(module), name)(*arguments, **options)

    return call


def _kinds_of_protocols() -> Mapping[str, Mapping[str, str]]:
    """Return `protocols.KINDS`; raise HiddenPackageError if another package hides `protocols`."""
    check_visible("protocols")
    from protocols import KINDS

    return KINDS


# Lower packages look these functions of higher ones up in tables, so that they import no package above them.
ENVIRONMENTS |= {name: _imported_later("desim.learning.make", name) for name in ("env", "parallel_env")}
MARGINS["margin"] = _imported_later("desim.analysis.properties", "margin")
PICTURES["run"] = _imported_later("desim.view.pictures.run_figure", "html_picture")
WORDINGS["call"] = _imported_later("desim.config.key_errors", "problems_of_call")
KINDS_OF["protocols"] = _kinds_of_protocols
explain_hidden_packages()
_HOMES = homes_of_exports(__file__)
"""The module of each public name; imported on first access, so that `desim --help` does not load numpy."""
__all__ = sorted(_HOMES.keys() - {"open"})  # a star import keeps the built-in `open`


def _import_hints() -> dict[str, str]:
    """Return, by names that users look for in this package, what to write instead."""
    protocols = homes_of_exports(str(package_folder("protocols") / "__init__.py"))
    hints = {name: f"from protocols import {name}" for name in protocols}
    hints["SAP"] = hints["SpatialAdaptivePlay"]
    synonyms = {"simulate": "run", "Simulation": "run", "Simulator": "run", "read": "open", "load_scenario": "load"}
    synonyms |= {"Network": "Links", "Robot": "Team", "Pursuers": "Team"}
    synonyms |= {"Experiment": "Scenario", "Config": "Scenario"}
    return hints | {synonym: f"from desim import {name}" for synonym, name in synonyms.items()}


COMMANDS_ONLY = ("check", "keys", "live", "merge", "netem", "new", "report", "schema", "submit")
"""Commands that are not functions of this package."""


def __getattr__(name: str) -> object:
    """Return the object that a public name denotes; its module is imported on first access.

    Raises:
        AttributeError: if there is no such name.
        ImportError: if the name is one of the package `protocols`, or of a function that has another name here.
        HiddenPackageError: if another package or module hides `protocols`.
        ModuleNotFoundError: if its module needs a package of an extra that is not installed.
    """
    if name in COMMANDS_ONLY:
        raise AttributeError(f"module 'desim' has no attribute {name!r}: `desim {name}` is a command")
    if name not in _HOMES:
        raise missing_export("desim", name, _HOMES, _import_hints())
    if (home := _HOMES[name]) not in sys.modules:
        check_visible("protocols")  # many modules import it
    with naming_extras():
        return getattr(import_module(home), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(_HOMES)
