// Torque against speed: points of the excitations by mass, and the curves of the last identification.

import { axisStyle, colour } from "./charts.js";

const COLOURS = ["--chart", "--second", "--green", "--purple"];
const DASHES = [[], [7, 4], [2, 3], [9, 3, 2, 3]];
const HEIGHT = 300;

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
    if (this.plot.width !== width) this.plot.setSize({ width, height: HEIGHT });
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
      width, height: HEIGHT,
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
