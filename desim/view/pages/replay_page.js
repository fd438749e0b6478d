// Texts.

const plural = (n, word) => `${n.toLocaleString("en")} ${word}${n === 1 ? "" : "s"}`;
const clock = t => (t * TICK).toFixed(3);
/** A share in % with two digits, or as many as tell it apart from 100 %. */
function percent(share, digits = 2) {
  const shown = +(100 * share).toPrecision(digits);
  return shown >= 100 && share < 1 ? percent(share, digits + 1) : `${shown} %`;
}
function setText(id, text) { if ($(id).textContent !== text) $(id).textContent = text; }
const actionText = action => !action ? "is inactive" : M > 1 ? `chases ${action}` : "is active";
const chasersText = chasers => chasers.length > 8 ? plural(chasers.length, "pursuer") : chasers.length ? chasers.join(", ") : "none";
function writeTexts() {
  if (M > 1) setText("caught", `${capturerOf.size} of ${M}`);
  setText("chasing", M === 1 || M > 8 ? chasersText(all.filter(i => truth[i]))
    : evaders.map(evader => `${evader}: ${capturerOf.has(evader) ? `captured by ${capturerOf.get(evader)}` : chasersText(chasersOf(evader))}`).join("\n"));
  setText("flying", messages ? drawn.flying.toLocaleString("en") : "not recorded");
  const sent = sentBy(time), lost = lostBy(time);
  setText("sent", messages ? sent.toLocaleString("en") : "not recorded");
  setText("lost", messages ? lost.toLocaleString("en") + (sent ? ` (${percent(lost / sent)})` : "") : "not recorded");
  setText("wrong", belief ? `${wrongCount} of ${(N * (N - 1)).toLocaleString("en")}` : "not recorded");
  $("clock").firstChild.data = clock(time);
  setText("event", lastEvent());
  setText("said", beliefText());
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
  const events = [];
  const kind = $("kind").value, d = upto(kind === "decisions" ? decisions.t : changes.t, time) - 1;
  const source = kind === "decisions" ? decisions : changes;
  if (d >= 0 && source.cause[d] !== RELEASED) events.push([source.t[d], `${source.who[d]} ${source.cause[d] ? "breaks down" : actionText(source.active[d])}`]);
  const r = upto(relays.t, time) - 1, previous = r > 0 ? relays.evader.lastIndexOf(relays.evader[r], r - 1) : -1;
  if (r >= 0) events.push([relays.t[r], previous >= 0 ? `${relays.who[previous]} hands over${M > 1 ? " " + relays.evader[r] : ""} to ${relays.who[r]}` : `${relays.who[r]} is active alone${M > 1 ? ` on ${relays.evader[r]}` : ""}`]);
  if (M > 1) for (const { t, evader, capturer } of run.captures) if (t <= time) events.push([t, `${capturer} captures evader ${evader}`]);
  for (const fault of run.faults) {
    if (fault.begin <= time) events.push([fault.begin, faultText(fault, false)]);
    if (fault.end <= time && fault.end < END) events.push([fault.end, faultText(fault, true)]);
  }
  if (kind === "messages" && messages) {
    const row = upto(messages.begin, time) - 1;
    if (row >= 0) events.push([messages.begin[row], `${messages.src[row]} sends to ${messages.count[row] === 1 ? messages.dst[messages.first[row]] : plural(messages.count[row], "teammate")}`]);
  }
  if (time >= END && capturerOf.size < M) events.push([END, "the end"]);
  else if (time >= END && M === 1) events.push([END, `${capturerOf.get(1)} captures the evader`]);
  if (!events.length) return "";
  const t = events.reduce((latest, event) => Math.max(latest, event[0]), 0);
  return `${clock(t)} s: ${[...new Set(events.filter(event => event[0] === t).map(event => event[1]))].join("; ")}`;
}
let pointedCell = null;
function beliefText() {
  if (!belief) return "";
  if (pointedCell && pointedCell[0] !== pointedCell[1]) {
    const [i, j] = pointedCell, receivedAction = received[i * N + j];
    return `${i} ${receivedAction === UNHEARD ? "has received nothing about" : "last received about"} ${j}${receivedAction === UNHEARD ? "" : ` that it ${actionText(receivedAction)}`}; it ${actionText(truth[j])}.`;
  }
  const i = focus();
  if (i < 0) return "Point at a cell, or select a pursuer.";
  const senders = sendersTo(i), receivers = receiversOf(i), chance = run.reception.chance ? " with probability 0.5 or more" : "";
  const linkText = !run.reception.known ? "" : `receives from ${plural(senders.length, "teammate")}${chance}${`${senders}` === `${receivers}` ? "" : `, reaches ${receivers.length}`} and `;
  const clauses = evaders.flatMap(evader => {
    const chasers = all.filter(j => j !== i && believed(i, j) === evader), whom = M > 1 ? ` ${evader}` : "";
    const several = chasers.length > 1, verb = M > 1 ? `chase${several ? "" : "s"}${whom}` : several ? "are active" : "is active";
    return !chasers.length ? [] : `${chasers.length > 6 ? `${chasers.length} others` : chasers.join(", ")} ${verb}`;
  }).join(" and ") || "no other pursuer is active";
  const fooled = all.filter(j => isFooled(j, i)).length;
  const lieText = lies[i] ? ` It lies; ${fooled ? plural(fooled, "teammate") : "no teammate"} believe${fooled > 1 ? "" : "s"} it.` : "";
  return `${i} ${actionText(truth[i])} (${run.speeds[i]} m/s), ${linkText}believes that ${clauses}.${lieText}`;
}

// Playback.

function seek(t) { time = Math.min(Math.max(t, 0), END); stale = true; changedAt = performance.now(); }
function setPlaying(on) {
  if (on && time >= END && !isLed) seek(0);
  playing = on;
  $("play").innerHTML = on ? '<svg viewBox="0 0 20 20"><path d="M5 3h4v14H5zM11 3h4v14h-4z"/></svg>' : '<svg viewBox="0 0 20 20"><path d="M5 2.5v15l12-7.5z"/></svg>';
  $("play").setAttribute("aria-label", on ? "Pause" : "Play");
  $("event").setAttribute("aria-live", on ? "off" : "polite");
  $("play").title = on ? "Pause (space)" : "Play (space)";
  stale = true;
}
function step(direction) {
  setPlaying(false);
  const times = timesOf($("kind").value), next = upto(times, time);
  if (direction > 0) seek(next < times.length ? times[next] : END);
  else { let k = next - 1; if (k >= 0 && times[k] >= time) k--; seek(k >= 0 ? times[k] : 0); }
}
let lastFrameAt = null, isLed = false;  // isLed: a page around this one moves the time while it plays
function frame(now) {
  if (playing && !isLed && lastFrameAt !== null) {
    seek(time + Math.min(now - lastFrameAt, 100) / 1000 * speed / TICK);
    if (time >= END) setPlaying(false);
  }
  lastFrameAt = now;
  if (!playing && changedAt !== null && now - changedAt > 300) { changedAt = null; writeAddress(); }
  if (stale) { stale = false; draw(); }
  requestAnimationFrame(frame);
}
// The address: #t=2.5&p=4 is the state at 2.5 s with pursuer 4 selected.

const isLinkable = /^(file|https?):$/.test(location.protocol);  // not in the frame of a notebook
function writeAddress() {
  const hash = `#t=${+(time * TICK).toFixed(9)}${selected >= 0 ? `&p=${selected}` : ""}`;
  if (isLinkable && hash !== location.hash) history.replaceState(null, "", hash);
}
function readAddress() {
  const parameters = new URLSearchParams(location.hash.slice(1)), t = parseFloat(parameters.get("t")), p = parseInt(parameters.get("p"), 10);
  if (p >= 0 && p < N) selected = p;
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
function draw() { update(); drawArena(); drawMatrix(); drawAxis(); writeTexts(); frames++; }

// Controls.

const SPEEDS = [.005, .01, .02, .05, .1, .2, .5, 1, 2, 5, 10];
$("speed").append(...SPEEDS.map(rate => new Option(`\u00d7 ${rate}`, rate)));
function setSpeed(value) { speed = value; $("speed").value = value; stale = true; }
const nearestSpeed = value => SPEEDS.reduce((best, rate) => Math.abs(rate - value) < Math.abs(best - value) ? rate : best);
const changeSpeed = direction => setSpeed(SPEEDS[Math.min(Math.max(SPEEDS.indexOf(speed) + direction, 0), SPEEDS.length - 1)]);
$("speed").onchange = () => setSpeed(+$("speed").value);
{
  // At the default speed, a typical message takes about 0.25 s of wall time, and the whole run at most a minute.
  const flights = [];
  if (messages) for (let row = 0; row < messages.left.length; row += Math.ceil(messages.left.length / 500))
    if (messages.count[row] && messages.end[messages.first[row]] <= END) flights.push(messages.end[messages.first[row]] - messages.left[row]);
  flights.sort((a, b) => a - b);
  const typical = flights.length ? flights[flights.length >> 1] * TICK : Infinity;
  const targetSpeed = Math.max(Math.min(typical / .25 || 1, 1), END * TICK / 60);
  setSpeed(SPEEDS.filter(rate => rate <= 1).find(rate => rate >= targetSpeed) || 1);
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
new ResizeObserver(() => {  // the height of all but the plane, which on a narrow screen gets the rest
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
/** Whether the key fits beside the plane, instead of over it: the window is wide, or the height limits the plane anyway. */
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
  let best = -1, leastSquare = 22 ** 2;
  for (let i = 0; i < N; i++) {
    const d = (px(X[i]) - event.clientX + box.left) ** 2 + (py(Y[i]) - event.clientY + box.top) ** 2;
    if (d < leastSquare) { leastSquare = d; best = i; }
  }
  return best;
};
const choose = i => { selected = i === selected ? -1 : i; stale = true; changedAt = performance.now(); };
$("arena").onclick = event => choose(nearest(event));
$("arena").onpointermove = event => { const i = event.pointerType === "mouse" ? nearest(event) : -1; if (i !== hovered) { hovered = i; stale = true; } };
$("arena").onpointerleave = () => { hovered = -1; stale = true; };
const cellAt = event => {
  const box = $("matrix").getBoundingClientRect(), cell = (side() - GUTTER) / N;
  const [i, j] = [event.clientY - box.top, event.clientX - box.left].map(coordinate => Math.floor((coordinate - GUTTER) / cell));
  return i >= 0 && j >= 0 && i < N && j < N ? [i, j] : null;
};
$("matrix").onpointermove = $("matrix").onpointerdown = event => { pointedCell = cellAt(event); stale = true; };
$("matrix").onpointerleave = () => { pointedCell = null; stale = true; };
$("matrix").onclick = event => { const at = cellAt(event); if (at) choose(at[0]); };
const KEYS = {
  " ": () => setPlaying(!playing), ArrowLeft: () => step(-1), ArrowRight: () => step(1),
  ArrowUp: () => changeSpeed(1), ArrowDown: () => changeSpeed(-1), Home: () => seek(0), End: () => seek(END),
  ",": () => { setPlaying(false); seek(time - speed / 20 / TICK); }, ".": () => { setPlaying(false); seek(time + speed / 20 / TICK); },
  "+": () => setZoom(zoom * 2), "=": () => setZoom(zoom * 2), "-": () => setZoom(zoom / 2),
  l: () => $("links").click(), r: () => $("trails").click(), s: () => $("sight")?.click(), u: () => $("ellipses")?.click(), f: () => $("flow")?.click(), w: () => $("shadows")?.click(), o: () => $("other")?.click(), t: () => $("theme").click(), "?": () => $("help").click(),
  e: () => { $("kind").selectedIndex = ($("kind").selectedIndex + 1) % $("kind").length; stale = true; },
  k: () => $("legend").click(), p: () => $("save").click(),
  Escape: () => { choose(selected); if (!isBeside()) showKey(false); },
};
document.addEventListener("keydown", event => {
  const action = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  const isSpace = event.key === " ", inDialog = event.target.closest("dialog"), inSelect = event.target.closest("select") && !isSpace;
  if (!action || inDialog || inSelect || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  if (!(isSpace && event.repeat)) action();
});
// Space plays wherever the focus is, so only Enter presses buttons and ticks boxes.
document.addEventListener("keyup", event => { if (event.key === " " && !event.target.closest("dialog")) event.preventDefault(); });
document.querySelector(".options").addEventListener("keydown", event => { if (event.key === "Enter") event.target.click(); });
$("slider").onpointermove = event => {  // names the faults at the pointer
  const box = $("axis").getBoundingClientRect(), t = (event.clientX - box.left - axisLeft()) / axisWidth() * END;
  const near = 3 / axisWidth() * END, faults = run.faults.filter(fault => fault.begin - near <= t && t <= fault.end + near);
  $("slider").title = faults.map(fault => faultText(fault, false)).join("; ");
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
changedAt = null;
draw();
requestAnimationFrame(frame);

const metres = (numbers, width) => Array.from({ length: numbers.length / width }, (_, k) => [(numbers[k * width] - originX) / scale, (originY - numbers[k * width + 1]) / scale]);
/** An interface for pages that embed this one, and for tests; times in s. */
window.replay = {
  play: () => setPlaying(true), pause: () => setPlaying(false), seek: s => { seek(Math.round(s / TICK)); stale = false; draw(); },
  get time() { return time * TICK; }, get playing() { return playing; }, get frames() { return frames; },
  get drawn() { return { ...drawn }; }, get sent() { return sentBy(time); }, get lost() { return lostBy(time); },
  get truth() { return [...truth]; }, get captured() { return [...capturerOf]; }, get players() { return [...X].map((x, i) => [x, Y[i]]); }, get heard() { return [...received]; }, get hears() { return all.map(sendersTo); }, get places() { return { flying: metres(flying.used, 5), lost: metres(lost.used, 6) }; }, get scale() { return scale; }, pixel: (x, y) => [px(x), py(y)],
  get headings() { return [...heading]; }, get estimates() { return estimates ? shownEstimates().map(k => [estimates.pursuer[k], estimates.evader[k], ...estimates.centres.slice(2 * k, 2 * k + 2)]) : []; }, flowAt,
  get hidden() { return evaders.filter(isHidden); }, stretch,
  moveWalls, get wantedWalls() { return wantedOffsets.map(offset => [...offset]); }, get markedWall() { return focusedWall; },
  wantWall: (k, offset) => { wantedOffsets[k] = offset ?? walls[k].offset; draw(); }, markWall: k => document.querySelectorAll(".handles button")[k]?.focus({ preventScroll: true }),
  whenReleased: () => new Promise(go => { if (heldWall < 0) go(); else releases.push(go); }),
  choose: i => { selected = i; draw(); }, draw, get chosen() { return selected; },
  get end() { return END * TICK; }, get ghost() { return ghost && ghostAt(time); },
  get speed() { return speed; }, set speed(value) { setSpeed(nearestSpeed(value)); },
  get theme() { return document.documentElement.dataset.theme; }, setTheme, set led(on) { isLed = on; },
};
