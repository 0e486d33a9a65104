// What the charts of the console and of a run's page have in common: colours, axes, the band
// between the least and the greatest values, limits, marks and shaded times. uPlot draws them.

function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function axisStyle() {
  return { stroke: colour("--soft"), grid: { stroke: colour("--line"), width: 0.5 },
    ticks: { stroke: colour("--line") }, font: "12px system-ui", labelFont: "12px system-ui" };
}

// Returns two series, of the least and the greatest values, and the band between them; `index` is
// the place of the first series.
function envelope(index, stroke, { dash = [], fill = stroke, points = false, width = 1 } = {}) {
  const line = { stroke, dash, width, points: { show: points, size: 5, fill: stroke } };
  return { series: [{ ...line }, { ...line }], band: { series: [index + 1, index], fill } };
}

// Draws on the canvas of a plot, in its own pixels.
function paint(plot, name, draw) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = colour(name);
  ctx.font = `${11 * uPlot.pxRatio}px sans-serif`;
  ctx.textAlign = "left";
  ctx.textBaseline = "alphabetic";
  ctx.setLineDash([]);
  draw(ctx, bbox, uPlot.pxRatio);
  ctx.restore();
}

// Draws a limit: parts [from, to, value], with words at each part that is long enough, above or
// below it, at its left or right end.
function drawLimit(plot, parts, words, { below = false, right = false } = {}) {
  paint(plot, "--limit", (ctx, bbox, px) => {
    ctx.lineWidth = 1.5 * px;
    ctx.textAlign = right ? "right" : "left";
    for (const [from, to, value] of parts) {
      if (value < plot.scales.y.min || value > plot.scales.y.max) continue;
      const y = plot.valToPos(value, "y", true);
      const ends = [from, to].map((x) =>
        Math.min(Math.max(plot.valToPos(x, "x", true), bbox.left), bbox.left + bbox.width));
      ctx.setLineDash([6 * px, 4 * px]);
      ctx.beginPath();
      ctx.moveTo(ends[0], y);
      ctx.lineTo(ends[1], y);
      ctx.stroke();
      if (ends[1] - ends[0] < 0.25 * bbox.width) continue;
      ctx.fillText(words(value), right ? ends[1] - 4 * px : ends[0] + 4 * px, below ? y + 12 * px : y - 4 * px);
    }
  });
}

// Draws a vertical line with words beside it.
function drawMark(plot, time, words, bold = false) {
  if (time < plot.scales.x.min || time > plot.scales.x.max) return;
  paint(plot, "--ink", (ctx, bbox, px) => {
    ctx.lineWidth = (bold ? 1.5 : 1) * px;
    if (bold) ctx.font = `bold ${ctx.font}`;
    const x = plot.valToPos(time, "x", true);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    const shown = ` ${words} `;
    const wide = ctx.measureText(shown).width;
    const left = x > bbox.left + bbox.width / 2 ? x - wide - 1 * px : x + 1 * px;
    ctx.fillStyle = colour("--page");
    ctx.globalAlpha = 0.8;
    ctx.fillRect(left, bbox.top, wide, 15 * px);
    ctx.globalAlpha = 1;
    ctx.fillStyle = colour("--ink");
    ctx.fillText(shown, left, bbox.top + 12 * px);
  });
}

// Shades times [from, to, name, kind] behind the curves, and names them above the chart as far as
// there is room.
function drawShades(plot, shades) {
  for (const [from, to, name, kind] of shades) {
    paint(plot, `--shade-${kind}`, (ctx, bbox) => {
      const [left, right] = [from, to].map((x) => plot.valToPos(x, "x", true));
      ctx.fillRect(left, bbox.top, right - left, bbox.height);
    });
    if (!name) continue;
    paint(plot, "--ink", (ctx, bbox, px) => {
      const [left, right] = [from, to].map((x) => plot.valToPos(x, "x", true));
      let shown = name;
      while (shown && ctx.measureText(shown).width > right - left - 4 * px) shown = shown.slice(0, -1);
      if (shown.length < Math.min(name.length, 3)) return;
      ctx.fillText(shown === name ? name : `${shown.slice(0, -1)}…`, left + 3 * px, bbox.top - 5 * px);
      ctx.fillRect(left, bbox.top - 15 * px, 0.75 * px, 15 * px);
    });
  }
}
