// Draws the charts of a run's page from the data at the end of the page.

(() => {
  const HEIGHT = 160;
  const TALL = 260;
  const FEW = 150; // samples up to which each has a dot
  const DASHES = [[], [7, 4], [2, 3]];
  const { series, charts } = JSON.parse(document.getElementById("plots").textContent);
  const places = [...document.querySelectorAll("[data-plot]")];
  let plots = [];

  function options(chart, width) {
    const { frame, curves, limits, categories, unit } = chart;
    const few = series[chart.series].time.length <= FEW;
    const drawn = curves.map((name, k) => {
      const stroke = colour(`--curve-${k}`);
      const fill = curves.length > 1 ? `${stroke}70` : stroke;
      return envelope(1 + 2 * k, stroke, { dash: DASHES[k], fill, points: few, width: 1.5 });
    });
    const right = Boolean(frame.mark && frame.mark[0] <= 0.5);
    return {
      width, height: chart.tall ? TALL : HEIGHT,
      padding: [18, 12, 0, 0],
      legend: { show: false }, cursor: { show: false },
      scales: { x: { time: false, range: [0, 1] }, y: { range: chart.range } },
      axes: [
        { ...axisStyle(), size: 30, splits: frame.ticks.map(([place]) => place),
          values: () => frame.ticks.map(([, words]) => words) },
        { ...axisStyle(), size: categories.length ? 76 : 58, space: 26,
          ...(categories.length ? { splits: categories.map((_, i) => i), values: () => categories } : {}) },
      ],
      series: [{}, ...drawn.flatMap((each) => each.series)],
      bands: drawn.map((each) => each.band),
      hooks: {
        drawClear: [(plot) => drawShades(plot, frame.shades)],
        draw: [(plot) => {
          limits.forEach((parts) => drawLimit(plot, parts,
            (value) => `limit ${Number(value.toPrecision(4))} ${unit}`,
            { right, below: parts.some(([, , value]) => value > (chart.range[0] + chart.range[1]) / 2) }));
          if (frame.mark) drawMark(plot, ...frame.mark, true);
          paint(plot, "--soft", (ctx, bbox, px) => {
            ctx.font = `${10 * px}px sans-serif`;
            ctx.textAlign = "right";
            frame.clock.split(" ").forEach((word, line) =>
              ctx.fillText(word, bbox.left - 8 * px, bbox.top + bbox.height + (15 + 10 * line) * px));
          });
        }],
      },
    };
  }

  function data(chart) {
    const { time, low, high } = series[chart.series];
    const scaled = (values) => values.map((value) => (value === null ? null : chart.scale * value));
    return [time, ...chart.curves.flatMap((name) => {
      const least = scaled(low[name]);
      return [least, high ? scaled(high[name]) : least];
    })];
  }

  // Draws every chart at the width of its place, or at a width for paper.
  function draw(paper) {
    plots.forEach((plot) => plot.destroy());
    plots = places.map((place) => {
      const chart = charts[Number(place.dataset.plot)];
      const width = !paper ? place.clientWidth : place.closest(".pair") ? 335 : 690;
      return new uPlot(options(chart, Math.max(width, 200)), data(chart), place);
    });
  }

  draw(false);
  document.getElementById("undrawn").remove();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw(false));
  addEventListener("beforeprint", () => {
    document.documentElement.dataset.paper = "";
    draw(true);
  });
  addEventListener("afterprint", () => {
    delete document.documentElement.dataset.paper;
    draw(false);
  });
  let wide = document.body.clientWidth;
  addEventListener("resize", () => {
    if (document.body.clientWidth === wide) return;
    wide = document.body.clientWidth;
    plots.forEach((plot, k) => plot.setSize({ width: Math.max(places[k].clientWidth, 200), height: plot.height }));
  });
})();
