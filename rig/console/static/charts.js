// Charts of the channels over time, and of torque against speed; /static/chart.js has what they
// have in common with the charts of a run's page.

const HEIGHT = 150;
const OUT_OF_SIGHT = 10; // drawings of the charts in sight for each drawing of all charts

export function shownNumber(value, unit) {
  if (value === null || value === undefined || Number.isNaN(value)) return "not reported";
  const size = Math.abs(value);
  const digits = size >= 100 ? 1 : size >= 1 ? 2 : 3;
  // A value that rounds to zero has no sign.
  return `${value.toFixed(digits).replace(/^-(?=[0.]+$)/, "")} ${unit}`;
}

export function limitWords(channel) {
  const { low, high, unit } = channel;
  if (low === null && high === null) return "no limit";
  if (low === null) return `at most ${shownNumber(high, unit)}`;
  if (high === null) return `at least ${shownNumber(low, unit)}`;
  return `${shownNumber(low, unit)} to ${shownNumber(high, unit)}`;
}

export class Charts {
  // `widened` is called when the width of the charts has changed, also when they are first shown.
  constructor(holder, widened) {
    this.holder = holder;
    this.width = holder.clientWidth;
    this.list = [];
    this.signature = "";
    this.reset();
    this.visible = new Set();
    this.observer = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        if (entry.isIntersecting) this.visible.add(entry.target);
        else this.visible.delete(entry.target);
      }
      this.draw();
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.rebuild());
    addEventListener("beforeprint", () => this.draw(true));
    new ResizeObserver(() => {
      if (holder.clientWidth === this.width) return;
      this.width = holder.clientWidth;
      this.resize();
      widened();
    }).observe(holder);
  }

  reset() {
    this.first = 0;
    this.low = [];
    this.high = [];
    this.interval = 1;
    this.window = 30;
    this.latest = 0;
    this.continued = [];
    this.turn = -1; // the first drawing is of all charts
  }

  // Builds one chart for each channel.
  use(channels) {
    const signature = JSON.stringify(channels);
    if (signature === this.signature) return;
    this.signature = signature;
    this.channels = channels;
    this.rebuild();
  }

  rebuild() {
    if (!this.channels) return;
    for (const chart of this.list) {
      this.observer.unobserve(chart.box);
      chart.plot.destroy();
    }
    this.visible.clear();
    this.holder.replaceChildren();
    this.list = this.channels.map((channel) => this.build(channel));
    this.draw(true);
  }

  build(channel) {
    const box = document.createElement("div");
    box.className = "chart";
    box.id = `chart-${channel.name}`;
    const title = document.createElement("h3");
    title.textContent = channel.label;
    const now = document.createElement("span");
    now.className = "chart-now";
    const limits = document.createElement("p");
    limits.className = "chart-limits";
    limits.textContent = `Limits: ${limitWords(channel)}`;
    const place = document.createElement("div");
    place.setAttribute("role", "img");
    place.setAttribute("aria-label", `${channel.label} over time; its value is above the chart`);
    box.append(title, now, limits, place);
    this.holder.append(box);
    const plot = new uPlot(this.options(channel, place), [[], [], []], place);
    this.observer.observe(box);
    return { channel, box, now, place, plot };
  }

  options(channel, place) {
    const axis = axisStyle();
    const drawn = envelope(1, colour("--chart"));
    const limits = [channel.low, channel.high].filter((limit) => limit !== null)
      .map((limit) => [[-Infinity, Infinity, limit]]);
    return {
      width: Math.max(this.holder.clientWidth ? place.clientWidth : 300, 200),
      height: HEIGHT,
      legend: { show: false },
      cursor: { show: false },
      scales: { x: { time: false }, y: { range: (plot, low, high) => range(low, high) } },
      axes: [{ ...axis, size: 28, values: (plot, ticks) => ticks.map((t) => `${t} s`) },
        { ...axis, size: 56, space: 24 }],
      series: [{}, ...drawn.series],
      bands: [drawn.band],
      hooks: { draw: [(plot) => {
        limits.forEach((limit) => drawLimit(plot, limit, () => "limit"));
        // A line where a continued run begins again, on the time axis of all recordings.
        this.continued.forEach((time) => drawMark(plot, time, "continued"));
      }] },
    };
  }

  resize() {
    for (const chart of this.list) {
      const width = chart.place.clientWidth;
      if (width > 0) chart.plot.setSize({ width, height: HEIGHT });
    }
  }

  pixels() {
    return Math.max(this.list[0]?.place.clientWidth || 0, 200);
  }

  // Takes a message: header length, header, then minima and maxima of each channel.
  take(buffer, window) {
    const length = new DataView(buffer).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    const values = new Float32Array(buffer, 4 + length);
    const channels = values.length / head.count / 2;
    if (head.fresh) {
      this.first = head.first;
      this.low = Array.from({ length: channels }, () => []);
      this.high = Array.from({ length: channels }, () => []);
    }
    if (this.low.length !== channels) return;
    this.interval = head.interval_s;
    this.latest = head.latest_s;
    this.continued = head.continued_s;
    this.window = window || Math.max(head.latest_s, 1);
    const keep = Math.ceil(this.window / this.interval) + 2;
    const start = head.first - this.first;
    const drop = Math.max(0, start + head.count - keep);
    for (let c = 0; c < channels; c += 1) {
      for (const [kept, offset] of [[this.low[c], 2 * c], [this.high[c], 2 * c + 1]]) {
        while (kept.length < start) kept.push(null);
        for (let i = 0; i < head.count; i += 1) {
          const value = values[offset * head.count + i];
          kept[start + i] = Number.isNaN(value) ? null : value;
        }
        if (drop) kept.splice(0, drop);
      }
    }
    this.first += drop;
    this.draw();
    // The charts out of sight get the end of the recording as well.
    clearTimeout(this.rest);
    this.rest = setTimeout(() => this.draw(true), 1000);
  }

  // Charts out of sight are drawn more rarely; `all` draws them too.
  draw(all = false) {
    if (document.hidden || !this.low.length) return;
    this.turn = (this.turn + 1) % OUT_OF_SIGHT;
    const every = all || this.turn === 0;
    const count = this.low[0].length;
    const times = Array.from({ length: count }, (_, i) => (this.first + i + 0.5) * this.interval);
    this.list.forEach((chart, c) => {
      const there = this.low[c]?.some((value) => value !== null);
      chart.box.hidden = !there && count > 0;
      if (!there || !(every || this.visible.has(chart.box))) return;
      chart.plot.setData([times, this.low[c], this.high[c]], false);
      const start = this.latest - this.window;
      chart.plot.batch(() => {
        chart.plot.setScale("x", { min: Math.max(start, 0), max: Math.max(this.latest, start + 1) });
      });
    });
  }

  // Returns the least and the greatest value of each chart, by name.
  extremes() {
    const found = {};
    (this.channels || []).forEach((channel, c) => {
      const low = (this.low[c] || []).filter((value) => value !== null);
      const high = (this.high[c] || []).filter((value) => value !== null);
      if (low.length) found[channel.name] = [Math.min(...low), Math.max(...high)];
    });
    return found;
  }

  // Returns the least and the greatest value of the axis of a chart.
  axis(name) {
    const { min, max } = this.list.find((chart) => chart.channel.name === name).plot.scales.y;
    return [min, max];
  }

  // Empties the charts: another run is shown.
  clear() {
    this.reset();
    for (const chart of this.list) {
      chart.plot.setData([[], [], []]);
      chart.now.textContent = "";
    }
  }

  values(values, when) {
    this.list.forEach((chart, c) => {
      const value = values[c];
      const known = value !== null && value !== undefined;
      chart.now.textContent = `${known ? `${when} ` : ""}${shownNumber(value, chart.channel.unit)}${share(value, chart.channel)}`;
    });
  }
}

function share(value, channel) {
  const { low, high } = channel;
  if (value === null || low === null || high === null || low !== -high) return "";
  return `, ${Math.round((100 * Math.abs(value)) / high)} % of the limit`;
}

function range(low, high) {
  if (low === null || high === null) return [-1, 1];
  // A constant value is in the middle, with a few percent around it.
  const margin = high === low ? Math.max(Math.abs(high) * 0.05, 1e-3)
    : Math.max((high - low) * 0.1, Math.abs(high) * 1e-3, 1e-3);
  return [low - margin, high + margin];
}

// Torque against speed: points of the excitations by mass, and the curves of the last identification.

const COLOURS = ["--chart", "--second", "--green", "--purple"];
const DASHES = [[], [7, 4], [2, 3], [9, 3, 2, 3]];
const FRICTION_HEIGHT = 300;

export class Friction {
  constructor(holder, legend, words) {
    this.holder = holder;
    this.legend = legend;
    this.words = words;
    this.signature = "";
    this.masses = {};
    this.waiting = false;
    this.reset();
    new ResizeObserver(() => this.schedule()).observe(holder);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.signature = "";
      this.schedule();
    });
  }

  reset() {
    this.rows = [];
    this.curves = null;
    this.schedule();
  }

  take(points) {
    this.rows.length = Math.min(this.rows.length, points.from);
    this.rows.push(...points.rows);
    this.schedule();
  }

  // Takes the mass of each excitation, by its number.
  weigh(masses) {
    this.masses = masses;
    this.schedule();
  }

  use(curves) {
    this.curves = curves;
    this.words.textContent = `Points are means of 10 samples in excitations. ${curves
      ? `Lines: friction by ${curves.source}.` : "No identification of this bench was found beside the run."}`;
    this.schedule();
  }

  schedule() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  // Returns the masses that are drawn, kg, in order; null for points whose mass is not known yet.
  loads() {
    const found = new Set(this.rows.map(([, , segment]) => this.masses[segment] ?? null));
    for (const line of this.curves?.lines || []) found.add(line.mass_kg);
    return [...found].sort((a, b) => (a ?? Infinity) - (b ?? Infinity));
  }

  draw() {
    const width = this.holder.clientWidth;
    if (!width) return;
    const loads = this.loads();
    const lines = (this.curves?.lines || []).flatMap((line) => [-1, 1].map((sign) => ({ line, sign })));
    const signature = JSON.stringify([loads, lines.map(({ line }) => line.mass_kg)]);
    if (signature !== this.signature) {
      this.signature = signature;
      this.plot?.destroy();
      this.plot = new uPlot(this.options(loads, lines, width), [[]], this.holder);
      this.showLegend(loads);
    }
    if (this.plot.width !== width) this.plot.setSize({ width, height: FRICTION_HEIGHT });
    // One axis of speeds for all series, as uPlot draws them; the other series have gaps there.
    const all = this.rows.map(([speed, torque, segment]) =>
      [speed, torque, loads.indexOf(this.masses[segment] ?? null)]);
    const fastest = this.rows.reduce((most, [speed]) => Math.max(most, Math.abs(speed)), 1);
    lines.forEach(({ line, sign }, i) => this.curves.speed.forEach((speed, k) => {
      if (speed <= 1.05 * fastest) all.push([sign * speed, sign * line.torque[k], loads.length + i]);
    }));
    all.sort((a, b) => a[0] - b[0]);
    const data = [all.map(([speed]) => speed)];
    for (let s = 0; s < loads.length + lines.length; s += 1) {
      data.push(all.map(([, torque, series]) => (series === s ? torque : null)));
    }
    this.plot.setData(data);
    const most = (column) => this.rows.reduce((a, row) => Math.max(a, Math.abs(row[column])), 0).toFixed(1);
    this.holder.setAttribute("aria-label", `Torque against speed: ${this.rows.length} points, speeds up to ${most(0)} deg/s, torques up to ${most(1)} N m`);
  }

  options(loads, lines, width) {
    const paint = (load) => colour(COLOURS[loads.indexOf(load) % COLOURS.length]);
    const symmetric = (share) => (plot, low, high) => {
      const most = share * Math.max(Math.abs(low ?? 0), Math.abs(high ?? 0), 1);
      return [-most, most];
    };
    return {
      width, height: FRICTION_HEIGHT,
      legend: { show: false },
      cursor: { show: false },
      scales: { x: { time: false, range: symmetric(1.05) }, y: { range: symmetric(1.1) } },
      axes: [{ ...axisStyle(), label: "joint speed, deg/s", labelSize: 20, size: 32 },
        { ...axisStyle(), label: "joint torque, N m", labelSize: 20, size: 52 }],
      series: [{},
        ...loads.map((load, i) => ({ paths: () => null, stroke: paint(load),
          points: { show: true, size: 4, width: 1, fill: i % 2 ? "transparent" : paint(load) } })),
        ...lines.map(({ line }) => ({ stroke: colour("--ink"), width: 1.5, spanGaps: true,
          dash: DASHES[loads.indexOf(line.mass_kg) % DASHES.length], points: { show: false } }))],
    };
  }

  showLegend(loads) {
    const lines = new Set((this.curves?.lines || []).map((line) => line.mass_kg));
    this.legend.replaceChildren(...loads.map((load, i) => {
      const item = document.createElement("li");
      const key = document.createElement("span");
      key.className = `load load-${i % COLOURS.length}${i % 2 ? " hollow" : ""}`;
      const words = load === null ? "mass not known yet" : `${load} kg`;
      const dash = ["solid", "dashed", "dotted", "dash-dotted"][i % DASHES.length];
      item.append(key, lines.has(load) ? `${words}; ${dash} line` : words);
      return item;
    }));
  }
}
