// Torque against speed: points of the excitations, and the curve of the last identification.

const PAD = { left: 52, right: 10, top: 8, bottom: 34 };

export class Friction {
  constructor(canvas, words) {
    this.canvas = canvas;
    this.words = words;
    this.rows = [];
    this.curves = null;
    this.waiting = false;
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

  use(curves) {
    this.curves = curves;
    this.words.textContent = curves
      ? `Points are means of 10 samples in excitations: circles are points of odd excitations, squares of even excitations. Lines: friction by ${curves.source}; dashed where a mass hangs.`
      : "Points are means of 10 samples in excitations: circles are points of odd excitations, squares of even excitations. No identification of this bench was found beside the run.";
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

  draw() {
    const canvas = this.canvas;
    const ratio = devicePixelRatio || 1;
    const width = canvas.clientWidth;
    const height = canvas.clientHeight;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const ctx = canvas.getContext("2d");
    ctx.scale(ratio, ratio);
    const style = getComputedStyle(document.documentElement);
    const paint = (name) => style.getPropertyValue(name).trim();
    const speeds = this.rows.map((row) => row[0]);
    const torques = this.rows.map((row) => row[1]);
    const most = (list, least) => list.reduce((a, b) => Math.max(a, Math.abs(b)), least);
    const x = most(speeds, 1) * 1.05;
    const y = most(torques, 1) * 1.15;
    const w = width - PAD.left - PAD.right;
    const h = height - PAD.top - PAD.bottom;
    const px = (v) => PAD.left + ((v + x) / (2 * x)) * w;
    const py = (v) => PAD.top + ((y - v) / (2 * y)) * h;
    axes(ctx, { px, py, x, y, width, height }, paint);
    for (const [speed, torque, segment] of this.rows) {
      const odd = segment % 2 === 1;
      ctx.fillStyle = paint(odd ? "--chart" : "--second");
      if (odd) {
        ctx.beginPath();
        ctx.arc(px(speed), py(torque), 1.6, 0, 7);
        ctx.fill();
      } else {
        ctx.fillRect(px(speed) - 1.4, py(torque) - 1.4, 2.8, 2.8);
      }
    }
    for (const line of this.curves?.lines || []) {
      ctx.strokeStyle = paint("--ink");
      ctx.lineWidth = 1.5;
      ctx.setLineDash(line.mass_kg ? [6, 4] : []);
      for (const sign of [-1, 1]) {
        ctx.beginPath();
        this.curves.speed.forEach((speed, i) => {
          if (speed > x) return;
          ctx.lineTo(px(sign * speed), py(sign * line.torque[i]));
        });
        ctx.stroke();
      }
    }
    canvas.setAttribute("aria-label", `Torque against speed: ${this.rows.length} points, speeds up to ${most(speeds, 0).toFixed(1)} deg/s, torques up to ${most(torques, 0).toFixed(1)} N m`);
  }
}

function axes(ctx, place, paint) {
  const { px, py, x, y, width, height } = place;
  ctx.strokeStyle = paint("--line");
  ctx.fillStyle = paint("--soft");
  ctx.font = "12px sans-serif";
  ctx.textAlign = "center";
  for (const share of [-1, -0.5, 0, 0.5, 1]) {
    const v = (share * x) / 1.05;
    line(ctx, px(v), PAD.top, px(v), height - PAD.bottom);
    ctx.fillText(v.toFixed(x > 20 ? 0 : 1), px(v), height - PAD.bottom + 14);
    const t = (share * y) / 1.15;
    line(ctx, PAD.left, py(t), width - PAD.right, py(t));
    ctx.textAlign = "right";
    ctx.fillText(t.toFixed(1), PAD.left - 4, py(t) + 4);
    ctx.textAlign = "center";
  }
  ctx.fillText("joint speed, deg/s", (PAD.left + width) / 2, height - 4);
  ctx.save();
  ctx.translate(12, height / 2);
  ctx.rotate(-Math.PI / 2);
  ctx.fillText("joint torque, N m", 0, 0);
  ctx.restore();
}

function line(ctx, x0, y0, x1, y1) {
  ctx.beginPath();
  ctx.moveTo(x0, y0);
  ctx.lineTo(x1, y1);
  ctx.stroke();
}
