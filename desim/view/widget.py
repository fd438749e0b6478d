"""The widget of `scenario.play()` in a notebook: the page of `desim play`; needs anywidget (the extra `notebook`)."""

import os
from collections.abc import Callable
from functools import partial
from importlib.resources import files
from threading import Thread
from typing import Any

import anywidget
import traitlets

from desim.scenario.overrides import Source
from desim.scenario.scenario import Scenario
from desim.study.workers import Processes, Workers
from desim.view.play import Answer, Playground, is_request, paired_runs, style

GLUE = """
export default {
  render({ model, el }) {
    let last = 0;
    const asked = new Map();
    const hear = ({ number, answer, isLast }) => {
      const own = asked.get(number);
      if (isLast) { asked.delete(number); own?.done(answer); } else own?.show(answer);
    };
    model.on("msg:custom", hear);
    const ask = (what, body, signal, show) => new Promise((done, fail) => {
      const number = ++last;
      asked.set(number, { done, show });
      signal?.addEventListener("abort", () => {
        if (!asked.delete(number)) return;
        model.send({ number, what: "cancel" });
        fail(new DOMException("aborted", "AbortError"));
      });
      model.send({ number, what, body });
    });
    const transport = {
      run: (body, signal) => ask("run", body, signal),
      seeds: (body, show, signal) => ask("seeds", body, signal, show),
      save: body => ask("save", body),
    };
    const play = start(el, transport, { name: model.get("name"), changes: [], hasAddress: false });
    el.play = play;
    return () => { model.off("msg:custom", hear); play.remove(); };
  },
};
"""
"""The script that connects the page to the kernel: a request has a number, and so have its answers."""


class PlayWidget(anywidget.AnyWidget):
    """A widget with which the keys of a scenario are changed, and each run is seen beside the one that is pinned.

    Args:
        scenario: the scenario before any change.
        timeout: the wall time after which a run is ended, s.
        workers: they perform the runs; by default, one process per core.
    """

    _esm = files("desim.view").joinpath("play.js").read_text(encoding="utf-8") + GLUE
    _css = style()
    name = traitlets.Unicode().tag(sync=True)

    def __init__(self, scenario: Scenario, timeout: float = 30.0, workers: Workers | None = None):
        super().__init__(name=scenario.name)
        self._playground = Playground(Source.of(scenario), None, timeout=timeout)
        self._workers = workers or Processes(os.cpu_count() or 1)
        self._cancelled: set[int] = set()
        self.on_msg(self._hear)

    def _hear(self, _widget: Any, request: Any, _buffers: Any) -> None:
        """Answer a request of the page in a thread of its own, so that other cells can run."""
        number, what = request["number"], request["what"]
        if what == "cancel":
            self._cancelled.add(number)
            return
        if not is_request(body := request["body"]):
            return
        answers = {"run": self._run, "seeds": self._seeds, "save": self._save}[what]
        Thread(target=answers, args=(body, partial(self._tell, number), number), daemon=True).start()

    def _tell(self, number: int, answer: Answer | None, *, is_last: bool = True) -> None:
        self.send({"number": number, "answer": answer, "isLast": is_last})

    def _run(self, body: Answer, tell: Callable[..., None], _: int) -> None:
        tell(self._playground.performed(self._workers, body["now"], body["pinned"]))

    def _seeds(self, body: Answer, tell: Callable[..., None], number: int) -> None:
        found = paired_runs(self._playground, body["now"], body["pinned"], body["count"], self._workers)
        try:
            for each in found:
                if number in self._cancelled:
                    break
                tell(each, is_last=False)
        except Exception as error:
            tell({"error": f"{type(error).__name__}: {error}"}, is_last=False)
        finally:
            found.close()
        tell(None)

    def _save(self, body: Answer, tell: Callable[..., None], _: int) -> None:
        tell(self._playground.saved(body["now"]))
