"""What the source may use: the direction of imports, and no arithmetic that depends on the processor.

scenarios -> protocols -> desim; kernel <- pursuit <- simulation <- analysis <- cli.
"""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
OURS = ("desim", "protocols", "scenarios", "tests")

# What each module or package may import of ours; the most specific entry counts, and `desim` is its __init__ alone.
ALLOWED = {
    "desim.field_docs": set(),
    "desim.value": {"desim.field_docs", "desim.guards"},
    "desim.elementary": set(),
    "desim.kernel.clock": set(),
    "desim.kernel.seeds": set(),
    "desim.kernel.events": set(),
    "desim.kernel.trace_file": {"desim.kernel.clock", "desim.kernel.events"},
    "desim.kernel.positions": set(),
    "desim.kernel.cells": {"desim.kernel.positions", "desim.value"},
    "desim.kernel.complete": set(),
    "desim.kernel.hops": {"desim.kernel.positions", "desim.kernel.seeds"},
    "desim.kernel.latency": {"desim.elementary", "desim.kernel.hops", "desim.kernel.seeds", "desim.value"},
    "desim.kernel.loss": {"desim.elementary", "desim.kernel.hops", "desim.value"},
    "desim.kernel.reach": {"desim.value"},
    "desim.kernel.medium": {"desim.value"},
    "desim.kernel.wire": {"desim.kernel.records"},
    "desim.kernel.graphs": {
        "desim.kernel.complete",
        "desim.kernel.latency",
        "desim.kernel.loss",
        "desim.value",
    },
    "desim.kernel.links": {
        "desim.kernel.graphs",
        "desim.kernel.latency",
        "desim.kernel.loss",
        "desim.kernel.medium",
        "desim.kernel.presets",
        "desim.kernel.reach",
        "desim.value",
    },
    "desim.kernel.topology": {
        "desim.kernel.cells",
        "desim.kernel.complete",
        "desim.kernel.positions",
        "desim.kernel.reach",
        "desim.kernel.seeds",
    },
    "desim.kernel": {"desim.kernel", "desim.value"},
    "desim.pursuit.capture": {"desim.pursuit.state"},
    "desim.pursuit.game": {"desim.pursuit.state"},
    "desim.pursuit.assignment": {"desim.pursuit.game", "desim.pursuit.state"},
    "desim.pursuit.utility": {"desim.pursuit.game", "desim.pursuit.state", "desim.value"},
    "desim.pursuit.state": set(),
    "desim.pursuit.events": {"desim.kernel.events"},
    "desim.pursuit.motion": {"desim.pursuit.state"},
    "desim.pursuit.outlook": {"desim.pursuit.state"},
    "desim.pursuit.evasion": {
        "desim.elementary",
        "desim.pursuit.capture",
        "desim.pursuit.outlook",
        "desim.pursuit.state",
        "desim.value",
    },
    "desim.pursuit.perception": {
        "desim.kernel.clock",
        "desim.kernel.events",
        "desim.kernel.records",
        "desim.pursuit.evasion",
        "desim.pursuit.events",
        "desim.pursuit.outlook",
        "desim.pursuit.state",
        "desim.pursuit.word",
    },
    "desim.pursuit.kinematics": {"desim.kernel.clock", "desim.pursuit.state"},
    "desim.pursuit.target": {
        "desim.kernel.clock",
        "desim.pursuit.capture",
        "desim.pursuit.kinematics",
        "desim.pursuit.motion",
        "desim.pursuit.perception",
        "desim.pursuit.reckoning",
        "desim.pursuit.state",
        "desim.value",
    },
    "desim.pursuit.steering": {
        "desim.kernel.clock",
        "desim.pursuit.guidance",
        "desim.pursuit.kinematics",
        "desim.pursuit.sensing",
        "desim.pursuit.state",
        "desim.pursuit.target",
    },
    "desim.pursuit.sensing": {
        "desim.kernel",
        "desim.pursuit.reckoning",
        "desim.pursuit.state",
        "desim.pursuit.surroundings",
        "desim.value",
    },
    "desim.pursuit.guidance": {
        "desim.pursuit.capture",
        "desim.pursuit.motion",
        "desim.pursuit.state",
        "desim.value",
    },
    "desim.pursuit.reckoning": {"desim.kernel.clock", "desim.pursuit.guidance", "desim.pursuit.motion"},
    "desim.pursuit.word": {
        "desim.kernel.events",
        "desim.kernel.records",
        "desim.kernel.wire",
        "desim.pursuit.surroundings",
        "desim.value",
    },
    "desim.pursuit.surroundings": {"desim.pursuit.state"},
    "desim.pursuit.belief": {
        "desim.kernel",
        "desim.pursuit.state",
        "desim.pursuit.surroundings",
        "desim.pursuit.word",
        "desim.value",
    },
    "desim.pursuit.agent": {
        "desim.kernel",
        "desim.pursuit.belief",
        "desim.pursuit.state",
        "desim.pursuit.utility",
        "desim.pursuit.surroundings",
        "desim.pursuit.word",
    },
    "desim.grid": {"desim.value"},
    "desim.scenario": {"desim.grid", "desim.kernel", "desim.pursuit", "desim.value"},
    "desim.assumptions": {"desim.kernel", "desim.scenario"},
    "desim.invariants": {
        "desim.analysis.metrics",
        "desim.kernel",
        "desim.pursuit",
        "desim.scenario",
        "desim.simulation",
    },
    "desim.warnings": {"desim.assumptions", "desim.kernel", "desim.pursuit.sensing", "desim.scenario", "desim.value"},
    "desim.guards": set(),
    "desim.toml_lines": set(),
    "desim.source": {"desim.kernel.presets", "desim.scenario", "desim.toml_lines", "desim.value"},
    "desim.scenario_file": {"desim.guards", "desim.scenario", "desim.source", "desim.toml_lines", "desim.value"},
    "desim.environment": set(),
    "desim.provenance": {
        "desim.environment",
        "desim.guards",
        "desim.kernel.links",
        "desim.kernel.presets",
        "desim.scenario",
        "desim.source",
        "desim.value",
    },
    "desim.world": {"desim.kernel", "desim.pursuit", "desim.scenario", "desim.value"},
    "desim.interrupts": set(),
    "desim.timeout": set(),
    "desim.waiting": {"desim.kernel.clock", "desim.timeout"},
    "desim.simulation": {
        "desim.kernel",
        "desim.pursuit",
        "desim.scenario",
        "desim.timeout",
        "desim.waiting",
        "desim.world",
    },
    "desim.names": set(),
    "desim.folder": {
        "desim.analysis",
        "desim.guards",
        "desim.kernel",
        "desim.names",
        "desim.provenance",
        "desim.pursuit",
        "desim.scenario",
        "desim.scenario_file",
        "desim.simulation",
    },
    "desim.analysis": {
        "desim.analysis",
        "desim.guards",
        "desim.kernel",
        "desim.names",
        "desim.pursuit",
        "desim.scenario",
        "desim.simulation",
        "desim.value",
    },
    "desim.view.replay": {
        "desim.analysis",
        "desim.kernel",
        "desim.pursuit",
        "desim.simulation",
        "desim.view.passages",
    },
    "desim.view.report": {
        "desim.analysis",
        "desim.guards",
        "desim.names",
        "desim.provenance",
        "desim.study",
        "desim.view",
    },
    "desim.view": {
        "desim.analysis",
        "desim.guards",
        "desim.kernel.clock",
        "desim.kernel.events",
        "desim.kernel.faults",
        "desim.provenance",
        "desim.pursuit",
        "desim.scenario",
        "desim.scenario_file",
        "desim.simulation",
        "desim.value",
        "desim.view",
    },
    "desim.study.imperfections": {"desim.kernel", "desim.pursuit.sensing", "desim.scenario", "desim.value"},
    "desim.study.units": {"desim.scenario", "desim.value"},
    "desim.study": {
        "desim.analysis",
        "desim.environment",
        "desim.guards",
        "desim.interrupts",
        "desim.provenance",
        "desim.scenario",
        "desim.scenario_file",
        "desim.simulation",
        "desim.source",
        "desim.study",
        "desim.timeout",
        "desim.value",
    },
    "desim.cli": {"desim"},
    "desim.__main__": {"desim.cli"},
    "desim": {"desim"},
    "protocols": {
        "desim.kernel.clock",
        "desim.kernel.records",
        "desim.kernel.wire",
        "desim.pursuit.agent",
        "desim.pursuit.assignment",
        "desim.pursuit.belief",
        "desim.pursuit.capture",
        "desim.pursuit.game",
        "desim.pursuit.state",
        "desim.pursuit.utility",
        "desim.pursuit.word",
        "desim.value",
        "protocols",
    },
    "scenarios": {"desim", "protocols", "scenarios"},
}
FORBIDDEN = {
    "desim.kernel.events": {"simpy", "networkx"},
    "desim.kernel.trace_file": {"simpy", "networkx"},
    "desim.kernel.positions": {"simpy", "networkx"},
    "desim.kernel.cells": {"simpy", "networkx"},
    "desim.kernel.complete": {"simpy"},
    "desim.kernel.hops": {"simpy", "networkx"},
    "desim.kernel.latency": {"simpy", "networkx"},
    "desim.kernel.loss": {"simpy", "networkx"},
    "desim.kernel.reach": {"simpy", "networkx"},
    "desim.kernel.medium": {"simpy", "networkx"},
    "desim.kernel.graphs": {"simpy"},
    "desim.kernel.links": {"simpy", "networkx"},
    "desim.kernel.topology": {"simpy"},
    "desim.pursuit.game": {"simpy", "networkx"},
    "desim.pursuit.state": {"simpy", "networkx"},
    "desim.pursuit.motion": {"simpy", "networkx"},
    "desim.pursuit.evasion": {"simpy", "networkx"},
    "desim.pursuit.outlook": {"simpy", "networkx"},
    "desim.pursuit.guidance": {"simpy", "networkx"},
    "desim.scenario": {"simpy"},
    "desim.analysis": {"simpy", "networkx"},
    "desim.study": {"simpy", "networkx"},
    "desim.view": {"simpy", "networkx"},
    "protocols": {"simpy", "networkx"},
}
MODULES = sorted(path for package in ("desim", "protocols", "scenarios") for path in (ROOT / package).rglob("*.py"))


def name_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path):
    """Yield every module a file imports, at the top or inside a function."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if (ROOT / inner.replace(".", "/")).with_suffix(".py").exists() else node.module


def rule_for(name, rules):
    """Return the rule of the most specific entry that covers a module."""
    covering = [entry for entry in rules if name == entry or (name.startswith(entry + ".") and entry != "desim")]
    return rules[max(covering, key=len)] if covering else None


def within(module, allowed):
    return any(module == each or module.startswith(each + ".") for each in allowed)


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_module_imports_only_what_lies_below_it(path):
    name = name_of(path)
    ours = {module for module in imports(path) if module.split(".")[0] in OURS}
    allowed = rule_for(name, ALLOWED)
    assert allowed is not None or not ours, f"{name} has no rule"
    assert not [module for module in ours if not within(module, allowed)]
    theirs = {module.split(".")[0] for module in imports(path)} - set(OURS)
    assert not theirs & (rule_for(name, FORBIDDEN) or set())


def test_the_rules_would_notice_an_arrow_the_wrong_way():
    assert not within("desim.world", ALLOWED["desim.kernel"])
    assert rule_for("desim.kernel.network", ALLOWED) == ALLOWED["desim.kernel"]
    assert rule_for("desim.kernel.clock", ALLOWED) == set()
    assert rule_for("desim.novel", ALLOWED) is None
    assert rule_for("desim.pursuit.novel", ALLOWED) is None
    assert set(imports(ROOT / "desim/simulation.py")) >= {"desim.world", "simpy"}


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


def rounded_by_processor(source):
    """Return the line and name of all that a program uses whose last digits depend on the processor."""
    found = []
    for node in ast.walk(ast.parse(source)):
        owner, names = "", []
        if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
            names = ["matmul"]
        elif isinstance(node, ast.Attribute):
            owner, names = ast.unparse(node.value), [node.attr]
        elif isinstance(node, ast.Import | ast.ImportFrom):
            owner = getattr(node, "module", None) or ""
            names = [part for name in (owner, *(each.name for each in node.names)) for part in name.split(".")]
        rules = [LINEAR_ALGEBRA, OF_NUMPY] if owner in {"np", "numpy"} else [LINEAR_ALGEBRA]
        found += [(node.lineno, name) for name in names if any(rule.fullmatch(name) for rule in rules)]
    return found


def test_no_last_digit_depends_on_the_processor():
    found = {name_of(path): rounded_by_processor(path.read_text(encoding="utf-8")) for path in MODULES}
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
def test_a_digit_that_depends_on_the_processor_would_be_noticed(line):
    assert rounded_by_processor(line)
    assert not rounded_by_processor("from math import exp; exp(a) + math.log(b) + np.sqrt(c) + (a * b).sum()")


@pytest.mark.slow
def test_the_mathematics_loads_without_a_simulator():
    program = (
        "import sys; import desim.pursuit.game, desim.pursuit.motion, desim.pursuit.evasion, desim.kernel.links;"
        "sys.exit(bool({'simpy', 'networkx'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_the_kernel_stands_alone():
    program = (
        "import sys; import desim.kernel.network, desim.kernel.links;"
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
    *("desim.environment", "desim.provenance", "desim.study", "desim.view", "protocols.cbba", "protocols.server"),
}
"""What one run of a small scenario has no use for."""
COMPUTES = {"networkx", "numpy", "pydantic", "simpy"}
RELAY = "scenarios/relay.toml"
PROGRAMS = {
    "import": ("import desim; desim.__all__", SLOW_TO_IMPORT | COMPUTES | {"click", "desim.scenario"}),
    "load": (f"import desim; desim.load('{RELAY}')", SLOW_TO_IMPORT | {"desim.analysis", "desim.simulation"}),
    "check": (f"from desim.cli import main; main(['check', '{RELAY}'])", SLOW_TO_IMPORT | {"desim.simulation"}),
    "run": (f"from desim.cli import main; main(['run', '{RELAY}', '--set', 'horizon=0.1'])", SLOW_TO_IMPORT),
}


@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", PROGRAMS)
def test_nothing_is_loaded_that_is_not_needed(name):
    """What is slow to import is imported by whatever needs it: the start of a short run is most of its time."""
    program, absent = PROGRAMS[name]
    told = f"import sys\ntry:\n    {program}\nexcept SystemExit:\n    pass\nprint(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", told], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stderr.split())
    assert {"desim"} <= loaded
    assert not absent & loaded
