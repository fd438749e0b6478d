"""The widget of `desim.play` in a notebook: the page of `desim play`; needs anywidget (the extra `notebook`)."""

import os
from functools import cache
from importlib.resources import files
from threading import Thread
from typing import Any

import anywidget
import traitlets

from desim.scenario.overrides import Source
from desim.scenario.scenario import Scenario
from desim.study.workers.workers import Processes, Workers
from desim.view.pages.answers import Answer
from desim.view.pages.play_page import style
from desim.view.pages.playground import Playground
from desim.view.pages.session import Session, is_request

GLUE = """
export default {
  render({ model, el }) {
    const requests = new Map();
    const receive = ({ number, answer, isLast, error }) => {
      const request = requests.get(number);
      if (error) { requests.delete(number); request?.reject(new Error(error)); }
      else if (isLast) { requests.delete(number); request?.resolve(answer); } else request?.show(answer);
    };
    model.on("msg:custom", receive);
    const ask = (what, body, signal, show) => new Promise((resolve, reject) => {
      const number = `${Math.random()}`;  // each view of the widget receives all answers, so counters would collide
      requests.set(number, { resolve, reject, show });
      signal?.addEventListener("abort", () => {
        if (!requests.delete(number)) return;
        reject(new DOMException("aborted", "AbortError"));
      });
      model.send({ number, what, body });
    });
    const transport = {
      run: (body, signal) => ask("run", body, signal),
      seeds: (body, show, signal) => ask("seeds", body, signal, show),
      save: body => ask("save", body),
      cancel: body => ask("cancel", body),
    };
    const options = { name: model.get("name"), changes: [], values: model.get("values"), hasAddress: false };
    const play = start(el, transport, options);
    el.play = play;
    return () => { model.off("msg:custom", receive); play.remove(); };
  },
};
"""
"""The script that connects the page to the Python process of the notebook.

A request and its answers have the same `number`, a random text.

The frame of the replay is not sandboxed, because the page reads and sets the time of the replay. All text in the replay
is escaped.
"""


@cache
def _processes() -> Processes:
    """Return worker processes, the same at each call: a cell may be executed many times, and no widget is closed."""
    return Processes(os.cpu_count() or 1, kept=True)


class PlayWidget(anywidget.AnyWidget):
    """A widget in which the user changes keys of a scenario, and compares each run with a pinned run.

    Args:
        scenario: the scenario before any change.
        timeout: the wall time after which a run is ended, s.
        workers: the workers that perform the runs; None = one process per core, which all widgets share.
    """

    _esm = files("desim.view.pages").joinpath("play.js").read_text(encoding="utf-8") + GLUE
    _css = style()
    name = traitlets.Unicode().tag(sync=True)
    values = traitlets.Dict().tag(sync=True)

    def __init__(self, scenario: Scenario, timeout: float = 30.0, workers: Workers | None = None):
        playground = Playground(Source.of(scenario), None, timeout=timeout)
        super().__init__(name=scenario.name, values=playground.values)
        self._session = Session(playground, workers or _processes())
        self.on_msg(self._hear)

    def _hear(self, _widget: Any, request: Any, _buffers: Any) -> None:
        """Answer a request of the page in a thread of its own, so that other cells can run."""
        if is_request(request["body"]):
            Thread(target=self._answer, args=(request["number"], request["what"], request["body"]), daemon=True).start()
        else:
            self.send({"number": request["number"], "error": "the request is malformed"})

    def _answer(self, number: str, task: str, body: dict[str, Any]) -> None:
        """Perform the task of a request, and send its answers; the last one is marked."""
        session, last = self._session, Answer()
        if task == "run":
            last = session.run(body["now"], body["pinned"], body["page"])
        elif task == "save":
            last = session.save(body["now"])
        elif task == "cancel":
            session.cancel(body["page"])
        elif task == "seeds":
            try:
                for answer in session.compare(body["now"], body["pinned"], body["count"], body["page"]):
                    self.send({"number": number, "answer": answer, "isLast": False})
            except Exception as error:  # an answer that the page shows as the title of the table
                self.send({"number": number, "answer": {"error": f"{type(error).__name__}: {error}"}, "isLast": False})
        self.send({"number": number, "answer": last, "isLast": True})
