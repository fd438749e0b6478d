"""The stable hash of objects: equal for equal objects in every process, and refused for objects that have none."""

import copy
import linecache
import os
import pickle
import random
import re
import subprocess
import sys
import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Sized
from dataclasses import dataclass
from decimal import Decimal
from enum import Enum
from functools import cached_property, lru_cache, partial, partialmethod, reduce
from importlib import import_module, invalidate_caches, reload
from math import inf, nan, nextafter
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from unittest.mock import Mock
from weakref import WeakSet

import networkx as nx
import numpy as np
import pytest
from pydantic import BaseModel, PrivateAttr

from desim.config.data_files import content_hash
from desim.config.model import Value
from desim.config.own_modules import find_own_modules, module_beside
from desim.config.shared_state import StateWarning
from desim.study.plan import user_code
from desim.study.plan.assigned_values import values_beside_source
from desim.study.plan.config_hash import StablePickler, _imported, code_with_values, object_hash
from desim.study.plan.user_code import UserCode


def stable_hash(value):
    """Return the hash of an object, and of the sources that it comes from with the values that they do not tell."""
    user = UserCode()
    return StablePickler(user).digest(value), tuple(sorted(code_with_values(user).items()))


class Plain:
    def __init__(self, gain):
        self.gain = gain

    @cached_property
    def twice(self):
        return 2 * self.gain

    def rule(self, me):
        return iter((self.gain,))


class Slotted:
    __slots__ = ("gain",)

    def __init__(self, gain):
        self.gain = gain


class Keen(Slotted):
    """It declares its own contents."""

    __slots__ = ("lock",)

    def __getstate__(self):
        return self.gain


@dataclass(frozen=True)
class Record:
    gain: object


class Model(Value):
    gain: float = 1.0
    _table: tuple[float, ...] = PrivateAttr(default=())

    @cached_property
    def twice(self):
        return 2 * self.gain


class Open(BaseModel, extra="allow"):
    pass


class Colour(Enum):
    RED = 1
    BLUE = 2


def enclosing(gain):
    return lambda me: gain


def by_default(gain):
    return lambda me, gain=gain: gain


def with_attribute(gain):
    def rule(me):
        return rule.gain

    rule.gain = gain
    return rule


def remembering(gain):
    @lru_cache
    def rule(me):
        return gain

    return rule


def one_of_two(gain):
    if gain == 1.0:

        def rule(me):
            return 1.0

    else:

        def rule(me):
            return 2.0

    return rule


def with_private(gain):
    model = Model()
    model._table = (gain,)
    return model


def local(gain):
    class Local:
        kept = gain

        def __call__(self, me):
            return self.kept

    return Local()


def local_closure(gain):
    class Local:
        @property
        def gain(self):
            return gain

    return Local


def circle(gain):
    first, second = Plain(gain), Plain(None)
    first.next, second.next = second, first
    return first


def various(gain):
    class Local(Sized):
        __slots__ = ("slot",)

        def __len__(self):
            return 1

        @staticmethod
        def one(me):
            return 1.0

        @classmethod
        def other(cls, me):
            return gain

    return Local


def bound_beforehand(gain):
    class Local:
        __call__ = partialmethod(Plain.rule, gain)

    return Local


def derived(gain):
    class Local:
        @cached_property
        def rule(self):
            return gain

    return Local


TABLE = np.arange(2000.0)
MADE_OF = {
    "object": Plain,
    "object inside": lambda gain: Plain([{"a": Plain(gain)}]),
    "objects in a circle": circle,
    "slots": Slotted,
    "dataclass": Record,
    "state": lambda gain: Keen(gain),
    "model": lambda gain: Model(gain=gain),
    "what a model keeps to itself": with_private,
    "method": lambda gain: Plain(gain).rule,
    "closure": enclosing,
    "closure over an object": lambda gain: enclosing(Plain(gain)),
    "closure over a closure": lambda gain: enclosing(enclosing(gain)),
    "default": by_default,
    "default of a keyword": lambda gain: eval(f"lambda me, *, gain={gain}: gain"),
    "name that is read": lambda gain: eval(f"lambda me: me.gain_{gain:.0f}"),
    "attribute of a function": with_attribute,
    "function with a cache": remembering,
    "functions of one name": one_of_two,
    "partial": lambda gain: partial(enclosing, gain),
    "attribute of a local class": local,
    "method of a local class": local_closure,
    "methods of a local class": various,
    "method that is no function": bound_beforehand,
    "property that is kept": derived,
    "what a model has beside its fields": lambda gain: Open(gain=gain),
    "array": lambda gain: np.array([0.1, gain]),
    "array of objects": lambda gain: np.array([Plain(gain)], dtype=object),
    "masked array": lambda gain: np.ma.array([1.0, 2.0], mask=[False, gain > 1.0]),
    "long array": lambda gain: np.where(TABLE == 1000.0, gain, TABLE),
    "scalar": np.float64,
    "tuple": lambda gain: (gain,),
    "dict": lambda gain: {"a": gain},
    "key": lambda gain: {gain: "a"},
    "proxy": lambda gain: MappingProxyType({"a": gain}),
    "set": lambda gain: {"a", gain},
    "deque": lambda gain: deque([gain], maxlen=3),
    "counter": lambda gain: Counter({"a": gain}),
    "ordered": lambda gain: OrderedDict(a=gain),
    "namespace": lambda gain: SimpleNamespace(a=gain),
    "generator of numbers": lambda gain: np.random.default_rng(int(gain)),
    "generator of Python": lambda gain: random.Random(int(gain)),
    "graph": lambda gain: nx.path_graph(int(gain) + 2),
    "enumeration": lambda gain: Colour(int(gain)),
    "pattern": lambda gain: re.compile(f"{gain}"),
    "slice": slice,
}


def test_the_folder_of_a_module_is_not_in_the_hash_of_code_that_imports_it():
    def names(module):
        return StablePickler(UserCode()).digest((lambda: None).__code__.replace(co_names=("mine.helper", module)))

    assert names("mine@3f2a.helper") == names("mine@77aa.helper") == names("mine.helper")
    assert names("mine.helper") != names("yours.helper")


@pytest.mark.slow
@pytest.mark.parametrize("make", MADE_OF.values(), ids=MADE_OF)
def test_nested_differences_change_the_hash(make):
    assert stable_hash(make(1.0)) == stable_hash(make(1.0)) != stable_hash(make(2.0))


UNLIKE = [
    (0.1, nextafter(0.1, 1.0)),
    (0.0, -0.0),
    (inf, -inf),
    (inf, nan),
    (1, 1.0),
    (1, True),
    (1, "1"),
    ("1", b"1"),
    (1.0, np.float64(1.0)),
    (None, "None"),
    ((1, 2), [1, 2]),
    ([1, 2], [[1, 2]]),
    (["a", "b"], ["ab"]),
    ([], ()),
    ({"a": 1}, [("a", 1)]),
    ({1}, frozenset({1})),
    (np.array([0.1]), np.array([0.1 + 1e-9])),
    (TABLE, TABLE.reshape(40, 50)),
    (TABLE, TABLE.astype(">f8")),
    (np.zeros(2, np.int64), np.zeros(2)),
    (np.sin, np.cos),
    (len, max),
    (Plain, Slotted),
    (Plain(1.0), Slotted(1.0)),
    (np, random),
]


@pytest.mark.slow_but_one
@pytest.mark.parametrize(("one", "other"), UNLIKE)
def test_values_that_look_alike_have_different_hashes(one, other):
    assert stable_hash(one) != stable_hash(other)


def test_a_set_has_the_hash_of_its_members_in_any_order():
    words = [f"word {k}" for k in range(20)]
    assert stable_hash(Plain(set(words))) == stable_hash(Plain({*words[::-1]}))
    digests = {stable_hash(Plain(kind(members))) for kind in (set, frozenset) for members in (words, words[1:], ())}
    assert len(digests) == 6


@pytest.mark.slow
def test_a_copy_has_the_hash_of_its_original():
    held = [Plain({"a": (TABLE, Slotted(1.0))}), circle(1.0), np.random.default_rng(3), nx.path_graph(3)]
    assert stable_hash(held) == stable_hash(copy.deepcopy(held))


@pytest.mark.slow
def test_shared_mutable_objects_differ_from_equal_copies():
    shared, number = Plain(1.0), (1.0, 2.0)
    assert stable_hash([shared, shared]) != stable_hash([Plain(1.0), Plain(1.0)])
    one, other = Plain(1.0), Plain(1.0)
    assert stable_hash([one, other, one]) != stable_hash([one, other, other])
    assert stable_hash([number, number]) == stable_hash([number, tuple([1.0, 2.0])])  # noqa: C409
    assert stable_hash(["ab", "ab"]) == stable_hash(["ab", "".join(["a", "b"])])


@pytest.mark.parametrize("make", [Plain, lambda gain: Model(gain=gain)])
def test_derived_attributes_do_not_change_the_hash(make):
    one = make(1.0)
    before = stable_hash(one)
    assert one.twice == 2.0
    assert stable_hash(one) == before


def deep(_):
    return reduce(lambda inner, _: Plain(inner), range(100_000), None)


class Tags(set):
    """A set whose pickle is in the order of hashes."""


REFUSED = {
    "lock": (lambda _: threading.Lock(), "cannot pickle '_thread.lock' object"),
    "generator": (lambda _: (each for each in ()), "cannot pickle 'generator' object"),
    "function of C": (lambda _: np.frompyfunc(lambda x: x, 1, 1), "Can't pickle <ufunc"),
    "file": (lambda path: path.open("w"), "Cannot pickle files that are not opened for reading"),
    "own set": (lambda _: Tags("ab"), "'Tags' objects have no stable order"),
    "weak set": (lambda _: WeakSet([Plain]), "'WeakSet' objects have no stable order"),
    "deep": (deep, "excessively deep recursion"),
}


@pytest.mark.slow_but_one
@pytest.mark.parametrize(("make", "why"), REFUSED.values(), ids=REFUSED)
def test_an_object_without_a_stable_hash_is_refused(make, why, tmp_path):
    held = make(tmp_path / "file")
    with pytest.raises(Exception, match=re.escape(why)):
        stable_hash(Plain([held]))
    getattr(held, "close", int)()


MODULE = """
FACTOR = {}
try:
    from . import beside_in_a_package
except ImportError:
    pass
class Rule:
    pass
def rule(me):
    return FACTOR
def make():
    return lambda me: FACTOR
"""


@pytest.mark.parametrize("made", ["Rule()", "rule", "make()"])
def test_the_text_of_a_module_beside_the_file_counts(tmp_path, monkeypatch, made):
    """For what is held of it: an object of its class, its function, and one that its function makes."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    found = []
    for factor in (1, 1, 2):
        (tmp_path / "beside.py").write_text(MODULE.format(factor))
        linecache.clearcache()  # it goes by size and time of a file
        sys.modules.pop("beside", None)
        found.append(stable_hash([eval(made, vars(import_module("beside")))]))
    sys.modules.pop("beside")
    assert found[0] == found[1] != found[2]


def test_modules_of_one_name_in_two_folders_count_both_whichever_comes_first(tmp_path, monkeypatch):
    """One is imported by its plain name, the other as the module beside a file."""
    for folder, text in (("plain", "A = 1"), ("beside", "A = 2")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "twice.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path / "plain")
    plain, beside = "twice", module_beside("twice", tmp_path / "beside")
    find_own_modules()
    for names in ((plain, beside), (beside, plain)):
        code = UserCode()
        assert all(map(code.add, names))
        assert len({*code.code.values()}) == 2


GROUP = {
    "group/__init__.py": "",
    "group/near.py": "FACTOR = 1",
    "later.py": "",
    "group/mine.py": "from .near import FACTOR\ndef rule(me):\n    import later\n",
}


@pytest.mark.parametrize("changed", GROUP)
def test_the_text_of_what_a_module_imports_counts(tmp_path, monkeypatch, changed):
    """Of its package, of the module beside it in the package, and of one that its function has yet to import."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "group").mkdir()
    found = []
    for more in ("", "", "\nOTHER = 2"):
        for name, text in (GROUP | {changed: GROUP[changed] + more}).items():
            (tmp_path / name).write_text(text)
        invalidate_caches()
        found.append(stable_hash(import_module("group.mine").rule))
        for name in ("group", "group.near", "group.mine"):
            sys.modules.pop(name)
    assert found[0] == found[1] != found[2]


def test_a_module_that_a_function_imports_from_a_package_is_one_of_its_modules():
    namespace = {}
    exec("def rule(me):\n    from group import near\n    import other.part\n    near.GAIN", namespace)
    assert _imported(namespace["rule"].__code__) == {"group", "group.near", "other.part"}


@pytest.mark.parametrize(
    "body", ["import tuned", "from tuned import GAIN", "def inner():\n        import tuned", "import_module('tuned')"]
)
def test_the_text_of_what_a_function_of_a_script_imports_counts(tmp_path, monkeypatch, body):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    namespace = {"__name__": "__main__"}
    exec(f"def rule(me):\n    import absent.part, hypothesis\n    {body}", namespace)
    found = []
    for text in ("GAIN = 1", "GAIN = 1", "GAIN = 2"):
        (tmp_path / "tuned.py").write_text(text)
        invalidate_caches()
        found.append(stable_hash(namespace["rule"]))
        sys.modules.pop("tuned", None)
    assert found[0] == found[1] != found[2]


BY_TEXT = {
    "a text": "import_module('plugins.one')",
    "a keyword": "import_module(name='plugins.one')",
    "__import__": "__import__('plugins.one')",
    "a text of an f-string": "import_module(f'plugins.{name}')",
    "a text that is formatted": "import_module('plugins.{}'.format(name))",
    "a text that is added to": "import_module('plugins.' + name)",
}


@pytest.mark.parametrize("place", ["script", "module"])
@pytest.mark.parametrize("code", BY_TEXT.values(), ids=BY_TEXT)
def test_what_is_imported_by_a_text_counts(tmp_path, monkeypatch, code, place):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "plugins").mkdir()
    source = f"from importlib import import_module\n\ndef rule(me, name='one'):\n    return {code}\n"
    (tmp_path / "bytext.py").write_text(source)
    namespace = {"__name__": "__main__"}
    exec(source, namespace)
    found = []
    for text in ("GAIN = 1", "GAIN = 1", "GAIN = 2"):
        (tmp_path / "plugins" / "one.py").write_text(text)
        invalidate_caches()
        found.append(stable_hash(namespace["rule"] if place == "script" else import_module("bytext").rule))
        for name in ("plugins", "plugins.one", "bytext"):
            sys.modules.pop(name, None)
    assert found[0] == found[1] != found[2]


@pytest.mark.parametrize(
    ("name", "near"), [(".near", "group/inner/near"), ("..near", "group/near"), (".{}", "group/inner/near")]
)
def test_a_relative_name_that_is_imported_by_a_text_counts(tmp_path, monkeypatch, name, near):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "group" / "inner").mkdir(parents=True)
    call = f"import_module('{name}'.format('near'), __package__)"
    source = f"from importlib import import_module\n\ndef rule(me):\n    return {call}\n"
    (tmp_path / "group" / "inner" / "mine.py").write_text(source)
    found = []
    for text in ("GAIN = 1", "GAIN = 2"):
        (tmp_path / near).with_suffix(".py").write_text(text)
        invalidate_caches()
        found.append(stable_hash(import_module("group.inner.mine").rule))
        for module in ("group", "group.inner", "group.inner.mine"):
            sys.modules.pop(module)
    assert found[0] != found[1]


@pytest.mark.parametrize("beside", [False, True])
@pytest.mark.parametrize("is_hashed_before", [False, True])
def test_a_module_that_was_edited_after_its_import_counts_as_it_was_imported(
    tmp_path, monkeypatch, beside, is_hashed_before
):
    """Also if it is hashed only after the edit: the compiled code, or the loader, has what was imported."""
    monkeypatch.syspath_prepend(tmp_path / ("" if beside else "rules"))
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    (tmp_path / "rules").mkdir()
    (tmp_path / "rules" / "edited.py").write_text("def rule(me):\n    yield me.sleep(1)\n")
    invalidate_caches()
    find_own_modules()
    name = module_beside("edited", tmp_path / "rules")
    assert ("@" in name) == beside
    module = import_module(name)
    found = [object_hash(module.rule) for _ in range(2 * is_hashed_before)]
    (tmp_path / "rules" / "edited.py").write_text("def rule(me):\n    yield me.sleep(20)\n")
    for _ in range(2):
        with pytest.warns(StateWarning, match=r"^edited: edited.py was edited after it was imported, .* reload"):
            found.append(object_hash(module.rule))
    assert len({*found}) == 1
    assert object_hash(reload(module).rule) != found[0]  # a warning is an error
    sys.modules.pop(name)


@pytest.mark.parametrize("beside", [False, True])
def test_a_module_that_was_only_saved_again_was_not_edited(tmp_path, monkeypatch, beside):
    monkeypatch.syspath_prepend(tmp_path / ("" if beside else "rules"))
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    (tmp_path / "rules").mkdir()
    file = tmp_path / "rules" / "touched.py"
    file.write_text("def rule(me):\n    yield me.sleep(1)\n")
    invalidate_caches()
    find_own_modules()
    name = module_beside("touched", tmp_path / "rules")
    module = import_module(name)
    os.utime(file, (0, 0))
    found = object_hash(module.rule)  # a warning is an error
    sys.modules.pop(name)
    assert object_hash(import_module(name).rule) == found
    sys.modules.pop(name)


CONSTANTS = """
GAIN = 1.0
TABLE = {"a": [1, 2]}
ARRAY: tuple = (1, 2)
SET = {1, 2}
LATER = 0
SEEN = []
CACHE = {"a": {}}
TWICE = 1
TWICE = 2
HOOK = None
DRAWN = {}
COUNT = 0
LISTED = []
COMPUTED = len("abc")

class Setting:
    step = 0.1
    hook = None
    calls = 0

class Level(Enum):
    LOW = 1

@dataclass(slots=True)
class Slotted:
    step: float = 0.1

def rule(me):
    global LATER
    LATER += 1
    SEEN.append(1)
    CACHE["a"]["b"] = 2
    Setting.calls += 1
    yield me.sleep(GAIN)
"""
ASSIGNED = {
    "GAIN": lambda module: setattr(module, "GAIN", 2.0),
    "an int": lambda module: setattr(module, "GAIN", 1),
    "TABLE": lambda module: module.TABLE["a"].append(3),
    "ARRAY": lambda module: setattr(module, "ARRAY", np.array([1.0, 3.0])),
    "SET": lambda module: setattr(module, "SET", {1, 3}),
    "step": lambda module: setattr(module.Setting, "step", 0.2),
    "function": lambda module: setattr(module, "HOOK", lambda gain: gain),
    "another function": lambda module: setattr(module, "HOOK", module.rule),
    "number": lambda module: setattr(module, "GAIN", Decimal("1.0")),
    "what has no stable hash": lambda module: setattr(module, "HOOK", (yield_ for yield_ in ())),
    "function of a class": lambda module: setattr(module.Setting, "hook", lambda gain: gain),
}


@pytest.fixture
def with_constants(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "constants.py").write_text(f"from dataclasses import dataclass\nfrom enum import Enum\n{CONSTANTS}")
    (tmp_path / "reading.py").write_text(
        "import constants\nfrom constants import LISTED as LIST\n\ndef rule(me):\n    constants.DRAWN[me.id] = 1\n"
        "    constants.COUNT += 1\n    LIST.append(1)\n    GAIN = 1\n    GAIN += 1\n    TABLE = {}\n    TABLE[1] = 2\n"
        "    yield me.sleep(constants.GAIN)\n"
    )
    invalidate_caches()
    yield import_module("reading")
    for name in ("constants", "reading"):
        sys.modules.pop(name)


@pytest.mark.parametrize("assign", ASSIGNED.values(), ids=ASSIGNED)
def test_a_constant_of_a_module_counts_with_the_value_that_a_program_has_assigned(with_constants, assign):
    constants = with_constants.constants
    rules = [constants.rule, with_constants.rule]
    found = [stable_hash(rule) for rule in rules]
    assign(constants)
    assert all(stable_hash(rule) != before for rule, before in zip(rules, found, strict=True))
    assert values_beside_source(constants, b"", frozenset()) == {}


def test_an_equal_constant_and_what_a_module_changes_itself_do_not_count(with_constants):
    """Enumerations and slots differ from their sources; another module changes a dict, a list and a counter."""
    constants = with_constants.constants
    found = [stable_hash(rule) for rule in (constants.rule, with_constants.rule)]
    assert not any(", " in code for code in dict(stable_hash(with_constants.rule)[1]).values())
    for rule in (constants.rule, with_constants.rule):
        for _ in rule(Mock()):
            pass
    constants.GAIN, constants.ARRAY, constants.TABLE = np.float64(1.0), (1, 2), {"a": [1, 2]}
    constants.COMPUTED, constants.new = 4, 5
    assert (
        constants.LATER
        == constants.Setting.calls
        == len(constants.SEEN)
        == constants.COUNT
        == len(constants.DRAWN)
        == 1
    )
    assert stable_hash(with_constants.rule) == found[1]


def test_the_code_of_a_module_is_told_with_the_values_of_its_variables(with_constants):
    """A short value is shown, so that the error of a store says what differs."""
    constants = with_constants.constants
    ((_, code),) = stable_hash(constants.rule)[1]
    constants.GAIN, constants.TABLE = np.float64(2.0), {"a": ["b" * 50]}
    assert re.fullmatch(
        f"{code}, GAIN = 2.0, TABLE = [0-9a-f]{{16}}", dict(stable_hash(constants.rule)[1])["constants"]
    )


READS = {
    "array": "WEIGHTS = np.load('w.npy')",
    "list": "WEIGHTS = [float(w) for w in np.load('w.npy')]",
    "with": "with open('w.npy', 'rb') as file:\n    WEIGHTS = np.load(file)",
    "json": "WEIGHTS = json.load(open('w.json'))",
    "text": "WEIGHTS = Path('w.json').read_text()",
    "rows": "with open('w.json') as file:\n    WEIGHTS = [*csv.reader(file)]",
    "pickle": "WEIGHTS = pickle.loads(Path('w.pkl').read_bytes())",
    "frame": "WEIGHTS = pd.read_csv('w.csv')",
    "a branch": "if True:\n    WEIGHTS = np.load('w.npy')",
    "a function": "def weights():\n    return np.load('w.npy')\n\nWEIGHTS = weights()",
    "a word": "from lists import load_weights\nWEIGHTS = load_weights()",
    "a class": "class Net:\n    WEIGHTS = np.load('w.npy')",
}


UNCLOSED = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")


@UNCLOSED
@pytest.mark.parametrize("code", READS.values(), ids=READS)
def test_what_a_module_reads_from_a_file_as_it_is_imported_counts(tmp_path, monkeypatch, code):
    import pandas as pd

    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    imports = "import csv, json, pickle\nfrom pathlib import Path\nimport numpy as np\nimport pandas as pd\n"
    (tmp_path / "reads.py").write_text(f"{imports}{code}\n\ndef rule(me):\n    return WEIGHTS\n")
    (tmp_path / "lists.py").write_text("import numpy as np\n\ndef load_weights():\n    return np.load('w.npy')\n")
    found = []
    for weights in ([1.0, 2.0], [1.0, 2.0], [1.0, 3.0]):
        np.save(tmp_path / "w.npy", weights)
        (tmp_path / "w.json").write_text(str(weights))
        (tmp_path / "w.pkl").write_bytes(pickle.dumps(weights))
        pd.DataFrame({"w": weights}).to_csv(tmp_path / "w.csv")
        invalidate_caches()
        found.append(object_hash(import_module("reads").rule))
        for name in ("reads", "lists"):
            sys.modules.pop(name, None)
    assert found[0] == found[1] != found[2]


@UNCLOSED
def test_a_module_that_a_run_imports_has_the_same_hash_before_and_after(tmp_path, monkeypatch):
    """What it reads is not known before; otherwise a second sweep of a session would find other code."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "w.json").write_text("[1.0]")
    (tmp_path / "lazily.py").write_text(f"import json\n\nWEIGHTS = json.load(open({str(tmp_path / 'w.json')!r}))\n")
    (tmp_path / "importing.py").write_text("def rule(me):\n    import lazily\n    yield me.sleep(lazily.WEIGHTS[0])\n")
    invalidate_caches()
    rule = import_module("importing").rule
    found = object_hash(rule)
    assert "lazily" not in sys.modules
    next(rule(Mock()))
    assert object_hash(rule) == found
    sys.modules["lazily"].WEIGHTS.append(2.0)
    assert object_hash(rule) == found
    for name in ("importing", "lazily"):
        sys.modules.pop(name)


INSTALLED = {
    "pack/__init__.py": "",
    "pack/rule.py": "def rule(me):\n    from pack.inner import helper\n",
    "pack/inner/helper.py": "FACTOR = 1",
    "pack-1.0.dist-info/METADATA": (
        "Name: pack\nVersion: 1.0\nRequires-Dist: other>=1\nRequires-Dist: none; extra == 'x'\nRequires-Dist: absent"
    ),
    "pack-1.0.dist-info/top_level.txt": "pack",
    "other-1.0.dist-info/METADATA": "Name: other\nVersion: 1.0",
    "other-1.0.dist-info/top_level.txt": "another",
    "another.py": "",
    "../own.py": "import another, numpy\ndef rule(me):\n    pass\n",
}


@pytest.mark.whole
@pytest.mark.parametrize(
    ("changed", "text", "whose"),
    [
        ("pack/rule.py", "def rule(me):\n    pass\n", ["pack"]),
        ("pack/inner/helper.py", "FACTOR = 2", ["pack"]),
        ("other-1.0.dist-info/METADATA", "Name: other\nVersion: 1.1", ["pack", "own"]),
        ("another.py", "FACTOR = 2", []),
    ],
)
def test_an_installed_package_counts_with_all_its_modules_and_what_it_requires_with_its_version(
    tmp_path, monkeypatch, changed, text, whose
):
    """So does an installed package that a module beside the file imports."""
    folder = tmp_path / "site-packages"
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    names, found = ("pack", "pack.rule", "own"), []
    for texts in (INSTALLED, INSTALLED, INSTALLED | {changed: text}):
        for name, each in texts.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(each)
        for memory in (user_code._package, user_code._distributions, user_code._version):
            memory.cache_clear()
        for name in names:
            sys.modules.pop(name, None)
        invalidate_caches()
        found.append({name: stable_hash(import_module(name).rule) for name in names[1:]})
    for name in names:
        sys.modules.pop(name)
    user_code._distributions.cache_clear()
    assert found[0] == found[1]
    assert [name.split(".")[0] for name in names[1:] if found[1][name] != found[2][name]] == whose
    assert ("distribution other", "1.0") in found[0]["own"][1]


def test_an_installed_package_counts_with_its_modules_and_what_it_requires(monkeypatch):
    """`HASHED_BY_NAME` and extras are left out, and so is what cannot be found."""
    file, code = Path(import_module("jinja2").__file__), UserCode()
    assert code.add("jinja2")
    assert not code.add("no_such_module")
    assert not code.add("__main__")
    assert {*code.code} == {"jinja2", "distribution Jinja2", "distribution MarkupSafe"}
    assert user_code._package.__wrapped__("jinja2", file) == code.code
    read = []
    monkeypatch.setattr(Path, "read_bytes", lambda path: read.append(path) or b"")
    assert user_code._package.__wrapped__("jinja2", file)["jinja2"] != code.code["jinja2"]
    assert read == sorted(file.parent.rglob("*.py"))
    alone = user_code._package.__wrapped__("typing_extensions", file)
    assert alone["typing_extensions"] == content_hash(f'[["__init__.py", "{content_hash(b"")}"]]'.encode())


def test_the_versions_of_what_is_not_installed_are_left_out():
    assert user_code._versions(["numpy", "nobody-has-this"]) == {"distribution numpy": np.__version__}


DISPATCHING = """
from functools import singledispatch
@singledispatch
def read(body):
    return {other}
@read.register
def read_number(body: int):
    return {number}
def rule(body):
    return read(body)
"""


def test_a_function_that_dispatches_counts_with_all_implementations_and_not_with_its_cache():
    def hashed(other, number, *called):
        variables = {"__name__": "nowhere"}
        exec(DISPATCHING.format(other=other, number=number), variables)
        assert [variables["rule"](body) for body in called] == [number, other][: len(called)]
        return stable_hash(variables["rule"])

    plain = hashed(0, 1)
    assert hashed(0, 1, 3, "x") == plain
    assert plain not in (hashed(5, 1), hashed(0, 7))


SCRIPT = """
from dataclasses import dataclass
from enum import Enum
from functools import cache, cached_property, partial
import numpy as np
from desim.config.model import Value
from desim.study.plan.config_hash import StablePickler
from desim.study.plan.user_code import UserCode
FACTOR = {factor}
OTHER = {other}
def helper():
    return [FACTOR for _ in range(2)]
class Base:
    def gain(self):
        return helper()
class Rule(Base):
    @cached_property
    def table(self):
        return 1
    def __call__(self, me):
        return me in {{"a", "b", "c"}} and self.gain()
@dataclass
class Record:
    names: set
class Model(Value):
    names: frozenset[str] = frozenset("abc")
class Colour(Enum):
    RED = "red"
@cache
def remembered(me):
    return FACTOR
def nested(held):
    class Local:
        def __call__(self, me):
            return held
    return Local()
HELD = [Rule(), Record(set("abc")), Model(), Colour.RED, remembered, nested(np.ones(3)), nested, lambda me: "".join(me)]
HELD += [partial(helper), Rule().gain, np.random.default_rng(3), "".join(["a", "b"]), "ab", ("ab",)]
for each in HELD:
    print(StablePickler(UserCode()).digest(each))
"""


@pytest.mark.whole
def test_in_a_script_what_a_rule_reads_counts_and_nothing_else_in_every_process_and_folder(tmp_path):
    def hashes(seed="1", folder="a", **texts):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "script.py").write_text(SCRIPT.format(**{"factor": 1, "other": 1} | texts))
        environment = {"PYTHONHASHSEED": seed, "PYTHONPATH": ":".join(sys.path)}
        call = [sys.executable, str(tmp_path / folder / "script.py")]
        return subprocess.run(call, env=environment, capture_output=True, text=True, check=True).stdout.split()

    first = hashes()
    assert first == hashes(seed="2", folder="b", other=2)
    changed = [k for k, (one, other) in enumerate(zip(first, hashes(factor=2), strict=True)) if one != other]
    assert changed == [0, 4, 8, 9]


def test_the_names_of_a_module_and_of_what_is_in_it_do_not_run_together(monkeypatch):
    """Class `c` of a module `ab`, and class `bc` of a module `a`, neither of which has a text."""
    found = set()
    for module, name in (("ab", "c"), ("a", "bc")):
        home = type(name, (), {"__module__": module})
        monkeypatch.setitem(sys.modules, module, SimpleNamespace(**{name: home}))
        found.add(stable_hash(home))
    assert len(found) == 2


def test_the_files_of_a_class_are_not_those_of_its_objects():
    """A class that an object holds declares nothing: its `depends_on` is a method or a property of its objects."""

    class Meta(type):
        """A type of the user's classes."""

    class Reading(metaclass=Meta):
        @property
        def depends_on(self):
            return ("missing.csv",)

    user = UserCode()
    StablePickler(user).digest(Plain(Reading))
    assert user.files == {}


def test_what_a_source_may_import_is_read_with_its_dots():
    source = b"""
import a.b, c as d
from e import f
def later():
    from . import g
    from .h import i
    from ..j import k
    from ....beyond import n
    import_module("o.p"), importlib.import_module(".q", __package__), __import__("r"), import_module(s), t("u")
"""
    assert user_code._imported(source, "top.mid") == {
        *("a.b", "c", "e", "e.f", "top.mid", "top.mid.g", "top.mid.h", "top.mid.h.i", "top.j", "top.j.k"),
        *("o.p", "top.mid.q", "r"),
    }


def test_a_global_that_a_function_of_a_script_reads_by_its_name_as_a_text_counts():
    namespace = {"__name__": "__main__"}
    exec("GAIN = OTHER = 1\ndef rule(me):\n    return globals()['GAIN']", namespace)
    found = []
    for name, value in (("GAIN", 1), ("OTHER", 2), ("GAIN", 2)):
        namespace[name] = value
        found.append(stable_hash(namespace["rule"]))
    assert found[0] == found[1] != found[2]
