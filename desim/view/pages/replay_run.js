const $ = id => document.getElementById(id);
const run = JSON.parse($("run").textContent);
const M = run.evaders, UNHEARD = M + 1, END = run.end, TICK = run.tick;
const RELEASED = 2;  // the evader that it chased was captured
/** The bytes of a text in base64. */
function bytes(text) {
  const binary = atob(text), found = new Uint8Array(binary.length);
  for (let k = 0; k < found.length; k++) found[k] = binary.charCodeAt(k);
  return found;
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
/** The times of samples, and the x, y of all pursuers, then of the evaders, `width` numbers a sample; m. */
function unpack(given) {
  const start = i4(given.start), width = start.length, shifts = i4(given.shifts);
  const sums = new Float64Array(width + shifts.length);
  sums.set(start);
  for (let k = 0; k < shifts.length; k++) sums[width + k] = sums[k] + shifts[k];
  return { t: u4(given.t), width, places: sums.map(each => each / given.per_metre) };
}
const path = unpack(run.path);
const metresOf = text => Float64Array.from(i4(text), each => each / run.path.per_metre);
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
  const found = new Uint8Array(N * N), given = u2(run.arcs);
  for (let k = 0; k < given.length; k += 2) found[given[k] * N + given[k + 1]] = 1;
  return found;
})();
const radii = run.reception.radii && (() => {
  const found = new Float64Array(N * N), given = new Float64Array(bytes(run.reception.radii).buffer);
  for (let i = 0, k = 0; i < N; i++) for (let j = i + 1; j < N; j++, k++) found[i * N + j] = found[j * N + i] = given[k];
  return found;
})();
const sparse = arcs !== null || radii !== null || run.reception.radius !== null || !!run.walls?.some(wall => wall.blocks.includes("radio"));
const said = run.messages && {
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

/** Offsets of the samples of a path before and after a time, and the fraction of the interval between them. */
function moment(t, { t: times, width, places } = path, found = {}) {  // `found` spares an object for each message drawn
  const after = Math.min(upto(times, t), times.length - 1), before = Math.max(after - 1, 0);
  const span = times[after] - times[before];
  found.places = places; found.after = after; found.a = before * width; found.b = after * width;
  found.share = span > 0 ? Math.min((t - times[before]) / span, 1) : 0;
  return found;
}
const between = ({ places, a, b, share }, k) => places[a + k] + share * (places[b + k] - places[a + k]);

if (said) {
  const rows = said.begin.length, losses = [];
  said.first = new Uint32Array(rows + 1);
  said.latest = new Uint32Array(rows);
  for (let row = 0, m = 0; row < rows; row++) {
    said.first[row + 1] = said.first[row] + said.count[row];
    for (; m < said.first[row + 1]; m++) {
      if (said.end[m] > said.latest[row]) said.latest[row] = said.end[m];
      if (said.fate[m]) losses.push(said.end[m]);
    }
    said.longest = Math.max(said.longest ?? 0, Math.min(said.latest[row], END) - said.begin[row]);
  }
  said.ends = said.end.slice().sort();
  said.losses = Uint32Array.from(losses).sort();
}
const sentBy = t => said ? said.first[upto(said.begin, t)] : 0;
const lostBy = t => said ? upto(said.losses, t) : 0;
const inFlight = t => said ? sentBy(t) - upto(said.ends, t) : 0;

const changes = { t: [], who: [], active: [], cause: [], count: [] };  // `count`: the active pursuers from then on
/** Number of pursuers on each evader: initially, and after each change. */
const hunts = Array.from({ length: M }, (_, k) => ({ first: run.active.filter(each => each === k + 1).length, t: [], count: [] }));
{
  const now = Uint16Array.from(run.active), chased = hunts.map(hunt => hunt.first);
  let count = chased.reduce((sum, each) => sum + each, 0);
  changes.first = count;
  const chase = (evader, by, t) => {
    if (!evader) return;
    chased[evader - 1] += by; count += by;
    hunts[evader - 1].t.push(t); hunts[evader - 1].count.push(chased[evader - 1]);
  };
  for (let k = 0; k < decisions.t.length; k++) {
    const who = decisions.who[k], active = decisions.active[k];
    if (now[who] === active) continue;
    chase(now[who], -1, decisions.t[k]); chase(active, 1, decisions.t[k]);
    now[who] = active;
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
    if (!said) return;
    yield* said.begin;
    for (let k = 0; k < said.ends.length && said.ends[k] <= END; k++) if (said.ends[k] !== said.ends[k - 1]) yield said.ends[k];
  },
};
const stops = {};
/** The times of the events of a kind, ascending; made as they are first needed, as there may be millions of messages. */
const stopsOf = kind => stops[kind] ??= unique(EVENTS[kind]());
const LOOKBACK = 60;
/**
 * By player, the samples needed to draw its path to within a distance, m: others are near the line between two of them.
 * A line of many players with few corners is drawn many times as fast.
 */
const cornersOf = ({ t, width, places }, tolerance) => Array.from({ length: width / 2 }, (_, i) => {
  const kept = [0], x = k => places[k * width + 2 * i], y = k => places[k * width + 2 * i + 1];
  const fits = (from, to) => {  // whether the samples between two are near the line between these
    const dx = x(to) - x(from), dy = y(to) - y(from), length = Math.hypot(dx, dy);
    for (let k = from + 1; k < to; k++) {
      const u = x(k) - x(from), v = y(k) - y(from), along = length ? (u * dx + v * dy) / length : 0;
      if (along < -tolerance || along > length + tolerance) return false;
      if ((length ? Math.abs(u * dy - v * dx) / length : Math.hypot(u, v)) > tolerance) return false;
    }
    return true;
  };
  for (let k = 2; k < t.length; k++) if (k - kept.at(-1) > LOOKBACK || !fits(kept.at(-1), k)) kept.push(k - 1);
  if (t.length > 1) kept.push(t.length - 1);
  return kept;
});
const ghost = run.ghost && (() => {  // another run, in the same ticks
  const own = unpack(run.ghost.path), { t, count } = run.ghost.active;
  return { path: own, pursuers: run.ghost.pursuers, end: run.ghost.end, t: u4(t), count: u4(count) };
})();
