// Where the target is, from above and from the side. Left camera's frame: x right, y down, z ahead, metres.
const REACHES = [0.3, 0.5, 0.75, 1, 1.5, 2, 3, 4, 5, 7, 10, 15], TRAIL = 400;
const LEAST_PX = 9; // a smaller ellipse is also drawn magnified

const WAYS = {
  above: { across: [0, "right"], along: [2, "ahead"], edges: ["left", "right"], up: true },
  side: { across: [1, "down"], along: [2, "ahead"], edges: ["top", "bottom"], up: false },
};

export class Map2 {
  constructor(canvas, way, colour) {
    Object.assign(this, { canvas, way: WAYS[way], colour, trail: [], reach: REACHES[5] });
    new ResizeObserver(() => this.draw()).observe(canvas.parentElement);
  }

  reset(hello) {
    this.hello = hello;
    this.trail = [];
    this.now = null;
  }

  add(rows) {
    for (const row of rows) {
      this.now = row.length > 4 ? { status: row[2], range: row[4], p: row.slice(6, 9), c: row.slice(9, 15) } : null;
      if (this.now) this.trail.push(this.now.p);
    }
    this.trail.splice(0, this.trail.length - TRAIL);
    if (!this.now) return;
    const wanted = Math.hypot(...this.now.p) * 1.18;
    if (wanted > this.reach || wanted < 0.6 * this.reach) this.reach = REACHES.find((one) => one >= wanted) ?? wanted;
  }

  draw() {
    const { canvas, hello } = this, dot = devicePixelRatio;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!hello || !width) return;
    [canvas.width, canvas.height] = [width * dot, height * dot];
    const pen = canvas.getContext("2d");
    pen.scale(dot, dot);
    this.frame(width, height);
    this.grid(pen, width, height);
    this.limits(pen);
    this.camera(pen);
    this.target(pen);
  }

  frame(width, height) { // metres to pixels
    const margin = 26, long = (this.way.up ? height : width) - 2 * margin;
    this.scale = long / this.reach;
    this.at = this.way.up
      ? (p) => [width / 2 + p[0] * this.scale, height - margin - p[2] * this.scale]
      : (p) => [margin + p[2] * this.scale, height / 2 + p[1] * this.scale];
  }

  grid(pen, width, height) {
    const step = [0.1, 0.2, 0.5, 1, 2, 5].find((one) => one * this.scale >= 50) ?? 5;
    pen.font = "13px system-ui, sans-serif";
    pen.lineWidth = 1;
    for (let m = step; m <= this.reach * 1.01; m += step) {
      const [x, y] = this.at([0, 0, m]);
      pen.strokeStyle = this.colour("--grid");
      line(pen, this.way.up ? [[0, y], [width, y]] : [[x, 0], [x, height]]);
      pen.fillStyle = this.colour("--quiet");
      const words = `${+m.toFixed(2)} m`;
      if (this.way.up) pen.fillText(words, width - pen.measureText(words).width - 2, y - 3);
      else pen.fillText(words, x - pen.measureText(words).width - 3, height - 5);
    }
  }

  limits(pen) { // distances from the camera that mean something
    const { safety_m, standoff_m, reach_m } = this.hello.limits;
    pen.setLineDash([2, 4]);
    for (const [radius, name] of [[safety_m, "--bad"], [standoff_m, "--ink"], [reach_m, "--good"]]) {
      pen.strokeStyle = this.colour(name);
      pen.lineWidth = 1.5;
      pen.beginPath();
      const start = this.way.up ? -Math.PI : -Math.PI / 2;
      pen.arc(...this.at([0, 0, 0]), radius * this.scale, start, start + Math.PI);
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  camera(pen) {
    const { view, laser, right_m } = this.hello, far = this.reach * 2, eye = [0, 0, 0];
    pen.lineWidth = 1.5;
    pen.strokeStyle = this.colour("--quiet");
    for (const edge of this.way.edges) line(pen, [eye, view[edge].map((one) => one * far)].map(this.at));
    if (laser) {
      const [origin, direction] = laser;
      pen.strokeStyle = this.colour("--beam");
      pen.setLineDash([7, 4]);
      line(pen, [origin, origin.map((one, i) => one + direction[i] * far)].map(this.at));
      pen.setLineDash([]);
    }
    pen.fillStyle = this.colour("--ink");
    for (const where of [eye, right_m]) {
      const [x, y] = this.at(where);
      pen.fillRect(x - 5, y - 4, 10, 8);
    }
  }

  target(pen) {
    pen.strokeStyle = this.colour("--line");
    pen.lineWidth = 1.5;
    pen.globalAlpha = 0.5;
    line(pen, this.trail.map(this.at));
    pen.globalAlpha = 1;
    if (!this.now) return;
    const { p, c, range, status } = this.now, middle = this.at(p);
    if (this.hello.target.startsWith("sphere")) {
      pen.fillStyle = this.colour("--ball");
      disc(pen, middle, Math.max(Math.hypot(...p) - range, 0) * this.scale);
      pen.fill();
    }
    pen.strokeStyle = this.colour(status === 0 ? "--line" : "--bad");
    this.ellipse(pen, middle, c);
    pen.fillStyle = this.colour("--ink");
    disc(pen, middle, 3.5);
    pen.fill();
  }

  ellipse(pen, middle, [xx, xy, xz, yy, yz, zz]) { // 2 sigma
    const [a, b, d] = this.way.up ? [xx, -xz, zz] : [zz, yz, yy]; // covariance across and down the canvas
    const half = (a + d) / 2, root = Math.hypot((a - d) / 2, b), turn = Math.atan2(2 * b, a - d) / 2;
    const axes = [half + root, half - root].map((one) => 2 * Math.sqrt(Math.max(one, 0)) * this.scale);
    const times = [1, 10, 100, 1000].find((one) => axes[0] * one >= LEAST_PX) ?? 1000;
    pen.lineWidth = 2.5;
    pen.beginPath();
    pen.ellipse(...middle, axes[0] * times, axes[1] * times, turn, 0, 7);
    pen.stroke();
    pen.fillStyle = this.colour("--ink");
    pen.fillText(times === 1 ? "2 sigma" : `2 sigma, drawn ${times}×`, 4, 36);
  }
}

function line(pen, points) {
  pen.beginPath();
  points.forEach((point, i) => pen[i ? "lineTo" : "moveTo"](...point));
  pen.stroke();
}

function disc(pen, [x, y], radius) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 7);
}
