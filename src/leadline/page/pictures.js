// Both images with what was found in them. Overlays come in the pixels of the full image.
const COLOURS = { box: "#ffb000", target: "#00e5ff", beam: "#ff5fdc", spot: "#7cff4f" };

// paint(pen, side, scale): what goes over a picture; scale: of the full image's pixels.
export async function drawPictures(canvases, blobs, size, paint) {
  const images = await Promise.all(blobs.map((blob) => createImageBitmap(blob)));
  ["left", "right"].forEach((side, i) => {
    const canvas = canvases[side], image = images[i], pen = canvas.getContext("2d");
    if (canvas.width !== image.width || canvas.height !== image.height) [canvas.width, canvas.height] = [image.width, image.height];
    pen.drawImage(image, 0, 0);
    image.close();
    paint(pen, side, canvas.width / size[0]);
  });
}

export const placed = (scale) => (point) => (point ? [(point[0] + 0.5) * scale, (point[1] + 0.5) * scale] : null);
export const unitOf = (pen) => pen.canvas.width / 320; // lines as wide in a small picture as in a large one

export function overlay(pen, side, scene, beam, scale) {
  const at = placed(scale), unit = unitOf(pen);
  if (beam) line(pen, beam[side].map(at), COLOURS.beam, 1.3 * unit, [6 * unit, 4 * unit]);
  if (side === "left") for (const found of scene.boxes) box(pen, found, scale, unit);
  if (scene.outline) line(pen, scene.outline[side].map(at), COLOURS.target, 1.2 * unit);
  const target = scene.target && at(scene.target[side]);
  if (target) cross(pen, target, COLOURS.target, 6 * unit, 1.2 * unit);
  const spot = scene.spot && at(scene.spot[side]);
  if (spot) ring(pen, spot, COLOURS.spot, 4.5 * unit, 1.5 * unit, scene.spot_seen);
}

export function haloed(pen, colour, width, path) { // readable on whatever is behind
  for (const [style, wide] of [["rgba(0,0,0,.75)", width * 2.2], [colour, width]]) {
    pen.strokeStyle = style;
    pen.lineWidth = wide;
    pen.beginPath();
    path();
    pen.stroke();
  }
}

export function line(pen, points, colour, width, dashes = []) {
  pen.setLineDash(dashes);
  haloed(pen, colour, width, () => {
    let down = false;
    for (const point of points) {
      if (point) pen[down ? "lineTo" : "moveTo"](...point);
      down = Boolean(point);
    }
  });
  pen.setLineDash([]);
}

function box(pen, found, scale, unit) {
  const [x, y, width, height] = found.box.map((one) => one * scale);
  haloed(pen, COLOURS.box, 1.4 * unit, () => pen.rect(x, y, width, height));
  const words = `${found.label} ${Math.round(found.score * 100)} %`;
  pen.font = `600 ${9.5 * unit}px system-ui, sans-serif`;
  const wide = pen.measureText(words).width + 6 * unit, high = 13 * unit;
  const left = Math.min(Math.max(x, 0), pen.canvas.width - wide), top = y > high ? y - high : Math.max(y, 0);
  pen.fillStyle = COLOURS.box;
  pen.fillRect(left, top, wide, high);
  pen.fillStyle = "#000";
  pen.fillText(words, left + 3 * unit, top + 10 * unit);
}

function cross(pen, [x, y], colour, size, width) {
  haloed(pen, colour, width, () => {
    pen.moveTo(x - size, y); pen.lineTo(x + size, y);
    pen.moveTo(x, y - size); pen.lineTo(x, y + size);
  });
}

function ring(pen, [x, y], colour, radius, width, sure) { // dashed while only the laser's reading puts it there
  pen.setLineDash(sure ? [] : [radius / 2, radius / 2]);
  haloed(pen, colour, width, () => pen.arc(x, y, radius, 0, 7));
  pen.setLineDash([]);
}
