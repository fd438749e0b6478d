const $ = id => document.getElementById(id);
const run = JSON.parse($("run").textContent);
const M = run.evaders, UNHEARD = M + 1, END = run.end, TICK = run.tick;
const RELEASED = 2;  // cause of an action, as in replay_data.py: the capture of the evader
/** The bytes of a text in base64. */
function bytes(text) {
  const binary = atob(text), content = new Uint8Array(binary.length);
  for (let k = 0; k < content.length; k++) content[k] = binary.charCodeAt(k);
  return content;
}
/** The integers of a column, as `packed_column` of replay_columns.py describes it, in a typed array. */
function unpacked(text, Numbers) {
  const content = bytes(text), isDifference = content[0] & 1, hasRuns = content[0] & 2;
  let at = 1;
  const next = () => {  // products instead of shifts, which are of 32 bits
    let code = 0;
    for (let weight = 1; ; weight *= 128) {
      const byte = content[at++];
      code += (byte & 127) * weight;
      if (byte < 128) return code;
    }
  };
  const signed = code => code % 2 ? -(code + 1) / 2 : code / 2;
  let count = 0;
  if (hasRuns) while (at < content.length) { next(); count += next(); }
  else for (let k = 1; k < content.length; k++) count += content[k] < 128;
  const numbers = new Numbers(count);
  at = 1;
  for (let k = 0, last = 0; k < count;) {
    const number = signed(next());
    for (let left = hasRuns ? next() : 1; left > 0; left--) numbers[k++] = last = isDifference ? last + number : number;
  }
  return numbers;
}
const u4 = text => unpacked(text, Uint32Array), u2 = text => unpacked(text, Uint16Array), u1 = text => unpacked(text, Uint8Array);
const i4 = text => unpacked(text, Int32Array);
const actions = text => M < 255 ? u1(text) : u2(text);  // number of the chased evader, 1 .. M, or 0

// The recorded run, in columns; times in ticks.

const N = run.active.length;
/** A path: times of samples, and the x, y of all pursuers, then of the evaders, m, as `width` numbers for each sample. */
function unpackPath(columns) {
  const start = i4(columns.start), width = start.length, shifts = i4(columns.shifts);
  const sums = new Float64Array(width + shifts.length);
  sums.set(start);
  for (let k = 0; k < shifts.length; k++) sums[width + k] = sums[k] + shifts[k];
  return { t: u4(columns.t), width, places: sums.map(number => number / columns.per_metre) };
}
const path = unpackPath(run.path);
const metresOf = text => Float64Array.from(i4(text), number => number / run.path.per_metre);
const decisions = {
  t: u4(run.decisions.t), who: u2(run.decisions.who), active: actions(run.decisions.active), cause: u1(run.decisions.cause),
};
const relays = { t: u4(run.relays.t), who: u2(run.relays.who), evader: u2(run.relays.evader) };
/** The players with inertia, and their headings at each sample, in parts of a full turn from the x axis to the left. */
const headings = run.headings && { players: run.headings.players, values: u1(run.headings.values), turn: 2 * Math.PI / run.headings.turn };
const estimates = run.estimates && {  // ellipses of one standard deviation
  t: u4(run.estimates.t), pursuer: u2(run.estimates.pursuer), evader: u2(run.estimates.evader), angles: u1(run.estimates.angles),
  turn: 2 * Math.PI / run.estimates.turn, centres: metresOf(run.estimates.centres), semiAxes: metresOf(run.estimates.semi_axes),
};
const flow = run.flow && {
  ...run.flow, t: u4(run.flow.t), velocities: new Float32Array(bytes(run.flow.velocities).buffer),
};
const player = evader => N + evader - 1;  // index of an evader among all players, pursuers first
const arcs = run.arcs && (() => {  // N x N by sender and receiver
  const matrix = new Uint8Array(N * N), pairs = u2(run.arcs);
  for (let k = 0; k < pairs.length; k += 2) matrix[pairs[k] * N + pairs[k + 1]] = 1;
  return matrix;
})();
const radii = run.reception.radii && (() => {
  const matrix = new Float64Array(N * N), pairs = new Float64Array(bytes(run.reception.radii).buffer);
  for (let i = 0, k = 0; i < N; i++) for (let j = i + 1; j < N; j++, k++) matrix[i * N + j] = matrix[j * N + i] = pairs[k];
  return matrix;
})();
/** Whether two pursuers may be unable to hear each other. */
const canLackLinks = arcs !== null || radii !== null || run.reception.radius !== null || !!run.walls?.some(wall => wall.blocks.includes("radio"));
const messages = run.messages && {
  begin: u4(run.messages.begin), left: u4(run.messages.left), src: u2(run.messages.src), count: u2(run.messages.count),
  dst: u2(run.messages.dst), end: u4(run.messages.end), fate: u1(run.messages.fate), causes: run.messages.causes,
};
const belief = run.beliefs && {
  t: u4(run.beliefs.t), reader: u2(run.beliefs.reader), source: u2(run.beliefs.source), value: actions(run.beliefs.value),
};

const suspicion = run.distrust && {
  t: u4(run.distrust.t), who: u2(run.distrust.who), suspect: u2(run.distrust.suspect), begins: u1(run.distrust.begins),
};

/** Number of ascending times at or before t. */
function upto(times, t) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1; else high = middle;
  }
  return low;
}

/** Offsets of the samples of a path before and after a time, and the fraction of the interval between them; written to `offsets`. */
function moment(t, { t: times, width, places } = path, offsets = {}) {  // one object serves all messages of a frame
  const after = Math.min(upto(times, t), times.length - 1), before = Math.max(after - 1, 0);
  const span = times[after] - times[before];
  offsets.places = places; offsets.after = after; offsets.a = before * width; offsets.b = after * width;
  offsets.share = span > 0 ? Math.min((t - times[before]) / span, 1) : 0;
  return offsets;
}
/** The k-th number of a path at a moment. */
const between = ({ places, a, b, share }, k) => places[a + k] + share * (places[b + k] - places[a + k]);

if (messages) {  // of each transmission: its first delivery, and the end of its last one; the longest time from begin to end
  const rows = messages.begin.length, losses = [];
  messages.first = new Uint32Array(rows + 1);
  messages.latest = new Uint32Array(rows);
  for (let row = 0, m = 0; row < rows; row++) {
    messages.first[row + 1] = messages.first[row] + messages.count[row];
    for (; m < messages.first[row + 1]; m++) {
      if (messages.end[m] > messages.latest[row]) messages.latest[row] = messages.end[m];
      if (messages.fate[m]) losses.push(messages.end[m]);
    }
    messages.longest = Math.max(messages.longest ?? 0, Math.min(messages.latest[row], END) - messages.begin[row]);
  }
  messages.ends = messages.end.slice().sort();
  messages.losses = Uint32Array.from(losses).sort();
}
const sentBy = t => messages ? messages.first[upto(messages.begin, t)] : 0;
const lostBy = t => messages ? upto(messages.losses, t) : 0;
const inFlight = t => messages ? sentBy(t) - upto(messages.ends, t) : 0;

const changes = { t: [], who: [], active: [], cause: [], count: [] };  // `count`: the active pursuers from then on
/** Number of pursuers on each evader: initially, and after each change. */
const chaserCounts = Array.from({ length: M }, (_, k) => ({ first: run.active.filter(action => action === k + 1).length, t: [], count: [] }));
{
  const actionOf = Uint16Array.from(run.active), chased = chaserCounts.map(({ first }) => first);
  let count = chased.reduce((sum, chasers) => sum + chasers, 0);
  changes.first = count;
  const addChasers = (evader, step, t) => {
    if (!evader) return;
    chased[evader - 1] += step; count += step;
    chaserCounts[evader - 1].t.push(t); chaserCounts[evader - 1].count.push(chased[evader - 1]);
  };
  for (let k = 0; k < decisions.t.length; k++) {
    const who = decisions.who[k], active = decisions.active[k];
    if (actionOf[who] === active) continue;
    addChasers(actionOf[who], -1, decisions.t[k]); addChasers(active, 1, decisions.t[k]);
    actionOf[who] = active;
    changes.t.push(decisions.t[k]); changes.who.push(who); changes.active.push(active);
    changes.cause.push(decisions.cause[k]); changes.count.push(count);
  }
}
// A fault is drawn by what its sketch contains, whatever its kind.
const isCut = fault => "groups" in fault, isJam = fault => "radius" in fault, isCrash = fault => "scope" in fault, isLie = fault => "model" in fault;
for (const cut of run.faults) if (isCut(cut)) {  // group of each pursuer; -1: not listed
  cut.side = new Int16Array(N).fill(-1);
  cut.groups.forEach((group, k) => group.forEach(i => { cut.side[i] = k; }));
}
const unique = times => Float64Array.from(new Set(times)).sort();
const EVENTS = {
  changes: () => changes.t, decisions: () => decisions.t, relays: () => relays.t,
  captures: () => run.captures.map(capture => capture.t),
  faults: () => run.faults.flatMap(fault => [fault.begin, fault.end]),
  *messages() {
    if (!messages) return;
    yield* messages.begin;
    for (let k = 0; k < messages.ends.length && messages.ends[k] <= END; k++) if (messages.ends[k] !== messages.ends[k - 1]) yield messages.ends[k];
  },
};
const timesByKind = {};
/** The times of the events of a kind, ascending; made when first needed, because there may be millions of messages. */
const timesOf = kind => timesByKind[kind] ??= unique(EVENTS[kind]());
const LOOKBACK = 60;  // largest number of samples between two corners: each new sample is compared with all of these
/**
 * By player, the corners of its path: the other samples are within a distance, m, of the lines between corners.
 * Lines of many players with few corners are drawn many times as fast.
 */
const cornersOf = ({ t, width, places }, tolerance) => Array.from({ length: width / 2 }, (_, i) => {
  const corners = [0], x = k => places[k * width + 2 * i], y = k => places[k * width + 2 * i + 1];
  const isNearLine = (from, to) => {  // whether the samples between two samples are near the line that connects the two
    const dx = x(to) - x(from), dy = y(to) - y(from), length = Math.hypot(dx, dy);
    for (let k = from + 1; k < to; k++) {
      const u = x(k) - x(from), v = y(k) - y(from), along = length ? (u * dx + v * dy) / length : 0;
      if (along < -tolerance || along > length + tolerance) return false;
      if ((length ? Math.abs(u * dy - v * dx) / length : Math.hypot(u, v)) > tolerance) return false;
    }
    return true;
  };
  for (let k = 2; k < t.length; k++) if (k - corners.at(-1) > LOOKBACK || !isNearLine(corners.at(-1), k)) corners.push(k - 1);
  if (t.length > 1) corners.push(t.length - 1);
  return corners;
});
const ghost = run.ghost && (() => {  // another run, in the same ticks
  const ghostPath = unpackPath(run.ghost.path), { t, count } = run.ghost.active;
  return { path: ghostPath, pursuers: run.ghost.pursuers, end: run.ghost.end, t: u4(t), count: u4(count) };
})();
