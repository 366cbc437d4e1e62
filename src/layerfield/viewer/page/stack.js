// The layers drawn apart, with the eye and its view cone, in oblique projection.

import { extent } from "layerfield/optics.js";

const ACROSS = [0.5, 0.2], DOWN = [0, 1], TOWARD = [-0.92, 0.16]; // axes on the picture
const APART = 1.5; // depth of the stack, in heights of a layer
const AWAY = 1.5; // of the eye from the front layer

export function drawStack(canvas, result, eye, highlighted) {
  const width = (canvas.width = Math.round(canvas.clientWidth * devicePixelRatio));
  const height = (canvas.height = Math.round(canvas.clientHeight * devicePixelRatio));
  const pen = canvas.getContext("2d");
  const style = getComputedStyle(canvas);
  const { display, layer, bitmaps } = result;
  const half = [layer.width / layer.height / 2, 0.5];
  const range = display.depths[0] - display.depths.at(-1) || 1;
  const middle = (display.depths[0] + display.depths.at(-1)) / 2;
  const depthOf = (k) => ((display.depths[k] - middle) / range) * APART;
  const unit = Math.min(width / (2 * half[0] * 0.5 + 0.92 * (APART + AWAY) + 0.7), height / (1.3 + 0.4 * half[0] + 0.16 * (APART + AWAY)));
  const shift = [0.46 * AWAY, -0.08 * AWAY]; // the whole, eye and stack, in the middle
  const project = ([x, y, z]) =>
    [0, 1].map((i) => (i ? height : width) / 2 + unit * (shift[i] + x * ACROSS[i] + y * DOWN[i] + z * TOWARD[i]));
  const corners = (z) =>
    [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => [x * half[0], y * half[1], z]);
  const { centre, half: reach } = extent(display);
  const widest = Math.max(...reach) || 1;
  const place = [
    ((eye.slope[0] - centre[0]) / widest) * half[1],
    ((eye.slope[1] - centre[1]) / widest) * half[1],
    depthOf(0) + AWAY,
  ];
  const at = project(place);

  pen.lineWidth = devicePixelRatio;
  pen.font = `${13 * devicePixelRatio}px system-ui, sans-serif`;
  const back = corners(depthOf(display.depths.length - 1)).map(project);
  cone(pen, at, back, style);
  for (let k = display.depths.length - 1; k >= 0; k--) {
    const outline = corners(depthOf(k)).map(project);
    picture(pen, bitmaps[0][k], outline, layer);
    pen.strokeStyle = k === highlighted ? style.accentColor : style.color;
    pen.stroke(polygon(outline));
    const [x, y] = outline[0];
    pen.fillStyle = style.color;
    pen.fillText(k ? `layer ${k}` : "layer 0, nearest", x, y - 8 * devicePixelRatio);
  }
  edges(pen, at, back, style);
  pen.beginPath();
  pen.arc(...at, 7 * devicePixelRatio, 0, 2 * Math.PI);
  pen.fillStyle = style.accentColor;
  pen.fill();
  pen.fillStyle = style.color;
  pen.fillText("eye", at[0] - 10 * devicePixelRatio, at[1] - 12 * devicePixelRatio);
}

// An oblique projection maps a picture to a parallelogram: three corners say all.
function picture(pen, bitmap, [a, b, , d], { width, height }) {
  pen.save();
  pen.setTransform(
    (b[0] - a[0]) / width, (b[1] - a[1]) / width,
    (d[0] - a[0]) / height, (d[1] - a[1]) / height, ...a,
  );
  pen.drawImage(bitmap, 0, 0);
  pen.restore();
}

function cone(pen, eye, outline, style) {
  pen.save();
  pen.globalAlpha = 0.12;
  pen.fillStyle = style.accentColor;
  outline.forEach((corner, i) => pen.fill(polygon([eye, corner, outline[(i + 1) % 4]])));
  pen.restore();
}

// The edges of the cone run through all layers, so they are drawn over them.
function edges(pen, eye, outline, style) {
  pen.save();
  pen.globalAlpha = 0.7;
  pen.setLineDash([5 * devicePixelRatio, 4 * devicePixelRatio]);
  pen.strokeStyle = style.accentColor;
  outline.forEach((corner) => pen.stroke(polygon([eye, corner])));
  pen.restore();
}

function polygon(points) {
  const path = new Path2D();
  points.forEach(([x, y]) => path.lineTo(x, y));
  path.closePath();
  return path;
}
