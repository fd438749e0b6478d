"""What names say: local variables name the thing they hold, and a public name is defined in one module."""

import ast
import re
from collections import Counter, defaultdict

import pytest

from tests.test_architecture import MODULES, name_of, nodes_of, tree_of

VAGUE = {"each": 20, "found": 5, "own": 5, "known": 5, "what": 10, "given": 5, "said": 0}
"""Names that say nothing of what they hold, and the most variables and arguments with each."""
LIBRARIES = ("desim", "protocols")
"""The packages whose public names are unique; a script in `scenarios` is a program with a `main`."""
SHARED_NAMES = {
    "a command is called like the function that it runs, and completes the words that it lists": (
        "bench compare examples explain export fates keys ls play plot protocols race replay report run"
        " sensitivity status summary sweep"
    ),
    "a module of one file format or folder is used by its name, as in perfetto.write": "document read tables write",
    "one thing in two forms: in the records of a trace, and in a scenario": "Actions Evader Speeds",
    "the same measure of two things, each beside what it measures": "capture_time first_contact gains",
    "the terms of two fields, or of two file formats": (
        "Column Component Diffusion Entry Measurement Message Node Order Point Points Row Table Track Velocity"
    ),
    "small functions of two rooms that do not know each other": (
        "columns_of connected differences from_json kind_of positions_known size_of within"
    ),
}
"""Public functions, classes and types that several modules define, by the reason."""


def bindings(tree):
    """Yield the name of each variable that is assigned, and of each argument."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and node.name is not None:
            yield node.name


@pytest.mark.slow
def test_variables_say_what_they_hold():
    modules = defaultdict(Counter)
    for path in MODULES:
        for name in bindings(tree_of(path)):
            if name in VAGUE:
                modules[name][name_of(path)] += 1
    frequent = {name: modules[name] for name, most in VAGUE.items() if modules[name].total() > most}
    assert not frequent, f"at most {VAGUE}: {frequent}"


@pytest.mark.parametrize(
    "line",
    [
        "each = 1",
        "def f(each): pass",
        "g = lambda each: 1",
        "y = [1 for each in ()]",
        "for _, each in (): pass",
        "with open(f) as each: pass",
        "try: pass\nexcept ValueError as each: pass",
        "match y:\n    case [each]: pass",
        "if (each := 1): pass",
    ],
)
def test_a_vague_name_would_be_detected(line):
    assert list(bindings(ast.parse(line))).count("each") == 1


def public_names(tree):
    """Yield the names of the public functions, classes and types of a module; type variables are not among them."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names = [node.name]
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            is_variable = isinstance(node.value, ast.Call) and ast.unparse(node.value.func) == "TypeVar"
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [] if is_variable else [target.id for target in targets if isinstance(target, ast.Name)]
            names = [name for name in names if re.search("[a-z]", name)]
        else:
            names = []
        yield from (name for name in names if not name.startswith("_"))


@pytest.mark.slow
def test_a_public_name_is_defined_in_one_module():
    """Constants are not counted: those that one module uses alone are called after their part in it."""
    modules = defaultdict(set)
    for path in MODULES:
        if name_of(path).partition(".")[0] in LIBRARIES:
            for name in public_names(tree_of(path)):
                modules[name].add(name_of(path))
    allowed = {name for names in SHARED_NAMES.values() for name in names.split()}
    repeated = {name: sorted(owners) for name, owners in modules.items() if len(owners) > 1}
    assert not {name: owners for name, owners in repeated.items() if name not in allowed}


def test_a_public_name_would_be_detected():
    source = """
def f(): pass
class C: pass
Alias = dict[str, int]
Other: TypeAlias = int
Variable = TypeVar("Variable")
CONSTANT = 1
def _private(): pass
"""
    assert list(public_names(ast.parse(source))) == ["f", "C", "Alias", "Other"]


@pytest.mark.slow
def test_a_sentence_about_what_to_choose_begins_a_paragraph():
    """An error message shows the first paragraph of a field, which says what the field is."""
    texts = [
        (name_of(path), paragraph)
        for path in MODULES
        for node in nodes_of(path)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and "doubt" in node.value
        for paragraph in re.split(r"\n\s*\n", node.value)
    ]
    assert len(texts) > 100
    assert not [(module, text) for module, text in texts if re.search(r"[.)\]]\s+If\s+in\s+doubt", text)]
