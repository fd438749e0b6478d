"""Scenario files: where each key stands, overrides, and the way there and back."""

import importlib
import re
import sys
import tomllib
from math import inf
from pathlib import Path
from time import perf_counter

import pytest
import tomli_w
from hypothesis import example, given, settings
from hypothesis import strategies as st

from desim.config.errors import KeyedError
from desim.kernel.models.latency import Constant as ConstantLatency
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.team.announcements import STARTS, Announcements
from desim.scenario.checks import warnings
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.players import Evader, Speeds, Team
from desim.scenario.scenario import Capture, Motion, Recording, Scenario
from desim.scenario.toml import dump, load, read_source, validate
from desim.scenario.toml_lines import key_lines
from protocols.centralised import Centralised
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson, SharedSeed
from protocols.temperature import ConstantTau, PaperTau

SCENARIOS = sorted((Path(__file__).parents[2] / "scenarios").glob("*.toml"))


def line_of(text: str, *place: str | int) -> int:
    """Return the line with which an error at a place of a TOML text is reported."""
    source = Source("f", tomllib.loads(text), Scenario, key_lines(text))
    return int(source.where(place).removeprefix("f:"))


# Where keys stand: a document is written together with the line of each of its keys.


class Document:
    """A TOML text, and the line of every key in it that is written out."""

    def __init__(self):
        self.lines: list[str] = []
        self.expected: dict[tuple[str | int, ...], int] = {}
        self.count = 0

    def write(self, text: str) -> int:
        """Append lines and return the number of the first."""
        first = len(self.lines) + 1
        self.lines += text.split("\n")
        return first

    def key(self, style: str) -> tuple[str, str]:
        """Return a new key as it is written, and as it is."""
        self.count += 1
        bare = f"k{self.count}"
        odd = f"{bare} [x] = # .y"
        return {"bare": (bare, bare), "digits": (f"{self.count}", f"{self.count}")}.get(
            style, (f'"{odd}"', odd) if style == "quoted" else (f"'{odd}'", odd)
        )

    @property
    def text(self) -> str:
        return "\n".join(self.lines) + "\n"


STYLES = st.sampled_from(["bare", "bare", "digits", "quoted", "literal"])
# What surrounds a statement without being one, though some of it looks it.
FILLERS = st.sampled_from(["", "# a comment", "  # [x]", "\t", "# k = 1", "#" * 3])
SCALARS = st.sampled_from(
    ["1", "-0.5", "true", "inf", '"[x]"', "'a # b'", '"\\"["', "1979-05-27T07:32:00Z", '""', "''", '"""x"""']
)
# Values of several lines, with lines inside that look like headers, keys, comments and ends of strings.
LONG = st.sampled_from(
    [
        '"""\n[x]\nk1 = 2\n"""',
        "'''\n[[x]]\n# no comment\n\"\"\"\n'''",
        '"""a\n\\"""\n[x]""""',
        '"""\\\n   folded \\\n\n  on\n"""',
        "[\n  1, # one ]\n  2,\n]",
        "[ # [\n\n  [1, 2],\n  [3,\n   4],\n]",
        '[\n  "]",\n  """\n]\n""",\n  "x = 1"\n]',
        "[\n  '[x]'\n]  # [x]",
        '[\n  """a"""", "[",\n  \'\'\'b\'\'\'\', "[",\n]',  # four quotes: the first still belongs to the string
    ]
)
TRAILERS = st.sampled_from(["", "  # [x]", " # k = [", "\t"])


def write_statement(draw, document: Document, table: tuple[str | int, ...]) -> None:
    """Write one key, and what belongs to it, into a table."""
    kind = draw(st.sampled_from(["scalar", "long", "dotted", "inline", "list of tables", "filler"]))
    if kind == "filler":
        document.write(draw(FILLERS))
        return
    (written, key), (written_inside, inside) = document.key(draw(STYLES)), document.key(draw(STYLES))
    indent, trailer = draw(st.sampled_from(["", "  ", "\t"])), draw(TRAILERS)
    if kind in {"scalar", "long"}:
        value, below = draw(SCALARS if kind == "scalar" else LONG), []
        parsed = tomllib.loads(f"v = {value}")["v"]
        below = [(k,) for k in range(len(parsed))] if isinstance(parsed, list) else []
    elif kind == "dotted":
        written, value, below = f"{written} . {written_inside}", draw(SCALARS), [(inside,)]
    elif kind == "inline":
        value, below = f"{{ {written_inside} = {draw(SCALARS)} }}", [(inside,)]
    else:
        value = f"[\n  {{ {written_inside} = 1 }},\n  {{ {written_inside} = {{ a.b = 2 }} }},\n]"
        below = [(0,), (1,), (0, inside), (1, inside), (1, inside, "a", "b")]
    first = document.write(f"{indent}{written} = {value}{trailer}")
    for place in [(), *below]:
        document.expected[*table, key, *place] = first


def write_table(draw, document: Document, parent: tuple[str | int, ...], headers: str, depth: int) -> None:
    """Write a table or an array of tables below another, with statements in it and tables below it."""
    written, key = document.key(draw(STYLES))
    headers = f"{headers}.{written}" if headers else written
    is_array = draw(st.booleans())
    for k in range(draw(st.integers(1, 3)) if is_array else 1):
        table = (*parent, key, k) if is_array else (*parent, key)
        spaced = draw(st.sampled_from(["{}", " {} "])).format(headers)
        document.expected[table] = document.write((f"[[{spaced}]]" if is_array else f"[{spaced}]") + draw(TRAILERS))
        for _ in range(draw(st.integers(0, 3))):
            write_statement(draw, document, table)
        if depth:
            for _ in range(draw(st.integers(0, 2))):
                write_table(draw, document, table, headers, depth - 1)


@st.composite
def documents(draw) -> Document:
    document = Document()
    for _ in range(draw(st.integers(0, 4))):
        write_statement(draw, document, ())
    for _ in range(draw(st.integers(0, 3))):
        write_table(draw, document, (), "", depth=2)
    return document


@pytest.mark.slow
@settings(deadline=None)
@given(documents())
def test_an_error_is_reported_with_the_line_of_its_key(document):
    """In tables, dotted keys, inline tables, arrays of several lines, arrays of tables and tables below them."""
    tables, lines = tomllib.loads(document.text), key_lines(document.text)
    source = Source("f", tables, Scenario, lines)
    found = {place: source.where(place) for place in document.expected}
    assert found == {place: f"f:{line}" for place, line in document.expected.items()}
    for place in lines:  # and nothing else has a line
        node = tables
        for part in place:
            node = node[part]


@pytest.mark.parametrize(
    ("text", "place", "line"),
    [
        ("a = 1\n\n[t.u]\nb = 1", ("t",), 3),
        ("a = 1\n\n[t.u]\nb = 1\n\n[t]\nc = 1", ("t", "c"), 7),
        ("a = 1\n\n[[t]]\nb = 1\n\n[[t]]\nb = 2", ("t",), 3),
        ("a = 1\n\n[[t.u]]\nb = 1", ("t", "u"), 3),
        ("[[t]]\n[[t.u]]\n[[t]]\n\n[[t.u]]\n[t.u.v]", ("t", 1, "u"), 5),
    ],
    ids=["table", "table that comes later", "array of tables", "array of tables below", "array below the second"],
)
def test_a_table_named_only_in_a_longer_header_is_reported_with_the_line_of_that_header(text, place, line):
    assert line_of(text, *place) == line


def test_a_missing_key_is_reported_with_the_line_of_its_table():
    text = "a = 1\n[t]\nb = 1\n[[l]]\n[[l]]\nc = 1"
    assert line_of(text, "t", "missing") == 2
    assert line_of(text, "l", 1, "missing", "too") == 5
    assert line_of(text, "missing") == 1


@pytest.mark.parametrize(
    ("text", "line"),
    [("# a\x85b\nkey = 1\n", 2), ('name = "a\u2028b"\nkey = 1\n', 2), ("name = '''\na\u2029b\n'''\n\nkey = 1\n", 5)],
    ids=["comment", "string", "string of several lines"],
)
def test_only_what_toml_calls_a_line_counts_as_one(text, line):
    """Python's str.splitlines also splits at these, which TOML allows inside comments and strings."""
    assert line_of(text, "key") == line


def test_lines_are_counted_alike_whatever_ends_them(tmp_path):
    (tmp_path / "dos.toml").write_bytes(b"[team]\r\ncount = 3\r\n\r\n[evader]\r\nspeed = -1\r\n")
    with pytest.raises(ScenarioError, match=r"dos\.toml:5: evader\.speed: "):
        load(tmp_path / "dos.toml")


def test_the_cost_of_finding_lines_grows_with_the_length_of_the_file_only(monkeypatch):
    """A list of 200 points on 800 lines: to parse each beginning of it anew would read 400 times the file."""
    text = tomli_w.dumps({"team": {"positions": [[float(k), 0.5] for k in range(200)]}})
    read_so_far, loads = [], tomllib.loads
    monkeypatch.setattr(tomllib, "loads", lambda part: read_so_far.append(len(part)) or loads(part))
    assert key_lines(text)["team", "positions", 199, 1] == 2
    assert sum(read_so_far) <= 10 * len(text)


# Overrides.


@pytest.fixture
def written(tmp_path):
    """Return a function that writes a scenario file."""

    def write(text: str) -> Path:
        (tmp_path / "scenario.toml").write_text(text, encoding="utf-8")
        return tmp_path / "scenario.toml"

    return write


DOTTED = "a." * 100 + "b"


@pytest.mark.parametrize(
    "text",
    [
        f'name = "{DOTTED}"',
        f"name = '{DOTTED}'",
        f'name = """\n"{DOTTED}\n"""',
        f"name = '''it's\n{DOTTED}''''",
        f'name = "\\"{DOTTED}"',
        f"# {DOTTED}",
    ],
)
def test_a_text_with_many_dots_is_no_deep_key(text, tmp_path):
    (tmp_path / "f.toml").write_text(f"{text}\n")
    load(tmp_path / "f.toml")
    load(tmp_path / "f.toml", [f'name="{DOTTED}"'])


@pytest.mark.parametrize(
    "text",
    [
        f"{DOTTED} = 1",
        f"[{DOTTED}]",
        f"x = [1, {{ {DOTTED} = 1 }}]",
        f'"x\\"" . \'y\' . {DOTTED} = 1',
        f"x = \"it's\" # it's\n{DOTTED} = 1",
        f'x = """\\"" \'\n"""\n{DOTTED} = \'\'',
    ],
)
def test_a_deep_key_is_refused_wherever_it_is(text, tmp_path):
    (tmp_path / "f.toml").write_text(f"seed = 1\n{text}\n")
    line = 2 + text[: text.index(DOTTED)].count("\n")
    with pytest.raises(ScenarioError, match=f":{line}: not TOML: a key of more than 100 parts"):
        load(tmp_path / "f.toml")


@pytest.mark.parametrize("text", [f"{DOTTED}=1", f"'={{ {DOTTED} = 1 }}'", f"horizon={{ {DOTTED} = 1 }}"])
def test_a_deep_key_of_an_override_is_refused(text, tmp_path):
    (tmp_path / "f.toml").write_text("")
    with pytest.raises(ScenarioError, match="a key of more than 100 parts"):
        load(tmp_path / "f.toml", [text])


@pytest.mark.slow
@pytest.mark.parametrize("text", ['"' + '\\"' * 200_000, '""\\"""\n' * 100_000, ('"' + "a" * 10_000 + '".') * 90])
def test_a_file_without_deep_keys_is_refused_soon(text, tmp_path):
    """Not in a time that grows with the square of its size."""
    (tmp_path / "f.toml").write_text(text)
    start = perf_counter()
    with pytest.raises(ScenarioError, match="not TOML"):
        load(tmp_path / "f.toml")
    assert perf_counter() - start < 5.0


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("horizon=5", {"horizon": 5}),
        (" horizon = 5 ", {"horizon": 5}),
        ("name=Relay race", {"name": "Relay race"}),
        ('name="5"', {"name": "5"}),
        ("name=a=b", {"name": "a=b"}),
        ("network.range=inf", {"network": {"range": inf}}),
        ("motion.static=true", {"motion": {"static": True}}),
        ("team.speeds=[1.0, 2.0]", {"team": {"count": 2, "speeds": [1.0, 2.0]}}),
        ("team={ count = 3 }", {"team": {"count": 3}}),
        ("a.b.c.d=1", {"a": {"b": {"c": {"d": 1}}}}),
    ],
)
def test_the_value_of_an_override_is_toml_and_a_bare_word_is_a_string(written, override, expected):
    before = {"seed": 1, "horizon": 9.0, "team": {"count": 2}}
    source = read_source(written(tomli_w.dumps(before)), [override])
    assert source.tables == before | expected


def test_an_override_can_change_one_item_of_a_list(written):
    text = "[team]\npositions = [[0.0, 0.0], [1.0, 1.0]]\nspeeds = [1.0, 2.0]\n"
    team = load(written(text), ["team.positions.1.0=7.0", "team.speeds.0=0.5"]).team
    assert (team.positions, team.speeds) == (((0.0, 0.0), (7.0, 1.0)), (0.5, 2.0))


def test_the_last_override_of_a_key_counts(written):
    assert load(written("seed = 1"), ["seed=2", "seed=3"]).seed == 3
    assert load(written(""), ["evader={ speed = 0.1 }", "evader.speed=0.2"]).evader.speed == 0.2
    assert load(written(""), ["evader.speed=0.2", "evader={ box = [1.0, 2.0] }"]).evader.speed == Evader().speed


def test_an_override_replaces_what_is_wrong_in_the_file(written):
    assert load(written("horizon = -1.0\n[evader]\nspeed = 0.5\n"), ["horizon=3.0"]).horizon == 3.0


def test_an_error_is_reported_with_the_override_in_effect_and_not_an_earlier_one(written):
    overrides = ["evader.speed=-1.0", "evader={ speed = -2.0 }"]
    with pytest.raises(ScenarioError) as error:
        load(written(""), overrides)
    assert str(error.value).startswith("--set evader={ speed = -2.0 }: evader.speed: ")
    with pytest.raises(ScenarioError) as error:
        load(written(""), overrides[::-1])
    assert str(error.value).startswith("--set evader.speed=-1.0: evader.speed: ")


def test_a_number_at_the_end_of_an_override_is_no_line(written):
    """The faults of overrides come before those of lines, and no override can set a base."""
    path = written("horizon = -1\n")
    with pytest.raises(ScenarioError) as error:
        load(path, ["colour=b:5"])
    first, second = str(error.value).split("\n")
    assert first.startswith("--set colour=b:5: colour: unknown key")
    assert " base," not in first
    assert second.startswith(f"{path}:1: horizon: ")


def test_a_value_that_no_override_changed_is_still_reported_with_its_line(written):
    path = written("\n[evader]\nspeed = -1.0\n")
    with pytest.raises(ScenarioError) as error:
        load(path, ["evader.box=[0.0, 1.0]"])
    assert str(error.value).startswith(f"{path}:3: evader.speed: ")


def test_an_error_of_a_table_in_the_file_is_not_reported_with_an_override_of_another_key(written):
    path = written("[network]\nlatency = { value = 0.1 }\n")
    with pytest.raises(ScenarioError) as error:
        load(path, ["network.latency.value=0.2"])
    assert str(error.value).startswith(f"{path}:2: network.latency: should be a table with a kind")


def test_a_scenario_error_is_a_value_error_with_one_line_per_fault(written):
    with pytest.raises(ValueError, match="seed") as error:
        load(written("seed = -1\nhorizon = -1\n"))
    assert isinstance(error.value, ScenarioError)
    assert len(str(error.value).split("\n")) == 2


def test_a_file_that_is_not_there_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "nowhere.toml")


@pytest.fixture(scope="module")
def shelf(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("shelf") / "scenario.toml"


KNOWN = sorted({key for key in key_lines(dump(Scenario())) if all(isinstance(part, str) for part in key)})
SCALAR = st.one_of(
    st.integers(-3, 3),
    st.floats(),
    st.booleans(),
    st.sampled_from(["", "sap", "constant", "poisson", "segment", "[x]", "1"]),
    st.dates(),
)
ANYTHING = st.recursive(
    SCALAR,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["kind", "x", "value", "tau", "default", "list", "0", ""]), inner, max_size=3)
    ),
    max_leaves=6,
)


def inline(value: object) -> str:
    """Return a value as TOML on one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f'"{key}" = {inline(each)}' for key, each in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    return tomli_w.dumps({"value": value}).removeprefix("value = ").strip()


@pytest.mark.slow
@settings(deadline=None)
@given(place=st.sampled_from([*KNOWN, ("team", "positions"), ("team", "box", "0"), ("x",)]), value=ANYTHING)
def test_any_override_gives_a_scenario_or_an_error_of_that_override(shelf, place, value):
    """No other exception, and no fault of the file, for the file is empty."""
    shelf.write_text("", encoding="utf-8")
    override = f"{'.'.join(place)}={inline(value)}"
    try:
        scenario = load(shelf, [override])
    except ScenarioError as error:
        for fault in str(error).split("\n"):
            assert fault.startswith(f"--set {override}: {place[0]}")
    else:
        assert isinstance(scenario, Scenario)


@pytest.mark.slow
@settings(deadline=None)
@given(place=st.sampled_from([*KNOWN, ("team", "positions"), ("x",)]), value=ANYTHING)
def test_any_file_gives_a_scenario_or_errors_on_the_lines_that_cause_them(shelf, place, value):
    tables = tomllib.loads(dump(Scenario()))
    node = tables
    for key in place[:-1]:
        node = node[key]
    node[place[-1]] = value
    shelf.write_text(tomli_w.dumps(tables), encoding="utf-8")
    lines = shelf.read_text(encoding="utf-8").split("\n")
    try:
        scenario = load(shelf)
    except ScenarioError as error:
        for fault in str(error).split("\n"):
            found = re.match(rf"{re.escape(str(shelf))}:(\d+): ([^:]*): .", fault)
            assert found, fault
            assert any(part in lines[int(found[1]) - 1] for part in found[2].split(".")), fault
    else:
        assert isinstance(scenario, Scenario)


# There and back.

COORDINATES = st.floats(-1e6, 1e6)
POINTS = st.tuples(COORDINATES, COORDINATES)
SPEEDS = st.floats(0, 100)
BOXES = st.tuples(st.floats(-50, 0), st.floats(0, 50))
TIMES = st.floats(1e-3, 1e3)
PROTOCOLS = st.one_of(
    st.builds(Centralised, slot=TIMES),
    st.builds(
        SpatialAdaptivePlay,
        tau=st.one_of(st.builds(PaperTau, scale=TIMES), st.builds(ConstantTau, value=TIMES)),
        schedule=st.one_of(st.builds(SharedSeed, slot=TIMES), st.builds(Poisson, rate=TIMES)),
    ),
)


@st.composite
def teams(draw) -> Team:
    count = draw(st.integers(1, 5))
    return Team(
        count=count,
        positions=draw(st.none() | st.lists(POINTS, min_size=count, max_size=count)),
        box=draw(BOXES),
        speeds=draw(
            st.one_of(
                SPEEDS,
                st.lists(SPEEDS, min_size=count, max_size=count),
                st.builds(Speeds, default=SPEEDS, last=SPEEDS),
            )
        ),
        active_at_start=draw(st.floats(0, 1)),
    )


SCENARIO_VALUES = st.builds(
    Scenario,
    name=st.text(st.characters(codec="utf-8")),
    seed=st.integers(0, 2**63 - 1),
    horizon=TIMES,
    team=teams(),
    evader=st.builds(Evader, position=st.none() | POINTS, box=BOXES, speed=SPEEDS),
    capture=st.builds(Capture, radius=TIMES, test=st.sampled_from(["segment", "sample"])),
    motion=st.builds(Motion, step=TIMES, order=st.sampled_from(["evader_first", "simultaneous"]), static=st.booleans()),
    protocol=PROTOCOLS,
    network=st.builds(
        Links,
        range=TIMES | st.just(inf),
        latency=st.builds(ConstantLatency, value=TIMES),
        loss=st.builds(Bernoulli, p=st.floats(0, 1)),
    ),
    record=st.builds(Recording, trajectory=TIMES | st.just(0.0), messages=st.booleans()),
)


@pytest.mark.slow
@settings(deadline=None)
@given(scenario=SCENARIO_VALUES)
@example(scenario=Scenario())
@example(scenario=Scenario(name='a\u2028b\x85c\r\nd"""\'\\ \x7f [x]\n# y'))
def test_a_scenario_survives_dumping_and_loading(shelf, scenario):
    shelf.write_text(dump(scenario), encoding="utf-8")
    assert load(shelf) == scenario


@pytest.mark.slow_but_one
@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_the_bundled_scenarios_are_valid_and_survive_a_round_trip(path, shelf):
    scenario = load(path)
    assert list(warnings(scenario)) == []
    shelf.write_text(dump(scenario), encoding="utf-8")
    assert load(shelf) == scenario


def test_a_script_and_a_file_make_the_same_value(written):
    from_file = load(
        written(
            """
            name = "relay"
            seed = 7
            horizon = 12

            [team]
            positions = [[0, 0], [1.5, 2]]
            speeds = [1, 2]

            [evader]
            speed = 0.5
            strategy = { kind = "pure_evasion" }

            [protocol]
            kind = "sap"
            schedule = { kind = "poisson", rate = 4.0 }
            tau.kind = "constant"
            tau.value = 0.2

            [network]
            range = inf
            latency = { kind = "constant", value = 0.05 }
            """
        )
    )
    from_script = Scenario(
        name="relay",
        seed=7,
        horizon=12.0,
        team=Team(positions=((0.0, 0.0), (1.5, 2.0)), speeds=(1.0, 2.0)),
        evader=Evader(speed=0.5),
        protocol=SpatialAdaptivePlay(schedule=Poisson(rate=4.0), tau=ConstantTau(value=0.2)),
        network=Links(latency=ConstantLatency(value=0.05)),
    )
    assert from_file == from_script
    assert hash(from_file) == hash(from_script)
    assert dump(from_file) == dump(from_script)


def test_tables_are_validated_without_a_file():
    assert validate(Source("x", {"seed": 3}, Scenario, {})) == Scenario(seed=3)
    with pytest.raises(ScenarioError, match=r"^x:1: sed: unknown key, did you mean 'seed'"):
        validate(Source("x", {"sed": 3}, Scenario, {}))


def test_a_scenario_with_a_user_function_is_dumped_with_its_import_path():
    written = tomllib.loads(dump(Scenario(protocol=mine)))
    assert written["protocol"] == {"kind": f"{__name__}:mine"}


def mine(me):
    yield me.at(0.0)


@pytest.mark.parametrize("content", ["", "# nothing\n", "0.1 x", "-0.1", "nan"])
def test_a_file_of_latencies_that_holds_none_is_refused(tmp_path, content):
    (tmp_path / "delays.txt").write_text(content)
    file = tmp_path / "bad.toml"
    file.write_text('name = "bad"\nnetwork.latency = { kind = "empirical", file = "delays.txt" }\n')
    with pytest.raises(ScenarioError, match=r"bad.toml:2: network.latency: .*delays\.txt"):
        load(file)


def test_files_are_found_beside_the_scenario_and_kept_in_it(tmp_path):
    (tmp_path / "delays.txt").write_text("0.1, 0.2 0.3  # s\n")
    (tmp_path / "good.toml").write_text('network.latency = { kind = "empirical", file = "delays.txt" }\n')
    scenario = load(tmp_path / "good.toml")
    assert scenario.network.latency.values == (0.1, 0.2, 0.3)
    assert load(tmp_path / "good.toml", ["team.count=3"]).network == scenario.network


# Models of one's own that a file names.

OWN = '''
from typing import Annotated, Any, Literal

from pydantic import BaseModel

from desim.config.model import Positive, Probability, Value
from desim.kernel.models.latency_by_link import LATENCIES
from protocols.rule import LearningRule


def slow(context, rng):
    return 0.5


class Steady(Value):
    kind: Literal["own_models:Steady"] = "own_models:Steady"
    rate: Positive

    def mean_slot(self, me):
        return 1.0

    def __call__(self, me, revise):
        yield from ()


class Doubled(Value):
    value: Positive = 1.0

    def __call__(self, context, rng):
        return 2 * self.value


class Plain:
    def __init__(self, value=1.0):
        self.value = value

    def __call__(self, context, rng):
        return self.value


class Loose(BaseModel):
    value: float = 1.0

    def __call__(self, context, rng):
        return self.value


class Rule(LearningRule):
    """A rule of a user."""

    inertia: Probability = 0.3
    """Probability of no change, in [0, 1]."""
    slow: Annotated[Any, LATENCIES] = None

    def actions(self, me):
        while True:
            yield 0


class Outer:
    class Inner(Doubled):
        pass

    def constant(context, rng):
        return 0.5


class Misspelt:
    ominscient = True

    def __call__(self, me):
        yield from ()


number = 3
'''


@pytest.fixture
def own_models(tmp_path, monkeypatch):
    """Return a module that only this test can import."""
    (tmp_path / "own_models.py").write_text(OWN)
    (tmp_path / "untyped.py").write_text("from protocols.rule import Rule\nclass Bold(Rule):\n    omniscient = True\n")
    (tmp_path / "unwritten.py").write_text("def slow(\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "own_models", raising=False)
    yield importlib.import_module("own_models")
    sys.modules.pop("own_models", None)


def test_a_file_may_name_a_user_function_or_model(own_models, written):
    scenario = load(
        written(
            """
            protocol = { kind = "sap", schedule = { kind = "own_models:Steady", rate = 2.0 } }

            [network]
            latency = { kind = "own_models:slow" }
            link = [{ src = 0, dst = 1, latency = { kind = "own_models:Doubled", value = 0.25 } }]
            """
        ),
        ["network.link.0.latency.value=0.125"],
        allow_import=True,
    )
    assert scenario.network.latency is own_models.slow
    assert scenario.protocol.schedule == own_models.Steady(rate=2.0)
    assert scenario.network.link[0].latency == own_models.Doubled(value=0.125)


def test_a_scenario_with_user_models_survives_dumping_and_loading(own_models, shelf):
    scenario = Scenario(
        protocol=SpatialAdaptivePlay(schedule=own_models.Steady(rate=3.0)),
        network=Links(latency=own_models.slow, link=[{"src": 0, "dst": 1, "latency": own_models.Doubled(value=0.5)}]),
    )
    shelf.write_text(dump(scenario), encoding="utf-8")
    again = load(shelf, allow_import=True)
    assert again == scenario
    assert dump(again) == dump(scenario)


def test_a_class_inside_another_survives_dumping_and_loading(own_models, shelf):
    """Its name is dotted, as that of an entry point may be."""
    for model in (own_models.Outer.Inner(value=0.5), own_models.Outer.constant):
        scenario = Scenario(network=Links(latency=model))
        shelf.write_text(dump(scenario), encoding="utf-8")
        assert 'kind = "own_models:Outer.' in shelf.read_text(encoding="utf-8")
        assert load(shelf, allow_import=True) == scenario
    shelf.write_text('network.latency = "own_models:Outer.constant"\n')
    assert load(shelf, allow_import=True) == scenario


BAD_MODELS = {
    "no such module": ('{ kind = "own_modelz:slow" }', ["'own_modelz:slow' cannot be imported", "own_modelz"]),
    "no such name": ('{ kind = "own_models:fast" }', ["'own_models:fast' cannot be imported", "fast"]),
    "misspelt name": ('{ kind = "own_models:slwo" }', ["has no attribute 'slwo', did you mean 'slow'?"]),
    "misspelt inner name": ('{ kind = "own_models:Outer.Iner" }', ["'Iner', did you mean 'Inner'?"]),
    "no such inner name": (
        '{ kind = "own_models:Outer.fast" }',
        ["'own_models:Outer.fast' cannot be imported", "fast"],
    ),
    "no module": ('{ kind = ":slow" }', ["':slow' cannot be imported"]),
    "no name": ('{ kind = "own_models:" }', ["'own_models:' cannot be imported"]),
    "parameter of a function": ('{ kind = "own_models:slow", value = 1.0 }', ["takes no parameters, got value"]),
    "no type": (
        '{ kind = "untyped:Bold" }',
        ["'untyped:Bold' cannot be imported", "`omniscient = True`", "`ClassVar`"],
    ),
    "no Python": ('{ kind = "unwritten:slow" }', ["'unwritten:slow' cannot be imported", "(unwritten.py, line 1)"]),
    "no callable": ('{ kind = "own_models:number" }', []),
}


@pytest.mark.parametrize(("table", "words"), BAD_MODELS.values(), ids=BAD_MODELS)
def test_an_invalid_user_model_is_refused_with_file_line_and_key(own_models, written, table, words):
    file = written(f'name = "bad"\n\n[network]\nlatency = {table}\n')
    with pytest.raises(ScenarioError) as refused:
        load(file, allow_import=True)
    (said,) = str(refused.value).splitlines()
    assert said.startswith(f"{file}:4: network.latency: ")
    assert not [word for word in words if word not in said], said


WRONG_PARAMETERS = {
    "value of a model": (
        'network.latency = { kind = "own_models:Doubled", value = -1.0 }',
        "network.latency.value: should be greater than 0 (got -1.0)",
    ),
    "key of a model": (
        'network.latency = { kind = "own_models:Doubled", valu = 1.0 }',
        "network.latency.valu: unknown key, did you mean 'value'?; allowed: value",
    ),
    "key of a class": (
        'network.latency = { kind = "own_models:Plain", valu = 1.0 }',
        "network.latency.valu: unknown key, did you mean 'value'?; allowed: value",
    ),
    "key of a model that would ignore it": (
        'network.latency = { kind = "own_models:Loose", valu = 1.0 }',
        "network.latency.valu: unknown key, did you mean 'value'?; allowed: value",
    ),
    "missing key": (
        'protocol = { kind = "sap", schedule = { kind = "own_models:Steady" } }',
        "protocol.schedule.rate: is missing",
    ),
    "described value": (
        'protocol = { kind = "own_models:Rule", inertia = 1.5 }',
        "protocol.inertia: should be less than or equal to 1; Probability of no change, in [0, 1] (got 1.5)",
    ),
    "several": (
        'protocol = { kind = "own_models:Rule", inertai = 0.5, inertia = "1" }',
        "protocol.inertai: unknown key, did you mean 'inertia'?; allowed: inertia, schedule, slow, utility",
        "protocol.inertia: should be a number: 1 instead of the text '1'; Probability of no change, in [0, 1]",
    ),
    "built-in model in one's own": (
        'protocol = { kind = "own_models:Rule", schedule = { kind = "poisson", rat = 3.0 } }',
        "protocol.schedule.rat: unknown key, did you mean 'rate'?; allowed: kind, rate",
    ),
    "built-in kind in one's own": (
        'protocol = { kind = "own_models:Rule", schedule = { kind = "poison" } }',
        "protocol.schedule.kind: there is no 'poison', did you mean 'poisson'?; allowed: shared_seed, poisson, rounds,",
    ),
    "one's own in one's own": (
        'protocol = { kind = "own_models:Rule", slow = { kind = "own_models:Doubled", value = "x", vale = 1 } }',
        "protocol.slow.value: should be a number (got 'x')",
        "protocol.slow.vale: unknown key, did you mean 'value'?; allowed: value",
    ),
    "attribute": (
        'protocol = "own_models:Misspelt"',
        "protocol: Misspelt has an attribute 'ominscient', did you mean 'omniscient'?",
    ),
    "own model of a list": (
        'network.link = [{ src = 0, dst = 1, latency = { kind = "own_models:Doubled", valu = 1.0 } }]',
        "network.link.0.latency.valu: unknown key, did you mean 'value'?; allowed: value",
    ),
}


@pytest.mark.parametrize("line", WRONG_PARAMETERS)
def test_wrong_parameters_of_a_model_of_one_s_own_are_told_as_those_of_others(own_models, written, line):
    text, *says = WRONG_PARAMETERS[line]
    file = written(f'name = "bad"\n\n{text}\n')
    with pytest.raises(ScenarioError) as refused:
        load(file, allow_import=True)
    found = str(refused.value).splitlines()
    assert len(found) == len(says), found
    for fault, expected in zip(sorted(found), sorted(says), strict=True):
        assert fault.startswith(f"{file}:3: {expected}"), fault


def test_each_wrong_parameter_of_a_model_of_one_s_own_has_its_line(own_models, written):
    file = written('[protocol]\nkind = "own_models:Rule"\ninertia = 2.0\n\n[protocol.utility]\nkin = "mean"\n')
    with pytest.raises(ScenarioError) as refused:
        load(file, ["protocol.schedul=1"], allow_import=True)
    set_by, *lines = str(refused.value).splitlines()
    assert set_by.startswith("--set protocol.schedul=1: protocol.schedul: unknown key, did you mean 'schedule'?")
    assert [line.partition(": ")[0] for line in lines] == [f"{file}:3", f"{file}:5"]


def test_wrong_parameters_of_a_model_of_one_s_own_are_told_from_python_too(own_models):
    table = {"kind": "own_models:Rule", "inertia": 2.0}
    with pytest.raises(KeyedError, match=r"protocol\.inertia: should be less than or equal to 1; Probability"):
        Scenario(protocol=table)


def test_an_incomplete_user_model_is_refused_in_a_file_too(own_models, written):
    file = written('name = "bad"\n\n[announce]\ndissemination = { kind = "own_models:slow" }\n')
    with pytest.raises(ScenarioError, match=r":4: announce\.dissemination: should have broadcast; .* lacks broadcast"):
        load(file, allow_import=True)


OLD = {
    "announce.forget_after": "belief_timeout",
    "announce.spread": "dissemination",
    "capture.needed": "captures_to_end",
    "evader.reaction": "reaction_delay",
    "evader.sight": "sensing_range",
    "evader.strategy.heeds": "flees_from",
    "fault.0.at": "start",
    "fault.0.until": "end",
    "motion.frozen": "static",
    "network.reach": "reception",
    "protocol.patience": "winner_timeout",
    "protocol.schedule.floor": "min_timeout",
    "protocol.schedule.hold": "holding_time",
    "protocol.schedule.of": "schedule",
    "protocol.schedule.q": "participation",
    "protocol.tau.surprises": "reheat_on",
    "sensing.lost_after": "track_timeout",
    "sensing.pass_on": "relay",
    "sensing.when_lost": "on_lost",
}
"""Former keys, and their names now."""
KINDS_OF = {
    "evader.strategy.heeds": "max_min",
    "fault.0.at": "crash",
    "fault.0.until": "crash",
    "protocol.patience": "cbba",
    "protocol.schedule.floor": "local_mutex",
    "protocol.schedule.hold": "token_ring",
    "protocol.schedule.of": "synchronous",
    "protocol.schedule.q": "rounds",
    "protocol.tau.surprises": "adaptive",
}


@pytest.mark.parametrize("key", OLD)
def test_an_old_key_is_refused_with_the_new_one(key, written):
    table, _, name = key.rpartition(".")
    kind = f'kind = "{KINDS_OF[key]}"\n' if key in KINDS_OF else ""
    head = f"[[{table.removesuffix('.0')}]]" if ".0." in key else f"[{table}]"
    above = '[protocol]\nkind = "sap"\n' if table.startswith("protocol.") else ""
    file = written(f"{above}{head}\n{kind}{name} = 1\n")
    with pytest.raises(ScenarioError, match=rf"{re.escape(key)}: unknown key, did you mean '{OLD[key]}'\?"):
        load(file)


def test_an_old_key_with_other_values_is_refused_with_the_value_to_write_instead(written):
    """In files, overrides and Python; each of the three values is one that the new key takes."""
    says = re.escape('unknown key, use start: "known" instead of true, "silent" instead of false, or the default "ann')
    with pytest.raises(ScenarioError, match=rf"\.toml:2: announce\.warm_start: {says}"):
        load(written("[announce]\nwarm_start = false\n"))
    with pytest.raises(ScenarioError, match=says):
        load(written(""), ["announce.warm_start=true"])
    for make in (lambda: Announcements(warm_start=True), lambda: Scenario(announce={"warm_start": False})):
        with pytest.raises(KeyedError, match=says):
            make()
    assert {Announcements(start=start).start for start in STARTS} == {"known", "silent", "announced"}


@pytest.mark.parametrize(
    ("text", "new"),
    [
        ('[protocol]\nkind = "sap"\n[protocol.schedule]\nkind = "together"', "synchronous"),
        ('[evader.strategy]\nkind = "listener"\nthen = { kind = "still" }', "during_handover"),
        ('[evader.strategy]\nkind = "listener"\notherwise = { kind = "still" }', "normally"),
        ('network.fading = "frozen"', "per_link"),
        ('announce.reckoning = "cheap"', "straight_line"),
    ],
)
def test_an_old_kind_or_value_is_refused_with_the_new_one(text, new, written):
    with pytest.raises(ScenarioError, match=rf"did you mean '{new}'\?|should be .*'{new}'"):
        load(written(text))
