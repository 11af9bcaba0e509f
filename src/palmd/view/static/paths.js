// Paths of outlines, in mm, and how lines are drawn on a canvas.

import { colours } from "./theme.js";

const MM = 1e3;

/** A closed path through the outline's points, each moved by `off` (m) along its normal. */
export function ring(points, off) {
  const path = new Path2D();
  for (let i = 0; i < points.x.length; i++) path.lineTo(...place(points, i, off?.[i] ?? 0));
  path.closePath();
  return path;
}

/** A point of the outline, moved by `off` (m) along its normal. */
export function place(points, i, off) {
  return [(points.x[i] + off * points.nx[i]) * MM, (points.y[i] + off * points.ny[i]) * MM];
}

export function line(context, from, to) {
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
}

/** Draws a path as the rig's truth is drawn; `thin` is a CSS pixel in the context's unit. */
export function dash(context, path, thin) {
  context.strokeStyle = colours.truth;
  context.lineWidth = 1.5 * thin;
  context.setLineDash([6 * thin, 4 * thin]);
  context.stroke(path);
}
