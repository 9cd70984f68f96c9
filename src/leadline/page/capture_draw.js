// What is drawn in a guided capture: corners, boxes, where to hold the board and how; and the beep.
import { haloed, line, placed, unitOf } from "/pictures.js";

const COLOURS = { bad: "#ff6b6b", wait: "#7cff4f", same: "#c8c8c8", saved: "#7cff4f", goal: "#ffd400" };

export function paintLook(pen, side, scene, scale) {
  const at = placed(scale), unit = unitOf(pen), colour = COLOURS[scene.state];
  const outline = scene.outline[side];
  if (outline?.length) line(pen, [...outline, outline[0]].map(at), COLOURS.goal, 1.8 * unit, [6 * unit, 4 * unit]);
  const dots = scene.dots[side] ?? [];
  if (dots.length) {
    haloed(pen, colour, 0.9 * unit, () => {
      for (const point of dots) {
        const [x, y] = at(point);
        pen.moveTo(x + 1.2 * unit, y);
        pen.arc(x, y, 1.2 * unit, 0, 7);
      }
    });
  }
  for (const [x, y, width, height] of scene.boxes[side] ?? []) {
    haloed(pen, colour, 1.4 * unit, () => pen.rect((x + 0.5) * scale, (y + 0.5) * scale, width * scale, height * scale));
  }
}

const COLUMNS = 6, ROWS = 4, LEAN = 0.32;

// The board as the camera is to see it: the edge that is nearer is the longer one.
export function drawPose(canvas, tilt, enough) {
  const pen = canvas.getContext("2d"), { width, height } = canvas;
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  pen.clearRect(0, 0, width, height);
  if (enough) {
    pen.fillStyle = colour("--good");
    pen.font = "700 84px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.fillText("✓", width / 2, height * 0.8);
    return;
  }
  if (!tilt) return;
  const lean = { top: [0, -1], bottom: [0, 1], left: [-1, 0], right: [1, 0], square: [0, 0] }[tilt];
  const at = (u, v) => { // u, v from -1 to 1 on the board
    const near = 1 + LEAN * (u * lean[0] + v * lean[1]);
    return [width / 2 + u * 0.3 * width * near * (lean[0] ? 0.82 : 1), height / 2 + v * 0.3 * height * near * (lean[1] ? 0.72 : 1) - lean[1] * 6];
  };
  const quad = (u0, v0, u1, v1, style) => {
    pen.beginPath();
    for (const [u, v] of [[u0, v0], [u1, v0], [u1, v1], [u0, v1]]) pen.lineTo(...at(u, v));
    pen.closePath();
    pen.fillStyle = style;
    pen.fill();
  };
  quad(-1.12, -1.16, 1.12, 1.16, colour("--goal"));
  quad(-1.06, -1.08, 1.06, 1.08, "#fff");
  for (let row = 0; row < ROWS; row += 1) {
    for (let column = row % 2; column < COLUMNS; column += 2) {
      quad(-1 + (2 * column) / COLUMNS, -1 + (2 * row) / ROWS, -1 + (2 * (column + 1)) / COLUMNS, -1 + (2 * (row + 1)) / ROWS, "#000");
    }
  }
  if (tilt === "square") return;
  const [x, y] = at(1.42 * lean[0], 1.36 * lean[1]);
  pen.fillStyle = colour("--ink");
  pen.font = "600 15px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.save();
  pen.translate(Math.min(Math.max(x, 9), width - 9), Math.min(Math.max(y, 9), height - 9));
  if (lean[0]) pen.rotate(lean[0] * Math.PI / 2);
  pen.fillText("nearer", 0, 0);
  pen.restore();
}

let audio = null;

export function beep() {
  audio ??= new AudioContext();
  const tone = audio.createOscillator(), loudness = audio.createGain();
  tone.frequency.value = 880;
  loudness.gain.setValueAtTime(0.3, audio.currentTime);
  loudness.gain.exponentialRampToValueAtTime(0.001, audio.currentTime + 0.25);
  tone.connect(loudness).connect(audio.destination);
  tone.start();
  tone.stop(audio.currentTime + 0.25);
}
