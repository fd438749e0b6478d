// The belief matrix: what each pursuer (row) believes of each other (column).

const GUTTER = 18, side = () => Math.min(board.width, board.height);
let matrixState = "";
function drawMatrix() {
  if (!belief || !board.width) return;
  const { context: c, ratio } = board, w = side(), state = `${version} ${focus()} ${w} ${board.height} ${ratio} ${look}`;
  if (state === matrixState) return;
  matrixState = state;
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  c.clearRect(0, 0, board.width, board.height);
  const cell = (w - GUTTER) / N, gap = cell > 7 ? 1 : 0, from = focus(), gutter = GUTTER;
  const [across, downwards] = [N > 100 ? 24 : N > 10 ? 17 : 10, 11].map(room => [1, 2, 5, 10, 20, 50].find(n => n * cell >= room) || 100);
  c.font = `${Math.max(Math.min(cell - 3, 11), 10)}px ${FONT}`; c.textAlign = "center"; c.textBaseline = "middle";
  const square = (i, j, inset) => c.rect(gutter + j * cell + inset, gutter + i * cell + inset, cell - 2 * inset - gap, cell - 2 * inset - gap);
  for (let i = 0; i < N; i++) {  // the true actions, in the margins
    c.fillStyle = lies[i] ? colour.wrongBelief : truth[i] ? colour.active : colour.soft;
    if (i % across === 0) c.fillText(i, gutter + (i + .5) * cell, gutter / 2 - 1);
    if (i % downwards === 0) c.fillText(i, gutter / 2 - 1, gutter + (i + .5) * cell);
    if (truth[i]) {
      c.fillStyle = colour.active;
      c.fillRect(gutter + i * cell, gutter - 3, cell - gap, 2); c.fillRect(gutter - 3, gutter + i * cell, 2, cell - gap);
    }
  }
  if (cell * ratio < SMALL) return drawPixels(c, w, from);
  if (from >= 0) { c.fillStyle = colour.faint; c.fillRect(gutter, gutter + from * cell, N * cell, cell); }
  const kinds = { chases: [], inactive: [], phantom: [], missed: [], unheard: [] };  // i, j of the cells: right beliefs, wrong ones, none
  for (let i = 0; i < N; i++) for (let j = 0; j < N; j++) if (i !== j) {
    const believedAction = believed(i, j);
    if (believedAction === truth[j]) kinds[believedAction ? "chases" : received[i * N + j] === UNHEARD ? "unheard" : "inactive"].push(i, j);
    else {
      if (believedAction) kinds.phantom.push(i, j);
      if (truth[j]) kinds.missed.push(i, j);
    }
  }
  const forCells = (kind, visit) => { for (let k = 0; k < kinds[kind].length; k += 2) visit(kinds[kind][k], kinds[kind][k + 1]); };
  c.fillStyle = colour.active; c.beginPath(); forCells("chases", (i, j) => square(i, j, 0)); c.fill();
  c.fillStyle = colour.inactive; c.globalAlpha = .55; c.beginPath(); forCells("inactive", (i, j) => square(i, j, cell * .38)); c.fill(); c.globalAlpha = 1;
  c.fillStyle = colour.wrongBelief; c.beginPath();
  forCells("phantom", (i, j) => { const x = gutter + j * cell, y = gutter + i * cell, s = cell - gap; c.moveTo(x, y); c.lineTo(x + s, y); c.lineTo(x + s, y + s); c.closePath(); });
  c.fill();
  const stroke = Math.min(Math.max(cell / 6, 1), 2.5);
  c.strokeStyle = colour.wrongBelief; c.lineWidth = stroke; c.beginPath(); forCells("missed", (i, j) => square(i, j, stroke / 2 + .5)); c.stroke();
  if (M > 1 && cell > 12) writeActions(c, forCells, cell, gap, gutter);
  c.strokeStyle = colour.inactive; c.lineWidth = 1; c.globalAlpha = .6; c.beginPath();
  forCells("unheard", (i, j) => { const x = gutter + j * cell, y = gutter + i * cell; c.moveTo(x + cell * .25, y + cell * .75); c.lineTo(x + cell * .75, y + cell * .25); });
  c.stroke(); c.globalAlpha = 1;
  if (suspicion) {  // a cross: the row distrusts the column
    c.strokeStyle = colour.ink; c.lineWidth = 1.2; c.beginPath();
    for (let i = 0; i < N; i++) for (let j = 0; j < N; j++) if (distrusts[i * N + j]) {
      const x = gutter + j * cell, y = gutter + i * cell, s = cell - gap;
      c.moveTo(x + s * .2, y + s * .2); c.lineTo(x + s * .8, y + s * .8); c.moveTo(x + s * .2, y + s * .8); c.lineTo(x + s * .8, y + s * .2);
    }
    c.stroke();
  }
  c.fillStyle = colour.line; c.beginPath();
  for (let i = 0; i < N; i++) square(i, i, 0);
  c.fill();
}

const SMALL = 3.5;  // cells with a smaller side, in pixels of the screen, are drawn by `drawPixels`
const cells = document.createElement("canvas");
let cellImage = null, cellPixels = null;
/** Draw the matrix of a large team as a scaled picture with a pixel for each cell: 100,000 cells are too many shapes. */
function drawPixels(c, w, from) {
  if (!cellImage) {
    cells.width = cells.height = N;
    cellImage = new ImageData(N, N);
    cellPixels = new Uint32Array(cellImage.data.buffer);
  }
  const right = pixelOf(colour.active), inactive = pixelOf(colour.inactive, 60), phantom = pixelOf(colour.wrongBelief), missed = pixelOf(colour.wrongBelief, 170);
  const nothing = pixelOf(colour.inactive, 25), diagonal = pixelOf(colour.line), suspect = pixelOf(colour.ink, 110);
  for (let i = 0, k = 0; i < N; i++) for (let j = 0; j < N; j++, k++) {
    const receivedAction = received[k], believedAction = receivedAction === UNHEARD ? 0 : receivedAction, action = truth[j];
    cellPixels[k] = i === j ? diagonal : suspicion && distrusts[k] ? suspect : believedAction === action ? believedAction ? right : receivedAction === UNHEARD ? nothing : inactive : believedAction ? phantom : missed;
  }
  cells.getContext("2d").putImageData(cellImage, 0, 0);
  const size = w - GUTTER;
  c.imageSmoothingEnabled = board.ratio * size < N;  // fewer pixels than cells: the mean of several, else sharp edges
  c.drawImage(cells, GUTTER, GUTTER, size, size);
  if (from < 0) return;
  c.strokeStyle = colour.ink; c.lineWidth = 1;
  c.strokeRect(GUTTER - .5, GUTTER + from * size / N - 1, size, size / N + 2);
}

/** Write the believed evader into each cell. If the belief is wrong, the true evader, if any, is below it. */
function writeActions(c, forCells, cell, gap, gutter) {
  const write = (hue, action, i, j, x, y) => { c.fillStyle = hue; c.fillText(action, gutter + j * cell + x * (cell - gap), gutter + i * cell + y * (cell - gap) + .5); };
  c.save();
  c.font = `650 ${Math.min(cell * .42, 12)}px ${FONT}`;
  forCells("chases", (i, j) => write(colour.card, truth[j], i, j, .5, .5));
  forCells("phantom", (i, j) => write(colour.card, believed(i, j), i, j, .7, .32));
  forCells("missed", (i, j) => write(colour.wrongBelief, truth[j], i, j, ...believed(i, j) ? [.3, .7] : [.5, .5]));
  c.restore();
}
