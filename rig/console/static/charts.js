// Charts of the channels: minimum and maximum of each interval, with the limits.

const HEIGHT = 150;
const DASH = [6, 4];
const OUT_OF_SIGHT = 10; // drawings of the charts in sight for each drawing of all charts

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

export function axisStyle() {
  return { stroke: colour("--soft"), grid: { stroke: colour("--line"), width: 0.5 },
    ticks: { stroke: colour("--line") }, font: "12px system-ui", labelFont: "12px system-ui" };
}

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
    return {
      width: Math.max(this.holder.clientWidth ? place.clientWidth : 300, 200),
      height: HEIGHT,
      legend: { show: false },
      cursor: { show: false },
      scales: { x: { time: false }, y: { range: (plot, low, high) => range(low, high) } },
      axes: [{ ...axis, size: 28, values: (plot, ticks) => ticks.map((t) => `${t} s`) },
        { ...axis, size: 56, space: 24 }],
      series: [{},
        { stroke: colour("--chart"), width: 1, points: { show: false } },
        { stroke: colour("--chart"), width: 1, points: { show: false } }],
      bands: [{ series: [2, 1], fill: colour("--chart") }],
      hooks: { draw: [(plot) => drawLimits(plot, channel), (plot) => drawContinued(plot, this.continued)] },
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

function drawLimits(plot, channel) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.strokeStyle = colour("--second");
  ctx.fillStyle = colour("--second");
  ctx.lineWidth = 2 * devicePixelRatio;
  ctx.setLineDash(DASH.map((each) => each * devicePixelRatio));
  ctx.font = `${11 * devicePixelRatio}px sans-serif`;
  for (const limit of [channel.low, channel.high]) {
    if (limit === null || limit < plot.scales.y.min || limit > plot.scales.y.max) continue;
    const y = plot.valToPos(limit, "y", true);
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
    ctx.fillText("limit", bbox.left + 4, y - 3);
  }
  ctx.restore();
}

// A line where a continued run begins again, on the time axis of all recordings.
function drawContinued(plot, times) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.strokeStyle = colour("--ink");
  ctx.fillStyle = colour("--ink");
  ctx.lineWidth = devicePixelRatio;
  ctx.font = `${11 * devicePixelRatio}px sans-serif`;
  for (const time of times) {
    if (time < plot.scales.x.min || time > plot.scales.x.max) continue;
    const x = plot.valToPos(time, "x", true);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.textAlign = x > bbox.left + bbox.width / 2 ? "right" : "left";
    ctx.fillText(" continued ", x, bbox.top + 11 * devicePixelRatio);
  }
  ctx.restore();
}
