// ---- data: numbers come as base64 float32, whole or as pairs of index and value ----

const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;

function decode(packed) {
  const values = new Float32Array(bytes(packed.f32));
  if (packed.index === undefined) return values;
  const full = new Float32Array(packed.shape.reduce((a, b) => a * b, 1));
  new Uint32Array(bytes(packed.index)).forEach((place, k) => { full[place] = values[k]; });
  return full;
}

function decodeAll(node) {
  if (node === null || typeof node !== "object" || Array.isArray(node)) return node;
  if (typeof node.f32 === "string") return decode(node);
  return Object.fromEntries(Object.entries(node).map(([key, value]) => [key, decodeAll(value)]));
}

// A moment of a run: the frames before and after a time, and the share of the later one.
function momentOf(run, time) {
  const times = run.time;
  let low = 0, high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle; else high = middle;
  }
  const span = times[high] - times[low];
  const share = span > 0 ? Math.min(1, Math.max(0, (time - times[low]) / span)) : 0;
  return { before: low, after: high, share };
}

// The value at a moment. At a frame it is that frame's own, whatever (a hole, say) its neighbour holds.
const between = (values, moment, stride = 1, k = 0) => {
  const a = values[moment.before * stride + k], b = values[moment.after * stride + k];
  return moment.share === 0 ? a : moment.share === 1 ? b : a + (b - a) * moment.share;
};

const frameNear = (moment) => (moment.share < 0.5 ? moment.before : moment.after);

function guidePose(guide, moment) {
  const turn = between(guide.rotation, moment);
  const shift = [between(guide.displacement, moment, 2, 0), between(guide.displacement, moment, 2, 1)];
  if (turn === 0 && shift[0] === 0 && shift[1] === 0) return (x, y) => [x, y];
  const c = Math.cos(turn), s = Math.sin(turn), [px, py] = guide.pivot;
  return (x, y) => [px + shift[0] + c * (x - px) - s * (y - py), py + shift[1] + s * (x - px) + c * (y - py)];
}

const rollerCenter = (roller, moment) => [between(roller.center, moment, 2, 0), between(roller.center, moment, 2, 1)];

// Nodes as x, y, x, y, ... lead first.
function sheetNodes(sheet, moment) {
  const count = 2 * (sheet.bars + 1), nodes = new Float64Array(count);
  for (let k = 0; k < count; k++) nodes[k] = between(sheet.nodes, moment, count, k);
  return nodes;
}

// Curvature of each bar, 1/mm, positive to the left along the travel: the mean of its two joints.
function barCurvature(sheet, nodes) {
  const bars = sheet.bars, joints = new Float64Array(Math.max(1, bars - 1));
  const heading = (b) => Math.atan2(nodes[2 * b + 1] - nodes[2 * b + 3], nodes[2 * b] - nodes[2 * b + 2]);
  for (let j = 0, front = heading(0); j < bars - 1; j++) {
    const back = heading(j + 1), turn = front - back;
    joints[j] = Math.atan2(Math.sin(turn), Math.cos(turn)) / sheet.barLength;
    front = back;
  }
  const at = (j) => joints[Math.min(Math.max(j, 0), joints.length - 1)];
  return Float64Array.from({ length: bars }, (_, b) => 0.5 * (at(b - 1) + at(b)));
}
