// The time axis: active pursuers, messages in flight and lost, decisions and handovers, evaders, faults. Names at the left.

const PAD = 8;  // half the width of the handle of the slider, px
const axisLeft = () => $("slider").offsetLeft + PAD, axisWidth = () => axis.width - axisLeft() - PAD;
const xOf = t => axisLeft() + axisWidth() * (END ? t / END : 0);
const backdrop = document.createElement("canvas");
const faultLabel = fault => fault.kind === "crash" ? `${fault.scope === "radio" ? "radio" : "crash"} ${fault.node}` : fault.label;
const LANE = M > 1 ? Math.min(13, 78 / M) : 0, NAMED = 13, MAX_NAMED = 4;  // height of the lane of an evader, of a fault, px
/** The bar and the lane of each fault, the position of its name within or beside the bar, and the height of a lane; many lanes have no names. */
function faultLanes(c) {
  c.font = `10px ${FONT}`;
  const assignRows = extents => {
    const rows = [];
    return extents.map(([from, to]) => {
      let row = rows.findIndex(end => end <= from);
      if (row < 0) row = rows.push(0) - 1;
      rows[row] = to;
      return row;
    });
  };
  const bars = run.faults.map(fault => [xOf(fault.begin), Math.max(xOf(fault.end), xOf(fault.begin) + 3)]);
  const texts = run.faults.map((fault, k) => {
    const [from, to] = bars[k], width = c.measureText(faultLabel(fault)).width;
    return width + 8 <= to - from ? from + 5 : to + 3 + width <= axis.width ? to + 3 : from - 3 - width;
  });
  const spans = bars.map(([from, to], k) => [Math.min(from, texts[k] - 3), Math.max(to, texts[k] + c.measureText(faultLabel(run.faults[k])).width + 4)]);
  let lanes = assignRows(spans), count = Math.max(...lanes, -1) + 1;
  const areNamed = count <= MAX_NAMED;
  if (!areNamed) { lanes = assignRows(run.faults.map(fault => [fault.begin, fault.end])); count = Math.max(...lanes) + 1; }
  const laneHeight = areNamed ? NAMED : Math.min(4, 24 / count);
  return { bars, texts, lanes, areNamed, laneHeight, height: count ? laneHeight * count + 3 : 0 };
}
function drawBackdrop() {
  const { width: w, height: h, ratio } = axis;
  backdrop.width = w * ratio; backdrop.height = h * ratio;
  const c = backdrop.getContext("2d");
  c.scale(ratio, ratio);
  const faults = faultLanes(c), gutter = axisLeft() - 6;
  document.documentElement.style.setProperty("--lanes", `${faults.height + LANE * M}px`);
  const bottom = h - 16, tickHeight = 22, lossHeight = messages?.losses.length ? 9 : 0;
  const available = bottom - 3 - tickHeight - lossHeight - faults.height - LANE * M, activeHeight = messages ? available * .55 : available, flightHeight = messages ? available - activeHeight - 5 : 0;
  const names = [];  // text, y of its baseline
  c.font = `11px ${FONT}`; c.textBaseline = "alphabetic";
  c.strokeStyle = colour.line; c.fillStyle = colour.soft; c.textAlign = "center"; c.lineWidth = 1;
  const step = niceStep(END * TICK / Math.max(axisWidth() / 80, 1)) || 1;
  for (let s = 0; s <= END * TICK * 1.0001; s += step) {
    const x = Math.round(xOf(s / TICK)) + .5;
    c.beginPath(); c.moveTo(x, 0); c.lineTo(x, bottom); c.stroke();
    const text = s ? `${+s.toPrecision(6)}` : "0 s";
    c.fillText(text, Math.min(x, w - c.measureText(text).width / 2), h - 3);
  }
  // Active pursuers. The scale reaches at least two, so that one does not look like all. With several evaders, their lanes show who is alone.
  const ghostSteps = $("other")?.checked ? [...ghost.t].map((t, k) => [t, ghost.count[k]]).filter(([t]) => t <= END) : [];
  const maxCount = [...changes.count, ...ghostSteps.map(entry => entry[1])].reduce((most, entry) => Math.max(most, entry), Math.max(changes.first, Math.min(N, 2)));
  const level = n => 3 + activeHeight - (activeHeight - 6) * n / maxCount;
  const steps = [[0, changes.first], ...changes.t.map((t, k) => [t, changes.count[k]]), [END, 0]];
  for (let k = 0; k + 1 < steps.length; k++) {
    const [[from, count], [to]] = [steps[k], steps[k + 1]];
    c.fillStyle = M > 1 ? colour.inactive : count === 1 ? colour.active : colour.activeWithOthers; c.globalAlpha = count === 1 ? .8 : .6;
    c.fillRect(xOf(from), level(count), xOf(to) - xOf(from), level(0) - level(count));
  }
  c.globalAlpha = 1;
  if (ghostSteps.length) drawGhostSteps(c, ghostSteps, level);
  drawScale(c, gutter, level, level(1) - level(maxCount) > 9 ? [1, maxCount] : [maxCount]);
  names.push(["active", 3 + activeHeight / 2 + 3]);
  if (messages) {
    const floor = 3 + activeHeight + 5 + flightHeight, counts = [];
    for (let x = 0; x <= axisWidth(); x++) counts.push(inFlight(x / axisWidth() * END));
    const maxInFlight = counts.reduce((a, b) => Math.max(a, b), 1), height = n => floor - (flightHeight - 3) * n / maxInFlight;
    c.fillStyle = colour.inFlight; c.globalAlpha = .7; c.beginPath(); c.moveTo(axisLeft(), floor);
    counts.forEach((n, x) => c.lineTo(axisLeft() + x, height(n)));
    c.lineTo(axisLeft() + axisWidth(), floor); c.closePath(); c.fill();
    c.globalAlpha = 1;
    if (messages.ends.length) drawScale(c, gutter, height, [maxInFlight]);
    c.fillStyle = colour.lost;
    for (let x = 0, lostBefore = 0; x <= axisWidth(); x++) {
      const lostSoFar = lostBy(x / axisWidth() * END);
      if (lostSoFar > lostBefore) { c.globalAlpha = Math.min(.35 + (lostSoFar - lostBefore) / 10, 1); c.fillRect(axisLeft() + x, floor + 3, 1, 5); }
      lostBefore = lostSoFar;
    }
    c.globalAlpha = 1;
    names.push(["in flight", floor - flightHeight / 2 + 3]);
    if (lossHeight) names.push(["lost", floor + 9]);
  }
  const middle = bottom - faults.height - LANE * M - tickHeight / 2;
  c.strokeStyle = colour.inactive; c.globalAlpha = decisions.t.length > 3000 ? .12 : .4; c.beginPath();
  for (const t of decisions.t) { const x = xOf(t); c.moveTo(x, middle - 3); c.lineTo(x, middle + 3); }
  c.stroke(); c.globalAlpha = 1;
  for (const [hue, active, up, down] of [[colour.active, 1, 9, 0], [colour.soft, 0, 0, 9]]) {
    c.strokeStyle = hue; c.lineWidth = 1.5; c.beginPath();
    changes.t.forEach((t, k) => { if (!!changes.active[k] === !!active) { c.moveTo(xOf(t), middle - up); c.lineTo(xOf(t), middle + down); } });
    c.stroke();
  }
  names.push(["decisions", middle + 3]);
  if (M > 1) drawChaserCounts(c, bottom - faults.height - LANE * M);
  c.fillStyle = colour.ink;
  const laneMiddle = evader => bottom - faults.height - LANE * (M - evader + .5);
  if (LANE > 9) for (const evader of evaders) names.push([`evader ${evader}`, laneMiddle(evader) + 4]);
  else if (LANE) names.push(["evaders", laneMiddle(M / 2 + .5) + 4]);
  relays.t.forEach((t, k) => {
    const [x, y, r] = M > 1 ? [xOf(t), laneMiddle(relays.evader[k]), Math.min(4, LANE / 3)] : [xOf(t), middle, 4];
    c.beginPath(); c.moveTo(x, y - 1.25 * r); c.lineTo(x + r, y); c.lineTo(x, y + 1.25 * r); c.lineTo(x - r, y); c.fill();
  });
  const top = bottom - faults.height;
  run.faults.forEach((fault, k) => {
    const [from, to] = faults.bars[k], y = top + 1 + faults.lanes[k] * faults.laneHeight;
    c.fillStyle = colour.soft; c.globalAlpha = faults.areNamed ? .25 : isCrash(fault) ? .9 : .55;
    c.fillRect(from, y, to - from, Math.max(faults.laneHeight - 1, 1));
    c.globalAlpha = 1;
    if (!faults.areNamed) return;
    c.fillRect(from, y, 2, faults.laneHeight - 1);
    c.fillStyle = colour.ink; c.font = `10px ${FONT}`; c.textAlign = "left";
    c.fillText(faultLabel(fault), faults.texts[k], y + faults.laneHeight - 4);
  });
  if (run.faults.length) names.push(["faults", top + (faults.areNamed ? NAMED : faults.height) / 2 + 4]);
  if (M > 1) for (const { t, evader } of run.captures) { c.fillStyle = colour.ink; star(c, xOf(t), laneMiddle(evader), 6); c.fill(); }
  else if (run.captures.length) {  // the evader's diamond at the end
    c.fillStyle = colour.evader; c.beginPath();
    c.moveTo(xOf(END), middle - 6); c.lineTo(xOf(END) + 6, middle); c.lineTo(xOf(END), middle + 6); c.lineTo(xOf(END) - 6, middle); c.fill();
  }
  c.textAlign = "left"; c.fillStyle = colour.soft; c.font = `11px ${FONT}`;
  for (const [name, y] of names) c.fillText(name, 0, y);
}
/** The number of active pursuers of the other run, dashed, up to its end. */
function drawGhostSteps(c, steps, level) {
  const shownEnd = Math.min(ghost.end, END);
  c.save();
  c.strokeStyle = colour.ink; c.lineWidth = 1.3; c.setLineDash([4, 3]);
  c.beginPath(); c.moveTo(xOf(0), level(steps[0][1]));
  steps.forEach(([t, count], k) => { c.lineTo(xOf(t), level(steps[Math.max(k - 1, 0)][1])); c.lineTo(xOf(t), level(count)); });
  c.lineTo(xOf(shownEnd), level(steps.at(-1)[1]));
  if (ghost.end <= END) c.lineTo(xOf(shownEnd), level(0));
  c.stroke();
  c.restore();
}
/** The scale of a strip: a dotted line at each of some values, and the value at its left, within the strip. */
function drawScale(c, gutter, level, marks) {
  c.font = `10px ${FONT}`; c.textAlign = "right"; c.fillStyle = c.strokeStyle = colour.soft; c.lineWidth = 1;
  c.globalAlpha = .6; c.setLineDash([2, 3]); c.beginPath();
  for (const n of marks) { const y = Math.round(level(n)) + .5; c.moveTo(axisLeft(), y); c.lineTo(axisLeft() + axisWidth(), y); }
  c.stroke(); c.setLineDash([]); c.globalAlpha = 1;
  for (const n of marks) c.fillText(n.toLocaleString("en", n < 1e4 ? {} : { notation: "compact", maximumFractionDigits: 1 }), gutter, level(n) + (n === Math.max(...marks) ? 8 : 1));
}
/** A lane for each evader: the number of pursuers on it, capped at 3, until its capture. */
function drawChaserCounts(c, top) {
  const height = count => (LANE - 3) * Math.min(count, 3) / 3;
  chaserCounts.forEach((counts, k) => {
    const floor = top + LANE * (k + 1) - 1, captureTime = run.captures.find(capture => capture.evader === k + 1)?.t ?? END;
    const steps = [[0, counts.first], ...counts.t.map((t, n) => [t, counts.count[n]]).filter(entry => entry[0] < captureTime), [captureTime, 0]];
    c.globalAlpha = .8;
    for (let n = 0; n + 1 < steps.length; n++) {
      const [[from, count], [to]] = [steps[n], steps[n + 1]];
      c.fillStyle = count === 1 ? colour.active : colour.activeWithOthers;
      c.fillRect(xOf(from), floor - height(count), xOf(to) - xOf(from), height(count));
    }
    c.globalAlpha = 1; c.strokeStyle = colour.inactive; c.lineWidth = 1; c.beginPath(); c.moveTo(xOf(0), floor + .5); c.lineTo(xOf(captureTime), floor + .5); c.stroke();
  });
}
function drawAxis() {
  const { context: c, width: w, height: h, ratio } = axis;
  if (!w) return;
  if (axisStale) { drawBackdrop(); axisStale = false; }
  c.setTransform(1, 0, 0, 1, 0, 0);
  c.clearRect(0, 0, w * ratio, h * ratio);
  c.drawImage(backdrop, 0, 0);
  c.scale(ratio, ratio);
  const x = xOf(time);
  c.fillStyle = colour.ink; c.fillRect(x - .75, 6, 1.5, h - 22);
  c.beginPath(); c.arc(x, 6, 6, 0, 7); c.fill();
}
