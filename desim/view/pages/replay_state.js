// The state at the time shown.

let moved = null;  // when the time or the selection last changed, ms; null: the address names them
let time = 0, playing = false, speed = 1, chosen = -1, hovered = -1, zoom = 1, stale = true, axisStale = true;
const X = new Float64Array(N + M), Y = new Float64Array(N + M), heading = new Float64Array(N + M).fill(NaN);  // NaN: has none
const truth = new Uint16Array(N), heard = new Uint16Array(N * N);
const mistaken = new Uint16Array(N), down = new Uint8Array(N), deaf = new Uint8Array(N), lies = new Uint8Array(N);
const distrusts = new Uint8Array(suspicion ? N * N : 0);
const crowd = new Uint16Array(M + 1);  // number of pursuers on each evader
let cuts = [], caught = new Map(), decided = 0, learnt = 0, shownTime = -1, wrong = 0, open = [], drawn = { flying: 0, lost: 0, delivered: 0 }, marks = { flying: [], lost: [] }, frames = 0;

function recall() {
  if (time < shownTime || shownTime < 0) { truth.set(run.active); heard.fill(UNHEARD); decided = learnt = 0; }
  for (; decided < decisions.t.length && decisions.t[decided] <= time; decided++)
    truth[decisions.who[decided]] = decisions.active[decided];
  if (belief) for (; learnt < belief.t.length && belief.t[learnt] <= time; learnt++)
    heard[belief.reader[learnt] * N + belief.source[learnt]] = belief.value[learnt];
  shownTime = time;
  crowd.fill(0);
  for (const action of truth) crowd[action]++;
  mistaken.fill(0);
  wrong = 0;
  if (belief) for (let i = 0; i < N; i++) for (let j = 0; j < N; j++) {
    if (i === j) continue;
    if (believed(i, j) !== truth[j]) { mistaken[j]++; wrong++; }
  }
  caught = new Map(run.captures.filter(each => each.t <= time).map(each => [each.evader, each.capturer]));
  open = run.faults.filter(each => each.begin <= time && (time < each.end || each.end >= END));
  const now = moment(time);
  for (let i = 0; i < N + M; i++) { X[i] = between(now, 2 * i); Y[i] = between(now, 2 * i + 1); }
  headings?.players.forEach((i, k, { length }) => { heading[i] = headings.turn * headings.values[now.after * length + k]; });
  cuts = open.filter(isCut);
  const jams = open.filter(isJam);
  down.fill(0);
  for (const each of open) if (isCrash(each)) down[each.node] = 1;
  lies.fill(0);
  if (suspicion) {
    distrusts.fill(0);
    for (let k = 0, end = upto(suspicion.t, time); k < end; k++) distrusts[suspicion.who[k] * N + suspicion.suspect[k]] = suspicion.begins[k];
  }
  for (const each of open) if (isLie(each)) lies[each.node] = 1;
  for (let i = 0; i < N; i++) deaf[i] = jams.some(({ centre: [x, y], radius }) => (X[i] - x) ** 2 + (Y[i] - y) ** 2 <= radius ** 2);
}
/** Action of pursuer j as last received by i; without a message, j is believed inactive. */
function believed(i, j) { const found = heard[i * N + j]; return found === UNHEARD ? 0 : found; }
const isNear = (i, j) => radii ? Math.hypot(X[i] - X[j], Y[i] - Y[j]) <= radii[i * N + j]
  : run.reception.radius === null || Math.hypot(X[i] - X[j], Y[i] - Y[j]) <= run.reception.radius;
/** Whether a message sent now is received, apart from random loss; as in the network, a jammed node sends but does not receive. */
const passes = (src, dst) => src !== dst && (!arcs || arcs[src * N + dst] === 1) && !down[src] && !down[dst] && !deaf[dst]
  && cuts.every(cut => cut.side[src] === cut.side[dst]) && isNear(src, dst);
const all = Array.from({ length: N }, (_, i) => i), evaders = Array.from({ length: M }, (_, k) => k + 1);
const chasersOf = evader => all.filter(i => truth[i] === evader);
const heardBy = i => all.filter(j => passes(j, i)), hearersOf = i => all.filter(j => passes(i, j));

/** The places of the players of the other run, which stays where it ended. */
function ghostAt(t) {
  const now = moment(t, ghost.path);
  return ghost.corners.map((_, i) => [between(now, 2 * i), between(now, 2 * i + 1)]);
}
