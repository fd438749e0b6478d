// Texts.

const plural = (n, word) => `${n.toLocaleString("en")} ${word}${n === 1 ? "" : "s"}`;
const clock = t => (t * TICK).toFixed(3);
/** A share in % with two digits, or as many as tell it apart from 100 %. */
function percent(share, digits = 2) {
  const shown = +(100 * share).toPrecision(digits);
  return shown >= 100 && share < 1 ? percent(share, digits + 1) : `${shown} %`;
}
function put(id, text) { if ($(id).textContent !== text) $(id).textContent = text; }
const does = action => !action ? "is inactive" : M > 1 ? `chases ${action}` : "is active";
const who = chasers => chasers.length > 8 ? plural(chasers.length, "pursuer") : chasers.length ? chasers.join(", ") : "none";
function describe() {
  if (M > 1) put("caught", `${caught.size} of ${M}`);
  put("chasing", M === 1 || M > 8 ? who(all.filter(i => truth[i]))
    : evaders.map(each => `${each}: ${caught.has(each) ? `captured by ${caught.get(each)}` : who(chasersOf(each))}`).join("\n"));
  put("flying", said ? drawn.flying.toLocaleString("en") : "not recorded");
  const sent = sentBy(time), lost = lostBy(time);
  put("sent", said ? sent.toLocaleString("en") : "not recorded");
  put("lost", said ? lost.toLocaleString("en") + (sent ? ` (${percent(lost / sent)})` : "") : "not recorded");
  put("wrong", belief ? `${wrong} of ${(N * (N - 1)).toLocaleString("en")}` : "not recorded");
  $("clock").firstChild.data = clock(time);
  put("event", lastEvent());
  put("said", about());
  $("slider").value = time;
  $("slider").setAttribute("aria-valuetext", `${clock(time)} s`);
}
const MISBEHAVES = { liar: "lies", silent: "falls silent", replay: "repeats old announcements", spoof: "speaks in the name of others",
  equivocate: "tells some one thing and others another", selective: "withholds messages of others", slander: "accuses others falsely" };
function faultText(fault, isOver) {
  if (fault.kind === "crash" && fault.scope === "radio") return `the radio of ${fault.node} ${isOver ? "recovers" : "fails"}`;
  if (fault.kind === "crash") return `${fault.node} ${isOver ? "recovers" : "breaks down"}`;
  if (fault.kind === "misbehaviour") return `${fault.node} ${isOver ? "is honest again" : MISBEHAVES[fault.model] ?? `misbehaves (${fault.model})`}`;
  const name = isCut(fault) ? `${fault.label} ${fault.groups.map(group => "{" + group.join(" ") + "}").join(" ")}` : fault.label;
  return isOver ? `${name} ends` : name;
}
function lastEvent() {
  const found = [];
  const kind = $("kind").value, d = upto(kind === "decisions" ? decisions.t : changes.t, time) - 1;
  const source = kind === "decisions" ? decisions : changes;
  if (d >= 0 && source.cause[d] !== RELEASED) found.push([source.t[d], `${source.who[d]} ${source.cause[d] ? "breaks down" : does(source.active[d])}`]);
  const r = upto(relays.t, time) - 1, last = r > 0 ? relays.evader.lastIndexOf(relays.evader[r], r - 1) : -1;
  if (r >= 0) found.push([relays.t[r], last >= 0 ? `${relays.who[last]} hands over${M > 1 ? " " + relays.evader[r] : ""} to ${relays.who[r]}` : `${relays.who[r]} is active alone${M > 1 ? ` on ${relays.evader[r]}` : ""}`]);
  if (M > 1) for (const { t, evader, capturer } of run.captures) if (t <= time) found.push([t, `${capturer} captures evader ${evader}`]);
  for (const fault of run.faults) {
    if (fault.begin <= time) found.push([fault.begin, faultText(fault, false)]);
    if (fault.end <= time && fault.end < END) found.push([fault.end, faultText(fault, true)]);
  }
  if (kind === "messages" && said) {
    const row = upto(said.begin, time) - 1;
    if (row >= 0) found.push([said.begin[row], `${said.src[row]} sends to ${said.count[row] === 1 ? said.dst[said.first[row]] : plural(said.count[row], "teammate")}`]);
  }
  if (time >= END && caught.size < M) found.push([END, "the end"]);
  else if (time >= END && M === 1) found.push([END, `${caught.get(1)} captures the evader`]);
  if (!found.length) return "";
  const t = found.reduce((latest, each) => Math.max(latest, each[0]), 0);
  return `${clock(t)} s: ${[...new Set(found.filter(each => each[0] === t).map(each => each[1]))].join("; ")}`;
}
let pointed = null;
function about() {
  if (!belief) return "";
  if (pointed && pointed[0] !== pointed[1]) {
    const [i, j] = pointed, thinks = heard[i * N + j];
    return `${i} ${thinks === UNHEARD ? "has received nothing about" : "last received about"} ${j}${thinks === UNHEARD ? "" : ` that it ${does(thinks)}`}; it ${does(truth[j])}.`;
  }
  const i = focus();
  if (i < 0) return "Point at a cell, or select a pursuer.";
  const audible = heardBy(i), hearers = hearersOf(i), chance = run.reception.chance ? " with probability 0.5 or more" : "";
  const hearing = !run.reception.known ? "" : `receives from ${plural(audible.length, "teammate")}${chance}${`${audible}` === `${hearers}` ? "" : `, reaches ${hearers.length}`} and `;
  const named = evaders.flatMap(evader => {
    const chasers = all.filter(j => j !== i && believed(i, j) === evader), whom = M > 1 ? ` ${evader}` : "";
    const several = chasers.length > 1, act = M > 1 ? `chase${several ? "" : "s"}${whom}` : several ? "are active" : "is active";
    return !chasers.length ? [] : `${chasers.length > 6 ? `${chasers.length} others` : chasers.join(", ")} ${act}`;
  }).join(" and ") || "no other pursuer is active";
  const fooled = all.filter(j => isFooled(j, i)).length;
  const word = lies[i] ? ` It lies; ${fooled ? plural(fooled, "teammate") : "no teammate"} believe${fooled > 1 ? "" : "s"} it.` : "";
  return `${i} ${does(truth[i])} (${run.speeds[i]} m/s), ${hearing}believes that ${named}.${word}`;
}

// Playback.

function seek(t) { time = Math.min(Math.max(t, 0), END); stale = true; moved = performance.now(); }
function setPlaying(on) {
  if (on && time >= END && !led) seek(0);
  playing = on;
  $("play").innerHTML = on ? '<svg viewBox="0 0 20 20"><path d="M5 3h4v14H5zM11 3h4v14h-4z"/></svg>' : '<svg viewBox="0 0 20 20"><path d="M5 2.5v15l12-7.5z"/></svg>';
  $("play").setAttribute("aria-label", on ? "Pause" : "Play");
  $("event").setAttribute("aria-live", on ? "off" : "polite");
  $("play").title = on ? "Pause (space)" : "Play (space)";
  stale = true;
}
function step(way) {
  setPlaying(false);
  const times = stopsOf($("kind").value), next = upto(times, time);
  if (way > 0) seek(next < times.length ? times[next] : END);
  else { let k = next - 1; if (k >= 0 && times[k] >= time) k--; seek(k >= 0 ? times[k] : 0); }
}
let before = null, led = false;  // led: a page around this one moves the time while it plays
function frame(now) {
  if (playing && !led && before !== null) {
    seek(time + Math.min(now - before, 100) / 1000 * speed / TICK);
    if (time >= END) setPlaying(false);
  }
  before = now;
  if (!playing && moved !== null && now - moved > 300) { moved = null; writeAddress(); }
  if (stale) { stale = false; draw(); }
  requestAnimationFrame(frame);
}
// The address: #t=2.5&p=4 is the state at 2.5 s with pursuer 4 selected.

const isLinkable = /^(file|https?):$/.test(location.protocol);  // not in the frame of a notebook
function writeAddress() {
  const own = `#t=${+(time * TICK).toFixed(9)}${chosen >= 0 ? `&p=${chosen}` : ""}`;
  if (isLinkable && own !== location.hash) history.replaceState(null, "", own);
}
function readAddress() {
  const given = new URLSearchParams(location.hash.slice(1)), t = parseFloat(given.get("t")), p = parseInt(given.get("p"), 10);
  if (p >= 0 && p < N) chosen = p;
  if (t >= 0) { setPlaying(false); seek(Math.round(t / TICK)); }
}
function savePng() {
  const { canvas, ratio } = arena, copy = document.createElement("canvas"), c = copy.getContext("2d");
  copy.width = canvas.width; copy.height = canvas.height;
  c.fillStyle = colour.card; c.fillRect(0, 0, copy.width, copy.height);
  c.drawImage(canvas, 0, 0);
  c.scale(ratio, ratio);
  c.font = `600 14px ${FONT}`; c.textAlign = "right"; c.fillStyle = colour.ink;
  c.fillText(`${clock(time)} s`, arena.width - 12, arena.height - 14);
  const name = document.title.replace(/[^\p{L}\p{N}]+/gu, "-").replace(/^-|-$/g, "").slice(0, 60) || "replay";
  Object.assign(document.createElement("a"), { href: copy.toDataURL(), download: `${name}-${clock(time)}s.png` }).click();
}
function draw() { recall(); drawArena(); drawMatrix(); drawAxis(); describe(); frames++; }

// Controls.

const SPEEDS = [.005, .01, .02, .05, .1, .2, .5, 1, 2, 5, 10];
$("speed").append(...SPEEDS.map(each => new Option(`\u00d7 ${each}`, each)));
function setSpeed(value) { speed = value; $("speed").value = value; stale = true; }
const nearestSpeed = value => SPEEDS.reduce((best, each) => Math.abs(each - value) < Math.abs(best - value) ? each : best);
const bySpeed = way => setSpeed(SPEEDS[Math.min(Math.max(SPEEDS.indexOf(speed) + way, 0), SPEEDS.length - 1)]);
$("speed").onchange = () => setSpeed(+$("speed").value);
{
  // At the default speed, a typical message takes about 0.25 s of wall time, and the whole run at most a minute.
  const flights = [];
  if (said) for (let row = 0; row < said.left.length; row += Math.ceil(said.left.length / 500))
    if (said.count[row] && said.end[said.first[row]] <= END) flights.push(said.end[said.first[row]] - said.left[row]);
  flights.sort((a, b) => a - b);
  const typical = flights.length ? flights[flights.length >> 1] * TICK : Infinity;
  const wanted = Math.max(Math.min(typical / .25 || 1, 1), END * TICK / 60);
  setSpeed(SPEEDS.filter(each => each <= 1).find(each => each >= wanted) || 1);
}
$("play").onclick = () => setPlaying(!playing);
$("back").onclick = () => step(-1);
$("next").onclick = () => step(1);
$("kind").onchange = () => { stale = true; };
$("slider").max = END;
$("slider").oninput = () => { seek(+$("slider").value); };
for (const id of ["links", "trails", "sight", "ellipses", "flow", "shadows", "other"]) if ($(id)) $(id).onchange = () => { stale = axisStale = true; };
const setZoom = value => { zoom = Math.min(Math.max(value, 1), 64); stale = true; };
$("closer").onclick = () => setZoom(zoom * 2);
$("farther").onclick = () => setZoom(zoom / 2);
new ResizeObserver(() => {  // on a narrow screen, the height that is left for the plane
  const [main, footer] = ["main", "footer"].map(name => document.querySelector(name));
  document.documentElement.style.setProperty("--around", `${main.offsetTop + footer.offsetHeight + 10}px`);
}).observe(document.querySelector("footer"));
function setTheme(theme) { document.documentElement.dataset.theme = theme; readColours(); }
const darkness = matchMedia("(prefers-color-scheme: dark)");
darkness.addEventListener("change", () => setTheme(darkness.matches ? "dark" : "light"));
$("theme").onclick = () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
$("save").onclick = savePng;
const KEY_WIDTH = 248;
const root = document.documentElement;
let wasBeside = null;
/** Whether the key fits beside the plane: the height limits the plane anyway, or the window is wide; else it would cover the plane. */
function isBeside() {
  const stage = $("stage"), free = document.querySelector("main").clientWidth - document.querySelector("aside").clientWidth - KEY_WIDTH - 52;
  return innerWidth >= 1200 || (innerWidth > 860 && free >= Math.max(.8 * stage.clientHeight, 260));
}
function showKey(on) { $("key").hidden = !on; $("legend").setAttribute("aria-expanded", on); }
function placeKey() {
  const beside = isBeside();
  if (beside === wasBeside) return;
  wasBeside = beside;
  root.classList.toggle("key-over", !beside);
  showKey(beside);
}
new ResizeObserver(placeKey).observe(document.querySelector("main"));
$("legend").onclick = () => showKey($("key").hidden);
$("help").onclick = () => $("keys").showModal();
const nearest = event => {
  const box = $("arena").getBoundingClientRect();
  let best = -1, least = 22 ** 2;
  for (let i = 0; i < N; i++) {
    const d = (px(X[i]) - event.clientX + box.left) ** 2 + (py(Y[i]) - event.clientY + box.top) ** 2;
    if (d < least) { least = d; best = i; }
  }
  return best;
};
const choose = i => { chosen = i === chosen ? -1 : i; stale = true; moved = performance.now(); };
$("arena").onclick = event => choose(nearest(event));
$("arena").onpointermove = event => { const i = event.pointerType === "mouse" ? nearest(event) : -1; if (i !== hovered) { hovered = i; stale = true; } };
$("arena").onpointerleave = () => { hovered = -1; stale = true; };
const cellAt = event => {
  const box = $("matrix").getBoundingClientRect(), cell = (side() - GUTTER) / N;
  const [i, j] = [event.clientY - box.top, event.clientX - box.left].map(each => Math.floor((each - GUTTER) / cell));
  return i >= 0 && j >= 0 && i < N && j < N ? [i, j] : null;
};
$("matrix").onpointermove = $("matrix").onpointerdown = event => { pointed = cellAt(event); stale = true; };
$("matrix").onpointerleave = () => { pointed = null; stale = true; };
$("matrix").onclick = event => { const at = cellAt(event); if (at) choose(at[0]); };
const KEYS = {
  " ": () => setPlaying(!playing), ArrowLeft: () => step(-1), ArrowRight: () => step(1),
  ArrowUp: () => bySpeed(1), ArrowDown: () => bySpeed(-1), Home: () => seek(0), End: () => seek(END),
  ",": () => { setPlaying(false); seek(time - speed / 20 / TICK); }, ".": () => { setPlaying(false); seek(time + speed / 20 / TICK); },
  "+": () => setZoom(zoom * 2), "=": () => setZoom(zoom * 2), "-": () => setZoom(zoom / 2),
  l: () => $("links").click(), r: () => $("trails").click(), s: () => $("sight")?.click(), u: () => $("ellipses")?.click(), f: () => $("flow")?.click(), w: () => $("shadows")?.click(), o: () => $("other")?.click(), t: () => $("theme").click(), "?": () => $("help").click(),
  e: () => { $("kind").selectedIndex = ($("kind").selectedIndex + 1) % $("kind").length; stale = true; },
  k: () => $("legend").click(), p: () => $("save").click(),
  Escape: () => { choose(chosen); if (!isBeside()) showKey(false); },
};
document.addEventListener("keydown", event => {
  const act = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  const isSpace = event.key === " ", inDialog = event.target.closest("dialog"), inSelect = event.target.closest("select") && !isSpace;
  if (!act || inDialog || inSelect || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  if (!(isSpace && event.repeat)) act();
});
// Space plays wherever the focus is, so Enter is left to press buttons, and to tick boxes.
document.addEventListener("keyup", event => { if (event.key === " " && !event.target.closest("dialog")) event.preventDefault(); });
document.querySelector(".options").addEventListener("keydown", event => { if (event.key === "Enter") event.target.click(); });
$("slider").onpointermove = event => {  // names the faults at the pointer
  const box = $("axis").getBoundingClientRect(), t = (event.clientX - box.left - first()) / span() * END;
  const near = 3 / span() * END, found = run.faults.filter(each => each.begin - near <= t && t <= each.end + near);
  $("slider").title = found.map(each => faultText(each, false)).join("; ");
};
if (!belief) $("belief").hidden = true;
$("clock").append("", Object.assign(document.createElement("small"), { textContent: ` / ${clock(END)} s` }));
$("clock").prepend(document.createTextNode(""));
setTheme(darkness.matches ? "dark" : "light");
setPlaying(false);
placeKey();
if (!matchMedia("(prefers-reduced-motion: reduce)").matches) setPlaying(true);
readAddress();
window.addEventListener("hashchange", readAddress);
moved = null;
draw();
requestAnimationFrame(frame);

const metres = (given, width) => Array.from({ length: given.length / width }, (_, k) => [(given[k * width] - originX) / scale, (originY - given[k * width + 1]) / scale]);
/** An interface for pages that embed this one, and for tests; times in s. */
window.replay = {
  play: () => setPlaying(true), pause: () => setPlaying(false), seek: s => { seek(Math.round(s / TICK)); stale = false; draw(); },
  get time() { return time * TICK; }, get playing() { return playing; }, get frames() { return frames; },
  get drawn() { return { ...drawn }; }, get sent() { return sentBy(time); }, get lost() { return lostBy(time); },
  get truth() { return [...truth]; }, get captured() { return [...caught]; }, get players() { return [...X].map((x, i) => [x, Y[i]]); }, get heard() { return [...heard]; }, get hears() { return all.map(heardBy); }, get places() { return { flying: metres(flying.used, 5), lost: metres(gone.used, 6) }; }, get scale() { return scale; }, pixel: (x, y) => [px(x), py(y)],
  get headings() { return [...heading]; }, get estimates() { return estimates ? shownEstimates().map(k => [estimates.pursuer[k], estimates.evader[k], ...estimates.centres.slice(2 * k, 2 * k + 2)]) : []; }, flowAt,
  get hidden() { return evaders.filter(isHidden); }, stretch,
  moveWalls, get wantedWalls() { return wanted.map(offset => [...offset]); }, get markedWall() { return marked; },
  wantWall: (k, offset) => { wanted[k] = offset ?? walls[k].offset; draw(); }, markWall: k => document.querySelectorAll(".handles button")[k]?.focus({ preventScroll: true }),
  whenReleased: () => new Promise(go => { if (held < 0) go(); else releases.push(go); }),
  choose: i => { chosen = i; draw(); }, draw, get chosen() { return chosen; },
  get end() { return END * TICK; }, get ghost() { return ghost && ghostAt(time); },
  get speed() { return speed; }, set speed(value) { setSpeed(nearestSpeed(value)); },
  get theme() { return document.documentElement.dataset.theme; }, setTheme, set led(on) { led = on; },
};
