// ---- paint: one picture of all runs at a time ----

class Painter {
  constructor(view, runs) {
    Object.assign(this, { view, runs, context: view.canvas.getContext("2d"), names: [], namesFor: "" });
    this.readColors();
  }

  readColors() {
    const style = getComputedStyle(document.documentElement);
    const keys = ["page", "ink", "quiet", "rule", "metal", "fill", "face", "plain", "low", "high", "force", "after", "accent"];
    this.color = Object.fromEntries(keys.map((key) => [key, style.getPropertyValue(`--${key}`).trim()]));
    this.scales = {
      curvature: shades(this.color.low, this.color.plain, this.color.high),
      load: shades(this.color.plain, mixed(this.color.plain, this.color.high, 0.5), this.color.high),
    };
  }

  paint(time, shown) {
    const { context, view } = this, moments = this.runs.map((run) => momentOf(run, time));
    context.setTransform(view.ratio, 0, 0, view.ratio, 0, 0);
    context.clearRect(0, 0, view.width, view.height);
    this.enterWorld();
    this.machine(this.runs[0], moments[0]);
    if (this.runs.length > 1) this.changes(moments);
    if (this.runs.length > 1) this.otherSheets(this.runs[1], moments[1]);
    this.sheets(this.runs[0], moments[0], shown.color);
    this.clamps(this.runs[0], moments[0]);
    if (shown.arrows) this.arrows(this.runs[0], moments[0]);
    context.setTransform(view.ratio, 0, 0, view.ratio, 0, 0);
    if (shown.names) this.writeNames(moments[0]);
    this.scaleBar(shown.arrows);
    if (shown.color !== "plain") this.colorBar(shown.color);
  }

  enterWorld() {
    const { view } = this, k = view.ratio * view.scale;
    this.context.setTransform(
      k, 0, 0, -k, view.ratio * (view.width / 2 - view.x * view.scale), view.ratio * (view.height / 2 + view.y * view.scale));
    this.context.lineJoin = "round";
    this.context.lineCap = "round";
  }

  stroke(color, px, dash = []) {
    const { context, view } = this;
    context.strokeStyle = color;
    context.lineWidth = px / view.scale;
    context.setLineDash(dash.map((length) => length / view.scale));
    context.stroke();
  }

  polyline(points, pose = (x, y) => [x, y]) {
    this.context.beginPath();
    points.forEach((point, k) => (k ? this.context.lineTo(...pose(...point)) : this.context.moveTo(...pose(...point))));
  }

  disc(x, y, radius) {
    this.context.beginPath();
    this.context.arc(x, y, radius, 0, 2 * Math.PI);
  }

  machine(run, moment) {
    for (const guide of Object.values(run.guides)) this.guide(guide, guidePose(guide, moment));
    for (const roller of Object.values(run.rollers)) this.roller(roller, moment);
    for (const gate of Object.values(run.sensors)) {
      this.polyline(gate);
      this.stroke(this.color.quiet, 1.5, [6, 4]);
    }
  }

  guide(guide, pose) {
    this.context.beginPath();
    for (const [x0, y0, x1, y1] of guide.ticks) {
      this.context.moveTo(...pose(x0, y0));
      this.context.lineTo(...pose(x1, y1));
    }
    this.stroke(this.color.metal, 0.8);
    this.context.fillStyle = this.color.metal;
    for (const [x, y, radius] of guide.tips) {
      this.disc(...pose(x, y), radius);
      this.context.fill();
    }
    this.polyline(guide.face, pose);
    this.stroke(this.color.face, 1.6);
  }

  roller(roller, moment) {
    const [x, y] = rollerCenter(roller, moment), angle = between(roller.angle, moment), radius = roller.radius;
    if (roller.direction) this.spring(roller, x, y);
    this.disc(x, y, radius);
    this.context.fillStyle = this.color.fill;
    this.context.fill();
    this.stroke(this.color.ink, 1.4);
    this.polyline([[x - radius * Math.cos(angle), y - radius * Math.sin(angle)], [x, y]]);
    this.stroke(this.color.metal, 1.2);
    this.polyline([[x, y], [x + radius * Math.cos(angle), y + radius * Math.sin(angle)]]);
    this.stroke(this.color.ink, 2);
    this.disc(x, y, 0.1 * radius);
    this.context.fillStyle = this.color.ink;
    this.context.fill();
    if (roller.turning) this.turning(x, y, radius, roller.turning);
  }

  turning(x, y, radius, sign) {
    const at = (degrees) => [x + 0.66 * radius * Math.cos((degrees * Math.PI) / 180), y + 0.66 * radius * Math.sin((degrees * Math.PI) / 180)];
    this.polyline(Array.from({ length: 25 }, (_, k) => at(90 + sign * (-65 + 5 * k))));
    this.stroke(this.color.high, 1.5);
    this.head(at(90 + sign * 55), at(90 + sign * 75), 0.2 * radius, this.color.high);
  }

  head(from, to, width, color) {
    const { context } = this, dx = to[0] - from[0], dy = to[1] - from[1], length = Math.hypot(dx, dy) || 1;
    const sx = (-dy / length) * width, sy = (dx / length) * width;
    context.beginPath();
    context.moveTo(...to);
    context.lineTo(from[0] + sx, from[1] + sy);
    context.lineTo(from[0] - sx, from[1] - sy);
    context.closePath();
    context.fillStyle = color;
    context.fill();
  }

  spring(roller, x, y) {
    const [ux, uy] = roller.direction, radius = roller.radius, swing = 0.22 * radius;
    const seat = [roller.home[0] + 2.1 * radius * ux, roller.home[1] + 2.1 * radius * uy];
    const at = (share, side) => [x + radius * ux + share * (seat[0] - x - radius * ux) - side * uy, y + radius * uy + share * (seat[1] - y - radius * uy) + side * ux];
    this.polyline(Array.from({ length: 12 }, (_, k) => at(k / 11, k < 2 || k > 9 ? 0 : k % 2 ? -swing : swing)));
    this.stroke(this.color.metal, 1.2);
    this.polyline([at(1, -0.6 * radius), at(1, 0.6 * radius)]);
    this.stroke(this.color.metal, 2.5);
    const tail = at(1, 0.5 * radius), tip = [tail[0] - 0.9 * radius * ux, tail[1] - 0.9 * radius * uy];
    this.polyline([tail, tip]);
    this.stroke(this.color.metal, 1.2);
    this.head([tip[0] + 0.3 * radius * ux, tip[1] + 0.3 * radius * uy], tip, 0.14 * radius, this.color.metal);
  }

  sheets(run, moment, color) {
    const { context, view } = this, shade = this.scales[color];
    for (const sheet of Object.values(run.sheets)) {
      const nodes = sheetNodes(sheet, moment), values = this.barValues(run, sheet, nodes, moment, color);
      context.lineWidth = Math.max(sheet.thickness, 3.4 / view.scale);
      context.setLineDash([]);
      for (let b = 0; b < sheet.bars; b++) {
        context.strokeStyle = shade ? shade[values[b]] : this.color.plain;
        context.beginPath();
        context.moveTo(nodes[2 * b], nodes[2 * b + 1]);
        context.lineTo(nodes[2 * b + 2], nodes[2 * b + 3]);
        context.stroke();
      }
      this.disc(nodes[0], nodes[1], Math.max(0.5 * sheet.thickness, 2.6 / view.scale));
      context.fillStyle = this.color.ink;
      context.fill();
    }
  }

  // Number of the shade of each bar, 0 to 64.
  barValues(run, sheet, nodes, moment, color) {
    const shade = (share) => Math.round(64 * Math.min(1, Math.max(0, share || 0)));
    if (color === "curvature") return Array.from(barCurvature(sheet, nodes), (value) => shade(0.5 + (0.5 * value) / run.limits.curvature));
    const load = (b) => between(sheet.force, moment, sheet.bars, b) / sheet.width;
    return Array.from({ length: sheet.bars }, (_, b) => (color === "load" ? shade(load(b) / run.limits.load) : 0));
  }

  // Wide, under those of the first run, so that both show where they coincide.
  otherSheets(run, moment) {
    for (const sheet of Object.values(run.sheets)) {
      const nodes = sheetNodes(sheet, moment);
      this.polyline(Array.from({ length: sheet.bars + 1 }, (_, k) => [nodes[2 * k], nodes[2 * k + 1]]));
      this.stroke(this.color.after, 6);
      this.disc(nodes[0], nodes[1], 4.4 / this.view.scale);
      this.context.fillStyle = this.color.after;
      this.context.fill();
    }
  }

  // Parts of the second run that do not stand where those of the first do.
  changes([first, second]) {
    const [a, b] = this.runs, near = 0.4 / this.view.scale;
    for (const [name, roller] of Object.entries(b.rollers)) {
      const [x, y] = rollerCenter(roller, second), old = a.rollers[name], before = old && rollerCenter(old, first);
      if (old && Math.abs(old.radius - roller.radius) < near && Math.hypot(x - before[0], y - before[1]) < near) continue;
      this.disc(x, y, roller.radius);
      this.stroke(this.color.after, 1.5, [5, 3]);
    }
    for (const [name, guide] of Object.entries(b.guides)) {
      if (a.guides[name] && sameFace(a.guides[name], guide, first, second, near)) continue;
      this.polyline(guide.face, guidePose(guide, second));
      this.stroke(this.color.after, 1.5, [5, 3]);
    }
  }

  clamps(run, moment) {
    for (const clamp of Object.values(run.clamps)) {
      const nodes = sheetNodes(run.sheets[clamp.sheet], moment), x = nodes[2 * clamp.node], y = nodes[2 * clamp.node + 1];
      const r = 6 / this.view.scale;
      const corners = { pin: [[0, 0], [-r, -1.6 * r], [r, -1.6 * r]], wall: [[-r, -r], [r, -r], [r, r], [-r, r]], bar: [[0, -r], [r, 0], [0, r], [-r, 0]] };
      this.polyline([...corners[clamp.kind], corners[clamp.kind][0]], (dx, dy) => [x + dx, y + dy]);
      this.context.fillStyle = this.color.page;
      this.context.fill();
      this.stroke(this.color.ink, 2);
    }
  }

  arrows(run, moment) {
    const reach = this.arrowReach() / this.view.scale / run.limits.push, short = 2 / this.view.scale, longest = (2.5 * this.arrowReach()) / this.view.scale;
    for (const sheet of Object.values(run.sheets)) {
      const nodes = sheetNodes(sheet, moment);
      for (let b = 0; b < sheet.bars; b++) {
        const px = between(sheet.push, moment, 2 * sheet.bars, 2 * b), py = between(sheet.push, moment, 2 * sheet.bars, 2 * b + 1);
        const force = Math.hypot(px, py), length = Math.min(force * reach, longest), fx = (px / force) * length, fy = (py / force) * length;
        if (!(length > short)) continue;
        const x = 0.5 * (nodes[2 * b] + nodes[2 * b + 2]), y = 0.5 * (nodes[2 * b + 1] + nodes[2 * b + 3]);
        this.arrow(x, y, fx, fy, length);
      }
    }
  }

  arrow(x, y, fx, fy, length) {
    const tip = Math.min(8 / this.view.scale, 0.5 * length) / length;
    this.polyline([[x, y], [x + fx * (1 - tip), y + fy * (1 - tip)]]);
    this.stroke(this.color.force, 1.5);
    this.head([x + fx * (1 - tip), y + fy * (1 - tip)], [x + fx, y + fy], 3.2 / this.view.scale, this.color.force);
  }

  arrowReach() { return Math.min(60, 0.12 * this.view.height); }

  // ---- names ----

  writeNames(moment) {
    const { context, view } = this, run = this.runs[0], key = this.nameKey();
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    const anchors = this.nameAnchors(run, moment);
    if (this.namesFor !== key) {
      this.names = placeLabels(this.wantedNames(anchors), this.coveredPlaces(run, moment));
      this.namesFor = key;
    }
    for (const name of this.names) this.writeName(name, anchors[name.key].points[name.anchor]);
  }

  // Places stay while the picture moves a little, so that names do not jump.
  nameKey() {
    const { view } = this, step = (world) => Math.round((world * view.scale) / 60);
    return [view.scale, view.width, view.height, step(view.x), step(view.y)].join();
  }

  writeName(name, [x, y]) {
    const { context } = this, px = x + name.dx, py = y + name.dy;
    const ex = Math.min(Math.max(x, px - name.halfWidth), px + name.halfWidth), ey = Math.min(Math.max(y, py - name.halfHeight), py + name.halfHeight);
    if (Math.hypot(x - ex, y - ey) > 8) {
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(ex, ey);
      context.setLineDash([]);
      context.lineWidth = 0.7;
      context.strokeStyle = this.color.quiet;
      context.stroke();
    }
    this.text(name.text, px, py, this.color.ink);
  }

  text(words, x, y, color) {
    const { context } = this;
    context.setLineDash([]);
    context.lineWidth = 3;
    context.lineJoin = "round";
    context.strokeStyle = this.color.page;
    context.strokeText(words, x, y);
    context.fillStyle = color;
    context.fillText(words, x, y);
  }

  wantedNames(anchors) {
    return Object.entries(anchors).map(([key, { text, points, side }]) => ({ key, text, anchors: points, side, width: this.context.measureText(text).width }));
  }

  // By section and name, points on the page beside which each name may stand, and the side on which it should.
  nameAnchors(run, moment) {
    const { view } = this, found = {};
    for (const [name, roller] of Object.entries(run.rollers)) {
      const [x, y] = rollerCenter(roller, moment);
      const rim = (k) => view.toPage(x + roller.radius * Math.cos((k * Math.PI) / 8), y + roller.radius * Math.sin((k * Math.PI) / 8));
      found[`rollers.${name}`] = { text: name, points: Array.from({ length: 16 }, (_, k) => rim(k)), side: [0, 0] };
    }
    for (const [name, guide] of Object.entries(run.guides)) {
      const pose = guidePose(guide, moment), last = guide.face.length - 1;
      const at = (k) => view.toPage(...pose(...guide.face[Math.round((k * last) / 8)]));
      const back = guide.ticks.reduce((sum, [x0, y0, x1, y1]) => [sum[0] + x1 - x0, sum[1] - y1 + y0], [0, 0]);
      found[`guides.${name}`] = { text: name, points: Array.from({ length: 9 }, (_, k) => at(k)), side: back };
    }
    for (const [name, gate] of Object.entries(run.sensors)) found[`sensors.${name}`] = { text: name, points: gate.map((end) => view.toPage(...end)), side: [0, 0] };
    for (const [name, clamp] of Object.entries(run.clamps)) {
      const nodes = sheetNodes(run.sheets[clamp.sheet], moment);
      found[`clamps.${name}`] = { text: name, points: [view.toPage(nodes[2 * clamp.node], nodes[2 * clamp.node + 1])], side: [0, 0] };
    }
    return found;
  }

  coveredPlaces(run, moment) {
    const { view } = this, grid = new Grid(view.width, view.height);
    const line = (points) => points.forEach((end, k) => k && grid.markLine(...view.toPage(...points[k - 1]), ...view.toPage(...end)));
    for (const guide of Object.values(run.guides)) line(guide.face.map((point) => guidePose(guide, moment)(...point)));
    for (const gate of Object.values(run.sensors)) line(gate);
    for (const roller of Object.values(run.rollers)) {
      const [x, y] = rollerCenter(roller, moment), [ux, uy] = roller.direction || [0, 0], r = roller.radius;
      const ring = (k, share, out) => [x + out * r * ux + share * r * Math.cos(k / 4), y + out * r * uy + share * r * Math.sin(k / 4)];
      for (const share of [1, 0.75, 0.5, 0.25]) line(Array.from({ length: 27 }, (_, k) => ring(k, share, 0)));
      if (roller.direction) for (const share of [0.6, 0.3]) line(Array.from({ length: 27 }, (_, k) => ring(k, share, 1.6)));
    }
    for (const share of [0, 0.25, 0.5, 0.75, 1]) this.markSheets(run, share, line);
    grid.markBox([0, view.height - 44, view.width, view.height]);
    grid.markBox([view.width - 52, 0, view.width, 130]);
    return grid;
  }

  markSheets(run, share, line) {
    const moment = momentOf(run, share * run.time[run.time.length - 1]);
    for (const sheet of Object.values(run.sheets)) {
      const nodes = sheetNodes(sheet, moment);
      line(Array.from({ length: sheet.bars + 1 }, (_, k) => [nodes[2 * k], nodes[2 * k + 1]]).filter((point) => point.every(Number.isFinite)));
    }
  }

  // ---- keys to the picture, along its lower edge ----

  // A veil behind a key, so that it can be read over the machine.
  clear(x, width) {
    const { context, view } = this;
    context.globalAlpha = 0.8;
    context.fillStyle = this.color.page;
    context.fillRect(x, view.height - 52, width, 52);
    context.globalAlpha = 1;
  }

  scaleBar(arrows) {
    const { context, view } = this, length = niceBelow(90 / view.scale), px = length * view.scale, y = view.height - 14;
    context.font = "12px system-ui, sans-serif";
    this.clear(0, Math.max(px, 60) + (arrows ? 120 : 20));
    this.ruler(14, y, px, this.color.ink);
    this.caption(`${length} mm`, 14, y - 10);
    if (!arrows || !(this.runs[0].limits.push > 1e-9)) return;
    const force = niceBelow(this.runs[0].limits.push), reach = (this.arrowReach() * force) / this.runs[0].limits.push, x = 30 + Math.max(px, 60);
    this.ruler(x, y, reach, this.color.force);
    this.head([x + reach - 7, y], [x + reach, y], 3.2, this.color.force);
    this.caption(`${force} N on a bar`, x, y - 10);
  }

  ruler(x, y, length, color) {
    const { context } = this;
    context.setLineDash([]);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + length, y);
    context.lineWidth = 2;
    context.strokeStyle = color;
    context.stroke();
  }

  caption(words, x, y, align = "left") {
    this.context.textAlign = align;
    this.context.textBaseline = "middle";
    this.text(words, x, y, this.color.quiet);
  }

  colorBar(color) {
    const { context, view } = this, limit = this.runs[0].limits[color], width = Math.min(180, 0.36 * view.width);
    const x = view.width - 14 - width, y = view.height - 17;
    this.clear(x - 8, width + 22);
    this.scales[color].forEach((shade, k) => {
      context.fillStyle = shade;
      context.fillRect(x + (width * k) / 65, y, width / 65 + 0.6, 5);
    });
    const words = color === "curvature" ? [`\u2212${limit}`, "curvature (1/mm)", `${limit}`] : ["0", "force / width (N/mm)", `${limit}`];
    this.caption(words[1], x + width / 2, y - 24, "center");
    this.caption(words[0], x, y - 9);
    this.caption(words[2], x + width, y - 9, "right");
  }
}

function sameFace(a, b, first, second, near) {
  const [poseA, poseB] = [guidePose(a, first), guidePose(b, second)];
  const gap = (k) => {
    const [p, q] = [poseA(...a.face[k]), poseB(...b.face[k])];
    return Math.hypot(p[0] - q[0], p[1] - q[1]);
  };
  return a.face.length === b.face.length && a.face.every((_, k) => gap(k) < near);
}

function niceBelow(value) {
  const power = 10 ** Math.floor(Math.log10(value)), lead = value / power;
  return Number(((lead >= 5 ? 5 : lead >= 2 ? 2 : 1) * power).toPrecision(1));
}

function mixed(from, to, share) {
  const part = (text, k) => parseInt(text.slice(1 + 2 * k, 3 + 2 * k), 16);
  const channel = (k) => Math.round(part(from, k) + share * (part(to, k) - part(from, k)));
  return `#${[0, 1, 2].map((k) => channel(k).toString(16).padStart(2, "0")).join("")}`;
}

// 65 shades from one colour over a middle one to another.
function shades(low, middle, high) {
  return Array.from({ length: 65 }, (_, k) => (k < 32 ? mixed(low, middle, k / 32) : mixed(middle, high, (k - 32) / 32)));
}
