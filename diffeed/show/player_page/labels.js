// ---- labels: names stand where they cover neither each other nor the parts ----

const CELL = 4; // px of the grid on which covered places are counted
const WORST = 10; // a name that finds no better place is left out until there is room

class Grid {
  constructor(width, height) {
    Object.assign(this, { width, height });
    this.columns = Math.ceil(width / CELL) + 1;
    this.rows = Math.ceil(height / CELL) + 1;
    this.count = new Uint8Array(this.columns * this.rows);
  }

  holds(x, y) { return x >= 0 && y >= 0 && x <= this.width && y <= this.height; }

  mark(x, y) {
    const column = Math.floor(x / CELL), row = Math.floor(y / CELL);
    if (column >= 0 && row >= 0 && column < this.columns && row < this.rows) this.count[row * this.columns + column] = 1;
  }

  markLine(x0, y0, x1, y1) {
    const steps = Math.min(2000, Math.ceil(Math.hypot(x1 - x0, y1 - y0) / CELL) + 1);
    for (let k = 0; k <= steps; k++) this.mark(x0 + ((x1 - x0) * k) / steps, y0 + ((y1 - y0) * k) / steps);
  }

  markBox([left, top, right, bottom]) {
    for (let y = top; y <= bottom + CELL; y += CELL) this.markLine(left, y, right, y);
  }

  // Number of cells of a box that something covers; a box that is not whole on the page is out of the question.
  covered([left, top, right, bottom]) {
    if (!this.holds(left, top) || !this.holds(right, bottom)) return Infinity;
    let sum = 0;
    for (let row = Math.floor(top / CELL); row <= bottom / CELL; row++) {
      for (let column = Math.floor(left / CELL); column <= right / CELL; column++) sum += this.count[row * this.columns + column];
    }
    return sum;
  }
}

// wanted: [{key, text, width, anchors: [[x, y]], side: [x, y]}] in px. Returns {key, text, anchor (its index), dx, dy} or leaves a name out.
function placeLabels(wanted, grid) {
  const places = [];
  for (const label of [...wanted].sort((a, b) => b.width - a.width)) {
    const best = cheapest(label, grid);
    if (best === null) continue;
    grid.markBox(best.box);
    places.push(best);
  }
  return places;
}

function cheapest(label, grid) {
  const halfWidth = label.width / 2 + 2, halfHeight = 8;
  let best = null;
  label.anchors.forEach(([x, y], anchor) => {
    if (!grid.holds(x, y)) return;
    for (const ring of [3, 10, 20, 34]) {
      for (let k = 0; k < 16; k++) {
        const c = Math.cos((k * Math.PI) / 8), s = Math.sin((k * Math.PI) / 8);
        const sign = (value) => (Math.abs(value) < 1e-6 ? 0 : Math.sign(value));
        const dx = ring * c + sign(c) * halfWidth, dy = ring * s + sign(s) * halfHeight;
        const box = [x + dx - halfWidth, y + dy - halfHeight, x + dx + halfWidth, y + dy + halfHeight];
        const wrong = dx * label.side[0] + dy * label.side[1] < 0 ? 5 : 0;
        if (best !== null && 0.2 * ring + wrong >= best.cost) continue;
        const cost = 0.2 * ring + wrong + grid.covered(box);
        if (best === null || cost < best.cost) best = { key: label.key, text: label.text, anchor, dx, dy, halfWidth, halfHeight, box, cost };
      }
    }
  });
  return best !== null && best.cost < WORST ? best : null;
}
