// The page of `desim play`, and the widget of notebooks: controls, the replay, numbers, comparisons over seeds.

const make = (tag, attributes = {}, ...inner) => {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name in element && name !== "list" && name !== "form") element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...inner);
  return element;
};
const words = key => key.replaceAll("_", " ").replaceAll('"', "");
const BEFORE = "Before the last change: ", LEFT = /, about [^,]* left/;
let count = 0;  // for the ids of controls

/**
 * Show a scenario to play with.
 *
 * transport: the functions `run(body, signal)`, `seeds(body, show, signal)`, `save(body)` and `cancel(body)`, which return
 * promises of the answers. options: the `name` of the scenario; the `values` of its keys before any change; the `changes`,
 * each KEY=VALUE, at the beginning; `hasAddress`, whether the address of the page keeps the state.
 */
export function start(root, transport, options) {
  let now = new Map(), pinned = null;  // changed keys with their values; the changes of the pinned run
  let controls = [], rows = new Map(), drawnForms = "";  // the controls of the last answer, their elements, and the forms of these
  let running = null, comparing = null, frame = null, nextFrame = null, runs = 0, query = "", wrongKeys = new Set(), texts = null;  // the first two abort a run, a comparison
  let lastTime = null;  // the time that the last run took, s
  let startTime = null;  // the time at which the next replay begins, s; null: the time of the present replay
  const page = `${Math.random()}`;  // the name of this page, as several may share a session
  const lastShown = { time: 0, playing: !matchMedia("(prefers-reduced-motion: reduce)").matches };

  const split = text => [text.slice(0, text.indexOf("=")), text.slice(text.indexOf("=") + 1)];
  const joined = map => [...map].map(([key, value]) => `${key}=${value}`);

  // The address: #set=KEY=VALUE&set=...&pin=KEY=VALUE&t=1.5

  function readAddress() {
    const parameters = new URLSearchParams(options.hasAddress ? location.hash.slice(1) : "");
    const isNew = !parameters.has("set") && !parameters.has("pin") && !parameters.has("alone");
    now = new Map((isNew ? options.changes : parameters.getAll("set")).filter(Boolean).map(split));
    pinned = isNew ? [...options.changes] : parameters.has("pin") ? parameters.getAll("pin").filter(Boolean) : null;
    startTime = parameters.has("t") ? parseFloat(parameters.get("t")) || 0 : null;
    if (startTime !== null) lastShown.playing = false;
  }
  function writeAddress(isNew) {
    if (!options.hasAddress) return;
    const parts = new URLSearchParams();
    joined(now).forEach(change => parts.append("set", change));
    if (pinned === null) parts.append("alone", "");
    else (pinned.length ? pinned : [""]).forEach(change => parts.append("pin", change));
    const time = startTime ?? replay()?.time ?? lastShown.time;
    if (time) parts.append("t", +time.toFixed(4));
    const hash = `#${parts}`;
    if (hash !== location.hash) history[isNew ? "pushState" : "replaceState"](null, "", hash);
  }

  // The frame of the page.

  const button = (text, title, onclick) => make("button", { type: "button", title, onclick }, text);
  const status = make("span", { className: "status" }), spoken = make("span", { className: "spoken", role: "status" });
  const pin = button("Pin", "Compare with this run from now on", () => {
    if (pin.reason) return tellWhy(pin.reason);
    pinned = joined(now); writeAddress(true); run();
  });
  pin.className = "primary";
  const unpin = button("Unpin", "Compare with no run", () => { pinned = null; writeAddress(true); run(); });
  const reset = button("Reset", "Undo all changes", () => { now = new Map(options.changes.map(split)); writeAddress(true); run(); });
  const overSeeds = button("30 seeds", "Run both scenarios with 30 seeds, and compare the runs in pairs", () => { if (overSeeds.reason) tellWhy(overSeeds.reason); else compare(); });
  /** Disable a button for a reason, which a click then shows; null enables it. It can have the focus even if it is disabled. */
  function setDisabled(element, reason) {
    element.reason = reason;
    element.setAttribute("aria-disabled", reason !== null);
    element.title = reason ?? element.about;
  }
  for (const target of [pin, overSeeds]) target.about = target.title;
  const copy = button("Copy as …", "This scenario as a file, a command or a program", () => showTexts());
  const save = button("Save", "Write this run to a folder, which desim run --from repeats", () => saveRun());
  const toggle = button("Keys", "Show or hide the keys of the scenario", () => {
    toggle.setAttribute("aria-expanded", element.classList.toggle("open"));
  });
  toggle.className = "toggle";
  toggle.setAttribute("aria-expanded", "false");
  const theme = button("◐", "Light or dark theme", () => setTheme(isDark() ? "light" : "dark"));
  theme.setAttribute("aria-label", "Light or dark theme");
  const metricsSection = make("section", { className: "numbers" }), note = make("p", { className: "note" });
  metricsSection.setAttribute("aria-label", "Metrics of this run, and their differences from the pinned run");
  const wrongNote = make("p", { className: "wrong", role: "alert" }), oldNote = make("p", { className: "old" });
  const seeds = make("section", { className: "seeds", hidden: true });
  seeds.setAttribute("aria-label", "Comparison over seeds");
  const stage = make("div", { className: "stage" }), keys = make("form", { className: "keys", onsubmit: event => event.preventDefault() });
  keys.setAttribute("aria-label", "Keys of the scenario");
  const dialog = make("dialog");
  const element = make("div", { className: options.hasAddress ? "play" : "play inline" },
    make("header", {}, make("h1", {}, options.name, make("small", {}, " desim play")), status, spoken, toggle, pin, unpin, overSeeds, copy, save, reset, theme),
    keys, make("div", { className: "view" }, oldNote, metricsSection, note, wrongNote, make("div", { className: "beside" }, stage, seeds)), dialog);
  root.append(element);

  // Light and dark.

  const themed = options.hasAddress ? document.documentElement : element;
  const isDark = () => themed.dataset.theme === "dark";
  const darkness = matchMedia("(prefers-color-scheme: dark)");
  function setTheme(name) { themed.dataset.theme = name; replay()?.setTheme(name); }
  const followTheme = () => setTheme(darkness.matches ? "dark" : "light");
  darkness.addEventListener("change", followTheme);

  // Controls.

  function change(key, text) {
    const control = controls.find(candidate => candidate.key === key);
    if (control?.form === "kind")  // the keys of another kind no longer exist
      for (const below of [...now.keys()]) if (below.startsWith(`${key}.`)) now.delete(below);
    const changedKey = control?.form === "kind" ? `${key}.kind` : key;
    const isOfOtherKind = [...now.keys()].some(changed => changed.endsWith(".kind") && key.startsWith(changed.slice(0, -4)));
    if (options.values[key] === text && !isOfOtherKind) now.delete(changedKey);
    else now.set(changedKey, text);
    writeAddress(true);
    run();
  }
  const changed = key => now.has(key) || now.has(`${key}.kind`);

  // The positions of a slider are 0 .. positions(slider). One step changes a value by at least its last digit.
  const PER_DECADE = 200, STEPS = 1000;
  const positions = ({ low, high, is_log: isLog }, isInteger) => isLog ? Math.round(PER_DECADE * Math.log10(high / low)) : isInteger ? high - low : STEPS;
  function fromPosition(slider, position, isInteger) {
    const { low, high, is_log: isLog, at_low: atLow, at_high: atHigh } = slider, most = positions(slider, isInteger);
    if (position <= 0 && atLow !== null) return `${atLow}`;
    if (position >= most && atHigh !== null) return atHigh === "Infinity" ? "inf" : `${atHigh}`;
    const share = position / most, exact = isLog ? low * (high / low) ** share : low + (high - low) * share;
    return isInteger ? `${Math.round(exact)}` : `${+exact.toPrecision(3)}`;
  }
  function toPosition(slider, text, isInteger) {
    const { low, high, is_log: isLog, at_low: atLow } = slider, number = text === "inf" ? Infinity : +text;
    if (number === atLow) return 0;
    const share = isLog ? Math.log(number / low) / Math.log(high / low) : (number - low) / (high - low);
    return Math.round(positions(slider, isInteger) * Math.min(Math.max(share, 0), 1));
  }
  function draw(control, label) {
    const id = `desim-${count++}`, isInteger = control.form === "integer", unit = control.unit ? ` ${control.unit}` : "";
    const commit = () => change(control.key, control.form === "flag" ? `${input.checked}` : input.value.trim());
    const field = { id, title: control.help, onchange: commit };
    let input, slider = null, list = null;
    if (control.form === "kind" || control.form === "choice") {
      const optionElement = option => {
        const needsFile = control.needs_file.includes(option), choice = new Option(needsFile ? `${words(option)} (needs a file)` : words(option), option);
        choice.disabled = needsFile;
        return choice;
      };
      input = make("select", field, ...control.options.map(optionElement));
    }
    else if (control.form === "flag") input = make("input", { ...field, type: "checkbox" });
    else {
      input = make("input", { ...field, type: "text", spellcheck: false, autocomplete: "off" });
      if (control.form !== "text") { input.className = "number"; input.inputMode = "decimal"; }
      else if (control.example) input.placeholder = `e.g. ${control.example}`;
      if (control.options.length) {
        list = make("datalist", { id: `${id}-list` }, ...control.options.map(option => new Option(option)));
        input.setAttribute("list", list.id);
      }
      if (isInteger) input.onkeydown = event => {
        const step = { ArrowUp: 1, ArrowDown: -1 }[event.key];
        if (!step || !/^-?\d+$/.test(input.value)) return;
        event.preventDefault();
        input.value = +input.value + step;
        commit();
      };
    }
    const name = `${words(control.key.replaceAll(".", " "))}${control.unit ? `, ${control.unit}` : ""}`;
    input.setAttribute("aria-label", name);
    input.setAttribute("aria-describedby", `${id}-error ${id}-help`);
    const tell = () => slider.setAttribute("aria-valuetext", `${input.value}${unit}`);
    if (control.slider) {
      const most = positions(control.slider, isInteger);
      slider = make("input", { type: "range", min: 0, max: most, onchange: commit, oninput: () => { input.value = fromPosition(control.slider, +slider.value, isInteger); tell(); } });
      slider.setAttribute("aria-label", `${name}: slider`);
    }
    const error = make("p", { className: "error", id: `${id}-error` });
    const undo = button("↺", `Undo the change of ${control.key}`, () => {
      for (const key of [...now.keys()]) if (key === control.key || (control.form === "kind" && key.startsWith(`${control.key}.`))) now.delete(key);
      writeAddress(true);
      input.focus();
      run();
    });
    undo.className = "back";
    undo.setAttribute("aria-label", `Undo the change of ${control.key}`);
    const row = make("div", {}, make("label", { htmlFor: id, title: control.key }, label, control.form !== "kind" && unit ? make("small", {}, unit) : ""), input, ...(list ? [list] : []), undo);
    const group = make("div", { className: `key ${control.form}` }, row, ...(slider ? [slider] : []), error, make("p", { className: "help", id: `${id}-help` }, `${control.key}: ${control.help}${bounds(control)}`));
    group.dataset.key = control.key;
    let shownValue;  // the value that was shown last: what differs from it is being edited
    function update(value) {
      const isEdited = input === document.activeElement && control.form !== "flag" && input.value !== shownValue && shownValue !== undefined;
      undo.hidden = !changed(control.key);
      group.classList.toggle("changed", changed(control.key));
      if (isEdited || (slider && slider.matches(":active"))) return;
      shownValue = value;
      if (control.form === "flag") input.checked = value === "true";
      else {
        if (input.options && ![...input.options].some(option => option.value === value)) input.prepend(new Option(value || "none", value));
        input.value = value;
      }
      if (slider) { slider.value = toPosition(control.slider, value, isInteger); tell(); }
    }
    update(control.value);
    return { group, update, error, inputs: slider ? [input, slider] : [input] };
  }
  const bounds = control => {
    const ends = [control.low, control.high].map(end => end === null || Math.abs(end) >= 1e6 ? null : `${end}`);
    return ends[0] !== null && ends[1] !== null ? ` From ${ends[0]} to ${ends[1]}.` : ends[0] !== null && control.low !== 0 ? ` At least ${ends[0]}.` : "";
  };
  function label(control) {
    const parts = control.key.split(".").filter(part => !/^\d+$/.test(part)), above = controls.find(kind => kind.form === "kind" && control.key.startsWith(`${kind.key}.`) && kind.key !== "protocol");
    return words(control.first === null ? control.key : above ? parts.at(-1) : parts.slice(-2).join(" "));
  }
  const search = make("input", { type: "search", className: "search", oninput: () => { query = search.value; drawControls(); } });
  const first = make("div"), otherKeys = make("div", { className: "found" });
  keys.append(search, otherKeys, first);
  /** Show a control for each key that comes first, is changed, wrong or matches the search; controls shown before are kept. */
  function drawControls() {
    const searched = query.toLowerCase().split(/\s+/).filter(Boolean), hidden = controls.filter(control => control.first === null);
    const matches = control => searched.length && searched.every(word => `${control.key} ${words(control.key)} ${control.help}`.toLowerCase().includes(word));
    const isOpen = control => changed(control.key) || wrongKeys.has(control.key) || [...now.keys()].some(key => key.endsWith(".kind") && control.key.startsWith(key.slice(0, -4)));
    const drawn = controls.filter(control => control.first !== null || isOpen(control) || matches(control));
    search.placeholder = `Search ${hidden.length} more keys`;
    otherKeys.hidden = !drawn.some(control => control.first === null);
    search.setAttribute("aria-label", search.placeholder);
    const form = ({ key, form, options: kinds, needs_file: needsFile, slider }) => JSON.stringify([key, form, kinds, needsFile, slider]);
    const newLayout = drawn.map(form).join();
    if (newLayout !== drawnForms) {
      const oldRows = rows, kept = control => oldRows.get(control.key)?.form === form(control) ? oldRows.get(control.key) : null;
      drawnForms = newLayout;
      rows = new Map(drawn.map(control => [control.key, kept(control) ?? { ...draw(control, label(control)), form: form(control) }]));
      const focusedKey = keys.contains(document.activeElement) ? document.activeElement.closest("[data-key]")?.dataset.key : null;
      const focused = document.activeElement;
      first.replaceChildren(...drawn.filter(control => control.first !== null).map(control => rows.get(control.key).group));
      otherKeys.replaceChildren(...drawn.filter(control => control.first === null).map(control => rows.get(control.key).group));
      if (focusedKey !== null && focused !== document.activeElement) (keys.contains(focused) ? focused : rows.get(focusedKey)?.inputs[0])?.focus({ preventScroll: true });
    }
    // A wrong value stays as the user typed it.
    for (const control of drawn) rows.get(control.key).update(wrongKeys.has(control.key) ? now.get(control.key) ?? control.value : control.value);
  }
  function showErrors(errors) {
    for (const { error, inputs } of rows.values()) {
      error.textContent = "";
      inputs.forEach(input => input.removeAttribute("aria-invalid"));
    }
    const others = [];
    for (const [key, text] of Object.entries(errors)) {
      const row = rows.get(key) ?? rows.get(key.replace(/\.kind$/, ""));
      if (row) {
        row.error.textContent = text;
        row.inputs.forEach(input => input.setAttribute("aria-invalid", "true"));
        row.group.scrollIntoView({ block: "nearest" });
        spoken.textContent = `${key}: ${text}`;
      } else others.push(key ? `${key}: ${text}` : text);
    }
    wrongNote.textContent = others.join("\n");
  }

  // Runs.

  async function run() {
    running?.abort();
    endComparison();
    const controller = running = new AbortController(), begun = performance.now();
    const timer = setTimeout(() => { status.textContent = "running …"; }, 250);
    unpin.disabled = pinned === null;
    for (const target of [pin, overSeeds]) setDisabled(target, "Wait for the run.");
    let answer;
    try {
      answer = await transport.run({ now: joined(now), pinned, page }, controller.signal);
    } catch (error) {
      if (controller === running) { wrongNote.textContent = `No answer: ${error.message}`; status.textContent = ""; }
      return;
    } finally { clearTimeout(timer); }
    if (controller !== running) return;
    controls = answer.controls;
    wrongKeys = new Set(Object.keys(answer.errors ?? {}));
    texts = answer.texts ?? null;
    copy.disabled = save.disabled = texts === null;
    drawControls();
    showErrors(answer.errors ?? {});
    const isInvalid = Boolean(answer.errors);
    element.classList.toggle("outdated", isInvalid);
    if (isInvalid) {
      markWanted();
      status.textContent = "not run";
      oldNote.textContent = runs ? "Not run: the metrics and the replay are those of the last valid run." : "Not run.";
      for (const target of [pin, overSeeds]) setDisabled(target, "Correct the values that are marked first.");
      return;
    }
    setDisabled(pin, null);
    lastTime = (performance.now() - begun) / 1000;
    drawNumbers(answer);
    await showReplay(answer.page, controller);
    if (controller !== running) return;
    runs++;
    status.textContent = `${((performance.now() - begun) / 1000).toFixed(2)} s`;
    spoken.textContent = answer.metrics.filter(row => row.first).slice(0, 2).map(inWords).join("; ");
  }
  const inWords = row => `${row.name} ${row.value} ${row.unit}${row.difference ? `, ${row.difference} ${judged(row)}` : ""}`;
  const isPinned = () => pinned !== null && joined(now).sort().join("\n") === [...pinned].sort().join("\n");
  function drawNumbers(answer) {
    const figure = row => {
      const difference = row.difference === undefined ? [] : [" ", make("small", { className: judged(row), title: `Difference from the pinned run: ${judged(row) || "neither better nor worse"}` }, row.difference)];
      return make("p", {}, make("span", {}, row.name), " ", make("strong", {}, row.value, row.unit ? ` ${row.unit}` : "", ...difference));
    };
    metricsSection.replaceChildren(...answer.metrics.filter(row => row.first).map(figure));
    const [seed, other] = answer.seeds;
    setDisabled(overSeeds, other === null ? "Pin a run first: 30 seeds compare this run with the pinned one." : isPinned() ? "This run is the pinned one: change a key first." : null);
    note.replaceChildren(button("All metrics", "All metrics of this run", () => showMetrics(answer.metrics)), " ", [
      other === null ? "No run is pinned." : isPinned() ? "This run is the pinned one: change a key, and the next run is compared with it."
        : seed === other ? `Differences are from the pinned run, drawn faint. Both have seed ${seed} and so the same random numbers: they are effects of the changed keys.`
          : `Differences are from the pinned run, drawn faint. The seeds ${seed} and ${other} differ, so they are also due to chance: compare over 30 seeds.`,
      ...(hasWalls() ? ["Walls can be dragged."] : []),
      ...answer.warnings.map(warning => `Warning: ${warning}.`),
    ].join(" "));
  }
  const hasWalls = () => controls.some(control => control.key.startsWith("wall."));
  const judged = row => !row.more_is || !row.sign ? "" : (row.sign > 0) === (row.more_is === "better") ? "better" : "worse";

  // The replay: a new page is loaded behind the present one, which it replaces at the same instant.

  const replay = () => frame?.contentWindow?.replay;
  const BOXES = ["links", "trails", "other", "sight"];
  function remember() {
    const current = replay();
    if (!current) return;
    const wall = element.getRootNode().activeElement === frame ? current.markedWall : -1;
    Object.assign(lastShown, { time: current.time, playing: current.playing, speed: current.speed, chosen: current.chosen, wall });
    lastShown.boxes = BOXES.filter(id => frame.contentDocument.getElementById(id)?.checked === false);
  }
  function showReplay(page, controller) {
    nextFrame?.remove();
    const next = nextFrame = make("iframe", { title: "Replay of this run", className: "waiting", srcdoc: page });
    stage.append(next);
    return new Promise(done => {
      next.onload = async () => {
        await replay()?.whenReleased();  // the frame in which a wall is held stays
        if (controller !== running) { next.remove(); return done(); }
        const newReplay = next.contentWindow.replay;
        remember();
        next.contentDocument.documentElement.classList.add("embedded");
        next.contentDocument.querySelectorAll("h1, #theme").forEach(node => { node.style.display = "none"; });  // this page has both
        newReplay.setTheme(isDark() ? "dark" : "light");
        if (lastShown.speed) newReplay.speed = lastShown.speed;
        if (lastShown.chosen >= 0 && lastShown.chosen < newReplay.truth.length) newReplay.choose(lastShown.chosen);
        for (const id of lastShown.boxes ?? []) next.contentDocument.getElementById(id)?.click();
        newReplay.seek(startTime ?? Math.min(lastShown.time, newReplay.end));
        if (lastShown.playing) newReplay.play(); else newReplay.pause();
        startTime = null;
        frame?.remove();
        frame = next;
        nextFrame = null;
        newReplay.moveWalls((k, offset) => change(offsetKey(k), inFile(offset)));
        if (lastShown.wall >= 0) { next.contentWindow.focus(); newReplay.markWall(lastShown.wall); }
        frame.classList.remove("waiting");
        new ResizeObserver(fitHeight).observe(next.contentDocument.body);
        fitHeight();
        requestAnimationFrame(() => done());
      };
    });
  }

  // Walls: moved in the replay, as a change of their offset.

  const offsetKey = k => `wall.${k}.offset`;
  const inFile = offset => `[${offset.map(coordinate => Number.isInteger(coordinate) ? coordinate.toFixed(1) : `${coordinate}`).join(", ")}]`;
  /** Show in the replay of the last valid run the wanted offsets of the walls. */
  function markWanted() {
    const shownRun = replay();
    shownRun?.wantedWalls.forEach((_, k) => {
      const pair = /^\s*\[\s*([-+.\de]+)\s*,\s*([-+.\de]+)\s*\]\s*$/i.exec(now.get(offsetKey(k)) ?? "")?.slice(1).map(Number);
      shownRun.wantWall(k, pair?.every(Number.isFinite) ? pair : null);
    });
  }

  const isNarrow = matchMedia("(max-width: 860px)");
  /** On a narrow screen the replay is as high as its content, so that only the page scrolls. */
  function fitHeight() {
    const body = frame?.contentDocument?.body;
    stage.style.height = isNarrow.matches && options.hasAddress && body ? `${body.scrollHeight}px` : "";
  }
  isNarrow.addEventListener("change", fitHeight);

  // Over seeds.

  function tellWhy(reason) {
    status.textContent = reason;
    spoken.textContent = reason;
  }

  function stopComparing() {
    if (comparing) transport.cancel({ now: [], page }).catch(() => {});
    comparing?.abort();
    comparing = null;
  }
  function endComparison() {  // the scenario has changed, so the table is out of date
    stopComparing();
    const title = seeds.querySelector("h2"), cancel = seeds.querySelector(".cancel");
    if (title && !title.textContent.startsWith(BEFORE)) title.textContent = BEFORE + title.textContent.replace(LEFT, "");
    if (cancel) cancel.hidden = true;
  }
  async function compare() {
    stopComparing();
    const controller = comparing = new AbortController(), body = { now: joined(now), pinned, count: 30, page };
    const title = make("h2", {}, "30 seeds"), bar = make("progress", { max: 30, value: 0 }), table = make("table");
    bar.setAttribute("aria-label", "Pairs of runs that are done");
    const cancel = button("Cancel", "Stop the runs", () => { stopComparing(); title.textContent = `${title.textContent.replace(LEFT, "")}, cancelled`; cancel.hidden = true; });
    cancel.className = "cancel";
    begunAt = performance.now();
    title.textContent = lastTime === null ? "30 seeds" : `30 seeds: less than ${duration(60 * lastTime)}`;  // with one worker
    seeds.replaceChildren(make("div", {}, title, cancel, button("Close", "Close the comparison", () => { stopComparing(); seeds.hidden = true; })), bar, make("p", {}, "Differences from the pinned run in pairs of equal seeds, with 95 % intervals. At the end those in bold are told apart from 0 at a level of 5 % for all together; a colour says whether they are better or worse."), make("div", { className: "scroll" }, table));
    seeds.hidden = false;
    try {
      await transport.seeds(body, answer => { if (controller === comparing) showPairs(answer, title, bar, table); }, controller.signal);
      if (controller === comparing) { cancel.hidden = true; comparing = null; spoken.textContent = title.textContent; }
    } catch (error) {
      if (controller === comparing) { title.textContent = `No answer: ${error.message}`; cancel.hidden = true; }
    }
  }
  let begunAt = 0;  // when the comparison began, ms
  const duration = seconds => seconds < 90 ? `${Math.max(Math.ceil(seconds), 1)} s` : `${Math.ceil(seconds / 60)} min`;
  function showPairs(answer, title, bar, table) {
    if (answer.error) { title.textContent = answer.error; return; }
    bar.value = answer.done;
    const left = (performance.now() - begunAt) / 1000 * (answer.of - answer.done) / Math.max(answer.done, 1);
    title.textContent = `${answer.done} of ${answer.of} seeds${answer.done < answer.of ? `, about ${duration(left)} left` : ""}`
      + (answer.failed ? `; ${answer.failed} failed: ${answer.failure[0]}` : "");
    const row = (cells, cell = "td") => make("tr", {}, ...cells.map(content => content instanceof Node ? content : make(cell, {}, content)));
    const rows = answer.metrics.filter(metric => metric.first).map(metric => row([
      `${metric.name}${metric.unit ? `, ${metric.unit}` : ""}`, metric.now, metric.pinned,
      make("td", { className: metric.differs ? `apart ${judged(metric)}` : "", title: `${metric.count} pairs` }, metric.difference.replace("+-", "±"))]));
    table.replaceChildren(make("thead", {}, row(["metric", "mean", "pinned", "difference"], "th")), make("tbody", {}, ...rows));
  }

  // Texts to copy, all metrics, and a folder.

  function open(...inner) {
    dialog.replaceChildren(...inner, make("form", { method: "dialog" }, make("button", {}, "Close")));
    dialog.showModal();
  }
  function showTexts() {
    const titles = { command: "Command", toml: "Scenario file (TOML)", python: "Python" };
    open(...Object.entries(titles).flatMap(([name, title]) => {
      const copyText = button("Copy", `Copy: ${title}`, async () => { await navigator.clipboard.writeText(texts[name]); copyText.textContent = "Copied"; });
      copyText.setAttribute("aria-label", `Copy: ${title}`);
      return [make("div", {}, make("strong", {}, title), " ", copyText), make("pre", { tabIndex: 0 }, texts[name])];
    }));
  }
  function showMetrics(rows) {
    const table = make("table", {}, make("tbody", {}, ...rows.map(row => make("tr", {}, make("td", {}, row.name),
      make("td", {}, `${row.value}${row.unit ? ` ${row.unit}` : ""}`), make("td", { className: judged(row) }, row.difference ?? "")))));
    open(make("strong", {}, `All ${rows.length} metrics of this run, and their differences from the pinned run`), make("div", { className: "scroll", tabIndex: 0 }, table));
  }
  async function saveRun() {
    save.disabled = true;
    try {
      const { folder, error } = await transport.save({ now: joined(now) });
      open(make("p", {}, error ?? `Saved in ${folder}. Repeat it, watch it:`), ...(error ? [] : [make("pre", { tabIndex: 0 }, `desim run --from ${folder}/run.json${texts?.command.includes("--allow-import") ? " --allow-import" : ""}\ndesim replay ${folder}`)]));
    } catch (error) { wrongNote.textContent = `Not saved: ${error.message}`; } finally { save.disabled = texts === null; }
  }

  followTheme();
  readAddress();
  if (options.hasAddress) {
    window.addEventListener("popstate", () => { readAddress(); run(); });
    setInterval(() => { if (!running?.signal.aborted && startTime === null && replay() && !replay().playing && replay().time !== lastShown.time) { lastShown.time = replay().time; writeAddress(false); } }, 500);
  }
  run();

  return {
    stop() { status.textContent = "ended"; wrongNote.textContent = "The program that served this page has ended: run desim play again."; for (const row of element.querySelectorAll("header button, .keys input, .keys select")) if (row !== theme) row.disabled = true; },
    remove() { running?.abort(); stopComparing(); darkness.removeEventListener("change", followTheme); element.remove(); },
    change, get replay() { return replay(); }, get runs() { return runs; }, get changes() { return joined(now); }, get pinned() { return pinned; }, page,
  };
}
