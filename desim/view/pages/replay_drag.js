/* Walls that the user moves: for a page that embeds this one, and runs the scenario again with the moved walls. */
let putWall = null;  // called with the number of a wall and its new offset, [x, y] m; null: walls cannot be moved
const wantedOffsets = walls.map(({ offset }) => [...offset]);  // the offset to which the user has moved each wall, m
let heldWall = -1, focusedWall = -1, wasDragged = false;  // the wall that is being moved, and the one whose handle has the focus
let offsetBefore = null, gripPoint = null;  // of the held wall, m: its offset before, and where the pointer took hold of it
const releases = [];  // functions to call when the wall is released
const GRIP = 6, ARM = 10;  // px: the pointer takes hold of a wall up to GRIP away, but not within ARM of a player
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const shiftOf = k => [0, 1].map(axis => wantedOffsets[k][axis] - walls[k].offset[axis]);
/** The outline of a wall at its wanted offset, px; of its polygons only, or of all shapes. */
function wantedOutline(k, isSolid = false) {
  const path2d = new Path2D();
  for (const { closed, corners } of walls[k].shapes) if (closed || !isSolid) addOutline(path2d, corners, closed, shiftOf(k));
  return path2d;
}
function drawWanted(c) {
  walls.forEach((wall, k) => {
    const isMoved = shiftOf(k).some(Boolean);
    if (!isMoved && k !== heldWall && k !== focusedWall) return;
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
/** Set the wanted offset of a wall, rounded to about a pixel. */
function setWanted(k, offset) {
  const unit = 10 ** Math.floor(Math.log10(1 / scale));
  wantedOffsets[k] = offset.map(coordinate => +(Math.round(coordinate / unit) * unit).toFixed(9) + 0);
  stale = true;
}
function hold(k) { heldWall = k; offsetBefore = wantedOffsets[k]; stale = true; }
function release(isPut) {
  const k = heldWall;
  if (k < 0) return;
  heldWall = -1; gripPoint = null; stale = true;
  if (!isPut) wantedOffsets[k] = offsetBefore;
  else if (wantedOffsets[k].some((coordinate, axis) => coordinate !== offsetBefore[axis])) putWall(k, wantedOffsets[k]);
  releases.splice(0).forEach(go => go());
}
function drag(event) {
  if (heldWall < 0 || !gripPoint) { arena.canvas.style.cursor = wallAt(event) >= 0 ? "grab" : ""; return; }
  const [x, y] = metresAt(event);
  wasDragged = true;
  setWanted(heldWall, [offsetBefore[0] + x - gripPoint[0], offsetBefore[1] + y - gripPoint[1]]);
}
/** A button with which the keyboard moves a wall; it is visible while it has the focus. */
function handleOf(k) {
  const handle = Object.assign(document.createElement("button"), { type: "button", textContent: `Wall ${k}: arrow keys move it, Shift: farther` });
  handle.onfocus = () => { focusedWall = k; stale = true; };
  handle.onblur = () => { release(true); focusedWall = -1; stale = true; };
  handle.onkeydown = event => {
    const direction = ARROWS[event.key], length = 10 ** Math.ceil(Math.log10(1 / scale)) * (event.shiftKey ? 10 : 1);
    if (!direction || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault(); event.stopPropagation();
    if (heldWall < 0) hold(k);
    setWanted(k, wantedOffsets[k].map((coordinate, axis) => coordinate + length * direction[axis]));
  };
  handle.onkeyup = event => { if (ARROWS[event.key]) release(true); };
  return handle;
}
/** Let the user move walls with the pointer and the arrow keys; `put` is called with each wall released at another offset. */
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
    gripPoint = metresAt(event);
  });
  canvas.addEventListener("pointermove", drag);
  canvas.addEventListener("pointerup", event => { release(true); drag(event); });
  canvas.addEventListener("pointercancel", () => release(false));
  canvas.addEventListener("click", event => { if (wasDragged) event.stopImmediatePropagation(); }, { capture: true });
  canvas.addEventListener("touchstart", event => { if (wallAt(event.touches[0]) >= 0) event.preventDefault(); }, { passive: false });  // it would scroll
  document.addEventListener("keydown", event => {
    if (heldWall < 0 || event.key !== "Escape") return;
    event.stopImmediatePropagation();
    release(false);
  }, { capture: true });
}
