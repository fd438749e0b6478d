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
from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from desim.config.html import PICTURES
from desim.config.packages import KINDS_OF, check_visible, explain_hidden_packages

if TYPE_CHECKING:
    from desim.analysis.metrics import summary as summary
    from desim.config.data_files import open_data as open_data
    from desim.kernel.access import Aloha as Aloha
    from desim.kernel.access import Csma as Csma
    from desim.kernel.access import CsmaCa as CsmaCa
    from desim.kernel.access import SlottedAloha as SlottedAloha
    from desim.kernel.access import Tdma as Tdma
    from desim.kernel.clock_sync import TwoWay as TwoWay
    from desim.kernel.faults import ClockSkew as ClockSkew
    from desim.kernel.faults import Crash as Crash
    from desim.kernel.faults import Jamming as Jamming
    from desim.kernel.faults import Partition as Partition
    from desim.kernel.faults import RandomCrashes as RandomCrashes
    from desim.kernel.faults import RandomFaults as RandomFaults
    from desim.kernel.graphs import Complete as Complete
    from desim.kernel.graphs import Edge as Edge
    from desim.kernel.graphs import Edges as Edges
    from desim.kernel.graphs import Grid as Grid
    from desim.kernel.graphs import Link as Link
    from desim.kernel.graphs import Ring as Ring
    from desim.kernel.graphs import Star as Star
    from desim.kernel.interference import CaptureEffect as CaptureEffect
    from desim.kernel.interference import Collision as Collision
    from desim.kernel.interference import LoRaInterference as LoRaInterference
    from desim.kernel.interference import Sinr as Sinr
    from desim.kernel.latency import Constant as Constant
    from desim.kernel.latency import Empirical as Empirical
    from desim.kernel.latency import Gamma as Gamma
    from desim.kernel.latency import LatencyMatrix as LatencyMatrix
    from desim.kernel.latency import Lognormal as Lognormal
    from desim.kernel.latency import PerPair as PerPair
    from desim.kernel.latency import Propagation as Propagation
    from desim.kernel.latency import ShiftedExponential as ShiftedExponential
    from desim.kernel.latency import Uniform as Uniform
    from desim.kernel.link_traces import LatencyTrace as LatencyTrace
    from desim.kernel.link_traces import LossTrace as LossTrace
    from desim.kernel.link_traces import SignalTrace as SignalTrace
    from desim.kernel.links import Links as Links
    from desim.kernel.loss import Bernoulli as Bernoulli
    from desim.kernel.loss import ByDistance as ByDistance
    from desim.kernel.loss import Correlated as Correlated
    from desim.kernel.loss import FourState as FourState
    from desim.kernel.loss import GilbertElliott as GilbertElliott
    from desim.kernel.medium import Bitrate as Bitrate
    from desim.kernel.medium import LoRa as LoRa
    from desim.kernel.netem import Netem as Netem
    from desim.kernel.reception import Disk as Disk
    from desim.kernel.reception import LogDistance as LogDistance
    from desim.kernel.reception import Nakagami as Nakagami
    from desim.kernel.reception import QuasiUnitDisk as QuasiUnitDisk
    from desim.kernel.reception import Rice as Rice
    from desim.kernel.trace_file import TraceFile as TraceFile
    from desim.kernel.transport import BestEffort as BestEffort
    from desim.kernel.transport import Coded as Coded
    from desim.kernel.transport import Reliable as Reliable
    from desim.pursuit.announcements import Announcements as Announcements
    from desim.pursuit.dynamics import Acceleration as Acceleration
    from desim.pursuit.dynamics import TurnRate as TurnRate
    from desim.pursuit.evasion import ConstantHeading as ConstantHeading
    from desim.pursuit.evasion import Diffusion as Diffusion
    from desim.pursuit.evasion import Listener as Listener
    from desim.pursuit.evasion import MaxMin as MaxMin
    from desim.pursuit.evasion import PureEvasion as PureEvasion
    from desim.pursuit.evasion import Still as Still
    from desim.pursuit.evasion import VoronoiVertex as VoronoiVertex
    from desim.pursuit.evasion import WeightedFlee as WeightedFlee
    from desim.pursuit.evasion import Zigzag as Zigzag
    from desim.pursuit.flow import AffineFlow as AffineFlow
    from desim.pursuit.flow import Environment as Environment
    from desim.pursuit.flow import GyreFlow as GyreFlow
    from desim.pursuit.flow import HarmonicFlow as HarmonicFlow
    from desim.pursuit.flow import RecordedFlow as RecordedFlow
    from desim.pursuit.flow import SteadyFlow as SteadyFlow
    from desim.pursuit.guidance import ConstantBearing as ConstantBearing
    from desim.pursuit.guidance import PurePursuit as PurePursuit
    from desim.pursuit.lies import Equivocate as Equivocate
    from desim.pursuit.lies import Liar as Liar
    from desim.pursuit.lies import RandomLies as RandomLies
    from desim.pursuit.lies import ReplayAttack as ReplayAttack
    from desim.pursuit.lies import Selective as Selective
    from desim.pursuit.lies import Silent as Silent
    from desim.pursuit.lies import Slander as Slander
    from desim.pursuit.lies import Spoof as Spoof
    from desim.pursuit.noise import PositionNoise as PositionNoise
    from desim.pursuit.noise import RangeBearingNoise as RangeBearingNoise
    from desim.pursuit.recorded import RecordedMotion as RecordedMotion
    from desim.pursuit.recorded import RelayNode as RelayNode
    from desim.pursuit.sensing import Sensing as Sensing
    from desim.pursuit.tracking import AlphaBeta as AlphaBeta
    from desim.pursuit.tracking import Kalman as Kalman
    from desim.pursuit.trust import Accusations as Accusations
    from desim.pursuit.trust import Plausible as Plausible
    from desim.pursuit.trust import Reputation as Reputation
    from desim.pursuit.trust import Trimmed as Trimmed
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
    from desim.study.explain import explain as explain
    from desim.study.folder import open as open  # noqa: A004 - called as `desim.open`
    from desim.study.sweep import sweep as sweep
    from desim.view.replay import replay as replay
    from desim.view.run_figure import plot as plot
    from desim.view.widget import play as play


def _picture_of_run(result: Any) -> str:
    """Return the paths of a run as an HTML image for notebooks; see `desim.view.run_figure.html_picture`."""
    from desim.view.run_figure import html_picture

    return html_picture(result)


def _kinds_of_protocols() -> Mapping[str, Mapping[str, str]]:
    """Return `protocols.KINDS`; raise HiddenPackageError if another package hides `protocols`."""
    check_visible("protocols")
    from protocols import KINDS

    return KINDS


PICTURES["run"] = _picture_of_run
KINDS_OF["protocols"] = _kinds_of_protocols
explain_hidden_packages()
_NAMES = {
    "desim.analysis.metrics": ("summary",),
    "desim.config.data_files": ("open_data",),
    "desim.kernel.access": ("Aloha", "Csma", "CsmaCa", "SlottedAloha", "Tdma"),
    "desim.kernel.clock_sync": ("TwoWay",),
    "desim.kernel.faults": ("ClockSkew", "Crash", "Jamming", "Partition", "RandomCrashes", "RandomFaults"),
    "desim.kernel.graphs": ("Complete", "Edge", "Edges", "Grid", "Link", "Ring", "Star"),
    "desim.kernel.interference": ("CaptureEffect", "Collision", "LoRaInterference", "Sinr"),
    "desim.kernel.latency": (
        "Constant",
        "Empirical",
        "Gamma",
        "LatencyMatrix",
        "Lognormal",
        "PerPair",
        "Propagation",
        "ShiftedExponential",
        "Uniform",
    ),
    "desim.kernel.link_traces": ("LatencyTrace", "LossTrace", "SignalTrace"),
    "desim.kernel.links": ("Links",),
    "desim.kernel.loss": ("Bernoulli", "ByDistance", "Correlated", "FourState", "GilbertElliott"),
    "desim.kernel.medium": ("Bitrate", "LoRa"),
    "desim.kernel.netem": ("Netem",),
    "desim.kernel.reception": ("Disk", "LogDistance", "Nakagami", "QuasiUnitDisk", "Rice"),
    "desim.kernel.trace_file": ("TraceFile",),
    "desim.kernel.transport": ("BestEffort", "Coded", "Reliable"),
    "desim.pursuit.announcements": ("Announcements",),
    "desim.pursuit.dynamics": ("Acceleration", "TurnRate"),
    "desim.pursuit.evasion": (
        "ConstantHeading",
        "Diffusion",
        "Listener",
        "MaxMin",
        "PureEvasion",
        "Still",
        "VoronoiVertex",
        "WeightedFlee",
        "Zigzag",
    ),
    "desim.pursuit.flow": ("AffineFlow", "Environment", "GyreFlow", "HarmonicFlow", "RecordedFlow", "SteadyFlow"),
    "desim.pursuit.guidance": ("ConstantBearing", "PurePursuit"),
    "desim.pursuit.lies": (
        "Equivocate",
        "Liar",
        "RandomLies",
        "ReplayAttack",
        "Selective",
        "Silent",
        "Slander",
        "Spoof",
    ),
    "desim.pursuit.noise": ("PositionNoise", "RangeBearingNoise"),
    "desim.pursuit.recorded": ("RecordedMotion", "RelayNode"),
    "desim.pursuit.sensing": ("Sensing",),
    "desim.pursuit.tracking": ("AlphaBeta", "Kalman"),
    "desim.pursuit.trust": ("Accusations", "Plausible", "Reputation", "Trimmed"),
    "desim.scenario.examples": ("examples",),
    "desim.scenario.players": ("Evader", "Team"),
    "desim.scenario.scenario": ("Capture", "Clocks", "Motion", "Recording", "Scenario"),
    "desim.scenario.toml": ("load",),
    "desim.simulation.run": ("Result", "run"),
    "desim.study.explain": ("explain",),
    "desim.study.folder": ("open",),
    "desim.study.sweep": ("sweep",),
    "desim.view.replay": ("replay",),
    "desim.view.run_figure": ("plot",),
    "desim.view.widget": ("play",),
}
"""The public names by module. Each is imported on first access, so that `desim --help` does not load numpy."""
_HOMES = {name: home for home, names in _NAMES.items() for name in names}
__all__ = sorted(_HOMES.keys() - {"open"})  # a star import keeps the built-in `open`


def __getattr__(name: str) -> object:
    """Return the object that a public name denotes; its module is imported on first access.

    Raises:
        AttributeError: if there is no such name.
        HiddenPackageError: if another package or module hides `protocols`.
    """
    if name not in _HOMES:
        raise AttributeError(f"module 'desim' has no attribute {name!r}")
    if (home := _HOMES[name]) not in sys.modules:
        check_visible("protocols")
    return getattr(import_module(home), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(_HOMES)
