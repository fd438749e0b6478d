/* Walls: which lines they cross, how far radio reaches among them, and who is hidden. */
const walls = run.walls ?? [];
/** The edges [x, y, u, v, factor] of the walls that block `what`; they stretch distances for radio by a factor, or Infinity. */
const edgesOf = what => walls.filter(wall => wall.blocks.includes(what)).flatMap(({ shapes, factor }) => shapes.flatMap(({ closed, corners }) =>
  corners.slice(closed ? 0 : 1).map((corner, k) => [...corners.at(closed ? k - 1 : k), ...corner, factor ?? Infinity])));
const radioEdges = edgesOf("radio"), sightEdges = edgesOf("sight");
/** The cross product of two vectors. */
const cross = (x, y, u, v) => x * v - y * u;
/** Whether a ray crosses an edge; as in the network, a corner that is exactly on the ray is left of it. */
function crosses([ax, ay, bx, by], x, y, u, v) {
  if (x > u || (x === u && y > v)) [x, y, u, v] = [u, v, x, y];  // the same result in both directions
  return cross(ax - x, ay - y, ax - u, ay - v) >= 0 !== cross(bx - x, by - y, bx - u, by - v) >= 0
    && cross(ax - x, ay - y, bx - x, by - y) >= 0 !== cross(ax - u, ay - v, bx - u, by - v) >= 0;
}
/** The factor by which walls stretch the distance of two players for radio. */
function stretch(i, j) {
  let factor = 1;
  for (const edge of radioEdges) if (crosses(edge, X[i], Y[i], X[j], Y[j])) factor *= edge[4];
  return factor;
}
/** Whether each pursuer is too far from an evader to see it, or behind a wall. */
const isHidden = evader => sightEdges.length > 0 && all.every(i => {
  const x = X[player(evader)], y = Y[player(evader)];
  return (run.sensing_range !== null && Math.hypot(X[i] - x, Y[i] - y) > run.sensing_range) || sightEdges.some(edge => crosses(edge, X[i], Y[i], x, y));
});
const DIRECTIONS = 360;
/** By direction, the position up to which radio reaches, m, at most `far` away; `radius` is the range, or Infinity. */
function reachOf(x, y, radius, far) {
  const reach = [];
  for (let k = 0; k < DIRECTIONS; k++) {
    const dx = Math.cos(2 * Math.PI * k / DIRECTIONS), dy = Math.sin(2 * Math.PI * k / DIRECTIONS), hits = [];
    for (const edge of radioEdges) if (crosses(edge, x, y, x + far * dx, y + far * dy)) {
      const [ax, ay, bx, by, factor] = edge, distance = cross(ax - x, ay - y, bx - ax, by - ay) / cross(dx, dy, bx - ax, by - ay);
      hits.push([distance, factor]);
    }
    let factor = 1, end = null;
    for (const [distance, edgeFactor] of hits.sort(([a], [b]) => a - b)) {
      if (distance * factor > radius) break;
      factor *= edgeFactor;
      if (distance * factor > radius || factor === Infinity) { end = distance; break; }
    }
    end ??= Math.min(radius / factor, far);
    reach.push([x + end * dx, y + end * dy]);
  }
  return reach;
}
/** Add a line through positions, m, shifted by dx, dy, to a path of the canvas. */
function addOutline(path2d, positions, isClosed = true, [dx, dy] = [0, 0]) {
  positions.forEach(([x, y], k) => path2d[k ? "lineTo" : "moveTo"](px(x + dx), py(y + dy)));
  if (isClosed) path2d.closePath();
}
function drawWalls(c) {
  for (const { blocks, shapes } of walls) {
    c.strokeStyle = c.fillStyle = blocks.includes("motion") ? colour.ink : colour.soft;
    c.lineWidth = blocks.includes("motion") ? 2.6 : 1.6; c.lineJoin = "round";
    c.setLineDash(blocks.includes("sight") ? [] : [6, 4]);
    c.beginPath();
    for (const { closed, corners } of shapes) addOutline(c, corners, closed);
    if (shapes.some(shape => shape.closed)) { c.globalAlpha = .22; c.fill("evenodd"); }
    c.globalAlpha = .9; c.stroke();
  }
  c.globalAlpha = 1; c.setLineDash([]); c.lineJoin = "miter";
}
/** The walls of the other run that are not walls of this one. */
function drawOtherWalls(c) {
  const ownShapes = new Set(walls.map(({ shapes }) => JSON.stringify(shapes)));
  c.beginPath();
  for (const { shapes } of run.ghost.walls ?? []) if (!ownShapes.has(JSON.stringify(shapes))) for (const { closed, corners } of shapes) addOutline(c, corners, closed);
  c.stroke();
}
/** The area out of radio contact with the selected pursuer, or else with the first active or working one. */
function drawShadows(c, w, h) {
  const [from] = rangesShown().length ? rangesShown() : all.filter(i => !down[i]);
  if (from === undefined) return;
  const radius = run.reception.radius ?? Infinity, far = Math.min(radius, 4 * Math.hypot(w, h) / scale);
  c.beginPath();
  if (radius * scale <= MAX_RADIUS) c.arc(px(X[from]), py(Y[from]), radius * scale, 0, 7); else c.rect(0, 0, w, h);
  addOutline(c, reachOf(X[from], Y[from], radius, far));
  c.fillStyle = colour.lost; c.globalAlpha = .14; c.fill("evenodd");
  c.globalAlpha = 1;
}
