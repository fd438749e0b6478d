// Drawing.

const colour = {};
function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["page", "card", "ink", "soft", "line", "faint", "active", "active-with-others", "inactive", "evader", "in-flight", "delivered", "lost", "wrong-belief"])
    colour[name.replace(/-./g, part => part[1].toUpperCase())] = style.getPropertyValue("--" + name).trim();
  stale = axisStale = true;
  look++;
  sprites.clear();
}
let look = 0;  // counts the changes of the theme, and of the sizes of canvases
const sprites = new Map();
const DARK = "#1c2024";  // on light blue, in either theme
const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";
function surface(canvas) {
  const context = canvas.getContext("2d"), box = { canvas, context, width: 0, height: 0, ratio: 1 };
  new ResizeObserver(() => {
    const { width, height } = canvas.parentElement.getBoundingClientRect();
    Object.assign(box, { width: Math.floor(canvas.clientWidth || width), height: Math.floor(canvas.clientHeight || height), ratio: devicePixelRatio || 1 });
    canvas.width = box.width * box.ratio;
    canvas.height = box.height * box.ratio;
    stale = axisStale = true;
    look++;  // a canvas that is given a size is empty, even if the size is the same
  }).observe(canvas.parentElement);
  return box;
}
const arena = surface($("arena")), axis = surface($("axis")), board = surface($("matrix"));
/** The part of the plane that is shown without zoom: its centre, width and height, m. */
const extent = (() => {
  let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
  const include = (x, y) => { left = Math.min(left, x); right = Math.max(right, x); low = Math.min(low, y); high = Math.max(high, y); };
  for (let k = 0; k < path.places.length; k += 2) include(path.places[k], path.places[k + 1]);
  const reach = Math.max(right - left, high - low, 1e-3);  // walls that are near the players are shown as a whole
  const [xLow, xHigh, yLow, yHigh] = [left - reach / 2, right + reach / 2, low - reach / 2, high + reach / 2];
  for (const { shapes } of walls) for (const { corners } of shapes) for (const [x, y] of corners) include(Math.min(Math.max(x, xLow), xHigh), Math.min(Math.max(y, yLow), yHigh));
  if (ghost) {  // as far as it is shown
    for (let k = 0; k < ghost.path.places.length && ghost.path.t[Math.floor(k / ghost.path.width)] <= END; k += 2) include(ghost.path.places[k], ghost.path.places[k + 1]);
    for (const [x, y] of ghostAt(END)) include(x, y);
  }
  const size = Math.max(right - left, high - low, 10 * run.radius, 1e-3);
  return { x: (left + right) / 2, y: (low + high) / 2, width: Math.max(right - left, size / 3), height: Math.max(high - low, size / 3) };
})();
let scale = 1, originX = 0, originY = 0;  // px per m; the position of x = y = 0 on the canvas
const MAX_RADIUS = 20000;  // px: the edge of a larger circle is off the canvas, or too flat to be drawn as an arc
const px = x => originX + x * scale, py = y => originY - y * scale;
const niceStep = rough => {
  const power = 10 ** Math.floor(Math.log10(rough)), lead = rough / power;
  return power * (lead <= 1 ? 1 : lead <= 2 ? 2 : lead <= 5 ? 5 : 10);
};

const MANY = 60;  // if there are more pursuers, they are drawn as sprites, and few are labelled

/** A canvas off the page with the size of the plane, for parts that need not be drawn anew for each frame. */
function layer() {
  const canvas = document.createElement("canvas"), context = canvas.getContext("2d");
  return {
    context, state: "",
    clear() {
      const { width: w, height: h, ratio } = arena;
      if (canvas.width !== arena.canvas.width || canvas.height !== arena.canvas.height) { canvas.width = arena.canvas.width; canvas.height = arena.canvas.height; }
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.clearRect(0, 0, w, h);
    },
    show(c) { c.drawImage(canvas, 0, 0, arena.width, arena.height); },
  };
}
const ground = layer(), past = layer(), recent = layer(), ghostPast = layer();
let view = "";  // all layers depend on it: the part of the plane that is shown, the size of the canvas, the theme

function drawArena() {
  const { context: c, width: w, height: h, ratio } = arena;
  if (!w) return;
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  c.clearRect(0, 0, w, h);
  const edge = 30, fitScale = Math.max(Math.min((w - 2 * edge) / extent.width, (h - 2 * edge - 34) / extent.height), 1e-6);
  scale = fitScale * zoom;  // there are 34 px more than the edges, most of them at the top, for the options
  const evader = player(watched()), x = zoom > 1 ? X[evader] : extent.x, y = zoom > 1 ? Y[evader] : extent.y;
  originX = w / 2 - x * scale;
  originY = (h + 24) / 2 + y * scale;
  view = `${scale} ${originX} ${originY} ${w} ${h} ${ratio} ${look}`;
  drawGround(w, h);
  ground.show(c);
  if ($("flow")?.checked) drawFlow(c, w, h);
  if ($("other")?.checked) drawGhost(c);
  if ($("trails").checked) drawTrails(c);
  if (putWall) drawWanted(c);
  if (M > 1) drawTargets(c);
  if ($("ellipses")?.checked) drawEstimates(c);
  drawMessages(c);
  drawPlayers(c, w);
}
const groundX = new Float64Array(N), groundY = new Float64Array(N);  // the positions of the pursuers when the ground was drawn
/** Whether a pursuer has moved by more than a pixel since the ground was drawn. */
function hasMoved() {
  const pixel = 1 / scale;
  for (let i = 0; i < N; i++) if (Math.abs(X[i] - groundX[i]) > pixel || Math.abs(Y[i] - groundY[i]) > pixel) return true;
  return false;
}
/** Draw the parts that change slowly, if they have changed: the grid, sensing ranges, jammed areas, walls, links. */
function drawGround(w, h) {
  const hasLinks = $("links").checked && run.reception.known, hasSight = $("sight")?.checked;
  const ranges = hasLinks && isRangeShown() && focus() < 0 ? rangesShown().join() : "";
  const hasShadows = $("shadows")?.checked && run.reception.known;
  const state = `${view} ${epochCount} ${focus()} ${hasLinks} ${hasSight} ${hasShadows} ${ranges}`;
  const isMoving = openJams.length || hasSight || hasShadows || (hasLinks && (canLackLinks || focus() >= 0)) || ranges;
  if (state === ground.state && !(isMoving && (N <= MANY || hasMoved()))) return;
  ground.state = state;
  groundX.set(X.subarray(0, N)); groundY.set(Y.subarray(0, N));
  const c = ground.context;
  ground.clear();
  drawGrid(c, w, h);
  if (hasSight) drawSight(c);
  for (const jam of openJams) drawJam(c, jam);
  if (hasShadows) drawShadows(c, w, h);
  if (walls.length) drawWalls(c);
  if (hasLinks) { drawLinks(c); drawRanges(c); }
}
/** The evader in the centre of a zoomed view: that of the selected pursuer, else one at large, else the last captured. */
function watched() {
  const chased = focus() >= 0 && truth[focus()];
  return chased || evaders.find(number => !capturerOf.has(number)) || run.captures.at(-1).evader;
}
function drawGrid(c, w, h) {
  const step = niceStep(70 / scale);
  c.strokeStyle = colour.faint; c.lineWidth = 1;
  c.beginPath();
  for (let x = Math.ceil(-originX / scale / step) * step; px(x) < w; x += step) { c.moveTo(Math.round(px(x)) + .5, 0); c.lineTo(Math.round(px(x)) + .5, h); }
  for (let y = Math.ceil((originY - h) / scale / step) * step; py(y) > 0; y += step) { c.moveTo(0, Math.round(py(y)) + .5); c.lineTo(w, Math.round(py(y)) + .5); }
  c.stroke();
  c.strokeStyle = c.fillStyle = colour.soft;
  c.beginPath(); c.moveTo(14, h - 18); c.lineTo(14, h - 14); c.lineTo(14 + step * scale, h - 14); c.lineTo(14 + step * scale, h - 18); c.stroke();
  c.font = `12px ${FONT}`; c.textAlign = "left"; c.textBaseline = "alphabetic";
  c.fillText(`${+step.toPrecision(3)} m`, 20, h - 20);
}
/** The velocity of the flow at a place, m/s, between the points of its grid; null outside of it. */
function flowAt(x, y) {
  const { columns, edge, start, t, velocities } = flow, rows = velocities.length / (2 * t.length * columns);
  const [u, v] = [(x - start[0]) / edge, (y - start[1]) / edge], [i, j] = [Math.floor(u), Math.floor(v)];
  if (i < 0 || j < 0 || i > columns - 2 || j > rows - 2) return null;
  const sample = Math.max(upto(t, time) - 1, 0), next = Math.min(sample + 1, t.length - 1);
  const share = next > sample ? (time - t[sample]) / (t[next] - t[sample]) : 0;
  return [0, 1].map(axis => {
    const at = (k, a, b) => velocities[2 * ((k * rows + j + b) * columns + i + a) + axis];
    const mean = k => (at(k, 0, 0) * (i + 1 - u) + at(k, 1, 0) * (u - i)) * (j + 1 - v) + (at(k, 0, 1) * (i + 1 - u) + at(k, 1, 1) * (u - i)) * (v - j);
    return (1 - share) * mean(sample) + share * mean(next);
  });
}
const ARROW_SPACING = 54;  // distance of the arrows of a flow, px; the longest are half as long
function drawFlow(c, w, h) {
  const step = ARROW_SPACING / scale;
  c.strokeStyle = colour.delivered; c.lineWidth = 1.2; c.globalAlpha = .6;
  c.beginPath();
  for (let x = Math.ceil(-originX / ARROW_SPACING) * step; px(x) < w; x += step) for (let y = Math.ceil((originY - h) / ARROW_SPACING) * step; py(y) > 0; y += step) {
    const velocity = flowAt(x, y), speed = velocity && Math.hypot(...velocity);
    if (!speed) continue;
    const length = ARROW_SPACING / 2 * speed / flow.top, [ux, uy] = [velocity[0] / speed, -velocity[1] / speed], tip = Math.min(length / 2, 5);
    const [fromX, fromY] = [px(x) - ux * length / 2, py(y) - uy * length / 2], [toX, toY] = [fromX + ux * length, fromY + uy * length];
    c.moveTo(fromX, fromY); c.lineTo(toX, toY);
    c.moveTo(toX - tip * (ux - .7 * uy), toY - tip * (uy + .7 * ux)); c.lineTo(toX, toY); c.lineTo(toX - tip * (ux + .7 * uy), toY - tip * (uy - .7 * ux));
  }
  c.stroke();
  c.globalAlpha = 1;
}
/** The rows of the estimates that are drawn: those of the selected pursuer, or of each chaser about its evader. */
function shownEstimates() {
  const end = upto(estimates.t, time), from = focus(), rows = [];
  for (let k = end - 1; k >= 0 && estimates.t[k] === estimates.t[end - 1]; k--) {
    const pursuer = estimates.pursuer[k];
    if (!capturerOf.has(estimates.evader[k]) && (from >= 0 ? pursuer === from : truth[pursuer] === estimates.evader[k])) rows.push(k);
  }
  return rows;
}
const DEVIATIONS = Math.sqrt(-2 * Math.log(.05));  // number of standard deviations of an ellipse with 95 % of a normal distribution
function drawEstimates(c) {
  for (const k of shownEstimates()) {
    const x = px(estimates.centres[2 * k]), y = py(estimates.centres[2 * k + 1]), pursuer = estimates.pursuer[k];
    const [major, minor] = [0, 1].map(axis => DEVIATIONS * scale * estimates.semiAxes[2 * k + axis]);
    if (major > MAX_RADIUS) continue;
    c.strokeStyle = c.fillStyle = pursuer === focus() ? colour.ink : pursuersOn[truth[pursuer]] === 1 ? colour.active : colour.activeWithOthers;
    c.lineWidth = 1.5;
    c.beginPath(); c.ellipse(x, y, major, minor, -estimates.turn * estimates.angles[k], 0, 2 * Math.PI);
    c.globalAlpha = .08; c.fill();
    c.globalAlpha = 1; c.stroke();
    c.beginPath(); c.moveTo(x - 5, y); c.lineTo(x + 5, y); c.moveTo(x, y - 5); c.lineTo(x, y + 5); c.stroke();
  }
}
function hatch(c, x, y, r) {
  c.beginPath();
  for (let d = -r; d <= r; d += 9) {
    const half = Math.sqrt(Math.max(r * r - d * d, 0)), k = Math.SQRT1_2;
    c.moveTo(x + (d - half) * k, y + (d + half) * k); c.lineTo(x + (d + half) * k, y + (d - half) * k);
  }
  c.stroke();
}
function drawJam(c, jam) {
  const [x, y, r] = [px(jam.centre[0]), py(jam.centre[1]), jam.radius * scale];
  c.save();
  c.globalAlpha = .28; c.strokeStyle = colour.ink; c.lineWidth = 1;
  if (r < 4000) hatch(c, x, y, r);
  c.globalAlpha = .7; c.setLineDash([6, 5]); c.lineWidth = 1.5;
  c.beginPath(); c.arc(x, y, r, 0, 7); c.stroke();
  c.restore();
}
const focus = () => selected >= 0 ? selected : hovered;
/** Draw links, a list of sender, receiver and whether it is two-way; a one-way link has an arrow head at the receiver. */
function drawArrows(c, links, size) {
  c.beginPath();
  for (const [src, dst] of links) { c.moveTo(px(X[src]), py(Y[src])); c.lineTo(px(X[dst]), py(Y[dst])); }
  c.stroke();
  c.setLineDash([]);
  c.globalAlpha = Math.min(2 * c.globalAlpha, 1);
  c.beginPath();
  for (const [src, dst, isTwoWay] of links) {
    const x = px(X[dst]), y = py(Y[dst]), dx = x - px(X[src]), dy = y - py(Y[src]), length = Math.hypot(dx, dy);
    if (isTwoWay || length < 30) continue;
    const [ux, uy] = [dx / length, dy / length], tip = 10, tail = tip + size, half = size / 2.6;
    c.moveTo(x - tip * ux, y - tip * uy); c.lineTo(x - tail * ux - half * uy, y - tail * uy + half * ux);
    c.lineTo(x - tail * ux + half * uy, y - tail * uy - half * ux); c.closePath();
  }
  c.fill();
  c.globalAlpha = 1;
}
function drawLinks(c) {
  const from = focus();
  if (canLackLinks) {
    const links = [];
    for (let i = 0; i < N; i++) for (let j = i + 1; j < N; j++) {
      const to = passes(i, j), back = passes(j, i);
      if (to || back) links.push([to ? i : j, to ? j : i, to && back]);
    }
    c.strokeStyle = c.fillStyle = colour.inactive; c.lineWidth = 1; c.globalAlpha = from >= 0 ? .14 : N > 25 ? .22 : .4;
    drawArrows(c, links, 8);
  }
  if (from < 0) return;
  const senders = all.filter(j => passes(j, from)), receiversOnly = all.filter(j => passes(from, j) && !passes(j, from));
  c.strokeStyle = c.fillStyle = colour.soft; c.lineWidth = 1.4; c.globalAlpha = .75;
  drawArrows(c, senders.map(j => [j, from, passes(from, j)]), 10);
  c.setLineDash([5, 4]); c.globalAlpha = .75;
  drawArrows(c, receiversOnly.map(j => [from, j, false]), 10);
}
const isRangeShown = () => run.reception.radius !== null && run.reception.radius * scale <= MAX_RADIUS;
const rangesShown = () => (focus() >= 0 ? [focus()] : all.filter(i => truth[i]).slice(0, 3)).filter(i => !down[i]);
function drawRanges(c) {
  if (!isRangeShown()) return;
  const from = focus(), shown = rangesShown();
  c.setLineDash([2, 5]); c.lineWidth = 1.2; c.strokeStyle = from >= 0 ? colour.soft : colour.active;
  c.globalAlpha = from >= 0 ? .9 : .45;
  for (const i of shown) {
    c.beginPath();
    if (radioEdges.length) addOutline(c, reachOf(X[i], Y[i], run.reception.radius, run.reception.radius));
    else c.arc(px(X[i]), py(Y[i]), run.reception.radius * scale, 0, 7);
    c.stroke();
  }
  c.setLineDash([]); c.globalAlpha = 1;
}
function drawSight(c) {
  const r = run.sensing_range * scale, from = focus();
  if (r > MAX_RADIUS) return;
  c.fillStyle = c.strokeStyle = colour.inactive; c.lineWidth = 1;
  c.beginPath();
  for (const i of all) { c.moveTo(px(X[i]) + r, py(Y[i])); c.arc(px(X[i]), py(Y[i]), r, 0, 2 * Math.PI); }
  c.globalAlpha = .13; c.fill();
  c.globalAlpha = from >= 0 ? .2 : .4; c.stroke();
  if (from >= 0) { c.globalAlpha = 1; c.lineWidth = 1.5; c.beginPath(); c.arc(px(X[from]), py(Y[from]), r, 0, 7); c.stroke(); }
  c.globalAlpha = 1;
}
const DASHES = [[7, 4], [2, 3], [10, 3, 2, 3]];
/** A line from each pursuer to the evader that it chases. */
function drawTargets(c) {
  c.strokeStyle = colour.evader; c.lineWidth = 1.3; c.globalAlpha = .75;
  for (const evader of evaders) {
    const x = px(X[player(evader)]), y = py(Y[player(evader)]);
    c.setLineDash(DASHES[(evader - 1) % DASHES.length]);
    c.beginPath();
    for (const i of chasersOf(evader)) { c.moveTo(px(X[i]), py(Y[i])); c.lineTo(x, y); }
    c.stroke();
  }
  c.setLineDash([]); c.globalAlpha = 1;
}
const TOLERANCE = .3;  // of a trail, px
const cornersByScale = new WeakMap();  // by path: the scale for which its corners were found, and these
function cornersAt(track) {
  const kept = cornersByScale.get(track);
  if (kept && kept.scale >= scale && kept.scale <= 4 * scale) return kept.corners;
  const corners = cornersOf(track, TOLERANCE / scale);
  cornersByScale.set(track, { scale, corners });
  return corners;
}
/** Add the trail of a player from one sample to another to the line that is drawn. */
function addTrail(c, { width, places }, corners, i, from, until) {
  const x = k => px(places[k * width + 2 * i]), y = k => py(places[k * width + 2 * i + 1]);
  c.moveTo(x(from), y(from));
  for (let k = upto(corners, from); k < corners.length && corners[k] < until; k++) c.lineTo(x(corners[k]), y(corners[k]));
  c.lineTo(x(until), y(until));
}
/** Draw the trails of groups of players, each with a hue, from one sample to another. */
function strokeTrails(c, track, groups, from, until, lineWidth) {
  const corners = cornersAt(track);
  c.lineJoin = c.lineCap = "round"; c.lineWidth = lineWidth;
  for (const [hue, players] of groups) {
    c.strokeStyle = hue;
    c.beginPath();
    for (const i of players) addTrail(c, track, corners[i], i, from, until);
    c.stroke();
  }
}
/** Extend the trails of groups of players, each with a hue, on a layer up to a sample; if the view has changed, draw them anew. */
function extendTrails(target, track, groups, until, lineWidth) {
  if (target.state !== view || target.until > until) { target.clear(); target.state = view; target.until = 0; }
  if (target.until === until) return;
  strokeTrails(target.context, track, groups, target.until, until, lineWidth);
  target.until = until;
}
/** Draw the ends of the trails: from a sample to x, y of each player at the time shown. */
function drawTips(c, { width, places }, groups, from, x, y, lineWidth) {
  c.lineWidth = lineWidth; c.lineCap = "round";
  for (const [hue, players] of groups) {
    c.strokeStyle = hue;
    c.beginPath();
    for (const i of players) { c.moveTo(px(places[from * width + 2 * i]), py(places[from * width + 2 * i + 1])); c.lineTo(px(x(i)), py(y(i))); }
    c.stroke();
  }
  c.lineCap = "butt";
}
/** The other run: faint trails, and hollow marks without numbers. */
function drawGhost(c) {
  const places = ghostAt(time);
  if ($("trails").checked) {
    const groups = [[colour.soft, places.map((_, i) => i)]], last = Math.max(upto(ghost.path.t, time) - 1, 0);
    extendTrails(ghostPast, ghost.path, groups, last, 1);
    c.globalAlpha = .55;
    ghostPast.show(c);
    drawTips(c, ghost.path, groups, last, i => places[i][0], i => places[i][1], 1);
  }
  c.globalAlpha = .8; c.lineWidth = 1.2; c.strokeStyle = colour.soft;
  drawOtherWalls(c);
  c.beginPath();
  places.forEach(([x, y], i) => {
    const [u, v, r] = [px(x), py(y), i < ghost.pursuers ? 4.5 : 7];
    if (i < ghost.pursuers) { c.moveTo(u + r, v); c.arc(u, v, r, 0, 2 * Math.PI); }
    else { c.moveTo(u, v - r); c.lineTo(u + r, v); c.lineTo(u, v + r); c.lineTo(u - r, v); c.closePath(); }
  });
  c.stroke();
  c.globalAlpha = 1;
}
const RECENT = 2;  // the trails of the last seconds are drawn boldly
function drawTrails(c) {
  const groups = [[colour.active, all], [colour.evader, evaders.map(player)]], last = Math.max(upto(path.t, time) - 1, 0);
  extendTrails(past, path, groups, last, 1.4);
  c.globalAlpha = .35;
  past.show(c);
  const state = `${view} ${last}`;
  if (recent.state !== state) {
    recent.clear();
    recent.state = state;
    strokeTrails(recent.context, path, groups, Math.max(upto(path.t, time - RECENT / TICK) - 1, 0), last, 2.2);
  }
  c.globalAlpha = .85;
  recent.show(c);
  drawTips(c, path, groups, last, i => X[i], i => Y[i], 2.2);
  c.globalAlpha = 1;
}
/** A list of numbers that keeps its memory from frame to frame. */
class Numbers {
  constructor() { this.content = new Float64Array(1024); this.length = 0; }
  push(...numbers) {
    if (this.length + numbers.length > this.content.length) { const longer = new Float64Array(2 * this.content.length); longer.set(this.content); this.content = longer; }
    for (let k = 0; k < numbers.length; k++) this.content[this.length++] = numbers[k];
  }
  get used() { return this.content.subarray(0, this.length); }
}
const flying = new Numbers(), lost = new Numbers(), arrived = new Numbers();
const SWARM = 1500;  // if more messages are drawn, `drawSwarm` draws them
const RIM = 9;  // distance, px, at which a message leaves a player and reaches one
const departure = {}, arrival = {};

/**
 * Find the messages to draw, with their x, y: in flight (direction, length so far), just lost (direction, elapsed share of
 * the time for which a loss is shown, whether it is a collision), and just delivered.
 */
function findMessages() {
  flying.length = lost.length = arrived.length = 0;
  const collision = messages.causes.indexOf("collision") + 1 || -1;
  const fade = Math.min(.5 * speed, 1) / TICK, flash = .4 * fade, rows = upto(messages.begin, time);
  let arrivalTime = -1;  // the time of `arrival`
  for (let row = upto(messages.begin, time - fade - messages.longest - 1); row < rows; row++) {
    if (messages.latest[row] + fade <= time) continue;
    const left = messages.left[row], src = messages.src[row], waits = time < left;
    // A message moves at constant speed from its sender at transmission to its receiver at arrival.
    if (!waits) moment(left, path, departure);
    const x = px(waits ? X[src] : between(departure, 2 * src)), y = py(waits ? Y[src] : between(departure, 2 * src + 1));
    for (let m = messages.first[row], last = messages.first[row + 1]; m < last; m++) {
      const end = messages.end[m], isLost = messages.fate[m] > 0;
      if (time >= end + (isLost ? fade : flash)) continue;
      if (end !== arrivalTime) { moment(end, path, arrival); arrivalTime = end; }
      const dst = messages.dst[m], dx = px(between(arrival, 2 * dst)) - x, dy = py(between(arrival, 2 * dst + 1)) - y, length = Math.hypot(dx, dy) || 1;
      const begin = length > 3 * RIM ? RIM / length : 0, usable = 1 - 2 * begin;
      if (time < end) {
        const share = waits ? 0 : (time - left) / (end - left), partShare = begin + share * usable;
        flying.push(x + dx * partShare, y + dy * partShare, dx / length, dy / length, share * length);
      } else if (isLost) lost.push(x + dx * (1 - begin), y + dy * (1 - begin), dx / length, dy / length, (time - end) / fade, messages.fate[m] === collision ? 1 : 0);
      else arrived.push(x + dx * (1 - begin), y + dy * (1 - begin));
    }
  }
  drawn.flying = flying.length / 5; drawn.lost = lost.length / 6; drawn.delivered = arrived.length / 2;
}
/** Messages in flight, just lost (a collision as an asterisk) or just delivered; marks of the last two are just short of their receiver. */
function drawMessages(c) {
  if (!messages) return;
  findMessages();
  if (drawn.flying + drawn.lost > SWARM) drawSwarm(c);
  else { if (drawn.delivered <= SWARM) dots(c, colour.delivered, arrived, 2, 2.4); drawFlights(c); drawLosses(c); }
}
function drawFlights(c) {
  const { content, length } = flying;
  c.strokeStyle = colour.inFlight; c.globalAlpha = .45; c.lineWidth = 1.6;
  c.beginPath();
  for (let k = 0; k < length; k += 5) {
    const tail = Math.min(content[k + 4], 16);
    c.moveTo(content[k] - content[k + 2] * tail, content[k + 1] - content[k + 3] * tail); c.lineTo(content[k], content[k + 1]);
  }
  c.stroke();
  c.globalAlpha = 1;
  dots(c, colour.inFlight, flying, 5, 2.8);
}
function drawLosses(c) {
  const { content, length } = lost;
  c.strokeStyle = colour.lost;
  for (let shade = 0; shade < 4; shade++) {
    const crosses = new Path2D(), tails = new Path2D();
    for (let k = 0; k < length; k += 6) if (Math.min(Math.floor(content[k + 4] * 4), 3) === shade) {
      const x = content[k], y = content[k + 1];
      crosses.moveTo(x - 3.2, y - 3.2); crosses.lineTo(x + 3.2, y + 3.2); crosses.moveTo(x + 3.2, y - 3.2); crosses.lineTo(x - 3.2, y + 3.2);
      if (content[k + 5]) { crosses.moveTo(x - 4.6, y); crosses.lineTo(x + 4.6, y); crosses.moveTo(x, y - 4.6); crosses.lineTo(x, y + 4.6); }
      tails.moveTo(x - 14 * content[k + 2], y - 14 * content[k + 3]); tails.lineTo(x, y);
    }
    c.globalAlpha = 1 - shade / 4;
    c.lineWidth = 1.8; c.stroke(crosses);
    c.lineWidth = 1.3; c.setLineDash([2, 2.5]); c.stroke(tails); c.setLineDash([]);
  }
  c.globalAlpha = 1;
}
/** Dots at x, y of each `width` numbers. */
function dots(c, hue, { content, length }, width, radius) {
  c.fillStyle = hue;
  c.beginPath();
  for (let k = 0; k < length; k += width) { c.moveTo(content[k] + radius, content[k + 1]); c.arc(content[k], content[k + 1], radius, 0, 7); }
  c.fill();
}
const swarm = document.createElement("canvas");
let swarmImage = null, swarmPixels = null;
/** The red, green, blue and opacity of a colour as one number, as it stands in the memory of a picture. */
function pixelOf(hue, alpha = 255) {
  const [r, g, b] = [1, 3, 5].map(k => parseInt(hue.slice(k, k + 2), 16));
  return new Uint32Array(new Uint8Array([r, g, b, alpha]).buffer)[0];
}
/** Tens of thousands of messages: squares, and crosses for losses. To write pixels takes a tenth of the time of shapes. */
function drawSwarm(c) {
  const { width, height } = arena.canvas, ratio = arena.ratio;
  if (!swarmImage || swarmImage.width !== width || swarmImage.height !== height) {
    swarm.width = width; swarm.height = height;
    swarmImage = new ImageData(width, height);
    swarmPixels = new Uint32Array(swarmImage.data.buffer);
  } else swarmPixels.fill(0);
  const set = (x, y, pixel) => { if (x >= 0 && y >= 0 && x < width && y < height) swarmPixels[y * width + x] = pixel; };
  const half = drawn.flying > 10 * SWARM ? 0 : Math.max(Math.round(ratio), 1), arm = Math.round(3 * ratio);
  const shades = [255, 191, 127, 64].map(alpha => pixelOf(colour.lost, alpha));
  for (let k = 0; k < lost.length; k += 6) {
    const x = Math.round(lost.content[k] * ratio), y = Math.round(lost.content[k + 1] * ratio), pixel = shades[Math.min(Math.floor(lost.content[k + 4] * 4), 3)];
    for (let d = -arm; d <= arm; d++) { set(x + d, y + d, pixel); set(x + d, y - d, pixel); set(x + d + 1, y + d, pixel); set(x + d + 1, y - d, pixel); }
  }
  const pixel = pixelOf(colour.inFlight);
  for (let k = 0; k < flying.length; k += 5) {
    const x = Math.round(flying.content[k] * ratio), y = Math.round(flying.content[k + 1] * ratio);
    for (let v = -half; v <= half; v++) for (let u = -half; u <= half; u++) set(x + u, y + v, pixel);
  }
  swarm.getContext("2d").putImageData(swarmImage, 0, 0);
  c.drawImage(swarm, 0, 0, arena.width, arena.height);
}
function drawPlayers(c, w) {
  const size = w < 460 || N > 60 ? 5.5 : 7, from = focus();
  c.font = `600 11px ${FONT}`; c.textBaseline = "middle"; c.textAlign = "left";
  let letterCount = 0;  // one per group of a partition; unlisted pursuers have none
  const partitions = openCuts.map(cut => ({ cut, first: (letterCount += cut.groups.length) - cut.groups.length }));
  for (let pass = 0; pass < 2; pass++) for (let i = 0; i < N; i++) if (!!truth[i] === !!pass) {  // active pursuers on top
    const x = px(X[i]), y = py(Y[i]);
    const isAlone = pursuersOn[truth[i]] === 1;
    drawNose(c, i, x, y, size, !truth[i] ? colour.inactive : isAlone ? colour.active : colour.activeWithOthers);
    if (N <= MANY) { drawDisc(c, x, y, size, truth[i], isAlone); if (wrongAbout[i]) drawErrors(c, x, y, size, wrongAbout[i] / (N - 1)); }
    else {
      const part = Math.ceil(ARCS * wrongAbout[i] / (N - 1));
      stamp(c, x, y, `disc ${truth[i]} ${isAlone}`, size + 2, (onto, u, v) => drawDisc(onto, u, v, size, truth[i], isAlone));
      if (part) stamp(c, x, y, `errors ${part}`, size + 7, (onto, u, v) => drawErrors(onto, u, v, size, part / ARCS));
    }
    if (from >= 0 && from !== i && belief) {  // the belief of the selected pursuer about it
      const believedAction = believed(from, i);
      if (believedAction) { c.strokeStyle = colour.ink; c.lineWidth = 1.5; c.strokeRect(x - size - 7, y - size - 7, 2 * size + 14, 2 * size + 14); }
      if (believedAction && M > 1) mark(c, x - size - 7, y - size - 7, `${believedAction}`);
    }
    if (i === from) { c.strokeStyle = colour.ink; c.lineWidth = 2; c.beginPath(); c.arc(x, y, size + 8, 0, 7); c.stroke(); }
    if (lies[i]) drawLiar(c, i, x, y, size);
    const groupLetters = partitions.length && partitions.map(({ cut, first }) => { const group = cut.side[i]; return group < 0 ? "" : String.fromCharCode(65 + (first + group) % 26); }).join("");
    if (groupLetters) mark(c, x, y - size - 9, groupLetters);
    if (down[i]) for (const fault of openFaults) if (isCrash(fault) && fault.node === i) {
      c.strokeStyle = colour.ink; c.lineWidth = 1.6; c.setLineDash([3, 3]);
      c.beginPath(); c.arc(x, y, size + 5, 0, 7); c.stroke(); c.setLineDash([]);
      if (fault.scope === "robot") { c.beginPath(); c.moveTo(x - 4, y - 4); c.lineTo(x + 4, y + 4); c.moveTo(x + 4, y - 4); c.lineTo(x - 4, y + 4); c.stroke(); }
    }
  }
  drawNames(c, size, partitions.length > 0);
  for (const evader of evaders) if (M > 1 && capturerOf.has(evader)) drawCaught(c, evader);
  for (const evader of evaders) if (M === 1 || !capturerOf.has(evader)) drawEvader(c, evader);
}
const ARCS = 48;  // in a sprite, the share of the teammates that are wrong is rounded up to multiples of 1 / ARCS
function drawDisc(c, x, y, size, action, isAlone) {
  c.beginPath(); c.arc(x, y, size, 0, 7);
  c.fillStyle = !action ? colour.card : isAlone ? colour.active : colour.activeWithOthers; c.fill();
  c.lineWidth = 1.6; c.strokeStyle = action ? colour.card : colour.inactive; c.stroke();
  if (M > 1 && action) inside(c, action, x, y, size + 2, isAlone ? colour.card : DARK);
}
/** The share of the teammates that have a wrong belief about a pursuer. */
function drawErrors(c, x, y, size, share) {
  c.strokeStyle = colour.wrongBelief; c.lineWidth = 3;
  c.beginPath(); c.arc(x, y, size + 4, -Math.PI / 2, -Math.PI / 2 + 2 * Math.PI * share); c.stroke();
}
/** Draw a sprite, up to `half` px around a place; `paint` draws it once for each name. Copies take a tenth of the time. */
function stamp(c, x, y, name, half, paint) {
  let sprite = sprites.get(name);
  if (!sprite || sprite.ratio !== arena.ratio) {
    const canvas = document.createElement("canvas"), size = Math.ceil(2 * half * arena.ratio), context = canvas.getContext("2d");
    canvas.width = canvas.height = size;
    context.scale(arena.ratio, arena.ratio);
    context.font = c.font; context.textBaseline = c.textBaseline;
    sprite = { canvas, ratio: arena.ratio, width: size / arena.ratio };
    paint(context, sprite.width / 2, sprite.width / 2);
    sprites.set(name, sprite);
  }
  const { canvas, width, ratio } = sprite, snap = u => Math.round((u - width / 2) * ratio) / ratio;
  c.drawImage(canvas, snap(x), snap(y), width, width);
}
/** The heading of a player with inertia. */
function drawNose(c, i, x, y, size, hue) {
  if (Number.isNaN(heading[i])) return;
  const [ux, uy] = [Math.cos(heading[i]), -Math.sin(heading[i])], tip = size + 11;
  c.fillStyle = hue; c.strokeStyle = colour.card; c.lineWidth = 1.2;
  c.beginPath(); c.moveTo(x + tip * ux, y + tip * uy); c.lineTo(x - .85 * size * uy, y + .85 * size * ux); c.lineTo(x + .85 * size * uy, y - .85 * size * ux); c.closePath();
  c.fill(); c.stroke();
}
const isFooled = (i, liar) => i !== liar && !distrusts[i * N + liar] && believed(i, liar) !== truth[liar];
/** Mark a pursuer with a Byzantine fault, and draw lines to the teammates with a wrong belief about it. */
function drawLiar(c, i, x, y, size) {
  c.strokeStyle = colour.wrongBelief; c.lineWidth = 2; c.setLineDash([2, 5]);
  if (belief) for (const j of all) if (isFooled(j, i)) {
    c.beginPath(); c.moveTo(x, y); c.lineTo(px(X[j]), py(Y[j])); c.stroke();
  }
  c.setLineDash([]);
  c.fillStyle = colour.wrongBelief; c.strokeStyle = colour.card; c.lineWidth = 1.2;
  c.beginPath(); c.moveTo(x, y + size); c.lineTo(x + 8, y + size + 14); c.lineTo(x - 8, y + size + 14); c.closePath(); c.fill(); c.stroke();
  inside(c, "!", x, y + size + 9, 10);
}
function drawEvader(c, evader) {
  const x = px(X[player(evader)]), y = py(Y[player(evader)]), r = M > 1 ? 9.5 : run.radius * scale > 16 ? 6 : 8;
  c.strokeStyle = colour.evader; c.lineWidth = 1.5;
  c.globalAlpha = .15; c.fillStyle = colour.evader; c.beginPath(); c.arc(x, y, run.radius * scale, 0, 7); c.fill();
  c.globalAlpha = 1; c.stroke();
  if (!capturerOf.has(evader)) drawNose(c, player(evader), x, y, r - 2, colour.evader);
  c.beginPath(); c.moveTo(x, y - r); c.lineTo(x + r, y); c.lineTo(x, y + r); c.lineTo(x - r, y); c.closePath();
  if (!capturerOf.has(evader) && isHidden(evader)) {
    c.fillStyle = colour.card; c.fill(); c.setLineDash([3, 2]); c.lineWidth = 1.8; c.stroke(); c.setLineDash([]);
    c.fillStyle = colour.evader;
    if (M > 1) label(c, `${evader}`, x + r + 3, y, colour.evader);
    return;
  }
  c.fill(); c.strokeStyle = colour.card; c.lineWidth = 1.2; c.stroke();
  if (M > 1) inside(c, evader, x, y, 10);
  if (capturerOf.has(evader)) {
    c.strokeStyle = colour.ink; c.lineWidth = 2.5; c.beginPath(); c.arc(x, y, Math.max(16, run.radius * scale + 5), 0, 7); c.stroke();
    const capturer = capturerOf.get(evader);  // above the evader, which would hide it
    c.fillStyle = colour.active; c.strokeStyle = colour.card; c.lineWidth = 1.2; c.beginPath(); c.arc(px(X[capturer]), py(Y[capturer]), 4, 0, 7); c.fill(); c.stroke();
    label(c, `captured by ${capturer}`, x + Math.max(16, run.radius * scale + 5) + 7, y, colour.ink);
  }
}
function drawCaught(c, evader) {
  const x = px(X[player(evader)]), y = py(Y[player(evader)]);
  c.strokeStyle = colour.soft; c.lineWidth = 1; c.beginPath(); c.arc(x, y, run.radius * scale, 0, 7); c.stroke();
  c.fillStyle = colour.ink; star(c, x, y, 13); c.fill(); c.strokeStyle = colour.card; c.lineWidth = 1.2; c.stroke();
  inside(c, evader, x, y, 9);
  label(c, `by ${capturerOf.get(evader)}`, x + 15, y, colour.ink);
}
function star(c, x, y, r) {
  c.beginPath();
  for (let k = 0; k < 10; k++) {
    const [reach, angle] = [k % 2 ? .6 * r : r, Math.PI * k / 5];
    c.lineTo(x + reach * Math.sin(angle), y - reach * Math.cos(angle));
  }
  c.closePath();
}
/** A number within a shape, at most `size` px high. */
function inside(c, number, x, y, size, hue = colour.card) {
  c.save();
  c.font = `650 ${Math.min(size, 10) - (number > 9 ? 2 : 0)}px ${FONT}`; c.textAlign = "center"; c.fillStyle = hue;
  c.fillText(number, x, y + .5);
  c.restore();
}
const SLOTS = [[1, -1], [1, 1], [-1, -1], [-1, 1], [1, 0], [-1, 0]], slot = new Uint8Array(N);  // a label keeps its position
const FEW = 12;  // if there are more than `MANY` pursuers, the active ones are labelled if there are at most so many of them
/** Labels beside the players, without overlaps; if there is no room, only that of the selected pursuer. */
function drawNames(c, size, isLettered) {
  drawn.labels = 0;
  const from = focus(), pad = from >= 0 ? 10 : 4, high = isLettered ? size + 17 : size;
  const half = i => i < N || M === 1 ? size : 11, above = i => i < N ? high : half(i);
  if (N > MANY && from < 0 && N - pursuersOn[0] > FEW) return;
  const occupied = [...X].map((x, i) => [px(x) - half(i), py(Y[i]) - above(i), px(x) + half(i), py(Y[i]) + half(i)]);
  if (M > 1) for (const evader of capturerOf.keys()) {
    const x = px(X[player(evader)]), y = py(Y[player(evader)]);
    occupied.push([x, y - 6, x + 20 + c.measureText(`by ${capturerOf.get(evader)}`).width, y + 6]);
  }
  const isFree = ([left, top, right, bottom]) => occupied.every(other => right <= other[0] || left >= other[2] || bottom <= other[1] || top >= other[3]);
  const priority = i => 2 * (i === from) + !!truth[i];
  const labelled = N <= MANY ? [...all] : all.filter(i => i === from || (truth[i] && N - pursuersOn[0] <= FEW));
  for (const i of labelled.sort((i, j) => priority(j) - priority(i))) {
    const width = 7 * `${i}`.length, box = k => {
      const [h, v] = SLOTS[k], x = px(X[i]) + h * (size + pad) - (h < 0 ? width : 0), y = py(Y[i]) + v * size;
      return [x, y - 5, x + width, y + 5];
    };
    const free = [slot[i], ...SLOTS.keys()].find(k => isFree(box(k)));
    if (free === undefined && i !== from) continue;
    slot[i] = free ?? slot[i];
    const position = box(slot[i]);
    occupied.push(position);
    drawn.labels++;
    label(c, i, position[0], position[1] + 5, truth[i] ? colour.ink : colour.soft);
  }
}
function label(c, text, x, y, hue) {
  c.lineWidth = 3; c.strokeStyle = colour.card; c.lineJoin = "round";
  c.strokeText(text, x, y); c.fillStyle = hue; c.fillText(text, x, y);
}
function mark(c, x, y, letters) {
  const half = 2 + 4 * letters.length;
  c.fillStyle = colour.ink; c.beginPath(); c.roundRect(x - half, y - 7, 2 * half, 13, 3); c.fill();
  c.fillStyle = colour.card; c.textAlign = "center"; c.fillText(letters, x, y); c.textAlign = "left";
}
