// Range over time: the line, its uncertainty, the readings, and a band for each stage.
import uPlot from "/vendor/uPlot.js";
import { STAGES } from "/words.js";

const WINDOW_S = 120, LEAST_S = 20;

export class Curves {
  constructor(place, colour) {
    this.place = place;
    this.colour = colour; // a CSS variable's value
    this.reset();
    new ResizeObserver(() => this.plot?.setSize(this.size())).observe(place);
  }

  reset() {
    this.rows = [[], [], [], [], []]; // t, range, low, high, truth
    this.readings = [[], []];
    this.spans = []; // [from, to, stage]
    this.build();
  }

  size() {
    return { width: Math.max(this.place.clientWidth, 120), height: Math.max(this.place.clientHeight, 120) };
  }

  build() { // also after a change of colours
    this.plot?.destroy();
    const ink = this.colour("--ink"), faint = this.colour("--grid"), line = this.colour("--line");
    const axis = { stroke: ink, font: "14px system-ui, sans-serif", grid: { stroke: faint, width: 1 }, ticks: { stroke: faint, width: 1 } };
    const quiet = { stroke: "transparent", width: 0, points: { show: false } };
    this.plot = new uPlot({
      ...this.size(),
      legend: { show: false },
      cursor: { show: false },
      padding: [8, 22, 0, 0],
      scales: { x: { time: false, range: () => this.window() }, y: { range: (_, low, high) => [0, Math.max(high ?? 1, 0.3) * 1.08] } },
      axes: [{ ...axis, size: 30, values: (_, ticks) => ticks.map((one) => `${one} s`) }, { ...axis, size: 74, space: 44, values: (_, ticks) => ticks.map((one) => `${one} m`) }],
      series: [
        {},
        quiet, quiet,
        { stroke: "transparent", width: 0, points: { show: true, size: 5, width: 0, fill: this.colour("--reading") } },
        { stroke: line, width: 2.5, points: { show: false } },
        { stroke: this.colour("--truth"), width: 2.5, dash: [2, 6], points: { show: false } },
      ],
      bands: [{ series: [2, 1], fill: this.colour("--band") }],
      hooks: { drawClear: [() => this.drawSpans()] },
    }, this.data(), this.place);
  }

  window() {
    const last = this.rows[0].at(-1) ?? 0;
    return last > WINDOW_S ? [last - WINDOW_S, last] : [0, Math.max(last, LEAST_S)];
  }

  add(rows, readings) {
    for (const [t, stage, , truth, range = null, sigma] of rows) {
      if (t <= this.rows[0].at(-1)) continue; // a late sample's: the curve only goes on
      const wide = range == null ? null : 2 * sigma;
      [t, range, range && range - wide, range && range + wide, truth].forEach((one, i) => this.rows[i].push(one));
      const span = this.spans.at(-1);
      if (span) span[1] = t;
      if (span?.[2] !== stage) this.spans.push([t, t, stage]);
    }
    for (const [t, range] of readings) if (!(t <= this.readings[0].at(-1))) this.readings.forEach((list, i) => list.push(i ? range : t));
    this.forget();
  }

  forget() {
    const from = (this.rows[0].at(-1) ?? 0) - WINDOW_S - 5;
    for (const table of [this.rows, this.readings]) {
      const old = table[0].findIndex((t) => t >= from);
      if (old > 200) for (const list of table) list.splice(0, old);
    }
    while (this.spans[0]?.[1] < from) this.spans.shift();
  }

  data() {
    const [t, range, low, high, truth] = this.rows;
    const [times, lows, highs, ranges, truths, readings] = uPlot.join([[t, low, high, range, truth], this.readings]);
    return [times, lows, highs, readings, ranges, truths];
  }

  draw() {
    this.plot.setData(this.data());
  }

  drawSpans() {
    const { ctx: pen, bbox } = this.plot, dot = devicePixelRatio;
    pen.save();
    pen.beginPath();
    pen.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    pen.clip();
    pen.font = `600 ${12.5 * dot}px system-ui, sans-serif`;
    pen.textBaseline = "top";
    pen.textAlign = "left";
    for (const [from, to, stage] of this.spans) {
      const left = Math.max(this.plot.valToPos(from, "x", true), bbox.left), right = this.plot.valToPos(to, "x", true);
      if (right <= left) continue;
      pen.fillStyle = this.colour(`--stage${stage}`);
      pen.globalAlpha = 0.16;
      pen.fillRect(left, bbox.top, right - left, bbox.height);
      pen.globalAlpha = 1;
      pen.fillRect(left, bbox.top, right - left, 5 * dot);
      const words = [`${stage} ${STAGES[stage]}`, `${stage}`].find((one) => pen.measureText(one).width + 8 * dot < right - left);
      pen.fillStyle = this.colour("--ink");
      if (words) pen.fillText(words, left + 4 * dot, bbox.top + 8 * dot);
    }
    pen.restore();
  }
}
