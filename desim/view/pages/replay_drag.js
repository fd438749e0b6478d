/* Walls that are moved by hand: for a page that embeds this one, and runs the scenario again with the walls where they were put. */
let putWall = null;  // called with the number of a wall and its new offset, [x, y] m; null: walls cannot be moved
const wanted = walls.map(({ offset }) => [...offset]);  // the offset that is asked for of each wall, m
let held = -1, marked = -1, wasDragged = false;  // the wall that is being moved, and the one whose handle has the focus
let heldFrom = null, grip = null;  // of the wall that is held: its offset, and where the pointer took it, m
const releases = [];  // to be called when no wall is held any longer
const GRIP = 6, ARM = 10;  // distance up to which the pointer takes a wall, and that from players up to which it does not, px
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const shiftOf = k => [0, 1].map(axis => wanted[k][axis] - walls[k].offset[axis]);
/** The outline of a wall where it is asked for, px; of its polygons only, or of all shapes. */
function wantedOutline(k, isSolid = false) {
  const way = new Path2D();
  for (const { closed, corners } of walls[k].shapes) if (closed || !isSolid) outline(way, corners, closed, shiftOf(k));
  return way;
}
function drawWanted(c) {
  walls.forEach((wall, k) => {
    const isMoved = shiftOf(k).some(Boolean);
    if (!isMoved && k !== held && k !== marked) return;
    c.strokeStyle = c.fillStyle = colour.evader; c.lineWidth = 3;
    c.setLineDash(isMoved ? [7, 4] : []);
    c.globalAlpha = .18; c.fill(wantedOutline(k, true), "evenodd");
    c.globalAlpha = 1; c.stroke(wantedOutline(k));
    c.setLineDash([]);
  });
}
const pointAt = event => { const box = arena.canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
const metresAt = event => { const [x, y] = pointAt(event); return [(x - originX) / scale, (originY - y) / scale]; };
/** The wall at the pointer, or -1. */
function wallAt(event) {
  const { context: c, ratio } = arena, [x, y] = pointAt(event), pixel = [x * ratio, y * ratio];
  if (!putWall || all.some(i => Math.hypot(px(X[i]) - x, py(Y[i]) - y) < ARM)) return -1;
  c.lineWidth = 2 * GRIP;
  return walls.findLastIndex((wall, k) => c.isPointInStroke(wantedOutline(k), ...pixel) || c.isPointInPath(wantedOutline(k, true), ...pixel, "evenodd"));
}
/** Ask for an offset of a wall, rounded to about a pixel. */
function want(k, offset) {
  const unit = 10 ** Math.floor(Math.log10(1 / scale));
  wanted[k] = offset.map(each => +(Math.round(each / unit) * unit).toFixed(9) + 0);
  stale = true;
}
function hold(k) { held = k; heldFrom = wanted[k]; stale = true; }
function release(isPut) {
  const k = held;
  if (k < 0) return;
  held = -1; grip = null; stale = true;
  if (!isPut) wanted[k] = heldFrom;
  else if (wanted[k].some((each, axis) => each !== heldFrom[axis])) putWall(k, wanted[k]);
  releases.splice(0).forEach(go => go());
}
function drag(event) {
  if (held < 0 || !grip) { arena.canvas.style.cursor = wallAt(event) >= 0 ? "grab" : ""; return; }
  const [x, y] = metresAt(event);
  wasDragged = true;
  want(held, [heldFrom[0] + x - grip[0], heldFrom[1] + y - grip[1]]);
}
/** A button for the keyboard; it is seen while it has the focus. */
function handleOf(k) {
  const handle = Object.assign(document.createElement("button"), { type: "button", textContent: `Wall ${k}: arrow keys move it, Shift: farther` });
  handle.onfocus = () => { marked = k; stale = true; };
  handle.onblur = () => { release(true); marked = -1; stale = true; };
  handle.onkeydown = event => {
    const way = ARROWS[event.key], length = 10 ** Math.ceil(Math.log10(1 / scale)) * (event.shiftKey ? 10 : 1);
    if (!way || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault(); event.stopPropagation();
    if (held < 0) hold(k);
    want(k, wanted[k].map((each, axis) => each + length * way[axis]));
  };
  handle.onkeyup = event => { if (ARROWS[event.key]) release(true); };
  return handle;
}
/** Let walls be moved with the pointer and the arrow keys; `put` is called with each that is released elsewhere. */
function moveWalls(put) {
  putWall = put;
  const { canvas } = arena, handles = Object.assign(document.createElement("div"), { className: "handles" });
  handles.append(...walls.map((wall, k) => handleOf(k)));
  $("stage").append(handles);
  canvas.addEventListener("pointerdown", event => {
    const k = event.button ? -1 : wallAt(event);
    wasDragged = false;
    if (k < 0) return;
    canvas.setPointerCapture(event.pointerId);
    canvas.style.cursor = "grabbing";
    hold(k);
    grip = metresAt(event);
  });
  canvas.addEventListener("pointermove", drag);
  canvas.addEventListener("pointerup", event => { release(true); drag(event); });
  canvas.addEventListener("pointercancel", () => release(false));
  canvas.addEventListener("click", event => { if (wasDragged) event.stopImmediatePropagation(); }, { capture: true });
  canvas.addEventListener("touchstart", event => { if (wallAt(event.touches[0]) >= 0) event.preventDefault(); }, { passive: false });  // it would scroll
  document.addEventListener("keydown", event => {
    if (held < 0 || event.key !== "Escape") return;
    event.stopImmediatePropagation();
    release(false);
  }, { capture: true });
}
