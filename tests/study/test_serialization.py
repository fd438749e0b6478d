"""Serialization of calls: their bytes include the code of user modules, also if threads pack calls at the same time."""

import importlib
import pickle
import subprocess
import sys
from functools import lru_cache, partial
from pathlib import Path
from threading import Event, Thread
from types import ModuleType

import pytest

from desim.config.own_modules import is_installed
from desim.study.workers import serialization
from desim.study.workers.serialization import called, packed


def test_a_call_packed_while_another_thread_packs_includes_its_code(tmp_path, monkeypatch):
    (tmp_path / "packed_by_two.py").write_text("def double(x):\n    return 2 * x\n")
    monkeypatch.syspath_prepend(tmp_path)
    call = partial(importlib.import_module("packed_by_two").double, 2)
    begun, other = Event(), Event()
    contents = {}

    class Interleaved(serialization.CallPickler):
        """Ends the first call when the second has begun, if it can, and the second after the first."""

        def dump(self, obj):
            if begun.is_set():
                other.set()
                first.join(timeout=10.0)
            else:
                begun.set()
                other.wait(timeout=0.05)
            super().dump(obj)

    alone = packed(call)
    monkeypatch.setattr(serialization, "CallPickler", Interleaved)
    first, second = (Thread(target=lambda k=k: contents.__setitem__(k, packed(call))) for k in range(2))
    first.start()
    assert begun.wait(timeout=10.0)
    second.start()
    second.join(timeout=10.0)
    first.join(timeout=10.0)
    assert contents == {0: alone, 1: alone}
    assert b"packed_by_two.py" in alone


def test_a_wrapper_that_passes_on_attributes_arrives_in_another_process():
    """Made anew, it has nothing yet from which it could pass on `__setstate__`."""

    class Passing:
        def __init__(self, inner):
            self.inner = inner

        def __getattr__(self, name):
            return getattr(self.inner, name)

    assert pickle.loads(packed(partial(Passing([3]).index, 3)))() == 0
    assert pickle.loads(packed(partial(getattr, Passing(3 + 4j), "imag")))() == 4


@pytest.mark.parametrize("target", [False, True])
def test_the_code_of_an_installed_package_is_imported_by_the_other_process(tmp_path, monkeypatch, target):
    """Also if it was installed into any folder, by `pip install --target`; a module beside it is the user's."""
    folder, package = tmp_path / ("libraries" if target else "site-packages"), f"packed_{target}"
    (folder / package / "inner").mkdir(parents=True)
    for file in (f"{package}/__init__.py", f"{package}/inner/__init__.py"):
        (folder / file).touch()
    for file in (f"{package}/inner/deep", f"{package}_alone", f"{package}_mine"):
        (folder / f"{file}.py").write_text("def double(x):\n    return 2 * x\n")
    if target:
        (folder / f"{package}-1.0.dist-info").mkdir()
        listed = [f"{package}/__init__.py,sha256=0,9", f"{package}/inner/deep.py,,", f"{package}_alone.py,,"]
        (folder / f"{package}-1.0.dist-info" / "RECORD").write_text("\n".join(listed))
    monkeypatch.syspath_prepend(folder)
    for name, is_code in ((f"{package}.inner.deep", False), (f"{package}_alone", False), (f"{package}_mine", target)):
        module = importlib.import_module(name)
        assert (b".py" in packed(partial(module.double, 2))) == is_code
        assert is_installed(Path(module.__file__)) != is_code


def test_a_module_of_a_class_of_its_own_is_imported_by_the_other_process(monkeypatch):
    """Such as that of mpmath, or one that imports its parts when they are first named."""

    class Lazy(ModuleType):
        pass

    lazy = Lazy("lazy_module")
    lazy.three = 3
    monkeypatch.setitem(sys.modules, "lazy_module", lazy)

    def add(x):
        return lazy.three + x

    assert pickle.loads(packed(partial(add, 2)))() == 5


SCRIPT = """
import struct
from functools import cache, cached_property, lru_cache, singledispatch, singledispatchmethod

from desim import Scenario, Team, sweep

HEADER = struct.Struct("<if")


@lru_cache(maxsize=7)
def fibonacci(n):
    return n if n < 2 else fibonacci(n - 1) + fibonacci(n - 2)


@cache
def double(x):
    return 2 * x


@singledispatch
def read(body):
    return "other"


@read.register
def read_number(body: int):
    return f"number, {read([])}, {read('')}"


@read.register(str)
def read_text(body):
    return "text" if body else read(None)


class Notes:
    @singledispatchmethod
    def take(self, body):
        return body

    @take.register
    def take_number(self, body: int):
        return body + 1

    @cached_property
    def three(self):
        return 3


def protocol(me):
    notes = Notes()
    assert (fibonacci(10), double(4), notes.three, vars(notes), HEADER.size) == (55, 8, 3, {"three": 3}, 8)
    assert fibonacci.cache_info().maxsize == 7
    assert (read(3), read("a"), notes.take(3), notes.take("3")) == ("number, other, other", "text", 4, "3")
    yield me.sleep(0.1)
    me.assign(True)


if __name__ == "__main__":
    scenario = Scenario(team=Team(count=2, active_at_start=0.0), horizon=0.2, protocol=protocol)
    for executor in (1, 2):
        result = sweep(scenario, {"team.count": [1, 2]}, reps=1, executor=executor)
        print([estimate.mean for estimate in result.estimates("active_time")], [row.traceback for row in result.failed])
"""


@pytest.mark.whole
def test_a_script_may_cache_and_pack_in_workers_as_in_its_own_process(tmp_path):
    """The wrappers of functools around its code are made anew there, since nobody can import them."""
    (tmp_path / "script.py").write_text(SCRIPT)
    printed = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=True)
    alone, together = printed.stdout.splitlines()
    assert alone == together == "[0.1, 0.2] []"


def test_a_call_of_a_function_with_a_cache_is_made_anew_unless_it_can_be_imported(tmp_path):
    @lru_cache(maxsize=3)
    def count_down(n):
        return n and count_down(n - 1)

    made = pickle.loads(packed(partial(count_down, 5))).func
    assert (made(5), made.cache_info().maxsize, made.__wrapped__.__name__) == (0, 3, "count_down")
    assert made.cache_info().currsize == 3  # it calls itself through its own cache
    assert pickle.loads(packed(partial(is_installed, tmp_path))).func is is_installed


def counting():
    """Return a function that counts by a helper, one that reads the count, and one that calls itself."""
    count = 0

    def step():
        nonlocal count
        count += 1

    def counted():
        step()
        return count

    def factorial(n):
        return n * factorial(n - 1) if n else count

    return counted, lambda: count, factorial


def test_functions_share_the_variables_of_an_enclosing_function_in_another_process():
    def call(counted, read, factorial):
        return counted(), counted(), read(), factorial(3), [item() for item in (counted, read)]

    functions = counting()
    assert pickle.loads(called(packed(partial(call, *functions)))) == (1, 2, 2, 12, [3, 3])
    assert functions[1]() == 0
