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
 * transport: `run(body, signal)`, `seeds(body, show, signal)`, `save(body)` and `cancel(body)`, promises of the answers.
 * options: `name` of the scenario; `values`, of each key before any change; `changes`, KEY=VALUE, at the beginning;
 * `hasAddress`, whether the address keeps the state.
 */
export function start(root, transport, options) {
  let now = new Map(), pinned = null;  // changed keys with their values; the changes of the pinned run
  let controls = [], rows = new Map(), layout = "";  // the controls of the last answer, their elements, and which there are
  let running = null, comparing = null, frame = null, waiting = null, runs = 0, query = "", wrongKeys = new Set(), texts = null;
  let lastTime = null;  // that the last run took, s
  let instant = null;  // at which the next replay begins, if not at that of the present one, s
  const page = `${Math.random()}`;  // the name of this page, as several may share a session
  const shown = { time: 0, playing: !matchMedia("(prefers-reduced-motion: reduce)").matches };

  const split = text => [text.slice(0, text.indexOf("=")), text.slice(text.indexOf("=") + 1)];
  const joined = map => [...map].map(([key, value]) => `${key}=${value}`);

  // The address: #set=KEY=VALUE&set=...&pin=KEY=VALUE&t=1.5

  function readAddress() {
    const given = new URLSearchParams(options.hasAddress ? location.hash.slice(1) : "");
    const isNew = !given.has("set") && !given.has("pin") && !given.has("alone");
    now = new Map((isNew ? options.changes : given.getAll("set")).filter(Boolean).map(split));
    pinned = isNew ? [...options.changes] : given.has("pin") ? given.getAll("pin").filter(Boolean) : null;
    instant = given.has("t") ? parseFloat(given.get("t")) || 0 : null;
    if (instant !== null) shown.playing = false;
  }
  function writeAddress(isNew) {
    if (!options.hasAddress) return;
    const parts = new URLSearchParams();
    joined(now).forEach(each => parts.append("set", each));
    if (pinned === null) parts.append("alone", "");
    else (pinned.length ? pinned : [""]).forEach(each => parts.append("pin", each));
    const time = instant ?? replay()?.time ?? shown.time;
    if (time) parts.append("t", +time.toFixed(4));
    const own = `#${parts}`;
    if (own !== location.hash) history[isNew ? "pushState" : "replaceState"](null, "", own);
  }

  // The frame of the page.

  const button = (text, about, act) => make("button", { type: "button", title: about, onclick: act }, text);
  const status = make("span", { className: "status" }), spoken = make("span", { className: "spoken", role: "status" });
  const pin = button("Pin", "Compare with this run from now on", () => {
    if (pin.reason) return tellWhy(pin.reason);
    pinned = joined(now); writeAddress(true); run();
  });
  pin.className = "primary";
  const alone = button("Unpin", "Compare with no run", () => { pinned = null; writeAddress(true); run(); });
  const reset = button("Reset", "Undo all changes", () => { now = new Map(options.changes.map(split)); writeAddress(true); run(); });
  const many = button("30 seeds", "Run both scenarios with 30 seeds, and compare the runs in pairs", () => { if (many.reason) tellWhy(many.reason); else compare(); });
  /** Disable a button for a reason, which it then tells; null enables it. It stays reachable, so that the reason is, too. */
  function setDisabled(element, reason) {
    element.reason = reason;
    element.setAttribute("aria-disabled", reason !== null);
    element.title = reason ?? element.about;
  }
  for (const each of [pin, many]) each.about = each.title;
  const copy = button("Copy as …", "This scenario as a file, a command or a program", () => showTexts());
  const save = button("Save", "Write this run to a folder, which desim run --from repeats", () => saveRun());
  const toggle = button("Keys", "Show or hide the keys of the scenario", () => {
    toggle.setAttribute("aria-expanded", element.classList.toggle("open"));
  });
  toggle.className = "toggle";
  toggle.setAttribute("aria-expanded", "false");
  const theme = button("◐", "Light or dark theme", () => setTheme(isDark() ? "light" : "dark"));
  theme.setAttribute("aria-label", "Light or dark theme");
  const numbers = make("section", { className: "numbers" }), note = make("p", { className: "note" });
  numbers.setAttribute("aria-label", "Metrics of this run, and their differences from the pinned run");
  const wrong = make("p", { className: "wrong", role: "alert" }), old = make("p", { className: "old" });
  const seeds = make("section", { className: "seeds", hidden: true });
  seeds.setAttribute("aria-label", "Comparison over seeds");
  const stage = make("div", { className: "stage" }), keys = make("form", { className: "keys", onsubmit: event => event.preventDefault() });
  keys.setAttribute("aria-label", "Keys of the scenario");
  const dialog = make("dialog");
  const element = make("div", { className: options.hasAddress ? "play" : "play inline" },
    make("header", {}, make("h1", {}, options.name, make("small", {}, " desim play")), status, spoken, toggle, pin, alone, many, copy, save, reset, theme),
    keys, make("div", { className: "view" }, old, numbers, note, wrong, make("div", { className: "beside" }, stage, seeds)), dialog);
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
    const each = controls.find(one => one.key === key);
    if (each?.form === "kind")  // the keys of another kind no longer exist
      for (const below of [...now.keys()]) if (below.startsWith(`${key}.`)) now.delete(below);
    const own = each?.form === "kind" ? `${key}.kind` : key;
    const isOfOtherKind = [...now.keys()].some(one => one.endsWith(".kind") && key.startsWith(one.slice(0, -4)));
    if (options.values[key] === text && !isOfOtherKind) now.delete(own);
    else now.set(own, text);
    writeAddress(true);
    run();
  }
  const changed = key => now.has(key) || now.has(`${key}.kind`);

  // The positions of a slider are 0 .. positions(slider). One step changes each value by at least its last digit.
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
  function draw(each, label) {
    const id = `desim-${count++}`, isInteger = each.form === "integer", unit = each.unit ? ` ${each.unit}` : "";
    const commit = () => change(each.key, each.form === "flag" ? `${input.checked}` : input.value.trim());
    const field = { id, title: each.help, onchange: commit };
    let input, slider = null, list = null;
    if (each.form === "kind" || each.form === "choice") {
      const option = one => {
        const needsFile = each.needs_file.includes(one), made = new Option(needsFile ? `${words(one)} (needs a file)` : words(one), one);
        made.disabled = needsFile;
        return made;
      };
      input = make("select", field, ...each.options.map(option));
    }
    else if (each.form === "flag") input = make("input", { ...field, type: "checkbox" });
    else {
      input = make("input", { ...field, type: "text", spellcheck: false, autocomplete: "off" });
      if (each.form !== "text") { input.className = "number"; input.inputMode = "decimal"; }
      else if (each.example) input.placeholder = `e.g. ${each.example}`;
      if (each.options.length) {
        list = make("datalist", { id: `${id}-list` }, ...each.options.map(one => new Option(one)));
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
    const name = `${words(each.key.replaceAll(".", " "))}${each.unit ? `, ${each.unit}` : ""}`;
    input.setAttribute("aria-label", name);
    input.setAttribute("aria-describedby", `${id}-error ${id}-help`);
    const tell = () => slider.setAttribute("aria-valuetext", `${input.value}${unit}`);
    if (each.slider) {
      const most = positions(each.slider, isInteger);
      slider = make("input", { type: "range", min: 0, max: most, onchange: commit, oninput: () => { input.value = fromPosition(each.slider, +slider.value, isInteger); tell(); } });
      slider.setAttribute("aria-label", `${name}: slider`);
    }
    const error = make("p", { className: "error", id: `${id}-error` });
    const undo = button("↺", `Undo the change of ${each.key}`, () => {
      for (const key of [...now.keys()]) if (key === each.key || (each.form === "kind" && key.startsWith(`${each.key}.`))) now.delete(key);
      writeAddress(true);
      input.focus();
      run();
    });
    undo.className = "back";
    undo.setAttribute("aria-label", `Undo the change of ${each.key}`);
    const row = make("div", {}, make("label", { htmlFor: id, title: each.key }, label, each.form !== "kind" && unit ? make("small", {}, unit) : ""), input, ...(list ? [list] : []), undo);
    const whole = make("div", { className: `key ${each.form}` }, row, ...(slider ? [slider] : []), error, make("p", { className: "help", id: `${id}-help` }, `${each.key}: ${each.help}${bounds(each)}`));
    whole.dataset.key = each.key;
    let last;  // the value that was shown last: what differs from it is being edited
    function update(value) {
      const isEdited = input === document.activeElement && each.form !== "flag" && input.value !== last && last !== undefined;
      undo.hidden = !changed(each.key);
      whole.classList.toggle("changed", changed(each.key));
      if (isEdited || (slider && slider.matches(":active"))) return;
      last = value;
      if (each.form === "flag") input.checked = value === "true";
      else {
        if (input.options && ![...input.options].some(one => one.value === value)) input.prepend(new Option(value || "none", value));
        input.value = value;
      }
      if (slider) { slider.value = toPosition(each.slider, value, isInteger); tell(); }
    }
    update(each.value);
    return { whole, update, error, inputs: slider ? [input, slider] : [input] };
  }
  const bounds = each => {
    const ends = [each.low, each.high].map(one => one === null || Math.abs(one) >= 1e6 ? null : `${one}`);
    return ends[0] !== null && ends[1] !== null ? ` From ${ends[0]} to ${ends[1]}.` : ends[0] !== null && each.low !== 0 ? ` At least ${ends[0]}.` : "";
  };
  function label(each) {
    const parts = each.key.split(".").filter(part => !/^\d+$/.test(part)), above = controls.find(one => one.form === "kind" && each.key.startsWith(`${one.key}.`) && one.key !== "protocol");
    return words(each.first === null ? each.key : above ? parts.at(-1) : parts.slice(-2).join(" "));
  }
  const search = make("input", { type: "search", className: "search", oninput: () => { query = search.value; drawControls(); } });
  const first = make("div"), found = make("div", { className: "found" });
  keys.append(search, found, first);
  /** Show a control for each key that comes first, is changed, is wrong or is searched; those that stay are updated. */
  function drawControls() {
    const wanted = query.toLowerCase().split(/\s+/).filter(Boolean), rest = controls.filter(each => each.first === null);
    const matches = each => wanted.length && wanted.every(word => `${each.key} ${words(each.key)} ${each.help}`.toLowerCase().includes(word));
    const isOpen = each => changed(each.key) || wrongKeys.has(each.key) || [...now.keys()].some(key => key.endsWith(".kind") && each.key.startsWith(key.slice(0, -4)));
    const drawn = controls.filter(each => each.first !== null || isOpen(each) || matches(each));
    search.placeholder = `Search ${rest.length} more keys`;
    found.hidden = !drawn.some(each => each.first === null);
    search.setAttribute("aria-label", search.placeholder);
    const form = ({ key, form, options: kinds, needs_file: needsFile, slider }) => JSON.stringify([key, form, kinds, needsFile, slider]);
    const own = drawn.map(form).join();
    if (own !== layout) {
      const before = rows, kept = each => before.get(each.key)?.form === form(each) ? before.get(each.key) : null;
      layout = own;
      rows = new Map(drawn.map(each => [each.key, kept(each) ?? { ...draw(each, label(each)), form: form(each) }]));
      const place = keys.contains(document.activeElement) ? document.activeElement.closest("[data-key]")?.dataset.key : null;
      const isAt = document.activeElement;
      first.replaceChildren(...drawn.filter(each => each.first !== null).map(each => rows.get(each.key).whole));
      found.replaceChildren(...drawn.filter(each => each.first === null).map(each => rows.get(each.key).whole));
      if (place !== null && isAt !== document.activeElement) (keys.contains(isAt) ? isAt : rows.get(place)?.inputs[0])?.focus({ preventScroll: true });
    }
    // What was typed stays as it was typed while it is wrong.
    for (const each of drawn) rows.get(each.key).update(wrongKeys.has(each.key) ? now.get(each.key) ?? each.value : each.value);
  }
  function showErrors(errors) {
    for (const { error, inputs } of rows.values()) {
      error.textContent = "";
      inputs.forEach(one => one.removeAttribute("aria-invalid"));
    }
    const others = [];
    for (const [key, text] of Object.entries(errors)) {
      const own = rows.get(key) ?? rows.get(key.replace(/\.kind$/, ""));
      if (own) {
        own.error.textContent = text;
        own.inputs.forEach(one => one.setAttribute("aria-invalid", "true"));
        own.whole.scrollIntoView({ block: "nearest" });
        spoken.textContent = `${key}: ${text}`;
      } else others.push(key ? `${key}: ${text}` : text);
    }
    wrong.textContent = others.join("\n");
  }

  // Runs.

  async function run() {
    running?.abort();
    endComparison();
    const own = running = new AbortController(), begun = performance.now();
    const late = setTimeout(() => { status.textContent = "running …"; }, 250);
    alone.disabled = pinned === null;
    for (const each of [pin, many]) setDisabled(each, "Wait for the run.");
    let answer;
    try {
      answer = await transport.run({ now: joined(now), pinned, page }, own.signal);
    } catch (error) {
      if (own === running) { wrong.textContent = `No answer: ${error.message}`; status.textContent = ""; }
      return;
    } finally { clearTimeout(late); }
    if (own !== running) return;
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
      old.textContent = runs ? "Not run: the metrics and the replay are those of the last valid run." : "Not run.";
      for (const each of [pin, many]) setDisabled(each, "Correct the values that are marked first.");
      return;
    }
    setDisabled(pin, null);
    lastTime = (performance.now() - begun) / 1000;
    drawNumbers(answer);
    await showReplay(answer.page, own);
    if (own !== running) return;
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
    numbers.replaceChildren(...answer.metrics.filter(row => row.first).map(figure));
    const [own, other] = answer.seeds;
    setDisabled(many, other === null ? "Pin a run first: 30 seeds compare this run with the pinned one." : isPinned() ? "This run is the pinned one: change a key first." : null);
    note.replaceChildren(button("All metrics", "All metrics of this run", () => showMetrics(answer.metrics)), " ", [
      other === null ? "No run is pinned." : isPinned() ? "This run is the pinned one: change a key, and the next run is compared with it."
        : own === other ? `Differences are from the pinned run, drawn faint. Both have seed ${own} and so the same random numbers: they are effects of the changed keys.`
          : `Differences are from the pinned run, drawn faint. The seeds ${own} and ${other} differ, so they are also due to chance: compare over 30 seeds.`,
      ...(hasWalls() ? ["Walls can be dragged."] : []),
      ...answer.warnings.map(each => `Warning: ${each}.`),
    ].join(" "));
  }
  const hasWalls = () => controls.some(each => each.key.startsWith("wall."));
  const judged = row => !row.more_is || !row.sign ? "" : (row.sign > 0) === (row.more_is === "better") ? "better" : "worse";

  // The replay: a new page is loaded behind the present one, which it replaces at the same instant.

  const replay = () => frame?.contentWindow?.replay;
  const BOXES = ["links", "trails", "other", "sight"];
  function remember() {
    const last = replay();
    if (!last) return;
    const wall = element.getRootNode().activeElement === frame ? last.markedWall : -1;
    Object.assign(shown, { time: last.time, playing: last.playing, speed: last.speed, chosen: last.chosen, wall });
    shown.boxes = BOXES.filter(id => frame.contentDocument.getElementById(id)?.checked === false);
  }
  function showReplay(page, own) {
    waiting?.remove();
    const next = waiting = make("iframe", { title: "Replay of this run", className: "waiting", srcdoc: page });
    stage.append(next);
    return new Promise(done => {
      next.onload = async () => {
        await replay()?.whenReleased();  // the frame in which a wall is held stays
        if (own !== running) { next.remove(); return done(); }
        const made = next.contentWindow.replay;
        remember();
        next.contentDocument.documentElement.classList.add("embedded");
        next.contentDocument.querySelectorAll("h1, #theme").forEach(each => { each.style.display = "none"; });  // the page has its own
        made.setTheme(isDark() ? "dark" : "light");
        if (shown.speed) made.speed = shown.speed;
        if (shown.chosen >= 0 && shown.chosen < made.truth.length) made.choose(shown.chosen);
        for (const id of shown.boxes ?? []) next.contentDocument.getElementById(id)?.click();
        made.seek(instant ?? Math.min(shown.time, made.end));
        if (shown.playing) made.play(); else made.pause();
        instant = null;
        frame?.remove();
        frame = next;
        waiting = null;
        made.moveWalls((k, offset) => change(offsetKey(k), inFile(offset)));
        if (shown.wall >= 0) { next.contentWindow.focus(); made.markWall(shown.wall); }
        frame.classList.remove("waiting");
        new ResizeObserver(fit).observe(next.contentDocument.body);
        fit();
        requestAnimationFrame(() => done());
      };
    });
  }

  // Walls: moved in the replay, as a change of their offset.

  const offsetKey = k => `wall.${k}.offset`;
  const inFile = offset => `[${offset.map(each => Number.isInteger(each) ? each.toFixed(1) : `${each}`).join(", ")}]`;
  /** Show in the last valid run where the walls are asked for. */
  function markWanted() {
    const shownRun = replay();
    shownRun?.wantedWalls.forEach((_, k) => {
      const pair = /^\s*\[\s*([-+.\de]+)\s*,\s*([-+.\de]+)\s*\]\s*$/i.exec(now.get(offsetKey(k)) ?? "")?.slice(1).map(Number);
      shownRun.wantWall(k, pair?.every(Number.isFinite) ? pair : null);
    });
  }

  const isNarrow = matchMedia("(max-width: 860px)");
  /** On a narrow screen the replay is as high as its content, so that only the page scrolls. */
  function fit() {
    const body = frame?.contentDocument?.body;
    stage.style.height = isNarrow.matches && options.hasAddress && body ? `${body.scrollHeight}px` : "";
  }
  isNarrow.addEventListener("change", fit);

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
  function endComparison() {  // what is shown is of a scenario that has changed
    stopComparing();
    const title = seeds.querySelector("h2"), cancel = seeds.querySelector(".cancel");
    if (title && !title.textContent.startsWith(BEFORE)) title.textContent = BEFORE + title.textContent.replace(LEFT, "");
    if (cancel) cancel.hidden = true;
  }
  async function compare() {
    stopComparing();
    const own = comparing = new AbortController(), body = { now: joined(now), pinned, count: 30, page };
    const title = make("h2", {}, "30 seeds"), bar = make("progress", { max: 30, value: 0 }), table = make("table");
    bar.setAttribute("aria-label", "Pairs of runs that are done");
    const cancel = button("Cancel", "Stop the runs", () => { stopComparing(); title.textContent = `${title.textContent.replace(LEFT, "")}, cancelled`; cancel.hidden = true; });
    cancel.className = "cancel";
    begunAt = performance.now();
    title.textContent = lastTime === null ? "30 seeds" : `30 seeds: less than ${duration(60 * lastTime)}`;  // with one worker
    seeds.replaceChildren(make("div", {}, title, cancel, button("Close", "Close the comparison", () => { stopComparing(); seeds.hidden = true; })), bar, make("p", {}, "Differences from the pinned run in pairs of equal seeds, with 95 % intervals. At the end those in bold are told apart from 0 at a level of 5 % for all together; a colour says whether they are better or worse."), make("div", { className: "scroll" }, table));
    seeds.hidden = false;
    try {
      await transport.seeds(body, found => { if (own === comparing) showPairs(found, title, bar, table); }, own.signal);
      if (own === comparing) { cancel.hidden = true; comparing = null; spoken.textContent = title.textContent; }
    } catch (error) {
      if (own === comparing) { title.textContent = `No answer: ${error.message}`; cancel.hidden = true; }
    }
  }
  let begunAt = 0;  // when the comparison began, ms
  const duration = seconds => seconds < 90 ? `${Math.max(Math.ceil(seconds), 1)} s` : `${Math.ceil(seconds / 60)} min`;
  function showPairs(found, title, bar, table) {
    if (found.error) { title.textContent = found.error; return; }
    bar.value = found.done;
    const left = (performance.now() - begunAt) / 1000 * (found.of - found.done) / Math.max(found.done, 1);
    title.textContent = `${found.done} of ${found.of} seeds${found.done < found.of ? `, about ${duration(left)} left` : ""}`
      + (found.failed ? `; ${found.failed} failed: ${found.failure[0]}` : "");
    const row = (each, cell = "td") => make("tr", {}, ...each.map(one => one instanceof Node ? one : make(cell, {}, one)));
    const rows = found.metrics.filter(each => each.first).map(each => row([
      `${each.name}${each.unit ? `, ${each.unit}` : ""}`, each.now, each.pinned,
      make("td", { className: each.differs ? `apart ${judged(each)}` : "", title: `${each.count} pairs` }, each.difference.replace("+-", "±"))]));
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
    } catch (error) { wrong.textContent = `Not saved: ${error.message}`; } finally { save.disabled = texts === null; }
  }

  followTheme();
  readAddress();
  if (options.hasAddress) {
    window.addEventListener("popstate", () => { readAddress(); run(); });
    setInterval(() => { if (!running?.signal.aborted && instant === null && replay() && !replay().playing && replay().time !== shown.time) { shown.time = replay().time; writeAddress(false); } }, 500);
  }
  run();

  return {
    stop() { status.textContent = "ended"; wrong.textContent = "The program that served this page has ended: run desim play again."; for (const each of element.querySelectorAll("header button, .keys input, .keys select")) if (each !== theme) each.disabled = true; },
    remove() { running?.abort(); stopComparing(); darkness.removeEventListener("change", followTheme); element.remove(); },
    change, get replay() { return replay(); }, get runs() { return runs; }, get changes() { return joined(now); }, get pinned() { return pinned; }, page,
  };
}
