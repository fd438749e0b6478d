"""Serialization of calls: their bytes include the code of user modules, also if threads pack calls at the same time."""

import importlib
import pickle
from functools import partial
from threading import Event, Thread

from desim.study.workers import serialization
from desim.study.workers.serialization import packed


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
