"""What the source may use: the direction of imports, and no arithmetic that depends on the processor or on Python."""

import ast
import re
import subprocess
import sys
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
OURS = ("desim", "protocols", "scenarios", "tests")

FLOORS = [
    {"desim.config"},
    {"desim.kernel.core"},
    {"desim.kernel.measured", "desim.kernel.walls", "desim.pursuit.core"},
    {"desim.pursuit.paths"},
    {"desim.kernel.graph_files", "desim.pursuit.game", "desim.pursuit.mobility", "desim.pursuit.motion"},
    {"desim.kernel.models"},
    {"desim.kernel.tc", "desim.kernel.topology", "desim.pursuit.evaders"},
    {"desim.kernel.state"},
    {"desim.kernel.channel"},
    {"desim.kernel.link_layer"},
    {"desim.kernel.transport"},
    {"desim.kernel"},
    {"desim.adapters", "desim.pursuit.sensing"},
    {"desim.pursuit.team"},
    {"desim.pursuit.byzantine", "protocols.schedules"},
    {"desim.scenario", "protocols"},
    {"desim.simulation"},
    {"desim.analysis"},
    {"desim.analysis.drawing", "desim.view"},
    {"desim.results"},
    {"desim.study.plan", "desim.view.formats"},
    {"desim.study.store", "desim.study.workers"},
    {"desim.study.results", "desim.view.pictures"},
    {"desim.study.sweeps", "desim.view.pages"},
    {
        *("desim.study.ablation", "desim.study.breaking", "desim.study.selection", "desim.study.sensitivity"),
        "desim.testing",
    },
    {"desim.study.comparing"},
    {"desim.learning", "desim.live"},
    {"desim.cli"},
    {"scenarios.studies", "scenarios.templates"},
    {"scenarios", "scenarios.benchmarks"},
]
"""The rooms, lowest first: each imports from those below it only. Two that stand side by side do not know each other.

The kernel, and the mathematics of pursuit below it, know nothing of teams, scenarios or runs."""
PACKAGES = [
    {"desim.config"},
    {"desim.kernel"},
    {"desim.adapters", "desim.pursuit"},
    {"desim.scenario", "protocols"},
    {"desim.simulation"},
    {"desim.analysis"},
    {"desim.results"},
    {"desim.study"},
    {"desim.view"},
    {"desim.learning", "desim.live", "desim.testing"},
    {"desim.cli"},
    {"scenarios"},
]
"""The packages, lowest first; a room imports from the packages below its own, and from rooms of its own."""
ROOMS = set().union(*FLOORS)
TOP = {"desim": {room for room in ROOMS if not room.startswith("scenarios")}, "desim.__main__": {"desim.cli"}}
"""What the modules beside the packages import. `desim` hands functions down to packages that must not import them."""
FORBIDDEN = {
    "desim.kernel.core.events": {"simpy", "networkx"},
    "desim.kernel.core.trace_file": {"simpy", "networkx"},
    "desim.kernel.core.positions": {"simpy", "networkx"},
    "desim.kernel.topology.spatial_hash": {"simpy", "networkx"},
    "desim.kernel.models.implicit_complete": {"simpy"},
    "desim.kernel.core.link_context": {"simpy", "networkx"},
    "desim.kernel.models.latency": {"simpy", "networkx"},
    "desim.kernel.models.latency_by_link": {"simpy", "networkx"},
    "desim.kernel.models.loss": {"simpy", "networkx"},
    "desim.kernel.models.reception": {"simpy", "networkx"},
    "desim.kernel.models.medium": {"simpy", "networkx"},
    "desim.kernel.models.graphs": {"simpy"},
    "desim.kernel.models.links": {"simpy", "networkx"},
    "desim.kernel.topology.topology": {"simpy"},
    "desim.pursuit.game.game": {"simpy", "networkx"},
    "desim.pursuit.core.state": {"simpy", "networkx"},
    "desim.pursuit.core.geometry": {"simpy", "networkx"},
    "desim.pursuit.evaders.evasion": {"simpy", "networkx"},
    "desim.pursuit.evaders.observation": {"simpy", "networkx"},
    "desim.pursuit.motion.guidance": {"simpy", "networkx"},
    "desim.scenario.scenario": {"simpy"},
    "desim.analysis": {"simpy", "networkx"},
    "desim.study": {"simpy", "networkx"},
    "desim.view": {"simpy", "networkx"},
    "protocols": {"simpy", "networkx"},
}
MODULES = sorted(path for package in ("desim", "protocols", "scenarios") for path in (ROOT / package).rglob("*.py"))


def name_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {name_of(path) for path in MODULES if path.name != "__init__.py"}
"""The names of the modules that are no packages."""


@cache
def tree_of(path):
    return ast.parse(path.read_text())


@cache
def nodes_of(path):
    """Return the nodes of the tree of a file; to find them takes longer than most tests do with them."""
    return list(ast.walk(tree_of(path)))


def nodes_in(source):
    return list(ast.walk(ast.parse(source)))


@cache
def imports(path):
    """Return every module a file imports, at the top or inside a function."""
    modules = []
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            modules += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                modules.append(inner if inner in FILES else node.module)
    return modules


def rule_for(name, rules):
    """Return the rule of the most specific entry that covers a module."""
    covering = [entry for entry in rules if name == entry or name.startswith(entry + ".")]
    return rules[max(covering, key=len)] if covering else set()


def package_of(name):
    parts = name.split(".")
    return ".".join(parts[:2]) if parts[0] == "desim" else parts[0]


@cache
def room_of(name):
    """Return the room of a module: the longest name of a room that begins its own, or its package."""
    rooms = [room for room in ROOMS if name == room or name.startswith(room + ".")]
    return max(rooms, key=len, default=package_of(name))


def floor_of(name, floors):
    """Return the number of the floor with a name; -1 if none has it."""
    return next((k for k, floor in enumerate(floors) if name in floor), -1)


def may_import(name, module):
    """Return whether a module may import another one of ours."""
    if name in TOP:
        return room_of(module) in TOP[name]
    here, there = room_of(name), room_of(module)
    if here == there or (module == "desim" and package_of(name) == "scenarios"):
        return True
    same_package = package_of(name) == package_of(module)
    lower_package = -1 < floor_of(package_of(module), PACKAGES) < floor_of(package_of(name), PACKAGES)
    lower_room = -1 < floor_of(there, FLOORS) < floor_of(here, FLOORS)
    return lower_room and (same_package or lower_package)


def wrong_arrows(name, modules):
    """Return which of some modules of ours a module may not import."""
    return sorted(module for module in modules if module.split(".")[0] in OURS and not may_import(name, module))


@pytest.mark.slow
def test_every_module_imports_only_what_lies_below_it():
    wrong = {}
    for path in MODULES:
        name, modules = name_of(path), set(imports(path))
        theirs = {module.split(".")[0] for module in modules} - set(OURS)
        arrows = wrong_arrows(name, modules) + sorted(theirs & rule_for(name, FORBIDDEN))
        if arrows:
            wrong[name] = arrows
    assert wrong == {}


def test_an_import_in_the_wrong_direction_would_be_detected():
    assert wrong_arrows("desim.kernel.network", ["desim.simulation.world"]) == ["desim.simulation.world"]
    assert wrong_arrows("desim.scenario.toml", ["protocols.sap", "desim.kernel.models.links"]) == ["protocols.sap"]
    assert wrong_arrows("desim.view.pages.report", ["desim.study.store.store", "desim.cli.run", "tests.law"]) == [
        "desim.cli.run",
        "tests.law",
    ]
    assert set(imports(ROOT / "desim/simulation/world.py")) >= {"desim.simulation.steering", "simpy"}


def circle(graph):
    """Return the modules of a package that import each other, if there are any."""
    while leaves := {name for name, inner in graph.items() if not inner & set(graph)}:
        graph = {name: inner for name, inner in graph.items() if name not in leaves}
    return sorted(graph)


@pytest.mark.slow
def test_no_modules_import_each_other_in_a_circle():
    graph = {name: set(imports(path)) - {name} for path in MODULES if (name := name_of(path)) != "desim"}
    assert circle(graph) == []
    assert circle(graph | {"desim.kernel.core.clock": {"desim.kernel.network"}}) != []


def test_every_module_of_desim_lives_in_a_package():
    loose = [path.name for path in (ROOT / "desim").glob("*.py")]
    assert sorted(loose) == ["__init__.py", "__main__.py"]
    assert {f"desim.{path.parent.name}" for path in (ROOT / "desim").glob("*/__init__.py")} == {
        package for floor in PACKAGES for package in floor if package.startswith("desim.")
    }


def test_every_room_is_on_a_floor_and_says_what_is_in_it():
    doors = [path for path in MODULES if path.name == "__init__.py" and path.parent.name != "peers"]
    rooms = {name_of(path) for path in doors if any(other.name != "__init__.py" for other in path.parent.glob("*.py"))}
    assert rooms - {"desim"} == ROOMS
    for path in doors:
        assert len(ast.get_docstring(tree_of(path))) > 60, path


def test_a_room_does_not_import_the_door_of_its_package():
    assert not may_import("desim.kernel.link_layer.arrivals", "desim.kernel.network")
    assert not may_import("desim.kernel.models.latency", "desim.kernel.link_layer.propagation")
    assert may_import("desim.kernel.network", "desim.kernel.link_layer.arrivals")
    assert not may_import("desim.kernel.channel.air", "desim.pursuit.core.geometry")


LINEAR_ALGEBRA = re.compile(
    r"dot|vdot|vecdot|matvec|vecmat|matmul|multi_dot|tensordot|einsum|convolve|correlate|cov|corrcoef|polyfit|lstsq"
    r"|linalg|lapack|leggauss|pagerank|hits|\w+_(spectrum|connectivity|ordering|vector|numpy)"
    r"|laplacian_\w+|(spring|spectral|kamada_kawai)_layout"
)
"""Goes to BLAS or LAPACK, whose last digits depend on the processor and on the number of threads."""
OF_NUMPY = re.compile(
    r"inner|polynomial|exp|exp2|expm1|log|log2|log10|log1p|logaddexp|power|float_power|cbrt"
    r"|sin|cos|tan|arc(sin|cos|tan|tan2)|(arc)?(sin|cos|tan)h"
)
"""The same, and functions of which numpy has other loops for some processors: their last digits are not the others'."""


def owner_of(node):
    """Return the text before the dot of an attribute, or the module that names are imported from."""
    return ast.unparse(node.value) if isinstance(node, ast.Attribute) else getattr(node, "module", None)


def rounded_by_processor(nodes):
    """Return the line and name of all that a program uses whose last digits depend on the processor."""
    found = []
    for node in nodes:
        names = []
        if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
            names = ["matmul"]
        elif isinstance(node, ast.Attribute):
            names = [node.attr]
        elif isinstance(node, ast.Import | ast.ImportFrom):
            owner = getattr(node, "module", None) or ""
            names = [part for name in (owner, *(each.name for each in node.names)) for part in name.split(".")]
        found += [
            (node.lineno, name)
            for name in names
            if LINEAR_ALGEBRA.fullmatch(name) or (OF_NUMPY.fullmatch(name) and owner_of(node) in {"np", "numpy"})
        ]
    return found


@pytest.mark.slow
def test_no_last_digit_depends_on_the_processor():
    """No result depends on the checks in `desim.testing`, which compare within tolerances."""
    computing = [path for path in MODULES if not name_of(path).startswith("desim.testing")]
    found = {name_of(path): rounded_by_processor(nodes_of(path)) for path in computing}
    assert {name: uses for name, uses in found.items() if uses} == {}


@pytest.mark.parametrize(
    "line",
    [
        "a @ b",
        "a @= b",
        "a.dot(b)",
        "np.einsum('i,i', a, b)",
        "numpy.linalg.norm(a)",
        "from numpy.linalg import norm",
        "from scipy import linalg",
        "import scipy.linalg",
        "nx.pagerank(g)",
        "np.exp(a)",
        "from numpy import exp",
    ],
)
def test_a_digit_that_depends_on_the_processor_would_be_detected(line):
    allowed = "from math import exp; exp(a) + math.log(b) + np.sqrt(c) + (a * b).sum()"
    assert rounded_by_processor(nodes_in(line))
    assert not rounded_by_processor(nodes_in(allowed))


PRIVATE = {
    "desim.cli.program": {"click.echo.__code__"},
    "desim.config.choice": {"SchemaValidator", "__pydantic_core_schema__"},
    "desim.config.data_files": {"_getframe"},
    "desim.config.model": {"_parent_namespace_depth"},
    "desim.kernel.core.body_content": {"_slotnames"},
    "desim.kernel.core.clock": {"_eid", "_events", "_generator", "_now", "_ok", "_queue", "_value", "simpy.core"},
    "desim.kernel.models.implicit_complete": {"_adj", "_node", "_pred"},
    "desim.simulation.watchdog": {"PyThreadState_SetAsyncExc", "_current_exceptions"},
    "desim.study.workers.workers": {"KilledWorker", "_max_workers", "kill_workers"},
}
"""The modules that use parts of Python and of other packages which are not documented, or may change, and those parts.
A new version of a package can break these modules only; each has tests that then fail."""
COMMON = {"_now", "_ok", "_queue", "_value"}
"""Names in `PRIVATE` that classes of desim have, too. They cannot be told apart, and so are not looked for."""
OF_PYTHON = {"_replace", "_make", "_fields", "_asdict", "_exit"}
"""Documented names: of named tuples, and of `os`."""


def private_parts(nodes, ours):
    """Return the private parts of other packages that a program uses: those in `PRIVATE`, and what nobody defines."""
    listed = set().union(*PRIVATE.values())
    ends = {name.rpartition(".")[2] for name in listed if "." in name}
    parts = set()
    for node in nodes:
        names = []
        if isinstance(node, ast.Attribute):
            own = isinstance(node.value, ast.Name) and node.value.id in {"self", "cls"}
            dunder = node.attr.startswith("__")
            names = [] if own or (dunder and node.attr not in listed) else [node.attr]
            names += [ast.unparse(node)] if node.attr in ends else []
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.isidentifier():
            names = [node.value] if node.value in listed else []
        elif isinstance(node, ast.ImportFrom):
            names = [node.module, *(alias.name for alias in node.names)]
        elif isinstance(node, ast.keyword):
            names = [node.arg]
        for name in filter(None, names):
            private = name.startswith("_") and not name.endswith("__") and name.isidentifier() and name not in ours
            if (name in listed and name not in COMMON) or (private and name not in OF_PYTHON):
                parts.add(name)
    return parts


@cache
def names_of_ours():
    """Return the names that some module of ours defines: functions, classes, variables, attributes of self."""
    nodes = [node for path in MODULES for node in nodes_of(path)]
    defined = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    stored = [node for node in nodes if isinstance(getattr(node, "ctx", None), ast.Store)]
    own = [node for node in stored if isinstance(node, ast.Attribute) and ast.unparse(node.value) in {"self", "cls"}]
    return defined | {node.attr for node in own} | {node.id for node in stored if isinstance(node, ast.Name)}


@pytest.mark.slow
def test_private_parts_of_a_package_are_used_in_one_module():
    paths = [path for path in MODULES if not name_of(path).startswith("scenarios")]
    uses = {name_of(path): private_parts(nodes_of(path), names_of_ours()) for path in paths}
    expected = {name: parts - COMMON for name, parts in PRIVATE.items()}
    assert {name: parts for name, parts in uses.items() if parts} == expected
    users = [name for name, parts in PRIVATE.items() for _ in parts]
    assert len(users) == len(set().union(*PRIVATE.values()))  # each part has one user


@pytest.mark.parametrize(
    "line",
    [
        "graph._adj",
        "getattr(pool, '_max_workers')",
        "from simpy.core import Environment",
        "x._new_private",
        "f(kill_workers=1)",
    ],
)
def test_a_private_part_would_be_detected(line):
    public = "self._x; message._replace(a=1); value.__dict__; cls._y()"
    assert private_parts(nodes_in(line), set())
    assert not private_parts(nodes_in(public), set())


POSITIONS = {
    "desim.kernel.core.events:Broadcast": "t transmission src seq dst arrival created size body",
    "desim.kernel.core.events:Delivered": "t src dst port to_all seq created attempt body",
    "desim.kernel.core.events:Lost": "t transmission src dst cause",
    "desim.kernel.core.events:Retransmitted": "t src dst port to_all seq attempt",
    "desim.kernel.core.events:Sent": "t transmission src dst arrival created size body",
    "desim.kernel.transport.frames:Acknowledgement": "port to_all session expected received",
    "desim.kernel.transport.frames:Segment": "port to_all session seq base attempt body",
    "desim.kernel.transport.receiver:Arrived": "seq message attempt",
    "desim.kernel.state.inbox:Message": "src stamp body",
    "desim.kernel.core.records:Record": "src seq stamp body",
    "desim.live.link:DatagramFate": "number src dst arrival cause is_copy",
    "desim.live.wire:Parcel": "number src start content port to_one",
    "desim.pursuit.core.events:Decided": "t pursuer active",
    "desim.pursuit.team.beliefs:Belief": "active capture_time age",
    "desim.kernel.state.transmission:Flight": "transmission airtime",
    "desim.kernel.state.transmission:Transmission": "number src created size receivers content port reachable to_one",
    "desim.pursuit.motion.dead_reckoning:TrackSegment": "begun evader aim velocity end",
    "desim.kernel.transport.log:MessageFlow": "src dst port",
    "desim.pursuit.sensing.fusion:Information": "matrix vector determinant",
    "desim.pursuit.sensing.fusion:InformedTrack": "track information",
    "desim.pursuit.sensing.tracking:Track": "stamp state covariance",
    "desim.pursuit.sensing.tracking:Measurement": "stamp observer x y covariance origin_x origin_y",
}
"""The fields of the named tuples that are created or read by position, for speed or to be compared."""


@pytest.mark.parametrize("place", POSITIONS)
def test_fields_that_are_read_by_position_keep_their_place(place):
    module, _, name = place.partition(":")
    assert " ".join(getattr(import_module(module), name)._fields) == POSITIONS[place]


@pytest.mark.slow
def test_the_tuples_that_are_created_by_position_are_known():
    """`tuple.__new__` checks neither the number of the fields nor their order."""
    calls = [node for path in MODULES for node in nodes_of(path) if isinstance(node, ast.Call)]
    made = {ast.unparse(call.args[0]) for call in calls if ast.unparse(call.func) in {"_new", "tuple.__new__"}}
    assert made
    by_layout = {"self.body"}  # a layout is made of the fields of its body
    assert made <= {place.partition(":")[2] for place in POSITIONS} | by_layout


CHANGING = {
    *("_Awaited", "LinkContext", "_Site", "_Node", "Endpoint", "Owed"),  # desim.kernel
    *("_Pursuer", "Conduct"),  # desim.live
    *("LossTable", "Search"),  # desim.study
}
"""The dataclasses that are not frozen."""


def test_only_these_dataclasses_can_change():
    """One that can change has no hash, and whoever holds it may see another value later."""
    dataclass = re.compile(r"^@dataclass(.*)\nclass (\w+)", re.MULTILINE)
    found = [each for path in MODULES if "scenarios" not in path.parts for each in dataclass.findall(path.read_text())]
    assert len(found) > 80
    assert {name for options, name in found if "frozen=True" not in options} == CHANGING


FOREIGN = {"formatter", "os", "Path('/proc/sys/kernel/random/boot_id')", "Path(f'/proc/{pid}/stat')"}
"""Owners of methods that do something else, or read what is ASCII on each machine."""


def is_said(call):
    """Return whether a call has the keyword without which its result depends on the machine, or hides a mistake."""
    said = {keyword.arg for keyword in call.keywords}
    match call.func:
        case ast.Name("zip"):  # the longer one is cut off
            return "strict" in said or "repeat(" in ast.unparse(call)
        case ast.Attribute(attr="argsort"):  # numpy has loops for some processors that leave ties in another order
            return "kind" in said
        case ast.Attribute(attr="open" | "read_text" | "write_text" as name):  # in the encoding of the machine
            is_text = name != "open" or {*map(ast.unparse, call.args)} <= {"'r'", "'w'", "'a'"}
            is_encoded = "encoding" in said or len(call.args) == {"read_text": 1, "write_text": 2}.get(name)
            return is_encoded or not is_text or owner_of(call.func) in FOREIGN
    return True


def unsaid(nodes):
    """Return the line of each call that leaves to a default what it should say."""
    return [node.lineno for node in nodes if isinstance(node, ast.Call) and not is_said(node)]


@pytest.mark.slow
def test_no_order_length_or_encoding_is_left_to_a_default():
    ours = [path for path in MODULES if not name_of(path).startswith("scenarios.")]
    lines = {name_of(path): unsaid(nodes_of(path)) for path in ours}
    assert {name: numbers for name, numbers in lines.items() if numbers} == {}


@pytest.mark.parametrize(
    "line",
    [
        "x.argsort()",
        "np.argsort(x, axis=0)",
        "zip(a, b)",
        "file.open()",
        "file.open('w', newline='')",
        "file.read_text()",
        "file.write_text(text)",
    ],
)
def test_what_is_left_to_a_default_would_be_detected(line):
    said = "a.argsort(kind='stable'); zip(a, b, strict=False); file.open('rb'); file.read_text('utf-8'); os.open(a, b)"
    assert unsaid(nodes_in(line))
    assert not unsaid(nodes_in(said))


INTEGERS = {"len", "bool", "int", "isinstance"}
"""Functions whose values are integers or truth values."""


def is_count(term):
    """Return whether a term of a sum is evidently an integer: a literal, a comparison, or a value of `INTEGERS`."""
    if isinstance(term, ast.Call):
        return isinstance(term.func, ast.Name) and term.func.id in INTEGERS
    literal = isinstance(term, ast.Constant) and isinstance(term.value, int)
    return literal or isinstance(term, ast.Compare) or (isinstance(term, ast.UnaryOp) and isinstance(term.op, ast.Not))


def counts(call):
    """Return whether a call of `sum` adds evident integers: `sum(1 for ...)`, `sum(map(len, ...))`."""
    if call.keywords:  # a start
        return False
    match call.args:
        case [ast.GeneratorExp() | ast.ListComp() as terms]:
            return is_count(terms.elt)
        case [ast.Call(func=ast.Name("map"), args=[ast.Name(function), *_])]:
            return function in INTEGERS
    return False


def sums_that_may_round(nodes):
    """Return the line of each use of the built-in `sum` for terms that are not evidently integers."""
    calls = [node for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    integral = {call.func for call in calls if counts(call)}
    named = [node for node in nodes if isinstance(node, ast.Name) and node.id == "sum" and node not in integral]
    owned = [node for node in nodes if isinstance(node, ast.Attribute) and node.attr == "sum"]
    owned = [node for node in owned if ast.unparse(node.value) == "builtins"]
    imported = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module == "builtins"]
    return sorted(node.lineno for node in (*named, *owned, *imported))


@pytest.mark.slow
def test_no_sum_depends_on_the_version_of_python():
    """`sum` compensates for the rounding of floats from Python 3.12 on, and of complex numbers from 3.14 on."""
    lines = {name_of(path): sums_that_may_round(nodes_of(path)) for path in MODULES}
    assert {name: numbers for name, numbers in lines.items() if numbers} == {}  # use `portable_sum`


@pytest.mark.parametrize(
    "line",
    [
        "sum(times)",
        "sum(x * y for x, y in pairs)",
        "sum([x for x in values])",
        "sum(map(energy, runs))",
        "sum((0.1, 0.2))",
        "sum(run.captured and run.time for run in runs)",
        "sum((1 for run in runs), 0.1)",
        "sum(1.0 for run in runs)",
        "sum((len(x) for x in runs), start=0.1)",
        "add = sum",
        "map(sum, rows)",
        "functools.reduce(sum, rows)",
        "import builtins; builtins.sum(rows)",
        "from builtins import sum as add",
    ],
)
def test_a_sum_that_may_round_would_be_detected(line):
    assert sums_that_may_round(nodes_in(line))


def test_sums_of_integers_and_of_arrays_are_allowed():
    lines = "sum(1 for _ in a); sum(map(len, a)); sum(len(b) for b in a); sum(b > 0 for b in a); a.sum(); np.sum(a)"
    assert not sums_that_may_round(nodes_in(lines))


@pytest.mark.slow
def test_the_mathematics_loads_without_a_simulator():
    program = (
        "import sys; import desim.pursuit.game.game, desim.pursuit.core.geometry, desim.pursuit.evaders.evasion;"
        "import desim.kernel.models.links;"
        "sys.exit(bool({'simpy', 'networkx'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@pytest.mark.whole
def test_the_kernel_stands_alone():
    program = (
        "import sys; import desim.kernel.network, desim.kernel.models.links;"
        "sys.exit(any(name.startswith(('desim.pursuit', 'desim.scenario', 'protocols')) for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


SLOW_TO_IMPORT = {
    *(
        "cloudpickle",
        "concurrent.futures",
        "loky",
        "matplotlib",
        "multiprocessing",
        "pandas",
        "scipy",
        "sqlite3",
        "tqdm",
    ),
    *(
        "desim.results.environment",
        "desim.results.provenance",
        "desim.study",
        "desim.view",
        "protocols.cbba",
        "protocols.server",
    ),
}
"""What one run of a small scenario has no use for."""
COMPUTES = {"networkx", "numpy", "pydantic", "simpy"}
RELAY = "scenarios/relay.toml"
PROGRAMS = {
    "import": ("import desim; desim.__all__", SLOW_TO_IMPORT | COMPUTES | {"click", "desim.scenario.scenario"}),
    "load": (f"import desim; desim.load('{RELAY}')", SLOW_TO_IMPORT | {"desim.analysis", "desim.simulation.run"}),
    "check": (f"from desim.cli import main; main(['check', '{RELAY}'])", SLOW_TO_IMPORT | {"desim.simulation.run"}),
    "run": (f"from desim.cli import main; main(['run', '{RELAY}', '--set', 'horizon=0.1'])", SLOW_TO_IMPORT),
}


@pytest.mark.whole
@pytest.mark.parametrize("name", PROGRAMS)
def test_nothing_is_loaded_that_is_not_needed(name):
    """What is slow to import is imported by whatever needs it: the start of a short run is most of its time."""
    program, absent = PROGRAMS[name]
    told = f"import sys\ntry:\n    {program}\nexcept SystemExit:\n    pass\nprint(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", told], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stderr.split())
    assert {"desim"} <= loaded
    assert not absent & loaded
