"""A scenario file over a base file: which keys it has, where they are reported, and which bases are refused."""

import json
from math import inf

import pytest

from desim.config.tables import nested
from desim.kernel.models.latency import Gamma
from desim.results import provenance
from desim.scenario.overrides import ScenarioError
from desim.scenario.scenario import Scenario
from desim.scenario.toml import dump, load, read_source
from desim.study.plan.configurations import configurations
from protocols.cbba import CBBA
from scenarios.studies.study import SCENARIOS
from tests.command import accepted, refused, strict_json

RELAY = """\
name = "relay"
seed = 3

[team]
count = 4
box = [0.0, 9.0]

[protocol]
kind = "sap"
tau = { kind = "paper", scale = 3.0 }
schedule = { kind = "poisson", rate = 2.0 }

[network]
range = 7.0
latency = { kind = "gamma", scale = 0.1, shape = 3.0 }

[[fault]]
kind = "crash"
node = 1
start = 1.0
"""


@pytest.fixture
def files(tmp_path):
    """Return a function that writes files, by name, and returns the path of the first."""

    def write(**texts: str):
        for name, text in texts.items():
            path = tmp_path / f"{name.replace('__', '/')}.toml"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return tmp_path / f"{next(iter(texts))}.toml"

    return write


def test_a_file_overrides_keys_of_its_base_table_by_table(files):
    text = (
        "base = 'relay.toml'\nseed = 4\n[team]\ncount = 5\n[network.latency]\nscale = 0.2\n[[fault]]\nkind = 'crash'\n"
    )
    found = load(files(mine=text + "node = 2\nstart = 3.0\n", relay=RELAY))
    assert (found.name, found.seed, found.team.count, found.team.box) == ("relay", 4, 5, (0.0, 9.0))
    assert found.network.latency == Gamma(scale=0.2, shape=3.0)
    assert found.network.range == 7.0
    assert [each.node for each in found.fault] == [2]


def test_a_new_kind_keeps_the_keys_that_it_has(files):
    """cbba has no tau; best_response has neither tau nor a temperature, but the same schedule."""
    mine = "base = 'relay.toml'\nprotocol.{}\nnetwork.latency.kind = 'lognormal'\n"
    assert load(files(mine=mine.format("kind = 'cbba'"), relay=RELAY)).protocol == CBBA(
        schedule=load(files(relay=RELAY)).protocol.schedule
    )
    ruled = load(files(mine=mine.format("schedule.kind = 'rounds'"), relay=RELAY)).protocol
    assert (ruled.kind, ruled.schedule.kind, ruled.tau.scale) == ("sap", "rounds", 3.0)
    bare = load(files(mine="base = 'relay.toml'\nprotocol = 'cbba'\nnetwork.range = inf\n", relay=RELAY))
    assert (bare.protocol, bare.network.range) == (CBBA(), inf)


@pytest.mark.whole_but_one
@pytest.mark.slow_but_one
@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda path: path.stem)
def test_an_example_is_its_own_scenario_over_no_keys_and_over_the_default(path, tmp_path):
    (tmp_path / "empty.toml").write_text("")
    (tmp_path / "base.toml").write_text(dump(load(path)))
    (tmp_path / "same.toml").write_text("base = 'base.toml'\n")
    (tmp_path / "over.toml").write_text("base = 'empty.toml'\n" + dump(load(path)))
    assert load(tmp_path / "same.toml") == load(path)
    assert load(tmp_path / "over.toml") == load(path)


@pytest.mark.parametrize(
    ("base", "mine", "same"),
    [
        ("network.latency = 0.1", "network.latency.value = 0.2", "network.latency = 0.2"),
        (
            "network.latency = 'gamma'",
            "network.latency.scale = 0.2",
            "network.latency = { kind = 'gamma', scale = 0.2 }",
        ),
        ("network.latency = 0.1", "network.latency = { kind = 'gamma' }", "network.latency = 'gamma'"),
        ("protocol = 'cbba'", "protocol.winner_timeout = 5.0", "protocol = { kind = 'cbba', winner_timeout = 5.0 }"),
        ("team.speeds = 1.5", "team.speeds.last = 5.0", "team.speeds = { last = 5.0 }"),
        ("sweep.design = 'sobol:8'", "sweep.design.size = 16", "sweep.design = 'sobol:16'"),
        ("sweep.design = 'sobol:x'", "sweep.design.size = 16", "sweep.design = 'sobol:16'"),
    ],
)
def test_a_key_of_what_a_bare_value_of_the_base_stands_for_is_overridden(base, mine, same, files):
    """As by --set."""
    path = files(mine=f"base = 'b.toml'\n{mine}\n", b=base)
    assert load(path) == load(files(other=same))


def test_an_error_in_a_bare_value_of_the_base_is_told_with_its_line(files, tmp_path):
    path = files(mine="base = 'b.toml'\nprotocol.slot = 5.0\n", b="seed = 1\nprotocol = 'no:rule'\n")
    with pytest.raises(ScenarioError, match=rf"^{tmp_path / 'b.toml'}:2: protocol.kind: 'no:rule' names code"):
        load(path)


def test_a_base_has_a_base(files):
    found = load(files(a="base = 'b.toml'\nseed = 1\n", b="base = 'c.toml'\nseed = 2\nhorizon = 2.0\n", c=RELAY))
    assert (found.seed, found.horizon, found.team.count) == (1, 2.0, 4)


def test_overrides_come_last(files):
    path = files(mine="base = 'relay.toml'\nseed = 4\n", relay=RELAY)
    found = load(path, ["seed=5", "network.range=8.0", "protocol.kind=cbba"])
    assert (found.seed, found.network.range, found.protocol.kind) == (5, 8.0, "cbba")


def test_a_grid_is_merged_with_that_of_the_base(files):
    base = "[sweep]\nreps = 2\n[sweep.grid]\n'network.range' = [1.0, 2.0]\n'horizon' = [1.0]\n"
    mine = "base = 'other.toml'\n[sweep.grid]\n'network.range' = [3.0]\n"
    grid = [each.settings for each in configurations(read_source(files(mine=mine, other=base)))]
    assert grid == [{"network.range": 3.0, "horizon": 1.0}]


def test_errors_name_the_file_and_line_of_the_key(files, tmp_path):
    base = RELAY.replace("box = [0.0, 9.0]", "box = [9.0, 0.0]").replace("rate = 2.0", "rte = 2.0")
    path = files(mine="base = 'b.toml'\n\n[network]\nrange = -1.0\nlatency.scale = -1.0\n", b=base)
    said = refused("check", path, "--set", "seed=-1").splitlines()
    assert sorted(line.split(": ")[0] for line in said) == sorted(
        ["--set seed=-1", f"{path}:4", f"{path}:5", f"{tmp_path}/b.toml:6", f"{tmp_path}/b.toml:11"]
    )
    (said,) = refused("check", files(mine="base = 'b.toml'\n", b="seed = 1\nhorizon = \n")).splitlines()
    assert said.startswith(f"{tmp_path}/b.toml:2: not TOML: ")


def test_a_list_of_a_base_that_is_replaced_leaves_no_lines_behind(files):
    path = files(mine="base = 'b.toml'\nteam.speeds = [1.0, -2.0]\n", b="[team]\ncount = 2\nspeeds = [\n1.0,\n2.0]\n")
    (said,) = refused("check", path).splitlines()
    assert said.startswith(f"{path}:2: team.speeds.1: should be greater than or equal to 0")


@pytest.mark.parametrize(
    ("base", "why"),
    [
        ("3", "base: should be the path of a scenario file (got 3)"),
        ("'no.toml'", "base: {folder}/no.toml cannot be read: No such file or directory"),
        ("'../out.toml'", "base: ../out.toml leads out of the folder of the file that names it; if you trust"),
        ("'/etc/passwd'", "base: /etc/passwd leads out of the folder of the file that names it; if you trust"),
        ("'.'", "base: {folder} cannot be read: Is a directory"),
        ("'a\\u0000'", "base: a\\u0000 cannot be read: "),
        ("'mine.toml'", "base: {folder}/mine.toml and {folder}/mine.toml are bases of each other"),
    ],
)
def test_a_base_that_cannot_be_one_is_refused_with_its_line(base, why, files, tmp_path):
    base = base if "u0000" not in base else base.replace("'", '"')
    path = files(mine=f"seed = 1\nbase = {base}\n")
    (said,) = refused("check", path).splitlines()
    assert said.startswith(f"{path}:2: {why.format(folder=tmp_path)}")


def test_a_circle_is_refused_with_both_names(files, tmp_path):
    path = files(a="base = 'b.toml'\n", b="base = 'c.toml'\n", c="seed = 1\nbase = 'b.toml'\n")
    (said,) = refused("check", path).splitlines()
    why = f"{tmp_path}/c.toml and {tmp_path}/b.toml are bases of each other, directly or through others"
    assert said == f"{tmp_path}/c.toml:2: base: {why}"


def test_a_trusted_file_has_a_base_anywhere(files, tmp_path):
    files(out=RELAY)
    inner = files(sub__mine="base = '../out.toml'\n").parent / "sub" / "mine.toml"
    with pytest.raises(ScenarioError, match="leads out of the folder"):
        load(inner)
    assert load(inner, allow_import=True).team.count == 4


GRAPH = {"directed": False, "multigraph": False, "graph": {}, "nodes": [{"id": 0}, {"id": 1}]}
TWO = "team.count = 2\n"


@pytest.mark.parametrize(
    ("mine", "base", "deeper"),
    [
        ("", TWO + "network.graph = { kind = 'edges', file = 'g.json' }", ""),
        ("", "base = 'deeper/c.toml'\nnetwork.graph.file = 'g.json'", TWO + "network.graph.kind = 'edges'"),
        ("", "base = 'deeper/c.toml'\nnetwork.graph.kind = 'edges'", TWO + "network.graph.file = '../g.json'"),
        ("network.graph.kind = 'edges'", TWO + "network.graph.file = 'g.json'", ""),
        ("network.graph.file = 'sub/g.json'", TWO + "network.graph.kind = 'edges'", ""),
        ("network.graph.file = 'sub/g.json'", TWO + "network.graph = { kind = 'edges', file = 'none.json' }", ""),
    ],
)
def test_data_files_of_a_base_in_another_folder_lie_beside_it(mine, base, deeper, files, tmp_path):
    """Whichever of the files sets the kind of the table."""
    path = files(mine=f"base = 'sub/b.toml'\n{mine}\n", sub__b=base)
    files(sub__deeper__c=deeper)
    (tmp_path / "sub" / "g.json").write_text(json.dumps(GRAPH | {"edges": [{"source": 0, "target": 1}]}))
    assert len(load(path).network.graph.edges) == 1


@pytest.mark.parametrize(
    "table", ["graph.kind = 'edges'", "graph = 'edges'", "graph = { kind = 'edges', file = 'a.json' }"]
)
@pytest.mark.parametrize("grid", ["sweep.grid.'network.graph.file'", "sweep.grid.network.graph.file"])
def test_data_files_in_the_grid_of_a_base_in_another_folder_lie_beside_it(table, grid, files, tmp_path):
    path = files(mine="base = 'sub/b.toml'\n", sub__b=f"{TWO}{grid} = ['a.json', 'deeper/b.json']\nnetwork.{table}\n")
    files(sub__deeper__c="")
    for name, edges in (("a", []), ("deeper/b", [{"source": 0, "target": 1}])):
        (tmp_path / f"sub/{name}.json").write_text(json.dumps(GRAPH | {"edges": edges}))
    found = {
        each.settings["network.graph.file"]: each.scenario.network.graph for each in configurations(read_source(path))
    }
    assert [(name, len(graph.edges)) for name, graph in found.items()] == [("sub/a.json", 0), ("sub/deeper/b.json", 1)]


@pytest.mark.parametrize(
    "base",
    [
        "[[wall]]\nfile = 'corners.txt'",
        "[[wall]]\nline = [[0, 0], [1, 1]]\n[sweep.grid]\n'wall.0.file' = ['corners.txt']",
        "[sweep.grid]\nwall = [[{ file = 'corners.txt' }]]",
        "[team.positions]\nfile = 'corners.txt'",
        "[sweep.grid]\n'team.positions.file' = ['corners.txt']",
    ],
)
def test_a_data_file_of_a_table_without_a_kind_lies_beside_the_base_too(base, files):
    """Otherwise a file of the same name beside the other file would be read."""
    tables = read_source(files(mine="base = 'sub/b.toml'\n", sub__b=base)).tables
    (path,) = (value for (*_, key), value in nested(tables) if str(key).endswith("file"))
    assert ([path] if isinstance(path, str) else path) == ["sub/corners.txt"]


def test_a_key_file_of_a_users_own_table_stays_as_it_is(files):
    base = "protocol = { kind = 'my:Rule', file = 'a' }\nsweep.grid.'protocol.file' = ['a', 'b']\n"
    tables = read_source(files(mine="base = 'sub/b.toml'\n", sub__b=base)).tables
    assert (tables["protocol"]["file"], tables["sweep"]["grid"]) == ("a", {"protocol.file": ["a", "b"]})


def test_a_base_is_a_key_of_files_only(files):
    path = files(mine="seed = 1\n", relay=RELAY)
    (said,) = refused("check", path, "--set", "base=relay.toml").splitlines()
    assert said.startswith("--set base=relay.toml: base: is a key of scenario files only")
    (said,) = refused("check", files(mine="bas = 'relay.toml'\n")).splitlines()
    assert "bas: unknown key, did you mean 'base'?; allowed: announce, base, capture, " in said


@pytest.mark.slow
def test_what_is_written_of_a_run_is_complete(files, tmp_path):
    path, out = files(mine="base = 'relay.toml'\nhorizon = 0.5\n", relay=RELAY), tmp_path / "out"
    accepted("run", path, "-o", out)
    for name in ("mine", "relay"):
        (tmp_path / f"{name}.toml").unlink()
    assert "base" not in provenance.read(out / "run.json")["scenario"]
    assert load(out / "scenario.toml").team.count == 4
    assert accepted("run", "--from", out / "run.json").stdout.startswith("relay: 4 pursuers")


@pytest.mark.slow
def test_keys_and_the_schema_have_the_key():
    assert accepted("keys", "base").stdout.startswith("base: Path of another scenario file")
    assert "\n    base: Path of another scenario file" in accepted("keys").stdout
    assert strict_json(accepted("schema").stdout)["properties"]["base"]["type"] == "string"
    assert "base" not in Scenario.model_fields


BELOW = """\
network.loss = 0.1
[network.latency]
kind = "constant"
value = 0.1
[protocol]
kind = "sap"
[protocol.schedule]
kind = "poisson"
rate = 3.0
[team]
count = 3
speeds = [1.0, 2.0, 3.0]
"""
WRONG_ABOVE = [
    # a line of the file, the file and the line that are named, and the key
    ("network.latency = -1.0", "f.toml:3: network.latency.value"),
    ("network.latency.value = -1.0", "f.toml:3: network.latency.value"),
    ('network.latency = { kind = "constant", value = -1.0 }', "f.toml:3: network.latency.value"),
    ('network.latency = { kind = "uniform", value = 1.0 }', "f.toml:3: network.latency.value"),
    ('network.latency = { kind = "uniform", low = 2.0, high = 1.0 }', "f.toml:3: network.latency"),
    ("network.loss = 2.0", "f.toml:3: network.loss.p"),
    ('network.loss = { kind = "bernoulli", p = 2.0 }', "f.toml:3: network.loss.p"),
    ('protocol = "nope"', "f.toml:3: protocol.kind"),
    ('protocol.schedule = { kind = "rounds", rate = 2.0 }', "f.toml:3: protocol.schedule.rate"),
    ("protocol.schedule.rate = -3.0", "f.toml:3: protocol.schedule.rate"),
    ("team.speeds = [1.0, -2.0, 3.0]", "f.toml:3: team.speeds.1"),
    ("team.speeds = -1.0", "f.toml:3: team.speeds"),
    ("team = { count = 3, speeds = [1.0, 2.0] }", "f.toml:3: team.speeds"),
    ("team.count = 2", "base.toml:12: team.speeds"),
    ("team.cuont = 2", "f.toml:3: team.cuont"),
]


@pytest.mark.parametrize(("line", "place"), WRONG_ABOVE)
def test_an_error_names_the_file_and_the_line_of_its_value(tmp_path, line, place):
    (tmp_path / "base.toml").write_text(BELOW)
    (tmp_path / "f.toml").write_text(f'base = "base.toml"\n\n{line}\n')
    with pytest.raises(ScenarioError) as refused:
        load(tmp_path / "f.toml")
    assert str(refused.value).replace(f"{tmp_path}/", "").startswith(f"{place}:")


def test_a_grid_of_a_base_with_an_index_of_thousands_of_digits_is_refused_like_any_wrong_key(files):
    grid = f'[sweep.grid]\n"evader.{"9" * 5000}.strategy.file" = ["a.csv"]'
    source = read_source(files(mine="base = 'other.toml'", other=f"[[evader]]\n{grid}"))
    with pytest.raises(ScenarioError, match="is not a key of a table"):
        list(configurations(source))
