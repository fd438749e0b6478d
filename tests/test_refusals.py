"""What a scenario file may not say is refused with file, line, key and what is allowed.

Bounds, types and choices are derived from the models, those of every kind included: each file plants a wrong value in
all keys of one table, as many files as the key with the most bounds needs. One example each of all other faults is
written out.
"""

from collections.abc import Iterator
from decimal import Decimal
from math import inf, nextafter
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

import annotated_types
import pytest
from pydantic import Field, WrapValidator, create_model
from pydantic.fields import FieldInfo

from desim.config.choice import choices_of
from desim.config.field_docs import fields_of
from desim.config.model import Value
from desim.config.model_parts import models_in
from desim.kernel.models.graphs import Edges
from desim.kernel.models.latency import Empirical
from desim.kernel.models.latency_by_link import LatencyMatrix
from desim.kernel.models.netem import Netem
from desim.kernel.walls.wall import Wall
from desim.pursuit.evaders.recorded import RecordedMotion, RecordedPositions
from desim.pursuit.motion.flow import RecordedFlow
from desim.scenario import toml
from desim.scenario.overrides import ScenarioError
from desim.scenario.scenario import Scenario
from desim.scenario.toml import load, read_source
from desim.study.plan.configurations import configurations
from protocols import Policy
from tests.command import JARGON
from tests.golden import golden

BOUNDS = {
    annotated_types.Ge: ("ge", "greater than or equal to", -inf),
    annotated_types.Gt: ("gt", "greater than", 0.0),
    annotated_types.Le: ("le", "less than or equal to", inf),
    annotated_types.Lt: ("lt", "less than", 0.0),
}
"""Of each kind of bound its attribute, its text, and in which direction from it the nearest wrong number lies."""
TYPES = {float: ("true", "a number"), int: ("2.5", "an integer"), bool: ("1", "true or false"), str: ("3", "a string")}
"""A TOML value of another type, and its error message."""


class Wrong(NamedTuple):
    """A value that a key refuses."""

    toml: str
    words: str
    """The text after "should be"."""
    below: tuple[int, ...] = ()
    """Positions in the lists that the value is, down to what is wrong."""


class Table(NamedTuple):
    """A table of a scenario file that a model describes."""

    path: tuple[tuple[str, str | None, bool], ...]
    """Key, kind and whether it is a list of tables, of each table from the top down to it."""
    model: type[Value]

    @property
    def place(self) -> str:
        """Its place as refusals name it, with the kind that it has."""
        return ".".join(f"{key}.0" if listed else key for key, _, listed in self.path)

    def __str__(self) -> str:
        return ".".join(f"{key}.{kind}" if kind else key for key, kind, _ in self.path) or "the top"


def tables(model: type[Value] = Scenario) -> Iterator[Table]:
    """Yield a table for each model that a scenario may hold, where it is least deep."""
    seen, found = {model}, [Table((), model)]
    for table in found:  # it grows
        yield table
        for key, field in fields_of(table.model).items():
            listed = get_origin(field.annotation) is tuple
            kinds = [item for choices in choices_of(field) for item in choices.choices().items()]
            for kind, inner in kinds or [(None, each) for each in models_in(field.annotation)]:
                if issubclass(inner, Value) and inner not in seen:
                    seen.add(inner)
                    found.append(Table((*table.path, (key, kind, listed)), inner))


def wrong_of(field: FieldInfo) -> list[Wrong]:
    """Return values that a key refuses."""
    wrong = list(wrong_values(field.annotation, tuple(field.metadata)))
    if kinds := [kind for choices in choices_of(field) for kind in choices.choices()]:
        words = f'a table with a kind, {{ kind = "{kinds[0]}" }} for instance; allowed: {", ".join(kinds)}'
        wrong.append(Wrong("[true]", words, (0,)) if wrong else Wrong("true", words))
    elif not wrong and any(models_in(field.annotation)):
        wrong.append(Wrong("3", "a table"))
    return wrong


def wrong_values(annotation: Any, metadata: tuple[Any, ...] = ()) -> Iterator[Wrong]:
    """Yield values just beyond each bound of a type, one of another type and, of a float, what is not finite."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        yield from wrong_values(inner[0], (*_flat(inner[1:]), *metadata))
    elif origin in {Union, UnionType}:
        arms = [each for each in inner if each is not NoneType]
        found = [wrong for each in arms for wrong in wrong_values(each)]
        yield from (wrong for wrong in found if len(arms) == 1 or wrong.words != "a list")
    elif origin is Literal:
        *others, last = map(repr, inner)
        yield Wrong("'nonsense'", f"{', '.join(others)} or {last}" if others else last)
    elif origin is tuple:
        yield Wrong("3", "a list")
        yield from (Wrong(f"[{each.toml}]", each.words, (0, *each.below)) for each in wrong_values(inner[0]))
    elif annotation in TYPES:
        yield Wrong(*TYPES[annotation])
        bounds = [each for each in metadata if type(each) in BOUNDS]
        for bound in bounds:
            name, words, outwards = BOUNDS[type(bound)]
            limit = getattr(bound, name)
            step = 0 if not outwards else 1 if outwards > 0 else -1
            beyond = limit + step if annotation is int else nextafter(limit, outwards) if step else float(limit)
            yield Wrong(str(beyond), f"{words} {Decimal(str(limit)):f}".removesuffix(".0"))
        if annotation is float:
            yield Wrong("nan", "")
            if any(getattr(mark, "allow_inf_nan", None) is False for mark in metadata):
                yield Wrong("inf", "a finite number")


def _flat(metadata: tuple[Any, ...]) -> Iterator[Any]:
    """Yield the marks of a type, those of a `Field` one by one."""
    for each in metadata:
        yield from each.metadata if isinstance(each, FieldInfo) else [each]


def not_refused(table: Table, folder) -> list[str]:
    """Return the wrong values that the refusals of a table's keys do not tell of as they should.

    The refusal of each names file, line, key, what the key takes and, if it has a sentence, what it means.
    """
    wrong = {key: wrong_of(field) for key, field in fields_of(table.model).items() if (table.model, key) not in BY_HAND}
    file, missed = folder / "f.toml", []
    for k in range(max(map(len, wrong.values()), default=0)):
        lines = _headers(table)
        planted = {}
        for key, each in wrong.items():
            if each:
                planted[key] = (len(lines) + 1, each[k % len(each)])
                lines.append(f"{key} = {planted[key][1].toml}")
        file.write_text("\n".join(lines) + "\n")
        try:
            load(file)
            said = []
        except ScenarioError as error:
            said = str(error).splitlines()
        for key, (line, value) in planted.items():
            meaning = " ".join((fields_of(table.model)[key].description or "").partition("\n\n")[0].split()).rstrip(".")
            place = ".".join([*filter(None, [table.place]), key, *map(str, value.below)])
            start = f"{file}:{line}: {place}: should be {value.words}"
            if not any(each.startswith(start) and meaning in each and not JARGON.search(each) for each in said):
                missed.append((f"{key} = {value.toml}", start, said))
    return missed


def _headers(table: Table) -> list[str]:
    """Return the lines of the tables that lead to a table, up to its keys."""
    lines = []
    for depth, (_, kind, listed) in enumerate(table.path, start=1):
        name = ".".join(key for key, *_ in table.path[:depth])
        lines += ["", f"[[{name}]]" if listed else f"[{name}]", *([f"kind = '{kind}'"] if kind else [])]
    return lines


TABLES = list(tables())
BY_HAND = {(each.model, "kind") for each in TABLES}
BY_HAND |= {
    (each, "file") for each in (Empirical, Edges, LatencyMatrix, Netem, Policy, RecordedFlow, RecordedMotion, Wall)
}
BY_HAND.add((LatencyMatrix, "values"))  # nan stands for a link that does not exist
BY_HAND |= {(RecordedMotion, "node"), (RecordedPositions, "nodes")}
"""Keys whose refusals are written out below or in `tests/pursuit/test_recorded.py`.

They take several types, or the value of another key decides what they take."""


@pytest.mark.parametrize("table", TABLES, ids=str)
def test_a_wrong_value_is_reported_with_file_line_key_and_allowed_values(table, tmp_path):
    assert not_refused(table, tmp_path) == []


def test_the_keys_with_what_they_take_and_their_defaults_are_golden():
    """A bound that is moved or taken away is seen here: above, what is refused follows from it."""
    golden("keys.txt", "".join(f"{line}\n" for table in TABLES for line in _keys(table)))


def _keys(table: Table) -> Iterator[str]:
    for key, field in fields_of(table.model).items():
        if key == "kind":
            continue
        default = "" if field.is_required() else f" = {_plain(field.get_default(call_default_factory=True))!r}"
        takes = ", ".join(dict.fromkeys(each.words for each in wrong_of(field) if each.words))
        yield f"{table}: {key}{default}: {takes}"


def _plain(default: Any) -> Any:
    return default.plain() if isinstance(default, Value) else default


def unbounded(model: type[Value]) -> list[str]:
    """Return the keys that take any number."""
    said = {key: [each.words for each in wrong_of(field)] for key, field in fields_of(model).items()}
    return [key for key, words in said.items() if {"a number", "an integer"} & {*words} and not _bounded(words)]


def _bounded(words: list[str]) -> bool:
    return any(each.startswith(("greater than", "less than")) for each in words)


def test_no_key_takes_any_number():
    assert [(str(table), unbounded(table.model)) for table in TABLES if unbounded(table.model)] == []


class Lax(Value):
    """A table whose keys are declared, but whose bounds are missing or not enforced."""

    whatever: float = 0.0
    unenforced: Annotated[float, Field(ge=0), WrapValidator(lambda value, _: value)] = 0.0
    bounded: Annotated[float, Field(ge=0, strict=True)] = 0.0
    """A length, m."""


def test_a_bound_that_is_missing_or_not_enforced_is_detected(tmp_path, monkeypatch):
    monkeypatch.setattr(toml, "Scenario", create_model("Scenario", __base__=Scenario, lax=(Lax, Lax())))
    assert unbounded(Lax) == ["whatever"]
    missed = not_refused(Table((("lax", None, False),), Lax), tmp_path)
    assert {each.split(" = ")[0] for each, *_ in missed} == {"whatever", "unenforced"}


RADIO = "[network.medium]\nkind = 'bitrate'\nbitrate = 9600.0\n"
ACCESS = "[network.medium.access]\n"
FAULTS = [
    "name = 'x'\nhorizn = 3.0",
    "name = 'x'\n\nzzz = 3.0",
    "[evader]\nsped = 0.9",
    "[network]\nrange = 3.0\nlatency = { kind = 'constant', vlue = 1.0 }",
    "[protocol]\nkind = 'sap'\n\n[protocol.tau]\nkind = 'paper'\nscal = 1.0",
    "[team]\nspeeds = { default = 1.0, lst = 2.0 }",
    "name = 'x'\n\n[foo.bar]\na = 1",
    "evader.strategy = { kind = 'voronoi_vertex' }",
    "[evader]\nspeed = '60'",
    "[team]\nspeeds = 'fast'",
    "[team]\ncount = true",
    "seed = 2020-01-01",
    "[horizon.x]\ny = 1",
    "name = 'x'\n\n[[team]]\ncount = 3",
    "network.graph = { kind = 'edges', file = 3 }",
    "name = 'x'\n[protocol]\nkind = 'sop'",
    "[protocol]\nkind = [1]",
    "network.latency = {}",
    "fault = [{ kind = 'crahs' }]",
    "evader.strategy = { kind = 'listener', during_handover = { kind = 'listener' } }",
    "evader.strategy = { kind = 'listener', normally = { kind = 'zigzag', period = -1.0 } }",
    "network.link = [{ src = 0, dst = 2, latency = { kind = 'constant', value = -2.0 } }]",
    "team.positions = [[1.0, 2.0, 3.0]]",
    "team.positions = [[1.0]]",
    "team.positions = []",
    "[team]\ncount = 3\npositions = [[1.0, 2.0]]",
    "[team]\npositions = [\n  [0.0, 0.0],\n]\nspeeds = [1.0, 2.0]",
    "team.box = [20.0, 0.0]",
    "evader.strategy = { kind = 'voronoi_vertex', arena = [5.0, 5.0] }",
    "record.trajectory = 1e-12",
    "horizon = 5e-324",
    "network.latency = { kind = 'uniform', low = 2.0, high = 1.0 }",
    "network.loss = { kind = 'gilbert_elliott', share = 0.9, burst = 2.0 }",
    "fault = [{ kind = 'crash', node = 1, start = 2.0, end = 1.0 }]",
    "fault = [{ kind = 'partition', start = 1.0, groups = [[0, 1], [1]] }]",
    "network.latency = { kind = 'empirical' }",
    "network.latency = { kind = 'matrix' }",
    "network.latency = { kind = 'matrix', values = 3 }",
    "network.latency = { kind = 'matrix', values = [[0.0, -1.0], ['1', 0.0]] }",
    "network.latency = { kind = 'matrix', values = [[0.0, 1.0], [1.0]] }",
    "team.count = 3\nnetwork.latency = { kind = 'matrix', values = [[0.0, 1.0], [1.0, 0.0]] }",
    "evader.strategy = { kind = 'recorded' }",
    "evader.strategy = { kind = 'recorded', file = 3 }",
    "evader.strategy = { kind = 'recorded', file = 'no.txt', node = 1 }",
    "[evader]\nstrategy = { kind = 'recorded', waypoints = [[0.0, 1.0, 1.0], [1.0, 2.0, 1.0]] }",
    "[[team.relay]]\npursuer = 20\nmotion = { kind = 'recorded', waypoints = [[0.0, 1.0, 1.0]] }",
    "network.link = [{ src = 0, dst = 2 }]",
    "network.latency = { kind = 'trace' }",
    "network.latency = { kind = 'trace', table = \"t,rtt\\n0,1\" }",
    "team.count = 3\n[network.loss]\nkind = 'signal_trace'\ntable = \"t,src,dst,value\\n0,0,1,weak\"",
    "team.count = 3\n[network.loss]\nkind = 'trace'\ntable = \"t,src,dst,value\\n0,0,1,1\\n0,0,3,1\"",
    "team.count = 4\nnetwork.link = [{ src = 0, dst = 2, order = 'fifo' }, { src = 1, dst = 9, order = 'fifo' }]",
    "network = { graph = { kind = 'ring' }, link = [{ src = 0, dst = 2, order = 'fifo' }] }",
    "network.link = [{ src = 0, dst = 2, both_ways = true, order = 'fifo' }, { src = 2, dst = 0, order = 'fifo' }]",
    "team.count = 4\nnetwork.graph = { kind = 'edges', nodes = 3, edges = [{ src = 0, dst = 1 }] }",
    "team.count = 4\nnetwork.graph = { kind = 'edges', edges = [{ src = 0, dst = 1 }, { src = 1, dst = 0 }] }",
    "team.count = 4\nnetwork.graph = { kind = 'edges', edges = [{ src = 0, dst = 4 }] }",
    "team.count = 4\nnetwork.graph = { kind = 'star', centre = 4 }",
    "network.graph = { kind = 'edges', file = 'no.json' }",
    "[network.medium]\naccess = { kind = 'csma' }",
    "[network.medium]\nkind = 'unlimited'\naccess = 'csma'",
    "[network.medium]\nkind = 'bitrate'\naccess = 'csma'",
    f"{RADIO}access = 'cmsa'",
    f"{RADIO}shared = true\n\naccess = 'aloha'",
    f"{RADIO}access = 'aloha'\n\nreception = 'lora'",
    f"team.count = 4\n{RADIO}{ACCESS}kind = 'tdma'\nslot = 0.1\nslots = [0, 1, 2]",
    f"team.count = 2\n{RADIO}{ACCESS}kind = 'tdma'\nslot = 0.1\nslots = [0, 1, 2]",
    f"{RADIO}{ACCESS}kind = 'tdma'\nguard = 0.001\nslot = 0.02",
    f"{RADIO}{ACCESS}kind = 'tdma'\nguard = 0.1\nslot = 0.1",
    "team.count = 9\nprotocol = { kind = 'sap', schedule = { kind = 'token_ring' } }\n"
    f"{RADIO}{ACCESS}kind = 'tdma'\nslot = 0.1",
    f"{RADIO}{ACCESS}kind = 'csma_ca'\nsifs = 0.1",
    "[network]\npreset = 'lora_sf7'\nmedium = { access = 'ideal' }",
    "team.count = 3\n[network.medium]\nkind = 'lora'\naccess = 'aloha'\nspreading_factors = [7, 8]",
    "team.count = 2\n[network.medium]\nkind = 'lora'\n\nfrequencies = [868e6, 869e6]",
    "fault = [{ kind = 'crash', node = 1, start = 2.0 }, { kind = 'crash', node = 20, start = 2.0 }]",
    "fault = [{ kind = 'liar', start = 0.0 }]",
    "fault = [{ kind = 'silent', start = 0.0, node = 1, share = 0.5 }]",
    "fault = [{ kind = 'spoof', start = 1.0, end = 0.5, node = 1 }]",
    "[[fault]]\nkind = 'spoof'\nstart = 0.0\nnode = 20\nvictim = 21",
    "fault = [{ kind = 'slander', start = 0.0, node = 1, accused = [3, 40] }]",
    "fault = [{ kind = 'liar', start = 0.0, node = 1, phi = { kind = 'random', low = 2.0, high = 1.0 } }]",
    "fault = [{ kind = 'liar', start = 0.0, node = 1, phi = 'plausibel' }]",
    "announce.trust = { kind = 'trimmed', F = 1 }",
    "[evader]\nposition = [[1.0, 2.0]]",
    "[protocol]\nkind = 'sap'\nsap = 1\ntau = { kind = 'constant', value = -1.0 }",
    "[[evader]]\n\n[[evader]]\nspeed = -0.8\nstrategy = { kind = 'max_min', candidates = 0 }\n"
    "[[evader]]\ncolour = 'red'\n[evader.strategy]\nkind = 'zigzag'\namplitud = 0.1\n"
    "[[evader]]\nstrategy = { kind = 'voronoi_vertex' }",
]
"""Files that are wrong in ways that no type expresses, or in one way of each kind."""
GRIDS = [
    '"team.count" = [0]',
    "team.count = [1, 0]",
    'protocol.kind = ["sapp"]',
    'protocol = ["sapp"]',
    'protocol = [{ kind = "sap", tua = 1 }]',
    'network.preset = ["wify"]',
    "team.positions = [[[0.0, 1.0]]]",
    "fault.0.start = [1.0]",
    "horizon.x = [1.0]",
    "horizon = 1.0",
    'prune = "inf"',
    "horizon = []",
    "motion.step = []",
    "",
    "horizon = {}",
    'horizn = [1.0, 2.0]\nmotion.steps = [1.0]\n"network.latency.valu" = [0.0]',
    "horizon = [1.0, -1.0]\n\n\n\n\nteam.count = [2, 0]\nmotion.steps = [0.1, 0.2]",
    'horizon = [1.0]\n"seed" = [1, 2]',
    'horizon = [1.0]\n"name" = [1, 2]',
    'horizon = [1.0]\n"sweep.reps" = [1, 2]',
    'horizon = [1.0]\n"sweep.grid" = [1, 2]',
    "prune = ['inf']\nhorizon = [1.0, 2.0, 1.0]",
    "prune = ['inf']\nhorizon = [1, 2, 1]",
    "prune = ['inf']\nhorizon = [1, 2, 1.0]",
    'horizon = [1.0, 2.0]\nteam.count = [2, 4]\nfault = [[{ kind = "crash", node = 1, start = 0 }], '
    '[{ kind = "crash", node = 3, start = 0 }]]',
]
"""Grids that are wrong, over GRID."""
GRID = 'horizon = 1.0\nteam.count = 2\nnetwork.latency = { kind = "constant", value = 0.02 }\n[sweep.grid]\n'
OVERRIDES = [
    ("", "horizn=3"),
    ("horizon = 3.0", "horizon="),
    ("", "team.count=many"),
    ("[evader]\nspeed = 1.0", "evader={ speed = -1.0 }"),
    ("team.positions = [[0.0, 0.0]]", "team.positions.0.1=x"),
    ("", "horizon.x=3"),
    ("", "team.0.count=3"),
    *(("", each) for each in ("horizon", "", "=3", "team..count=3", ".=3", "  =3")),
    ("horizon = 3.0", "horizon.x=3"),
    ("horizon = 3.0", "horizon.x.y=3"),
    ("team.speeds = [1.0, 2.0]", "team.speeds.last=3"),
    ("team.positions = [[0.0, 0.0]]", "team.positions.2=3"),
    ("team.positions = [[0.0, 0.0]]", "team.positions.\u00b2=3"),
    ("evader.position = [1.0, 0.0]", "evader.position.x=3"),
    ("", 'name="a'),
    ("", "seed=1\nhorizon=-2"),
]
"""Files that are right, and overrides that are not."""


def refusal(folder: Path, text: str, *overrides: str) -> str:
    """Return a file and its overrides, and how they are refused, with the name of the file instead of its path."""
    file = folder / "f.toml"
    file.write_text(f"{text}\n")
    with pytest.raises(ScenarioError) as refused:
        configurations(read_source(file, overrides)) if text.startswith(GRID) else load(file, overrides)
    said = str(refused.value).replace(f"{folder}/", "")
    assert not JARGON.search(said)
    given = [*text.removeprefix(GRID).splitlines(), *(f"--set {each}" for each in overrides)]
    return "".join(f"    {each}".rstrip() + "\n" for each in given) + f"{said}\n\n"


@pytest.mark.parametrize(
    ("name", "cases"),
    [("files", [(each,) for each in FAULTS]), ("grids", [(GRID + each,) for each in GRIDS]), ("overrides", OVERRIDES)],
)
def test_refusals_are_golden(name, cases, tmp_path):
    """Each names file, line, key and allowed values: review it when it is regenerated."""
    golden(f"refused_{name}.txt", "".join(refusal(tmp_path, *each) for each in cases))
