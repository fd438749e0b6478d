"""What breaks each protocol: the smallest scenario in which it leaves the evader alone for long, and its price.

The search begins with six pursuers that are equally fast, so that any can stand in for another, a latency of 0.1 s,
and announcements over the network. It adds imperfections at random (`desim break`) until a protocol leaves the evader
without a pursuer for 5 s more than the centralised planner does in the same scenario with the same seed. The scenario
that it finds is made as small as possible, and all other protocols are run in it. Then the search goes on without the
imperfections that this scenario needs, and may find another weakness. `local_min` under each kind of trust is searched
in the same way, and so are protocols with mended parameters.

All runs are kept in the folder `breaking` of the output. The same command goes on after an interruption, and a command
with more --runs or --minutes goes on where the last one ended.
"""

from collections.abc import Mapping, Sequence, Set
from contextlib import redirect_stderr
from dataclasses import dataclass
from functools import partial
from io import StringIO
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import click

from desim import Announcements, Links, Scenario, Team
from desim.analysis.properties import Judgement
from desim.analysis.tables import aligned
from desim.config.traits import kind_of
from desim.config.whole_files import write_whole
from desim.pursuit.team.trust import TRUSTS
from desim.scenario.properties import property_of
from desim.scenario.scenario import PROTOCOLS
from desim.study.breaking.case_log import CaseLog
from desim.study.breaking.features import FEATURES
from desim.study.breaking.found import case_text, scenario_text
from desim.study.breaking.search import WITHOUT_WEIGHTS, Violation, find_violation
from desim.study.workers.batch import run_many
from scenarios.studies.study import NumberRange, Options, study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AGAINST = "centralised"
PROPERTY = f"idle at most 5 in total against {AGAINST}"
BASE = Scenario(
    team=Team(count=6, speeds=2.5),
    horizon=20.0,
    network=Links(latency=0.1),
    announce=Announcements(payload="time"),
)
TRUSTED = "local_min"
"""The protocol that is searched under each kind of trust."""
MENDED: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "server-takeover": {"protocol": {"kind": "server", "takeover": True}},
        "sap-affordable": {"protocol": "sap", "announce.belief_timeout": "affordable"},
        "local_min-affordable": {"protocol": "local_min", "announce.belief_timeout": "affordable"},
    }
)
"""By name, protocols with parameters that mend a weakness which a search has found."""


@dataclass(frozen=True)
class Weakness:
    """A scenario that breaks a protocol."""

    violation: Violation
    protocols: Mapping[str, Judgement | str]
    """The judgement of each protocol in the scenario, or why it cannot be run there."""

    @property
    def features(self) -> Set[str]:
        """The features that the next search leaves out: all that the scenario needs, except the number of pursuers."""
        return self.violation.case.keys() & FEATURES.keys() - {"team"}


@dataclass(frozen=True)
class Broken:
    """The result of the searches for one protocol."""

    name: str
    """The protocol, with the kind of trust or the mend."""
    weaknesses: Sequence[Weakness]
    """In the order of the searches; each search leaves out the features of the weaknesses before."""
    cases: int
    """The number of cases that were run, without those that made a case smaller."""
    seconds: float
    """The wall time of all runs, s."""
    closest: float
    """The least margin of the last search, s; inf if the search found a weakness."""


def bases() -> dict[str, Scenario]:
    """Return the scenario in which each search begins, by the protocol with its kind of trust or mend."""
    kinds = [kind for kind in PROTOCOLS.choices() if kind not in (AGAINST, WITHOUT_WEIGHTS)]
    trusts = [kind for kind in TRUSTS.choices() if kind != kind_of(BASE.announce.trust)]
    changes: dict[str, Mapping[str, Any]] = {kind: {"protocol": kind} for kind in kinds}
    changes |= {f"{TRUSTED}-{kind}": {"protocol": TRUSTED, "announce.trust": {"kind": kind}} for kind in trusts}
    return {name: BASE.with_({"name": name, **keys}) for name, keys in (changes | {**MENDED}).items()}


def break_protocol(folder: Path, runs: int, seconds: float, scenario: Scenario, seed: int) -> Broken:
    """Search for weaknesses of the protocol of a scenario, one after the other, until cases or time are up.

    The runs are kept in the folder, and the next call does not perform them again. After `seconds` no further cases
    begin; the time of earlier calls counts, too.
    """
    log = CaseLog(folder / f"{scenario.name}.jsonl", property_of(PROPERTY))
    weaknesses: list[Weakness] = []
    cases, spent, closest = 0, 0.0, inf
    features = [*FEATURES]
    with redirect_stderr(StringIO()):  # no progress bars, because several searches run at the same time
        while features and cases < runs and spent < seconds:
            search = find_violation(
                scenario,
                PROPERTY,
                runs=runs - cases,
                seed=seed,
                jobs=1,
                features=features,
                budget=seconds - spent,
                log=log,
            )
            cases, spent, closest = cases + search.runs, spent + search.seconds, inf
            if search.violation is None:
                closest = search.closest
                break
            weaknesses.append(Weakness(search.violation, search.violation.protocols(1, log)))
            if not weaknesses[-1].features:  # the next search could leave out nothing, and would find the same
                break
            features = [feature for feature in features if feature not in weaknesses[-1].features]
    return Broken(scenario.name, weaknesses, cases, spent, closest)


def broken_elsewhere(name: str, broken: Sequence[Broken]) -> list[str]:
    """Return the names of the other searches whose smallest scenario breaks the protocol `name`, too."""
    others = (search for search in broken if search.weaknesses and search.name != name)
    verdicts = {search.name: search.weaknesses[0].protocols.get(name) for search in others}
    return [other for other, verdict in verdicts.items() if isinstance(verdict, Judgement) and not verdict.holds]


def rows_of(broken: Broken) -> list[tuple[str, ...]]:
    """Return the rows of the table about a protocol."""
    rows: list[tuple[str, ...]] = []
    for weakness in broken.weaknesses:
        violation = weakness.violation
        idle, case = f"{violation.verdict.measure:.1f}", case_text(violation.case)
        rows.append((broken.name, case, f"{violation.searched}", f"{violation.seed}", idle, f"{_others(weakness)}"))
    more = "no more" if broken.weaknesses else "none"
    least = "" if broken.closest == inf else f"; least margin {broken.closest:.2f} s"
    end = f"{more} in {broken.cases:,} cases, {broken.seconds / 60.0:.1f} min{least}"
    return [*rows, (broken.name, end, *[""] * 4)]


def _others(weakness: Weakness) -> int:
    """Return how many other protocols violate the property in the same scenario."""
    return sum(not verdict.holds for verdict in weakness.protocols.values() if isinstance(verdict, Judgement)) - 1


def table(broken: Sequence[Broken]) -> str:
    """Return the results as text."""
    rows: list[tuple[str, ...]] = [("protocol", "smallest scenario", "case", "seed", "idle (s)", "others")]
    rows += [row for search in broken for row in rows_of(search)]
    about = f'"{PROPERTY}"; others: protocols that violate it in the same scenario, too'
    breakers = {search.name: broken_elsewhere(search.name, broken) for search in broken if not search.weaknesses}
    notes = [f"{name} is broken by the smallest scenario of {', '.join(by)}" for name, by in breakers.items() if by]
    return "\n".join([about, aligned(rows, right_from=2), *notes])


def picture(broken: Sequence[Broken]) -> "Figure":
    """Draw the time for which each protocol leaves the evader alone in the smallest scenario of each other one."""
    import numpy as np

    from desim.analysis.drawing import plots

    columns = {search.name: search.weaknesses[0].protocols for search in broken if search.weaknesses}
    rows = sorted({kind for protocols in columns.values() for kind in protocols})
    values = np.array([[_excess(protocols.get(kind)) for protocols in columns.values()] for kind in rows])
    with plots.styled(figsize=(plots.COLUMN * 1.6, 0.6 + 0.2 * len(rows)), font=7.0) as figure:
        axes = figure.add_subplot()
        image = axes.imshow(values, cmap="Greys", vmin=0.0, vmax=8.0, aspect="auto")
        axes.set_yticks(range(len(rows)), rows)
        axes.set_xticks(range(len(columns)), [*columns], rotation=60, ha="right", rotation_mode="anchor")
        axes.set(xlabel="smallest scenario that breaks ...", ylabel="protocol in it")
        axes.tick_params(length=0)
        figure.colorbar(image, ax=axes, label="idle beyond centralised (s)")
    return figure


def _excess(verdict: Judgement | str | None) -> float:
    """Return the time without a pursuer, s, beyond that of the reference; nan if the protocol cannot be run there."""
    if not isinstance(verdict, Judgement) or verdict.reference is None:
        return float("nan")
    return max(verdict.measure - verdict.reference, 0.0)


@study(
    "breaking",
    __doc__,
    200,
    click.Option(["--protocol"], metavar="NAME", help="Search for this protocol only, such as local_min-trimmed."),
    click.Option(
        ["--minutes"],
        type=NumberRange(0.0, min_open=True),
        default=inf,
        help="Longest time of each protocol, min.",
    ),
    seconds=2.0,
)
def main(options: Options) -> None:
    """Search, compare and show."""
    only: Any = options.extra["protocol"]
    searched = {name: base for name, base in bases().items() if only in (None, name)}
    if not searched:
        raise click.BadParameter(f"there is no {only!r}; there are {', '.join(bases())}", param_hint="--protocol")
    folder = options.out / "breaking"
    folder.mkdir(parents=True, exist_ok=True)

    def show(_: int, search: Broken) -> None:
        click.echo(aligned(rows_of(search), right_from=2), err=True)
        for number, weakness in enumerate(search.weaknesses, start=1):
            file = options.out / f"breaking-{search.name}{'' if number == 1 else f'-{number}'}.toml"
            command = (
                f"python -m scenarios.breaking --protocol {search.name} --runs {options.runs} --seed {options.seed}"
            )
            write_whole(file, scenario_text(weakness.violation, file.name, command).encode())

    broken = run_many(
        [(base, options.seed) for base in searched.values()],
        options.jobs,
        "searches",
        _itself,
        partial(break_protocol, folder, options.runs, 60.0 * options.extra["minutes"]),  # type: ignore[arg-type]
        show,
    )
    searches = [_document(search) | {"broken_elsewhere": broken_elsewhere(search.name, broken)} for search in broken]
    document = {"property": PROPERTY, "searches": searches}
    has_weaknesses = any(search.weaknesses for search in broken)
    options.show(document, table(broken), (lambda: picture(broken)) if has_weaknesses else None)


def _itself(broken: Any) -> Broken:
    return cast("Broken", broken)


def _document(broken: Broken) -> dict[str, Any]:
    """Return the result of a search as JSON values."""
    return {
        "name": broken.name,
        "cases": broken.cases,
        "minutes": round(broken.seconds / 60.0, 2),
        "closest": None if broken.closest == inf else broken.closest,
        "weaknesses": [
            {
                "smallest": weakness.violation.case,
                "seed": weakness.violation.seed,
                "case": weakness.violation.searched,
                "shrunk": weakness.violation.shrunk,
                "idle_beyond": {kind: _excess(verdict) for kind, verdict in weakness.protocols.items()},
            }
            for weakness in broken.weaknesses
        ],
    }


if __name__ == "__main__":
    main()
