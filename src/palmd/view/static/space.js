// Three palms in space and the body between them, in a view that can be rotated by pointer or arrow keys.

import { classOf } from "./knowledge.js";
import { arrow, line, mark, polygon, write } from "./paths.js";
import { cross, dot, plus, rotation, scaled, surfaceOf, turned, unit } from "./surface.js";
import { colours, ofPalm } from "./theme.js";

const FROM = { around: -0.9, above: 0.45 }; // initial view direction (rad)
const STEEPEST = 1.5;
const SEEN = 1.8; // visible size, in sides of a pad
const SHADES = 12;
const LIGHT = unit([-0.35, 0.5, 0.8]); // right, up, towards the viewer
const DARKEST = 0.55;
const MM = 1e3;
const UP = [0, 0, 1];

/** The palms for joint angles beta, gamma2, gamma3 (rad): normal and pad axes a and b of each. */
export function palmsInSpace([beta, gamma2, gamma3]) {
  const edge = [1, 0, 0], b = [0, Math.cos(beta), Math.sin(beta)], first = [0, -Math.sin(beta), Math.cos(beta)];
  const mixed = (x, up) => plus(scaled(edge, x), b, up);
  return [
    { normal: first, a: edge, b },
    { normal: mixed(Math.cos(gamma2), Math.sin(gamma2)), a: mixed(-Math.sin(gamma2), Math.cos(gamma2)), b: first },
    { normal: mixed(-Math.cos(gamma3), Math.sin(gamma3)), a: mixed(Math.sin(gamma3), Math.cos(gamma3)), b: first },
  ];
}

/** The corners of the convex hull of planar points, in order. */
export function hull(points) {
  const sorted = [...points].sort(([x, y], [u, v]) => x - u || y - v);
  const half = (row) => {
    const kept = [];
    for (const point of row) {
      while (kept.length > 1 && turns(kept.at(-2), kept.at(-1), point) <= 0) kept.pop();
      kept.push(point);
    }
    return kept.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

function turns([x0, y0], [x1, y1], [x2, y2]) {
  return (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0);
}

export class SpaceView {
  #from = { ...FROM };

  /** Rotates the view direction (rad). */
  turn(around, above) {
    this.#from.around += around;
    this.#from.above = Math.max(-STEEPEST, Math.min(STEEPEST, this.#from.above + above));
  }

  /** Restores the initial view. */
  reset() {
    this.#from = { ...FROM };
  }

  /** Draws the contents of `store` at `now` (ms) on a cleared canvas of the given size. */
  draw(context, { width, height, ratio }, store, now) {
    const info = store.get("palm/info"), estimate = store.get("palm/estimate");
    const joints = info.joints?.map((joint) => estimate[`${joint}_rad`]) ?? [];
    if (!(info.pad_side_m > 0) || joints.length !== 3 || !joints.every(Number.isFinite)) return;
    const palms = palmsInSpace(joints).map((palm, i) => padOf(palm, info, info.palms[i]));
    const scale = Math.min(width, height) / (SEEN * info.pad_side_m);
    const middle = scaled(palms.reduce((sum, { centre }) => plus(sum, centre), [0, 0, 0]), 1 / palms.length);
    const eye = this.#eye();
    const project = (point) => {
      const offset = plus(point, middle, -1);
      return [width / 2 + dot(offset, eye.right) * scale, height / 2 - dot(offset, eye.up) * scale];
    };
    const seen = { context, ratio, eye, project, scale };
    const behind = ({ normal }) => dot(normal, eye.towards) > 0; // a palm whose inner side is visible is behind the body
    for (const palm of palms.filter(behind)) drawPad(seen, palm, 0.3);
    const com = [estimate.com_x_m, estimate.com_y_m, estimate.com_z_m];
    const shape = store.get("palm/shape"), object = store.get("rig/object");
    if (shape.h_m && com.every(Number.isFinite) && estimate.quat_xyzw.every(Number.isFinite)) {
      drawBody(seen, shape, rotation(estimate.quat_xyzw), com, estimate.valid);
    }
    const truth = store.get("rig/truth");
    if (store.truthful(now)) {
      drawGhost(seen, object, rotation(truth.quat_xyzw), [truth.com_x_m, truth.com_y_m, truth.com_z_m]);
    }
    for (const palm of palms.filter((palm) => !behind(palm))) drawPad(seen, palm, 0.12);
    for (const palm of palms) drawContact(seen, palm, estimate, store.get("palm/contact"));
    drawScale(seen, height);
  }

  #eye() {
    const { around, above } = this.#from;
    const towards = [Math.cos(above) * Math.sin(around), -Math.cos(above) * Math.cos(around), Math.sin(above)];
    const right = unit(cross(UP, towards));
    return { towards, right, up: cross(towards, right) };
  }
}

function padOf(palm, info, number) {
  const [a, b] = info[`pad${number}_centre_m`];
  return { ...palm, number, half: info.pad_side_m / 2, centre: plus(scaled(palm.a, a), palm.b, b) };
}

function drawPad({ context, project, ratio }, { number, centre, half, a, b }, filled) {
  const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([u, v]) => project(plus(plus(centre, a, u * half), b, v * half)));
  const path = polygon(corners);
  context.fillStyle = context.strokeStyle = ofPalm(number);
  context.globalAlpha = filled;
  context.fill(path);
  context.globalAlpha = 1;
  context.lineWidth = 1.5 * ratio;
  context.stroke(path);
  const apex = project([0, 0, 0]);
  const farthest = corners.reduce((far, each) => (distance(each, apex) > distance(far, apex) ? each : far));
  write(context, `palm ${number}`, farthest, ofPalm(number), ratio, 600);
}

/** Draws every triangle that faces the viewer, coloured by class of standard deviation and shaded by the light. */
function drawBody({ context, project, eye, ratio }, shape, turn, com, valid) {
  const { sphere, surface: { points } } = surfaceOf(shape);
  const inWorld = points.map((point) => plus(turned(turn, point), com));
  const flat = inWorld.map(project);
  const paths = new Map();
  for (const [i, j, k] of sphere.faces) {
    if (turns(flat[i], flat[j], flat[k]) >= 0) continue; // y goes down on a canvas
    const normal = unit(cross(plus(inWorld[j], inWorld[i], -1), plus(inWorld[k], inWorld[i], -1)));
    const lit = dot([dot(normal, eye.right), dot(normal, eye.up), dot(normal, eye.towards)], LIGHT);
    const shade = Math.round(Math.max(0, lit) * SHADES);
    const error = classOf(Math.max(shape.h_sd_m[i], shape.h_sd_m[j], shape.h_sd_m[k]));
    const key = error * (SHADES + 1) + shade;
    if (!paths.has(key)) paths.set(key, new Path2D());
    const path = paths.get(key);
    path.moveTo(...flat[i]);
    path.lineTo(...flat[j]);
    path.lineTo(...flat[k]);
    path.closePath();
  }
  context.globalAlpha = valid ? 1 : 0.45;
  context.lineWidth = 0.7 * ratio; // no seams
  for (const [key, path] of paths) {
    const bright = DARKEST + (1 - DARKEST) * ((key % (SHADES + 1)) / SHADES);
    context.fillStyle = context.strokeStyle = darkened(colours[`error${Math.floor(key / (SHADES + 1))}`], bright);
    context.fill(path);
    context.stroke(path);
  }
  context.globalAlpha = 1;
}

/** Draws the truth's contour at its own pose, dashed. */
function drawGhost({ context, project, ratio }, object, turn, com) {
  const { points } = surfaceOf(object).surface;
  context.save();
  context.strokeStyle = colours.truth;
  context.lineWidth = 1.5 * ratio;
  context.setLineDash([6 * ratio, 4 * ratio]);
  context.stroke(polygon(hull(points.map((point) => project(plus(turned(turn, point), com))))));
  context.restore();
}

function drawContact({ context, project, ratio }, { number, normal, a, b }, estimate, contact) {
  const [x, y] = ["a", "b"].map((side) => (estimate.valid ? estimate : contact)[`${side}${number}_m`]);
  if (!contact[`touch${number}`] || !Number.isFinite(x) || !Number.isFinite(y)) return;
  const place = plus(scaled(a, x), b, y);
  const force = estimate[`f${number}_n`];
  const [from, to] = [place, plus(place, normal, Math.min(force * 12, 30) / MM)].map(project);
  if (force > 0) {
    arrow(context, from, to, ofPalm(number), ratio);
    write(context, `${force.toFixed(2)} N`, [from[0], from[1] + 16 * ratio], ofPalm(number), ratio, 600);
  }
  mark(context, from, ofPalm(number), ratio);
}

function drawScale({ context, ratio, scale }, height) {
  const [x, y] = [18 * ratio, height - 18 * ratio];
  context.strokeStyle = colours.ink;
  context.lineWidth = 1.5 * ratio;
  line(context, [x, y], [x + 10e-3 * scale, y]);
  write(context, "10 mm", [x + 5e-3 * scale, y - 10 * ratio], colours.ink, ratio, 400);
}

function distance([x, y], [u, v]) {
  return Math.hypot(x - u, y - v);
}

/** A colour #rrggbb with its brightness multiplied by `bright`. */
function darkened(colour, bright) {
  return `rgb(${[1, 3, 5].map((i) => Math.round(parseInt(colour.slice(i, i + 2), 16) * bright)).join(" ")})`;
}
