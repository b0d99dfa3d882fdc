// ---- charts: curves over time with a line at the moment shown ----

const GAP_SHOWN = 5; // mm: what lies further off says nothing about a jam
const CHART_HEIGHT = 140;

class Charts {
  constructor(holder, runs, labels, seek) {
    Object.assign(this, { holder, runs, labels, seek, plots: [], hidden: new Set() });
    this.times = unionOf(runs.map((run) => run.time));
    this.build();
  }

  build() {
    this.plots.forEach((plot) => plot.destroy());
    this.holder.replaceChildren();
    this.plots = [
      this.chart("Slip of driven rollers", "Slip (mm/s)", this.curves("rollers", slipOf, (roller) => roller.driven), withoutPeaks),
      this.chart("Normal force on rollers", "Force (N)", this.curves("rollers", (roller) => roller.force), whole),
      this.chart(`Gap of guides to the sheet, within ${GAP_SHOWN} mm`, "Gap (mm)", this.curves("guides", (guide) => guide.gap), nearby),
    ].filter((plot) => plot !== null);
  }

  // One entry per part that passes and per run: {name, color, dash, values at this.times}.
  curves(section, read, passes = () => true) {
    const names = [...new Set(this.runs.flatMap((run) => Object.keys(run[section])))].sort();
    const curve = (name, i, part, r) => {
      const dotted = i > 6, values = resampled(this.runs[r].time, read(part), this.times);
      return { name, color: i % 7, dotted, dash: r ? [5, 4] : dotted ? [1, 3] : [], values };
    };
    return names.flatMap((name, i) => this.runs.flatMap((run, r) => {
      const part = run[section][name];
      return part !== undefined && passes(part) ? [curve(name, i, part, r)] : [];
    }));
  }

  chart(title, unit, curves, limits) {
    if (curves.length === 0) return null;
    const heading = document.createElement("h2"), box = document.createElement("div");
    const [low, high] = limits(curves), values = curves.flatMap((curve) => curve.values.filter((value) => value !== null));
    const beyond = limits === withoutPeaks && values.some((value) => value < low || value > high);
    const note = document.createElement("small");
    note.textContent = beyond ? `peaks from ${short(least(values))} to ${short(most(values))} lie off the scale` : "";
    heading.append(title, note);
    this.holder.append(heading, box);
    const plot = new uPlot(this.options(unit, curves, limits(curves)), [this.times, ...curves.map((curve) => curve.values)], box);
    this.addPlayhead(plot);
    this.addKeys(plot, title, curves);
    return plot;
  }

  options(unit, curves, [lowest, highest]) {
    const style = getComputedStyle(document.documentElement), color = (key) => style.getPropertyValue(`--${key}`).trim();
    const rule = { stroke: color("rule"), width: 1 }, font = "11px system-ui, sans-serif";
    const axis = { stroke: color("quiet"), grid: rule, ticks: { ...rule, size: 4 }, labelSize: 18, labelFont: font, font };
    const series = curves.map((curve) => ({ stroke: color(`c${curve.color}`), width: 1.5, dash: curve.dash, points: { show: false } }));
    return {
      width: this.width(), height: CHART_HEIGHT, padding: [8, 10, 0, 0], series: [{}, ...series],
      axes: [{ ...axis, label: "Time (s)", size: 24 }, { ...axis, label: unit, size: 42 }],
      scales: { x: { time: false }, y: { range: (_, low, high) => padded(Math.max(low, lowest), Math.min(high, highest), low, high) } },
      cursor: { show: false }, legend: { show: false },
    };
  }

  addPlayhead(plot) {
    plot.playhead = document.createElement("div");
    plot.playhead.className = "playhead";
    plot.over.append(plot.playhead);
    const go = (event) => this.seek(plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x"));
    plot.over.addEventListener("pointerdown", (event) => { plot.over.setPointerCapture(event.pointerId); go(event); });
    plot.over.addEventListener("pointermove", (event) => { if (event.buttons & 1) go(event); });
  }

  // Names under a chart with the values at the moment shown; a click hides or shows the curves of a name.
  addKeys(plot, title, curves) {
    const holder = document.createElement("div"), rows = new Map();
    holder.className = "keys";
    curves.forEach((curve, k) => {
      if (!rows.has(curve.name)) rows.set(curve.name, this.addKey(holder, plot, title, curve));
      rows.get(curve.name).series.push(k + 1);
    });
    plot.keys = [...rows.values()];
    plot.keys.forEach((row) => this.applyHidden(plot, row));
    plot.root.after(holder);
  }

  addKey(holder, plot, title, curve) {
    const button = document.createElement("button"), mark = document.createElement("i"), values = document.createElement("b");
    const row = { id: `${title}.${curve.name}`, button, values, series: [] };
    mark.style.borderColor = `var(--c${curve.color})`;
    if (curve.dotted) mark.style.borderTopStyle = "dotted";
    button.append(mark, curve.name, values);
    button.title = "Hide or show";
    button.addEventListener("click", () => {
      if (!this.hidden.delete(row.id)) this.hidden.add(row.id);
      this.applyHidden(plot, row);
    });
    holder.append(button);
    return row;
  }

  applyHidden(plot, row) {
    const show = !this.hidden.has(row.id);
    row.button.setAttribute("aria-pressed", String(show));
    row.series.forEach((k) => { if (plot.series[k].show !== show) plot.setSeries(k, { show }); });
  }

  width() { return Math.max(240, this.holder.clientWidth - 16); }

  resize() { this.plots.forEach((plot) => { if (plot.width !== this.width()) plot.setSize({ width: this.width(), height: CHART_HEIGHT }); }); }

  show(time) {
    const moment = nearest(this.times, time);
    for (const plot of this.plots) {
      plot.playhead.style.transform = `translateX(${plot.valToPos(time, "x")}px)`;
      for (const row of plot.keys) {
        const words = row.series.map((k) => brief(plot.data[k][moment])).join(" | ");
        if (row.values.textContent !== words) row.values.textContent = words;
      }
    }
  }
}

// Slip means something only while the roller touches a sheet.
const slipOf = (roller) => roller.slip.map((slip, k) => (roller.force[k] > 0 ? slip : NaN));

function brief(value) {
  if (value === null || value === undefined) return "\u2013";
  const size = Math.abs(value);
  if (size < 5e-4) return "0";
  return value.toFixed(size < 10 ? 3 : size < 100 ? 2 : 1).replace("-", "\u2212");
}

function padded(low, high, lowestValue, highestValue) {
  if (lowestValue === null || highestValue === null || !(low <= high)) return [0, 1];
  const room = 0.08 * (high - low) || Math.abs(high) || 1;
  return [low - room, high + room];
}

const short = (value) => String(Number(value.toPrecision(3))).replace("-", "\u2212");
const least = (values) => values.reduce((a, b) => Math.min(a, b), Infinity);
const most = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);

// Which part of the vertical axis a chart shows.
const whole = () => [-Infinity, Infinity];
const nearby = () => [-GAP_SHOWN, GAP_SHOWN];

// All but 2 % of the values, where a few peaks would flatten the rest.
function withoutPeaks(curves) {
  const values = curves.flatMap((curve) => curve.values.filter((value) => value !== null)).sort((a, b) => a - b);
  if (values.length === 0) return whole();
  const at = (share) => values[Math.round(share * (values.length - 1))], low = at(0.01), high = at(0.99), room = 0.5 * (high - low);
  return room > 0 && most(values) - least(values) > 4 * (high - low) ? [low - room, high + room] : whole();
}

function unionOf(lists) {
  return Array.from(new Set(lists.flatMap((list) => Array.from(list)))).sort((a, b) => a - b);
}

function nearest(times, time) {
  const { before, after, share } = momentOf({ time: times }, time);
  return share < 0.5 ? before : after;
}

// Values at other times: straight lines between frames, nothing outside the run or next to a hole.
function resampled(times, values, wanted) {
  const last = times[times.length - 1];
  return wanted.map((time) => {
    const value = time > last ? NaN : between(values, momentOf({ time: times }, time));
    return Number.isFinite(value) ? value : null;
  });
}
