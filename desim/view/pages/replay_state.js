// The state at the time shown.

let changedAt = null;  // when the time or the selection last changed, ms; null: the address of the page names the present ones
let time = 0, playing = false, speed = 1, selected = -1, hovered = -1, zoom = 1, stale = true, axisStale = true;
const X = new Float64Array(N + M), Y = new Float64Array(N + M), heading = new Float64Array(N + M).fill(NaN);  // NaN: has none
const truth = new Uint16Array(N), received = new Uint16Array(N * N);  // actions; those last received, by reader and source
const wrongAbout = new Uint16Array(N);  // by pursuer, the number of teammates with a wrong belief about it
const down = new Uint8Array(N), deaf = new Uint8Array(N), lies = new Uint8Array(N);  // crashed, jammed, with a Byzantine fault
const distrusts = new Uint8Array(suspicion ? N * N : 0);
const pursuersOn = new Uint16Array(M + 1);  // number of pursuers on each evader
let openFaults = [], openCuts = [], openJams = [], capturerOf = new Map();  // by evader
let nextDecision = 0, nextBelief = 0, shownTime = -1, wrongCount = 0, drawn = { flying: 0, lost: 0, delivered: 0 }, frames = 0;
let version = 0;  // counts the changes of actions, beliefs, faults and trust: the matrix is drawn anew only if it has changed
let epochCount = -1, trustCount = -1;  // how many of the times of faults and captures, and of the changes of trust, are applied
const pathMoment = {};  // the time shown among the samples of the path, see `moment`
const epochTimes = unique([...run.captures.map(capture => capture.t), ...run.faults.flatMap(fault => [fault.begin, fault.end])]);

/** Count a belief about pursuer j that has become wrong, or right. */
function countWrong(j, wasWrong, isWrong) {
  if (wasWrong === isWrong) return;
  wrongAbout[j] += isWrong ? 1 : -1;
  wrongCount += isWrong ? 1 : -1;
}
function setAction(j, action) {
  if (truth[j] === action) return;
  if (belief) for (let i = 0; i < N; i++) if (i !== j) countWrong(j, believed(i, j) !== truth[j], believed(i, j) !== action);
  pursuersOn[truth[j]]--; pursuersOn[action]++;
  truth[j] = action;
  version++;
}
function setBelief(i, j, value) {
  const before = believed(i, j);
  received[i * N + j] = value;
  if (i !== j) countWrong(j, before !== truth[j], believed(i, j) !== truth[j]);
  version++;
}
function resetState() {
  truth.set(run.active); received.fill(UNHEARD); nextDecision = nextBelief = 0; version++;
  pursuersOn.fill(0); wrongAbout.fill(0); wrongCount = 0;
  for (let j = 0; j < N; j++) {  // nothing is known yet, so all teammates of an active pursuer are wrong about it
    pursuersOn[truth[j]]++;
    if (belief && truth[j]) { wrongAbout[j] = N - 1; wrongCount += N - 1; }
  }
}
/** Bring the state to the present time, from the time shown last or, if that was later, from the beginning. */
function update() {
  if (time < shownTime || shownTime < 0) resetState();
  for (; nextDecision < decisions.t.length && decisions.t[nextDecision] <= time; nextDecision++) setAction(decisions.who[nextDecision], decisions.active[nextDecision]);
  if (belief) for (; nextBelief < belief.t.length && belief.t[nextBelief] <= time; nextBelief++) setBelief(belief.reader[nextBelief], belief.source[nextBelief], belief.value[nextBelief]);
  shownTime = time;
  const count = upto(epochTimes, time);
  if (count !== epochCount) {
    epochCount = count;
    capturerOf = new Map(run.captures.filter(capture => capture.t <= time).map(capture => [capture.evader, capture.capturer]));
    openFaults = run.faults.filter(fault => fault.begin <= time && (time < fault.end || fault.end >= END));
    openCuts = openFaults.filter(isCut); openJams = openFaults.filter(isJam);
    down.fill(0); lies.fill(0); deaf.fill(0);
    for (const fault of openFaults) { if (isCrash(fault)) down[fault.node] = 1; if (isLie(fault)) lies[fault.node] = 1; }
    version++;
  }
  moment(time, path, pathMoment);
  for (let i = 0; i < N + M; i++) { X[i] = between(pathMoment, 2 * i); Y[i] = between(pathMoment, 2 * i + 1); }
  headings?.players.forEach((i, k, { length }) => { heading[i] = headings.turn * headings.values[pathMoment.after * length + k]; });
  const suspicions = suspicion ? upto(suspicion.t, time) : -1;
  if (suspicions !== trustCount) {
    trustCount = suspicions;
    distrusts.fill(0);
    for (let k = 0; k < suspicions; k++) distrusts[suspicion.who[k] * N + suspicion.suspect[k]] = suspicion.begins[k];
    version++;
  }
  for (let i = 0; openJams.length && i < N; i++) deaf[i] = openJams.some(({ centre: [x, y], radius }) => (X[i] - x) ** 2 + (Y[i] - y) ** 2 <= radius ** 2);
}
/** Action of pursuer j as last received by i; without a message, j is believed inactive. */
function believed(i, j) { const action = received[i * N + j]; return action === UNHEARD ? 0 : action; }
const isNear = (i, j) => {
  const radius = radii ? radii[i * N + j] : run.reception.radius;
  const dx = X[i] - X[j], dy = Y[i] - Y[j];
  const isWithin = radius === null || (Math.abs(dx) <= radius && Math.abs(dy) <= radius && Math.hypot(dx, dy) <= radius);  // `hypot` is slow
  if (!isWithin || !radioEdges.length) return isWithin;
  const factor = stretch(i, j);
  return factor === 1 || (factor < Infinity && (radius === null || Math.hypot(dx, dy) * factor <= radius));
};
/** Whether a message sent now is received, apart from random loss; as in the network, a jammed node sends but does not receive. */
const passes = (src, dst) => src !== dst && isNear(src, dst) && (!arcs || arcs[src * N + dst] === 1) && !down[src] && !down[dst] && !deaf[dst]
  && openCuts.every(cut => cut.side[src] === cut.side[dst]);
const all = Array.from({ length: N }, (_, i) => i), evaders = Array.from({ length: M }, (_, k) => k + 1);
const chasersOf = evader => all.filter(i => truth[i] === evader);
const sendersTo = i => all.filter(j => passes(j, i)), receiversOf = i => all.filter(j => passes(i, j));

/** The positions of the players of the other run; after its end, the last ones. */
function ghostAt(t) {
  const ghostMoment = moment(t, ghost.path);
  return Array.from({ length: ghost.path.width / 2 }, (_, i) => [between(ghostMoment, 2 * i), between(ghostMoment, 2 * i + 1)]);
}
