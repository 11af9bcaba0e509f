// The palms, the object as estimated, and the rig's truth, drawn in mm with the hinge at rest and gravity down.

import { at, centreFromRadii, magnification, outline, palm } from "./geometry.js";
import { seconds } from "./store.js";
import { colours } from "./theme.js";

const VIEW = { width: 2.7, height: 1.66, below: 0.235 }; // what is seen, in pads, and how much of it lies below the hinge
const SOME_PAD_MM = 55.5; // what is seen while nobody has told how long the pads are
const THICK_MM = 3.2;
const FORCE_MM_PER_N = 12;
const GRID_MM = 10;
const BAND_SDS = 2;
const BAND_ROOM_M = 4e-3; // how thick a magnified band may be drawn
const MM = 1e3;

export class Scene {
  factor = 1; // by which errors are drawn larger than they are
  outdated = true; // whether to draw again even if nothing new is known
  #magnified = true;
  #scale = 1; // pixels per mm
  #below = 0; // mm that are seen below the hinge
  #canvas;
  #context;
  #pixels = { width: 0, height: 0, ratio: 1 };
  #shape = null; // the message that #paths belong to
  #points = null;
  #paths = null;
  #truthShape = null;
  #truthPath = null;

  constructor(canvas) {
    this.#canvas = canvas;
    this.#context = canvas.getContext("2d");
    new ResizeObserver(() => this.#resize()).observe(canvas);
    this.#resize();
  }

  /** Whether errors are drawn larger than they are. */
  setMagnified(magnified) {
    this.#magnified = magnified;
    this.#shape = null;
    this.outdated = true;
  }

  /** Draws what `store` knows at `now` (ms). */
  draw(store, now) {
    const estimate = store.get("palm/estimate");
    const motion = store.get("palm/motion");
    const pose = poseOf(estimate, motion);
    const rig = store.get("palm/info");
    this.outdated = false;
    this.#begin(Math.max(rig.pad1_length_m ?? 0, rig.pad2_length_m ?? 0) * MM || SOME_PAD_MM);
    if (!pose) return;
    const truth = store.truthful(now) ? truthAt(store, seconds(estimate)) : null;
    const centre = known(estimate, "r1_m", "r2_m")
      ? centreFromRadii(pose.phi1, pose.phi2, estimate.r1_m, estimate.r2_m) : null;
    const hinge = centre && known(estimate, "com_x_m", "com_y_m")
      ? [estimate.com_x_m - centre[0], estimate.com_y_m - centre[1]] : null;
    this.#drawGrid(hinge);
    if (centre && Number.isFinite(estimate.psi_rad)) {
      this.#learnShape(store.get("palm/shape"));
      if (this.#paths) this.#drawObject(estimate, centre);
      if (this.#points && truth && hinge) this.#drawTruth(store.get("rig/object"), truth, estimate, centre, hinge);
    }
    const contact = store.get("palm/contact");
    for (const number of [1, 2]) this.#drawPalm(number, pose, rig);
    this.#drawHinge();
    for (const number of [1, 2]) this.#drawContact(number, pose, estimate, contact);
    if (centre) this.#drawCentre(centre, estimate.psi_rad);
    this.#drawScale();
  }

  // -- outlines ---------------------------------------------------------------------------------------------------

  #learnShape(shape) {
    if (shape === this.#shape || !shape.h_m) return;
    this.#shape = shape;
    this.#points = outline(shape.theta_rad, shape.h_m);
    const errors = shape.h_sd_m.map((sd) => BAND_SDS * sd);
    this.factor = this.#magnified ? magnification(errors, BAND_ROOM_M, this.factor) : 1;
    const half = errors.map((error) => error * this.factor);
    const band = ring(this.#points, half);
    band.addPath(ring(this.#points, half.map((width) => -width)));
    this.#paths = { body: ring(this.#points), band, ...arcs(this.#points, shape.touched) };
  }

  #drawObject(estimate, centre) {
    const { body, band, touched, rest } = this.#paths;
    const context = this.#context;
    context.save();
    context.translate(centre[0] * MM, centre[1] * MM);
    context.rotate(estimate.psi_rad);
    context.globalAlpha = estimate.valid ? 1 : 0.45;
    context.fillStyle = colours["estimate-fill"];
    context.fill(body);
    context.fillStyle = colours.band;
    context.fill(band, "evenodd");
    context.strokeStyle = colours.estimate;
    context.lineJoin = "round";
    context.lineWidth = this.#thin(1.2);
    context.globalAlpha *= 0.45;
    context.stroke(rest);
    context.globalAlpha = estimate.valid ? 1 : 0.45;
    context.lineWidth = this.#thin(2.6);
    context.stroke(touched);
    context.restore();
  }

  /** The truth, dashed. Magnified, its distance from the estimate along each normal is, and its place is the estimate's. */
  #drawTruth(object, truth, estimate, centre, hinge) {
    const context = this.#context;
    context.save();
    if (this.factor === 1) {
      if (object.h_m !== this.#truthShape) {
        this.#truthShape = object.h_m;
        this.#truthPath = ring(outline(object.theta_rad, object.h_m));
      }
      context.translate((truth.com_x_m - hinge[0]) * MM, (truth.com_y_m - hinge[1]) * MM);
      context.rotate(truth.psi_rad);
      this.#dash(this.#truthPath);
    } else {
      const points = this.#points;
      const turned = estimate.psi_rad - truth.psi_rad;
      const off = Array.from(points.theta, (theta, i) => {
        const error = at(object.h_m, theta + turned) - points.h[i];
        return Math.max(-points.h[i] / 2, Math.min(points.h[i] / 2, error * this.factor));
      });
      context.translate(centre[0] * MM, centre[1] * MM);
      context.rotate(estimate.psi_rad);
      this.#dash(ring(points, off));
    }
    context.restore();
  }

  #dash(path) {
    const context = this.#context;
    context.strokeStyle = colours.truth;
    context.lineWidth = this.#thin(1.5);
    context.setLineDash([this.#thin(6), this.#thin(4)]);
    context.stroke(path);
  }

  #drawCentre([x, y], psi) {
    const context = this.#context;
    const size = this.#thin(6);
    context.save();
    context.translate(x * MM, y * MM);
    context.lineWidth = this.#thin(1.5);
    context.strokeStyle = context.fillStyle = colours.ink;
    if (Number.isFinite(psi)) {
      context.rotate(psi);
      line(context, [size, 0], [size * 2.6, 0]); // where the object's own x axis points
    }
    context.beginPath();
    context.arc(0, 0, size, 0, 2 * Math.PI);
    context.fillStyle = colours.panel;
    context.fill();
    context.stroke();
    context.fillStyle = colours.ink;
    for (const quarter of [0, Math.PI]) {
      context.beginPath();
      context.moveTo(0, 0);
      context.arc(0, 0, size, quarter, quarter + Math.PI / 2);
      context.fill();
    }
    context.restore();
  }

  // -- palms ------------------------------------------------------------------------------------------------------

  /** The palm in its length, which may lead out of the picture, and the pad on it; no pad while its length is unknown. */
  #drawPalm(number, pose, rig) {
    const { along, normal } = palm(number, pose.phi1, pose.phi2);
    const length = (rig[`palm${number}_length_m`] ?? 1) * MM;
    const pad = (rig[`pad${number}_length_m`] ?? 0) * MM;
    const context = this.#context;
    context.save();
    context.transform(...along, ...normal, 0, 0); // x along the surface, y towards the object
    context.fillStyle = colours.line;
    context.beginPath();
    context.roundRect(0, -THICK_MM, length, THICK_MM, [0, 0.8, 0.8, 0]);
    context.fill();
    context.fillStyle = colours[`palm${number}`];
    context.fillRect(0.5, -THICK_MM * 0.42, pad, THICK_MM * 0.42);
    context.restore();
    this.#label(`palm ${number}`, pad || SOME_PAD_MM, along, normal, colours[`palm${number}`]);
  }

  #drawHinge() {
    const context = this.#context;
    context.beginPath();
    context.arc(0, -THICK_MM / 2, THICK_MM * 0.8, 0, 2 * Math.PI);
    context.fillStyle = colours.line;
    context.fill();
    context.beginPath();
    context.arc(0, -THICK_MM / 2, THICK_MM * 0.3, 0, 2 * Math.PI);
    context.fillStyle = colours.panel;
    context.fill();
  }

  #drawContact(number, pose, estimate, contact) {
    const { along, normal } = palm(number, pose.phi1, pose.phi2);
    const colour = colours[`palm${number}`];
    const context = this.#context;
    const s = estimate.valid ? estimate[`s${number}_m`] : contact[`s${number}_m`];
    if (!contact[`touch${number}`] || !Number.isFinite(s)) return;
    const point = [along[0] * s * MM, along[1] * s * MM];
    this.#drawForce(estimate[`f${number}_n`], point, normal, colour);
    context.beginPath();
    context.arc(...point, this.#thin(5), 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.fill();
    context.lineWidth = this.#thin(1.8);
    context.strokeStyle = colours.panel;
    context.stroke();
  }

  /** Below the surface, `s` mm from the hinge. */
  #label(text, s, along, normal, colour) {
    const out = -THICK_MM - this.#thin(11);
    this.#write(text, along[0] * s + normal[0] * out, along[1] * s + normal[1] * out, colour, 600);
  }

  #drawForce(force, point, normal, colour) {
    if (!(force > 0)) return;
    const context = this.#context;
    const length = Math.min(force * FORCE_MM_PER_N, 30);
    const head = Math.min(this.#thin(10), length * 0.6);
    const tip = [point[0] + normal[0] * length, point[1] + normal[1] * length];
    const neck = [tip[0] - normal[0] * head, tip[1] - normal[1] * head];
    const wide = [-normal[1] * head * 0.42, normal[0] * head * 0.42];
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = this.#thin(3);
    line(context, point, neck);
    context.beginPath();
    context.moveTo(...tip);
    context.lineTo(neck[0] + wide[0], neck[1] + wide[1]);
    context.lineTo(neck[0] - wide[0], neck[1] - wide[1]);
    context.fill();
    const below = -THICK_MM - this.#thin(13);
    const beside = this.#thin(14) * Math.sign(-normal[0]);
    this.#write(`${force.toFixed(2)} N`, point[0] + normal[0] * below + beside, point[1] + normal[1] * below, colour, 600);
  }

  // -- surroundings -----------------------------------------------------------------------------------------------

  /** Clears the picture for pads of this length. */
  #begin(padMm) {
    const { width, height } = this.#pixels;
    const context = this.#context;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.setLineDash([]);
    context.globalAlpha = 1;
    context.clearRect(0, 0, width, height);
    const scale = Math.min(width / VIEW.width, height / VIEW.height) / padMm;
    this.#scale = scale;
    this.#below = VIEW.below * padMm;
    context.setTransform(scale, 0, 0, -scale, width / 2, height - this.#below * scale);
  }

  /** A grid that stands in the world, so that the hinge is seen to move. */
  #drawGrid(hinge) {
    if (!hinge) return;
    const context = this.#context;
    const { width, height } = this.#pixels;
    const half = width / this.#scale / 2;
    const top = height / this.#scale - this.#below;
    context.strokeStyle = colours.faint;
    context.lineWidth = this.#thin(1);
    context.beginPath();
    const [x0, y0] = hinge.map((place) => place * MM);
    for (let x = Math.ceil((x0 - half) / GRID_MM) * GRID_MM; x < x0 + half; x += GRID_MM) {
      context.moveTo(x - x0, -this.#below);
      context.lineTo(x - x0, top);
    }
    for (let y = Math.ceil((y0 - this.#below) / GRID_MM) * GRID_MM; y < y0 + top; y += GRID_MM) {
      context.moveTo(-half, y - y0);
      context.lineTo(half, y - y0);
    }
    context.stroke();
  }

  #drawScale() {
    const context = this.#context;
    const left = -this.#pixels.width / this.#scale / 2 + this.#thin(18);
    const y = -this.#below + 4;
    context.strokeStyle = colours.ink;
    context.lineWidth = this.#thin(1.5);
    line(context, [left, y], [left + 10, y]);
    this.#write("10 mm", left + 5, y + this.#thin(10), colours.ink, 400);
  }

  #write(text, x, y, colour, weight) {
    const context = this.#context;
    context.save();
    context.translate(x, y);
    context.scale(1 / this.#scale, -1 / this.#scale);
    context.font = `${weight} ${12 * this.#pixels.ratio}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineWidth = 3 * this.#pixels.ratio;
    context.lineJoin = "round";
    context.strokeStyle = colours.panel;
    context.strokeText(text, 0, 0);
    context.fillStyle = colour;
    context.fillText(text, 0, 0);
    context.restore();
  }

  /** So many CSS pixels, in mm. */
  #thin(pixels) {
    return (pixels * this.#pixels.ratio) / this.#scale;
  }

  #resize() {
    const ratio = devicePixelRatio || 1;
    const { width, height } = this.#canvas.getBoundingClientRect();
    this.#canvas.width = Math.round(width * ratio);
    this.#canvas.height = Math.round(height * ratio);
    this.outdated = true;
    this.#pixels = { width: this.#canvas.width, height: this.#canvas.height, ratio };
  }
}

/** The palms' angles: as estimated, else as the arm reports them; null for none. */
function poseOf(estimate, motion) {
  for (const told of [estimate, motion]) {
    if (known(told, "phi1_rad", "phi2_rad")) return { phi1: told.phi1_rad, phi2: told.phi2_rad };
  }
  return null;
}

/** What the rig says of the estimate's own instant: both come at 100 Hz, but not at the same times. */
function truthAt(store, t) {
  const place = store.truths.place(t);
  const latest = store.get("rig/truth");
  if (!place) return latest;
  const between = (name) => store.truths.between(name, place);
  return { psi_rad: between("psi_rad"), com_x_m: between("com_x_m"), com_y_m: between("com_y_m") };
}

function known(fields, ...names) {
  return names.every((name) => Number.isFinite(fields[name]));
}

/** A closed path (mm) through the outline's points, each moved by `off` (m) along its normal. */
function ring(points, off) {
  const path = new Path2D();
  for (let i = 0; i < points.x.length; i++) path.lineTo(...place(points, i, off?.[i] ?? 0));
  path.closePath();
  return path;
}

/** The parts of the outline where `touched` is 1, and the rest. */
function arcs(points, felt) {
  const touched = new Path2D();
  const rest = new Path2D();
  const count = felt.length;
  for (let i = 0; i < count; i++) {
    const next = (i + 1) % count;
    const path = felt[i] && felt[next] ? touched : rest;
    path.moveTo(...place(points, i, 0));
    path.lineTo(...place(points, next, 0));
  }
  return { touched, rest };
}

function place(points, i, off) {
  return [(points.x[i] + off * points.nx[i]) * MM, (points.y[i] + off * points.ny[i]) * MM];
}

function line(context, from, to) {
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
}
