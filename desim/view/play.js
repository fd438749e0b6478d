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
const BEFORE = "Before the last change: ";
let count = 0;  // for the ids of controls

/**
 * Show a scenario to play with.
 *
 * transport: `run(body, signal)`, `seeds(body, show, signal)` and `save(body)`, promises of the answers.
 * options: `name` of the scenario; `changes`, KEY=VALUE, at the beginning; `hasAddress`, whether the address keeps the state.
 */
export function start(root, transport, options) {
  let now = new Map(), pinned = null;  // changed keys with their values; the changes of the pinned run
  let known = new Map(), controls = [];  // the values of all keys without changes; the controls of the last answer
  let running = null, comparing = null, frame = null, waiting = null, runs = 0, query = "", wrongKeys = new Set();
  const shown = { time: 0, playing: false };

  const split = text => [text.slice(0, text.indexOf("=")), text.slice(text.indexOf("=") + 1)];
  const joined = map => [...map].map(([key, value]) => `${key}=${value}`);

  // The address: #set=KEY=VALUE&set=...&pin=KEY=VALUE&t=1.5

  function readAddress() {
    const given = new URLSearchParams(options.hasAddress ? location.hash.slice(1) : "");
    const isNew = !given.has("set") && !given.has("pin") && !given.has("alone");
    now = new Map((isNew ? options.changes : given.getAll("set")).filter(Boolean).map(split));
    pinned = isNew ? [...options.changes] : given.has("pin") ? given.getAll("pin").filter(Boolean) : null;
    shown.time = parseFloat(given.get("t")) || 0;
  }
  function writeAddress(isNew) {
    if (!options.hasAddress) return;
    const parts = new URLSearchParams();
    joined(now).forEach(each => parts.append("set", each));
    if (pinned === null) parts.append("alone", "");
    else if (pinned.length) pinned.forEach(each => parts.append("pin", each));
    else parts.append("pin", "");
    const time = replay()?.time ?? shown.time;
    if (time) parts.append("t", +time.toFixed(4));
    const own = `#${parts}`;
    if (own !== location.hash) history[isNew ? "pushState" : "replaceState"](null, "", own);
  }

  // The frame of the page.

  const button = (text, about, act) => make("button", { type: "button", title: about, onclick: act }, text);
  const status = make("span", { className: "status", role: "status" });
  const pin = button("Pin", "Compare with this run from now on", () => { pinned = joined(now); writeAddress(true); run(); });
  pin.className = "primary";
  const alone = button("Unpin", "Compare with no run", () => { pinned = null; writeAddress(true); run(); });
  const reset = button("Reset", "Undo all changes", () => { now = new Map(options.changes.map(split)); writeAddress(true); run(); });
  const many = button("30 seeds", "Run both scenarios with 30 seeds, and compare the runs in pairs", () => compare());
  const copy = button("Copy as …", "This scenario as a file, a command or a program", () => showTexts());
  const save = button("Save", "Write this run to a folder, which desim run --from repeats", () => saveRun());
  const theme = button("◐", "Light or dark theme", () => setTheme(isDark() ? "light" : "dark"));
  theme.setAttribute("aria-label", "Light or dark theme");
  const numbers = make("section", { className: "numbers" }), note = make("p", { className: "note" });
  numbers.setAttribute("aria-label", "Metrics of this run, and their differences from the pinned run");
  const wrong = make("p", { className: "wrong", role: "alert" });
  const seeds = make("section", { className: "seeds", hidden: true });
  seeds.setAttribute("aria-label", "Comparison over seeds");
  const stage = make("div", { className: "stage" }), keys = make("form", { className: "keys", onsubmit: event => event.preventDefault() });
  keys.setAttribute("aria-label", "Keys of the scenario");
  const dialog = make("dialog");
  const element = make("div", { className: options.hasAddress ? "play" : "play inline" },
    make("header", {}, make("h1", {}, options.name, make("small", {}, " desim play")), status, pin, alone, many, copy, save, reset, theme),
    keys, make("div", { className: "view" }, numbers, note, wrong, seeds, stage), dialog);
  root.append(element);

  // Light and dark.

  const themed = options.hasAddress ? document.documentElement : element;
  const isDark = () => themed.dataset.theme === "dark";
  const darkness = matchMedia("(prefers-color-scheme: dark)");
  function setTheme(name) { themed.dataset.theme = name; replay()?.setTheme(name); }
  const followTheme = () => setTheme(darkness.matches ? "dark" : "light");
  darkness.addEventListener("change", followTheme);

  // Controls.

  const control = key => keys.querySelector(`[data-key="${CSS.escape(key)}"]`);
  function change(key, text) {
    const each = controls.find(one => one.key === key);
    if (each?.form === "kind")  // the keys of another kind no longer exist
      for (const below of [...now.keys()]) if (below.startsWith(`${key}.`)) now.delete(below);
    const own = each?.form === "kind" ? `${key}.kind` : key;
    now.delete(own);
    if (known.get(key) !== text) now.set(own, text);
    writeAddress(true);
    run();
  }
  const changed = key => now.has(key) || now.has(`${key}.kind`);

  // The positions of a slider are 0 .. 1000.
  const STEPS = 1000;
  function fromPosition(slider, position, isInteger) {
    const { low, high, is_log: isLog, at_low: atLow, at_high: atHigh } = slider;
    if (position <= 0 && atLow !== null) return `${atLow}`;
    if (position >= STEPS && atHigh !== null) return atHigh === "Infinity" ? "inf" : `${atHigh}`;
    const share = position / STEPS, exact = isLog ? low * (high / low) ** share : low + (high - low) * share;
    return isInteger ? `${Math.round(exact)}` : `${+exact.toPrecision(isLog ? 2 : 3)}`;
  }
  function toPosition(slider, text) {
    const { low, high, is_log: isLog, at_low: atLow } = slider, number = text === "inf" ? Infinity : +text;
    if (number === atLow) return 0;
    return Math.round(STEPS * Math.min(Math.max(isLog ? Math.log(number / low) / Math.log(high / low) : (number - low) / (high - low), 0), 1));
  }
  function draw(each, label) {
    const id = `desim-${count++}`, field = { id, title: each.help, onchange: event => change(each.key, event.target.value.trim()) };
    let input, slider = null;
    if (each.form === "kind" || each.form === "choice") {
      input = make("select", field, ...each.options.map(one => new Option(words(one), one)));
      if (!each.options.includes(each.value)) input.prepend(new Option(each.value || "none", each.value));
      input.value = each.value;
    } else if (each.form === "flag") {
      input = make("input", { ...field, type: "checkbox", checked: each.value === "true", onchange: event => change(each.key, `${event.target.checked}`) });
    } else {
      const isNumber = each.form !== "text";
      input = make("input", { ...field, type: "text", value: each.value, spellcheck: false, autocomplete: "off" });
      if (isNumber) { input.className = "number"; input.inputMode = "decimal"; }
      if (each.options.length) {
        input.setAttribute("list", `${id}-list`);
        input.after(make("datalist", { id: `${id}-list` }, ...each.options.map(one => new Option(one))));
      }
      if (each.form === "integer") input.onkeydown = event => {
        const step = { ArrowUp: 1, ArrowDown: -1 }[event.key];
        if (!step || !/^-?\d+$/.test(input.value)) return;
        event.preventDefault();
        input.value = +input.value + step;
        change(each.key, input.value);
      };
      if (each.slider) {
        slider = make("input", {
          type: "range", min: 0, max: STEPS, value: toPosition(each.slider, each.value),
          oninput: () => { input.value = fromPosition(each.slider, +slider.value, each.form === "integer"); slider.setAttribute("aria-valuetext", `${input.value} ${each.unit}`); },
          onchange: () => change(each.key, input.value),
        });
        slider.setAttribute("aria-label", `${words(each.key.replaceAll(".", " "))}${each.unit ? `, ${each.unit}` : ""}: slider`);
        slider.setAttribute("aria-valuetext", `${each.value} ${each.unit}`);
      }
    }
    const unit = each.unit && each.form !== "kind" ? make("small", {}, ` ${each.unit}`) : "";
    const help = make("p", { className: "help", id: `${id}-help` }, `${each.key}: ${each.help}${bounds(each)}`);
    const error = make("p", { className: "error", id: `${id}-error`, role: "alert" });
    input.setAttribute("aria-describedby", `${id}-error ${id}-help`);
    input.setAttribute("aria-label", `${words(each.key.replaceAll(".", " "))}${each.unit ? `, ${each.unit}` : ""}`);
    const row = make("div", {}, make("label", { htmlFor: id, title: each.key }, label, unit), input);
    const whole = make("div", { className: `key ${each.form}` }, row, ...(slider ? [slider] : []), error, help);
    whole.dataset.key = each.key;
    if (changed(each.key)) {
      whole.classList.add("changed");
      const undo = button("↺", `Undo the change of ${each.key}`, () => { for (const key of [...now.keys()]) if (key === each.key || key === `${each.key}.kind` || (each.form === "kind" && key.startsWith(`${each.key}.`))) now.delete(key); writeAddress(true); run(); });
      undo.className = "back";
      undo.setAttribute("aria-label", `Undo the change of ${each.key}`);
      row.append(undo);
    }
    return whole;
  }
  const bounds = each => {
    const ends = [each.low, each.high].map(one => one === null || Math.abs(one) >= 1e6 ? null : `${one}`);
    return ends[0] !== null && ends[1] !== null ? ` From ${ends[0]} to ${ends[1]}.` : ends[0] !== null && each.low !== 0 ? ` At least ${ends[0]}.` : "";
  };
  function label(each) {
    const parts = each.key.split(".").filter(part => !/^\d+$/.test(part)), above = controls.find(one => one.form === "kind" && each.key.startsWith(`${one.key}.`) && one.key !== "protocol");
    return words(each.first === null ? each.key : above ? parts.at(-1) : parts.slice(-2).join(" "));
  }
  function drawControls() {
    const focused = keys.contains(document.activeElement) ? document.activeElement : null;
    const place = focused?.closest("[data-key]")?.dataset.key, isSlider = focused?.type === "range", isSearch = focused?.type === "search";
    const first = controls.filter(each => each.first !== null), rest = controls.filter(each => each.first === null);
    const search = make("input", { type: "search", className: "search", placeholder: `Search ${rest.length} more keys`, value: query, oninput: () => { query = search.value; found.replaceChildren(...hits()); } });
    search.setAttribute("aria-label", `Search ${rest.length} more keys`);
    const hits = () => {
      const wanted = query.toLowerCase().split(/\s+/).filter(Boolean);
      const matches = each => wanted.every(word => `${each.key} ${words(each.key)} ${each.help}`.toLowerCase().includes(word));
      const isOpen = each => changed(each.key) || wrongKeys.has(each.key) || [...now.keys()].some(key => key.endsWith(".kind") && each.key.startsWith(key.slice(0, -4)));
      return rest.filter(each => isOpen(each) || (wanted.length && matches(each))).map(each => draw(each, each.key));
    };
    const found = make("div", {}, ...hits());
    keys.replaceChildren(...first.map(each => draw(each, label(each))), make("h2", {}, "Other keys"), search, found);
    if (isSearch) search.focus();
    else if (place) control(place)?.querySelector(isSlider ? "[type=range]" : "select, input:not([type=range])")?.focus({ preventScroll: true });
  }
  function showErrors(errors) {
    keys.querySelectorAll("[data-key]").forEach(each => {
      each.querySelector(".error").textContent = "";
      each.querySelectorAll("[aria-invalid]").forEach(one => one.removeAttribute("aria-invalid"));
    });
    const others = [];
    for (const [key, text] of Object.entries(errors)) {
      const own = control(key) || control(key.replace(/\.kind$/, ""));
      if (own) {
        own.querySelector(".error").textContent = text;
        own.querySelectorAll("select, input").forEach(one => one.setAttribute("aria-invalid", "true"));
        own.scrollIntoView({ block: "nearest" });
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
    let answer;
    try {
      answer = await transport.run({ now: joined(now), pinned }, own.signal);
    } catch (error) {
      if (own === running) { wrong.textContent = `No answer: ${error.message}`; status.textContent = ""; }
      return;
    } finally { clearTimeout(late); }
    if (own !== running) return;
    controls = answer.controls;
    wrongKeys = new Set(Object.keys(answer.errors ?? {}));
    if (!now.size || !known.size) for (const each of controls) known.set(each.key, each.value);
    drawControls();
    showErrors(answer.errors ?? {});
    if (answer.errors) { status.textContent = "not run"; return; }
    drawNumbers(answer);
    await showReplay(answer.page, own);
    if (own === running) { runs++; status.textContent = `${((performance.now() - begun) / 1000).toFixed(2)} s`; }
  }
  function drawNumbers(answer) {
    const figure = row => {
      const difference = row.difference === undefined ? [] : [" ", make("small", { className: judged(row), title: "Difference from the pinned run" }, row.difference)];
      return make("p", {}, make("span", {}, row.name), " ", make("strong", {}, row.value, row.unit ? ` ${row.unit}` : "", ...difference));
    };
    numbers.replaceChildren(...answer.metrics.filter(row => row.first).map(figure));
    const [own, other] = answer.seeds, is_same = pinned && joined(now).join("\n") === pinned.join("\n");
    note.replaceChildren(button("All metrics", "All metrics of this run", () => showMetrics(answer.metrics)), " ", [
      other === null ? "No run is pinned." : is_same ? "This run is the pinned one: change a key, and the next run is compared with it."
        : own === other ? `Differences are from the pinned run, drawn faint. Both have seed ${own} and so the same random numbers: they are effects of the changed keys.`
          : `Differences are from the pinned run, drawn faint. The seeds ${own} and ${other} differ, so they are also due to chance: compare over 30 seeds.`,
      ...answer.warnings.map(each => `Warning: ${each}.`),
    ].join(" "));
    texts = answer.texts;
  }
  const judged = row => !row.more_is || !row.sign ? "" : (row.sign > 0) === (row.more_is === "better") ? "better" : "worse";

  // The replay: a new page is loaded behind the present one, which it replaces at the same instant.

  const replay = () => frame?.contentWindow?.replay;
  function showReplay(page, own) {
    const before = replay();
    if (before) Object.assign(shown, { time: before.time, playing: before.playing, speed: before.speed });
    waiting?.remove();
    const next = waiting = make("iframe", { title: "Replay of this run", className: "waiting", srcdoc: page });
    stage.append(next);
    return new Promise(done => {
      next.onload = () => {
        if (own !== running) { next.remove(); return done(); }
        const made = next.contentWindow.replay, last = replay();
        if (last) Object.assign(shown, { time: last.time, playing: last.playing, speed: last.speed });
        next.contentDocument.querySelectorAll("h1, #theme").forEach(each => { each.style.display = "none"; });  // the page has its own
        made.setTheme(isDark() ? "dark" : "light");
        if (shown.speed) made.speed = shown.speed;
        made.seek(shown.time);
        if (shown.playing) made.play();
        frame?.remove();
        frame = next;
        waiting = null;
        frame.classList.remove("waiting");
        requestAnimationFrame(() => done());
      };
    });
  }

  // Over seeds.

  function stopComparing() { comparing?.abort(); comparing = null; }
  function endComparison() {  // what is shown is of a scenario that has changed
    stopComparing();
    const title = seeds.querySelector("h2"), cancel = seeds.querySelector(".cancel");
    if (title && !title.textContent.startsWith(BEFORE)) title.textContent = BEFORE + title.textContent;
    if (cancel) cancel.hidden = true;
  }
  async function compare() {
    stopComparing();
    const own = comparing = new AbortController(), body = { now: joined(now), pinned: pinned ?? joined(now), count: 30 };
    const title = make("h2", {}, "30 seeds"), bar = make("progress", { max: 30, value: 0 }), table = make("table");
    bar.setAttribute("aria-label", "Pairs of runs that are done");
    const cancel = button("Cancel", "Stop the runs", () => { stopComparing(); title.textContent += ", cancelled"; cancel.hidden = true; });
    cancel.className = "cancel";
    seeds.replaceChildren(make("div", {}, title, cancel, button("Close", "Close the comparison", () => { stopComparing(); seeds.hidden = true; })), bar, make("div", { className: "scroll" }, table));
    seeds.hidden = false;
    try {
      await transport.seeds(body, found => { if (own === comparing) showPairs(found, title, bar, table); }, own.signal);
      if (own === comparing) cancel.hidden = true;
    } catch (error) {
      if (own === comparing) { title.textContent = `No answer: ${error.message}`; cancel.hidden = true; }
    }
  }
  function showPairs(found, title, bar, table) {
    if (found.error) { title.textContent = found.error; return; }
    bar.value = found.done;
    title.textContent = `${found.done} of ${found.of} seeds: difference from the pinned run in pairs of equal seeds, with 95 % intervals`
      + (found.failed ? `; ${found.failed} failed: ${found.failure[0]}` : "");
    const row = (each, cell = "td") => make("tr", {}, ...each.map(one => one instanceof Node ? one : make(cell, {}, one)));
    const rows = found.metrics.filter(each => each.first).map(each => row([
      `${each.name}${each.unit ? `, ${each.unit}` : ""}`, each.now, each.pinned,
      make("td", { className: each.differs ? judged(each) : "" }, each.difference), `${each.count}`]));
    table.replaceChildren(make("thead", {}, row(["metric", "mean", "pinned", "difference", "pairs"], "th")), make("tbody", {}, ...rows));
  }

  // Texts to copy, all metrics, and a folder.

  let texts = {};
  function open(...inner) {
    dialog.replaceChildren(...inner, make("form", { method: "dialog" }, make("button", {}, "Close")));
    dialog.showModal();
  }
  function showTexts() {
    const titles = { command: "Command", toml: "Scenario file (TOML)", python: "Python" };
    open(...Object.entries(titles).flatMap(([name, title]) => {
      const copyText = button("Copy", `Copy: ${title}`, async () => { await navigator.clipboard.writeText(texts[name]); copyText.textContent = "Copied"; });
      copyText.setAttribute("aria-label", `Copy: ${title}`);
      return [make("div", {}, make("strong", {}, title), " ", copyText), make("pre", { tabIndex: 0 }, texts[name] ?? "")];
    }));
  }
  function showMetrics(rows) {
    const table = make("table", {}, make("tbody", {}, ...rows.map(row => make("tr", {}, make("td", {}, row.name),
      make("td", {}, `${row.value}${row.unit ? ` ${row.unit}` : ""}`), make("td", { className: judged(row) }, row.difference ?? "")))));
    open(make("strong", {}, "All metrics of this run, and their differences from the pinned run"), make("div", { className: "scroll" }, table));
  }
  async function saveRun() {
    save.disabled = true;
    try {
      const { folder, error } = await transport.save({ now: joined(now) });
      open(make("p", {}, error ?? `Saved in ${folder}. Repeat it, watch it:`), ...(error ? [] : [make("pre", { tabIndex: 0 }, `desim run --from ${folder}/run.json\ndesim replay ${folder}`)]));
    } catch (error) { wrong.textContent = `Not saved: ${error.message}`; } finally { save.disabled = false; }
  }

  followTheme();
  readAddress();
  if (options.hasAddress) {
    window.addEventListener("popstate", () => { readAddress(); query = ""; run(); });
    setInterval(() => { if (replay() && !replay().playing && replay().time !== shown.time) { shown.time = replay().time; writeAddress(false); } }, 500);
  }
  run();

  return {
    stop() { status.textContent = "ended"; wrong.textContent = "The program that served this page has ended: run desim play again."; for (const each of element.querySelectorAll("header button, .keys input, .keys select")) if (each !== theme) each.disabled = true; },
    remove() { running?.abort(); stopComparing(); darkness.removeEventListener("change", followTheme); element.remove(); },
    change, get replay() { return replay(); }, get runs() { return runs; }, get changes() { return joined(now); }, get pinned() { return pinned; },
  };
}
