// Paths of outlines in mm, and drawing of lines on a canvas.

import { colours } from "./theme.js";

const MM = 1e3;

/** A closed path through the outline's points, each moved by `offset` (m) along its normal. */
export function ring(points, offset) {
  const path = new Path2D();
  for (let i = 0; i < points.x.length; i++) path.lineTo(...place(points, i, offset?.[i] ?? 0));
  path.closePath();
  return path;
}

/** A point of the outline, moved by `offset` (m) along its normal. */
export function place(points, i, offset) {
  return [(points.x[i] + offset * points.nx[i]) * MM, (points.y[i] + offset * points.ny[i]) * MM];
}

export function line(context, from, to) {
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
}

/** Draws a dashed path, as used for the rig's truth; `thin` is one CSS pixel in the context's unit. */
export function dash(context, path, thin, colour = colours.truth) {
  context.strokeStyle = colour;
  context.lineWidth = 1.5 * thin;
  context.setLineDash([6 * thin, 4 * thin]);
  context.stroke(path);
}

/** A closed path through these positions. */
export function polygon(corners) {
  const path = new Path2D();
  for (const corner of corners) path.lineTo(...corner);
  path.closePath();
  return path;
}

/** Fills a circle, and leaves it as the context's path. */
export function disc(context, [x, y], radius, colour) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = colour;
  context.fill();
}

/** Draws a dot with a rim; `ratio` is one CSS pixel in the context's unit. */
export function mark(context, place, colour, ratio) {
  disc(context, place, 5 * ratio, colour);
  context.lineWidth = 1.8 * ratio;
  context.strokeStyle = colours.panel;
  context.stroke();
}

export function arrow(context, from, to, colour, ratio) {
  const length = Math.hypot(to[0] - from[0], to[1] - from[1]);
  if (!(length > 0)) return;
  const [x, y] = [(to[0] - from[0]) / length, (to[1] - from[1]) / length];
  const head = Math.min(10 * ratio, length * 0.6);
  const neck = [to[0] - x * head, to[1] - y * head];
  context.strokeStyle = context.fillStyle = colour;
  context.lineWidth = 3 * ratio;
  line(context, from, neck);
  context.beginPath();
  context.moveTo(...to);
  context.lineTo(neck[0] - y * head * 0.42, neck[1] + x * head * 0.42);
  context.lineTo(neck[0] + y * head * 0.42, neck[1] - x * head * 0.42);
  context.fill();
}

/** Writes text centred at a point, with a halo that keeps it legible. */
export function write(context, text, [x, y], colour, ratio, weight) {
  context.font = `${weight} ${12 * ratio}px system-ui, sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.lineWidth = 3 * ratio;
  context.lineJoin = "round";
  context.strokeStyle = colours.panel;
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}
