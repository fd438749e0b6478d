// The front page: choose an example, move latency and loss, see the replay, copy the file.
//
// The replay of each example is recorded. Python is loaded when something is moved; without it, the page says how to run
// the same command elsewhere.
"use strict";
(() => {
  const PYODIDE = "https://cdn.jsdelivr.net/pyodide/v314.0.7/full/";
  const LONGEST = 60_000;  // of a run, ms; Python in a browser cannot interrupt itself
  const KEYS = ["latency", "loss"];
  const FOLLOWS = '<script>addEventListener("message", event => { if (event.data && event.data.theme)'
    + " window.replay.setTheme(event.data.theme); });<" + "/script>\n</body>";

  function start(root, examples) {
    const part = name => root.querySelector(`[data-part="${name}"]`);
    const [choice, status, frame, file, command] = ["example", "status", "replay", "file", "command"].map(part);
    const sliders = new Map(KEYS.map(key => [key, part(key)]));
    const moved = new Map();
    let worker = null, running = null, wanted = null, number = 0, late = null, cannot = "";

    const changes = () => KEYS.filter(key => moved.has(key)).map(key => `network.${key}=${moved.get(key)}`);
    const options = () => changes().map(change => ` --set ${change}`).join("");
    const say = text => { status.textContent = text; };

    function tell(texts) {
      file.textContent = texts?.toml ?? examples[choice.value].toml;
      command.textContent = texts?.command
        ?? `desim examples ${choice.value}\ndesim replay ${choice.value}.toml${options()}`;
    }
    function showValues() {
      for (const [key, slider] of sliders) {
        const unit = key === "latency" ? " s" : "";
        slider.nextElementSibling.textContent = moved.has(key) ? `${moved.get(key)}${unit}` : "as in the file";
      }
    }
    function showRecorded() {
      const wanted = examples[choice.value].replay;
      if (frame.getAttribute("src") === wanted && !frame.hasAttribute("srcdoc")) return;
      frame.removeAttribute("srcdoc");
      frame.src = wanted;
    }
    function record() {  // show the recorded run of an example as it is
      moved.clear();
      wanted = null;
      for (const slider of sliders.values()) slider.value = slider.defaultValue;
      showRecorded();
      showValues();
      tell();
      say(`${examples[choice.value].title} This run was recorded; move a slider to run it again here.`);
    }
    function withoutPython(why) {
      cannot = why;
      showRecorded();
      tell();
      say(`This page cannot run it: ${why}. The replay shows the recorded run of the example as it is;`
        + " the command below runs yours.");
    }
    function ask() {
      showValues();
      if (cannot) { withoutPython(cannot); return; }
      wanted = { name: choice.value, changes: changes() };
      if (running === null) send();
    }
    function send() {
      if (worker === null) {
        worker = new Worker(root.dataset.worker, { type: "module" });
        worker.onmessage = ({ data }) => hear(data);
        worker.onerror = () => withoutPython("Python did not start");
      }
      running = { ...wanted, number: ++number };
      wanted = null;
      worker.postMessage({ ...running, pyodide: root.dataset.pyodide || PYODIDE,
                           archive: new URL(root.dataset.archive, location).href });
    }
    function hear({ status: text, number: of, answer, failed }) {
      if (text !== undefined) { say(text); return; }
      if (of !== number) return;
      clearTimeout(late);
      const asked = running;
      running = null;
      if (failed !== undefined) { worker.terminate(); worker = null; withoutPython(failed); return; }
      if (wanted !== null) { send(); busy(); return; }
      if (asked.name === choice.value) show(answer);
    }
    function busy() {
      say("running ...");
      late = setTimeout(() => {
        worker.terminate();
        worker = running = null;
        say(`The run took longer than ${LONGEST / 1000} s and was ended.`);
      }, LONGEST);
    }
    function show(answer) {
      tell(answer.texts);
      if (answer.errors) { say(Object.values(answer.errors).join(" ")); return; }
      frame.srcdoc = answer.page.replace("</body>", FOLLOWS);
      const numbers = answer.metrics.filter(row => row.name === "capture time" || row.name === "active time")
        .map(row => `${row.name} ${row.value} ${row.unit}${row.difference ? ` (${row.difference})` : ""}`);
      say(`Run here: ${numbers.join(", ")}; in brackets, and drawn faint, against the file as it is.`);
    }

    for (const [name, example] of Object.entries(examples)) choice.append(new Option(name, name, name === "relay"));
    choice.onchange = record;
    for (const [key, slider] of sliders) {
      slider.oninput = () => { moved.set(key, slider.value); showValues(); };
      slider.onchange = () => { moved.set(key, slider.value); ask(); };
    }
    part("reset").onclick = record;
    part("copy").onclick = async () => {
      try {
        await navigator.clipboard.writeText(file.textContent);
        say("The file is copied.");
      } catch {
        say("The browser does not let this page copy: select the text.");
      }
    };
    part("controls").hidden = part("details").hidden = false;
    record();
  }

  addEventListener("DOMContentLoaded", async () => {
    const root = document.getElementById("try");
    if (root === null) return;
    try {
      start(root, await (await fetch(root.dataset.examples)).json());
    } catch {
      root.querySelector('[data-part="status"]').textContent = (location.protocol === "file:"
        ? "A page that is opened as a file only shows this run: serve its folder (python -m http.server)"
        : "The examples of this page did not load: open it again")
        + ", or run desim play relay.toml on your machine.";
    }
  });
})();
