"""What breaks each protocol: the smallest scenario in which it leaves the evader alone for long, and its price.

The search begins with six pursuers that are equally fast, so that any can stand in for another, a latency of 0.1 s,
and announcements over the network. It adds imperfections at random (`desim break`) until a protocol leaves the evader
without a pursuer for 5 s more than the centralised planner does in the same scenario with the same seed. What it finds
is made as small as it can be, and all other protocols are run in it. The same is done with `local_min` under each kind
of trust.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any

import click

from desim import Announcements, Links, Scenario, Team
from desim.analysis.properties import Judgement
from desim.analysis.tables import aligned
from desim.config.traits import kind_of
from desim.config.trust import write_whole
from desim.pursuit.team.trust import TRUSTS
from desim.scenario.scenario import PROTOCOLS
from desim.study.breaking.found import case_text, scenario_text
from desim.study.breaking.search import WITHOUT_WEIGHTS, Search, find_violation
from scenarios.studies.study import Options, study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AGAINST = "centralised"
PROPERTY = f"idle at most 5 in total against {AGAINST}"
BASE = Scenario(
    name="breaking",
    team=Team(count=6, speeds=2.5),
    horizon=20.0,
    network=Links(latency=0.1),
    announce=Announcements(payload="time"),
)
TRUSTED = "local_min"
"""The protocol that is searched under each kind of trust."""


@dataclass(frozen=True)
class Broken:
    """What breaks a protocol."""

    name: str
    """The protocol, and the kind of trust after a plus sign."""
    search: Search
    protocols: Mapping[str, Judgement | str]
    """What each protocol does in the smallest scenario; nothing without one."""


def bases() -> dict[str, Scenario]:
    """Return the scenario in which each search begins, by the name of the protocol and the trust."""
    kinds = [kind for kind in PROTOCOLS.choices() if kind not in (AGAINST, WITHOUT_WEIGHTS)]
    by_name = {kind: BASE.with_({"protocol": kind}) for kind in kinds}
    for kind in TRUSTS.choices():
        if kind != kind_of(BASE.announce.trust):
            by_name[f"{TRUSTED} + {kind}"] = BASE.with_({"protocol": TRUSTED, "announce.trust": {"kind": kind}})
    return by_name


def table(broken: Sequence[Broken], cases: int) -> str:
    """Return the results as text."""
    rows: list[tuple[str, ...]] = [("protocol", "smallest scenario", "case", "seed", "idle (s)", "others")]
    for one in broken:
        violation = one.search.violation
        if violation is None:
            rows.append((one.name, f"none in {one.search.runs}; least margin {one.search.closest:.2f} s", *[""] * 4))
            continue
        others = sum(not verdict.holds for verdict in one.protocols.values() if isinstance(verdict, Judgement)) - 1
        idle = f"{violation.verdict.measure:.1f}"
        rows.append(
            (one.name, case_text(violation.case), f"{violation.searched}", f"{violation.seed}", idle, f"{others}")
        )
    about = f'"{PROPERTY}", at most {cases} cases each; others: protocols that violate it in the same scenario, too'
    return f"{about}\n{aligned(rows, right_from=2)}"


def picture(broken: Sequence[Broken]) -> "Figure":
    """Draw the time for which each protocol leaves the evader alone in the smallest scenario of each other one."""
    import numpy as np

    from desim.analysis.drawing import plots

    violated = [one for one in broken if one.search.violation is not None]
    rows = sorted({kind for one in violated for kind in one.protocols})
    values = np.array([[_excess(one.protocols.get(kind)) for one in violated] for kind in rows])
    with plots.styled(figsize=(plots.COLUMN * 1.6, 0.6 + 0.2 * len(rows)), font=7.0) as figure:
        axes = figure.add_subplot()
        shown = axes.imshow(values, cmap="Greys", vmin=0.0, vmax=8.0, aspect="auto")
        axes.set_yticks(range(len(rows)), rows)
        axes.set_xticks(
            range(len(violated)), [one.name for one in violated], rotation=60, ha="right", rotation_mode="anchor"
        )
        axes.set(xlabel="smallest scenario that breaks ...", ylabel="protocol in it")
        axes.tick_params(length=0)
        figure.colorbar(shown, ax=axes, label="idle beyond centralised (s)")
    return figure


def _excess(verdict: Judgement | str | None) -> float:
    """Return the time without a pursuer, s, beyond that of the reference; nan if the protocol cannot be run there."""
    if not isinstance(verdict, Judgement) or verdict.reference is None:
        return float("nan")
    return max(verdict.measure - verdict.reference, 0.0)


@study(
    "breaking",
    __doc__,
    100,
    click.Option(["--protocol"], metavar="NAME", help="Search for this protocol only."),
    seconds=4.0,
)
def main(options: Options) -> None:
    """Search, compare and show."""
    only: Any = options.own["protocol"]
    chosen = {name: base for name, base in bases().items() if only in (None, name)}
    if not chosen:
        raise click.BadParameter(f"there is no {only!r}; there are {', '.join(bases())}", param_hint="--protocol")
    broken = []
    options.out.mkdir(parents=True, exist_ok=True)
    for name, base in chosen.items():
        search = find_violation(base, PROPERTY, runs=options.runs, seed=options.seed, jobs=options.jobs)
        violation = search.violation
        broken.append(Broken(name, search, {} if violation is None else violation.protocols()))
        if violation is not None:
            file = options.out / f"breaking-{name.replace(' + ', '-')}.toml"
            command = f"python -m scenarios.breaking --protocol '{name}' --runs {options.runs} --seed {options.seed}"
            write_whole(file, scenario_text(violation, file.name, command).encode())
        click.echo(table(broken[-1:], options.runs).splitlines()[-1], err=True)
    document = {
        "property": PROPERTY,
        "searches": [
            {
                "name": one.name,
                "cases": one.search.runs,
                "closest": None if one.search.closest == inf else one.search.closest,
                "smallest": None if one.search.violation is None else one.search.violation.case,
                "seed": None if one.search.violation is None else one.search.violation.seed,
                "idle_beyond": {kind: _excess(verdict) for kind, verdict in one.protocols.items()},
            }
            for one in broken
        ],
    }
    options.show(document, table(broken, options.runs), lambda: picture(broken))


if __name__ == "__main__":
    main()
