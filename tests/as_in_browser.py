"""A Python that lacks what a browser's lacks: `python -m tests.as_in_browser` runs desim in it, and prints what it did.

It has the modules and packages that `tests/pyodide.json` lists, and those of `FROM_INDEX`; it starts no threads and no
processes, and has no timers. The list is that of Pyodide, CPython compiled to WebAssembly.
"""

import json
import signal
import sys
import sysconfig
import threading
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"
LIST = json.loads((Path(__file__).parent / "pyodide.json").read_text(encoding="utf-8"))
FROM_INDEX = frozenset({"click", "loky", "simpy"})
"""The packages that a browser takes from PyPI instead: Pyodide lacks them or has an older version. They are Python."""
OURS = frozenset({"desim", "protocols", "scenarios", "tests"})
INSTALLED = frozenset(name for _, names in LIST["packages"].values() for name in names)
MISSING = frozenset(LIST["missing_modules"])
EXTREMES = (("network.latency=0.0", "network.loss=0.0"), ("network.latency=0.5", "network.loss=0.5"))


def is_there(name):
    """Return whether a browser can import a module."""
    top = name.partition(".")[0]
    if top in sys.stdlib_module_names:
        return name not in MISSING and top not in MISSING
    return top in OURS | INSTALLED | FROM_INDEX


class Blocked:
    """A finder of modules that refuses those that a browser cannot import."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        """Raise ModuleNotFoundError for such a module; leave others to the next finder."""
        if not is_there(name):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def no_thread(thread):
    """Refuse to start a thread, with the words of Pyodide."""
    raise RuntimeError("can't start new thread")


def restrict():
    """Take from this process what a browser lacks."""
    for name in [name for name in sys.modules if not is_there(name)]:
        del sys.modules[name]
    sysconfig.get_config_vars()  # those of this Python, whose file is named after the platform
    sys.meta_path.insert(0, Blocked)
    sys.platform = "emscripten"
    threading.Thread.start = no_thread
    del signal.setitimer, signal.getitimer


def main():
    """Run, measure, replay, play and sweep."""
    import desim
    from desim.view.pages.in_browser import answer_as_json

    scenario = desim.load(desim.examples()["relay"], ["horizon=2.0"])
    result = desim.run(scenario, seed=1)
    done = {"active_time": desim.summary(result).active_time, "replay": len(desim.replay(result).page)}
    for name in json.loads((DOCS / "_static" / "try_examples.json").read_text(encoding="utf-8")):
        for changes in EXTREMES:
            answer = json.loads(answer_as_json(name, ["horizon=1.0", *changes]))
            assert "errors" not in answer, answer["errors"]
            done[f"{name} {changes[0]}"] = len(answer["page"])
    refused = json.loads(answer_as_json("relay", ["network.loss=2"]))
    done["refused"] = refused["errors"]
    tops = {name.partition(".")[0] for name in sys.modules}
    done["needed"] = sorted(tops & (INSTALLED | FROM_INDEX) - {"_distutils_hack"})
    done["sweep"] = str(desim.sweep(scenario, {"network.latency.value": [0.0, 0.1]}, reps=2).table(["active_time"]))
    print(json.dumps(done))


if __name__ == "__main__":
    restrict()
    main()
