// The state at the time shown.

let moved = null;  // when the time or the selection last changed, ms; null: the address names them
let time = 0, playing = false, speed = 1, chosen = -1, hovered = -1, zoom = 1, stale = true, axisStale = true;
const X = new Float64Array(N + M), Y = new Float64Array(N + M), heading = new Float64Array(N + M).fill(NaN);  // NaN: has none
const truth = new Uint16Array(N), heard = new Uint16Array(N * N);
const mistaken = new Uint16Array(N), down = new Uint8Array(N), deaf = new Uint8Array(N), lies = new Uint8Array(N);
const distrusts = new Uint8Array(suspicion ? N * N : 0);
const crowd = new Uint16Array(M + 1);  // number of pursuers on each evader
let cuts = [], jams = [], caught = new Map(), decided = 0, learnt = 0, shownTime = -1, wrong = 0, open = [], drawn = { flying: 0, lost: 0, delivered: 0 }, frames = 0;

let version = 0, epoch = -1, suspected = -1;  // of actions and beliefs: counts their changes; of faults and captures; of trust
const now = {};  // the place of the time shown among the samples, see `moment`
const turns = unique([...run.captures.map(capture => capture.t), ...run.faults.flatMap(fault => [fault.begin, fault.end])]);

/** Count a belief about pursuer j as wrong, or no longer so. */
function judge(j, wasWrong, isWrong) {
  if (wasWrong === isWrong) return;
  mistaken[j] += isWrong ? 1 : -1;
  wrong += isWrong ? 1 : -1;
}
function setAction(j, action) {
  if (truth[j] === action) return;
  if (belief) for (let i = 0; i < N; i++) if (i !== j) judge(j, believed(i, j) !== truth[j], believed(i, j) !== action);
  crowd[truth[j]]--; crowd[action]++;
  truth[j] = action;
  version++;
}
function setBelief(i, j, value) {
  const before = believed(i, j);
  heard[i * N + j] = value;
  if (i !== j) judge(j, before !== truth[j], believed(i, j) !== truth[j]);
  version++;
}
function begin() {
  truth.set(run.active); heard.fill(UNHEARD); decided = learnt = 0; version++;
  crowd.fill(0); mistaken.fill(0); wrong = 0;
  for (let j = 0; j < N; j++) {  // nothing is known yet, so all teammates of an active pursuer are wrong about it
    crowd[truth[j]]++;
    if (belief && truth[j]) { mistaken[j] = N - 1; wrong += N - 1; }
  }
}
/** Bring the state to the time shown: by the changes since the time shown last, or, if that was later, from the beginning. */
function recall() {
  if (time < shownTime || shownTime < 0) begin();
  for (; decided < decisions.t.length && decisions.t[decided] <= time; decided++) setAction(decisions.who[decided], decisions.active[decided]);
  if (belief) for (; learnt < belief.t.length && belief.t[learnt] <= time; learnt++) setBelief(belief.reader[learnt], belief.source[learnt], belief.value[learnt]);
  shownTime = time;
  const turn = upto(turns, time);
  if (turn !== epoch) {
    epoch = turn;
    caught = new Map(run.captures.filter(each => each.t <= time).map(each => [each.evader, each.capturer]));
    open = run.faults.filter(each => each.begin <= time && (time < each.end || each.end >= END));
    cuts = open.filter(isCut); jams = open.filter(isJam);
    down.fill(0); lies.fill(0); deaf.fill(0);
    for (const each of open) { if (isCrash(each)) down[each.node] = 1; if (isLie(each)) lies[each.node] = 1; }
    version++;
  }
  moment(time, path, now);
  for (let i = 0; i < N + M; i++) { X[i] = between(now, 2 * i); Y[i] = between(now, 2 * i + 1); }
  headings?.players.forEach((i, k, { length }) => { heading[i] = headings.turn * headings.values[now.after * length + k]; });
  const suspicions = suspicion ? upto(suspicion.t, time) : -1;
  if (suspicions !== suspected) {
    suspected = suspicions;
    distrusts.fill(0);
    for (let k = 0; k < suspicions; k++) distrusts[suspicion.who[k] * N + suspicion.suspect[k]] = suspicion.begins[k];
    version++;
  }
  for (let i = 0; jams.length && i < N; i++) deaf[i] = jams.some(({ centre: [x, y], radius }) => (X[i] - x) ** 2 + (Y[i] - y) ** 2 <= radius ** 2);
}
/** Action of pursuer j as last received by i; without a message, j is believed inactive. */
function believed(i, j) { const found = heard[i * N + j]; return found === UNHEARD ? 0 : found; }
const isNear = (i, j) => {
  const radius = radii ? radii[i * N + j] : run.reception.radius;
  const dx = X[i] - X[j], dy = Y[i] - Y[j];
  const isWithin = radius === null || (Math.abs(dx) <= radius && Math.abs(dy) <= radius && Math.hypot(dx, dy) <= radius);  // `hypot` is exact, and slow
  if (!isWithin || !radioEdges.length) return isWithin;
  const factor = stretch(i, j);
  return factor === 1 || (factor < Infinity && (radius === null || Math.hypot(dx, dy) * factor <= radius));
};
/** Whether a message sent now is received, apart from random loss; as in the network, a jammed node sends but does not receive. */
const passes = (src, dst) => src !== dst && isNear(src, dst) && (!arcs || arcs[src * N + dst] === 1) && !down[src] && !down[dst] && !deaf[dst]
  && cuts.every(cut => cut.side[src] === cut.side[dst]);
const all = Array.from({ length: N }, (_, i) => i), evaders = Array.from({ length: M }, (_, k) => k + 1);
const chasersOf = evader => all.filter(i => truth[i] === evader);
const heardBy = i => all.filter(j => passes(j, i)), hearersOf = i => all.filter(j => passes(i, j));

/** The places of the players of the other run, which stays where it ended. */
function ghostAt(t) {
  const then = moment(t, ghost.path);
  return Array.from({ length: ghost.path.width / 2 }, (_, i) => [between(then, 2 * i), between(then, 2 * i + 1)]);
}
