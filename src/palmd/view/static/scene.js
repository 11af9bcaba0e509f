// The palms, the estimated object, and the rig's truth, drawn in mm relative to the hinge with gravity downwards.

import { centreFromRadii, chords, MM, onPalm, outline, posture, DEFAULT_PAD_MM, THICK_MM } from "./geometry.js";
import { CLASSES_M, classOf } from "./knowledge.js";
import { arrow, dash, disc, line, mark, place, ring, write } from "./paths.js";
import { palmsOf } from "./quantities.js";
import { inSpace } from "./surface.js";
import { SYSTEMS } from "./systems.js";
import { colours, ofPalm } from "./theme.js";
import { truthDifference, truthAt } from "./truth.js";

// Visible area and its part below the hinge, in pad lengths
const VIEW = { width: 2.7, height: 1.66, below: 0.235 };
const FORCE_MM_PER_N = 12;
const GRID_MM = 10;
// Half-width of a palm's label, in CSS pixels
const LABEL_HALF = 16;
const ARC_POINTS = 32; // points of a curved palm
// Drawn length of a curved palm in pad lengths: longer arcs would meet
const ARC_FRACTION = 1.2;
// Line widths of the outline, for each class of its error
const WIDTHS = [3.4, 2.8, 2.2, 1.6, 1];
// Rotation of a view of space per pixel; per key:
const RAD_PER_PIXEL = 0.01;
const KEYS = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };

/** A function that loads a module at its first call and returns null until it is there; then calls `onLoaded`. */
function loadLater(load, make, onLoaded) {
  let [requested, made] = [false, null];
  return () => {
    if (!requested) {
      requested = true;
      load().then((module) => {
        made = make(module);
        onLoaded();
      });
    }
    return made;
  };
}

export class Scene {
  #space = loadLater(() => import("./space.js"), ({ SpaceView }) => new SpaceView(), () => this.#renew());
  #lens = loadLater(() => import("./lens.js"), ({ Lens }) => new Lens(), () => this.#renew());
  #others = SYSTEMS.map(({ drawing }) => loadLater(drawing, ({ draw }) => draw, () => this.#renew()));
  #lensOn = false;
  // Magnification of the lens; 0 while it shows nothing
  #factor = 0;
  // CSS pixels in the canvas; null while there is none
  #pointer = null;
  #scale = 1; // pixels per mm
  #below = 0; // visible mm below the hinge
  #canvas;
  #context;
  #pixels = { width: 0, height: 0, ratio: 1 };
  // The message that #paths belong to
  #shape = null;
  #points = null;
  #paths = null;
  #truthShape = null;
  #truthPath = null;
  #turns = false;
  #renew;

  /** `renew` is called when the picture must be redrawn without new data. */
  constructor(canvas, renew) {
    [this.#canvas, this.#renew] = [canvas, renew];
    this.#context = canvas.getContext("2d", { alpha: false });
    new ResizeObserver(() => this.#resize()).observe(canvas);
    this.#resize();
    canvas.addEventListener("pointermove", ({ offsetX, offsetY }) => this.#point([offsetX, offsetY]));
    canvas.addEventListener("pointerleave", () => this.#point(null));
    canvas.addEventListener("pointerdown", ({ pointerId }) => canvas.setPointerCapture(pointerId));
    canvas.addEventListener("pointermove", ({ buttons, movementX, movementY }) => {
      if (buttons & 1) this.#turn(-movementX * RAD_PER_PIXEL, movementY * RAD_PER_PIXEL);
    });
    canvas.addEventListener("dblclick", () => {
      this.#space()?.reset();
      this.#renew();
    });
    canvas.addEventListener("keydown", (event) => {
      if (!this.#turns || !(event.key in KEYS)) return;
      event.preventDefault();
      this.#turn(...KEYS[event.key]);
    });
  }

  /** Whether an outline is known. */
  get shaped() {
    return this.#paths !== null;
  }

  /** Current magnification of the lens; 0 while it shows nothing. */
  get factor() {
    return this.#lensOn ? this.#factor : 0;
  }

  /** Switches the lens on or off. */
  setLens(on) {
    this.#lensOn = on;
    this.#renew();
  }

  #point(place) {
    this.#pointer = place;
    if (this.#lensOn) this.#renew();
  }

  /** Draws the contents of `store` at `now` (ms). */
  draw(store, now) {
    const estimate = store.get("palm/estimate");
    const other = SYSTEMS.findIndex(({ isOwn }) => isOwn(estimate));
    if (other >= 0) {
      this.#factor = 0;
      this.#others[other]()?.(this, this.#context, store, now);
      return;
    }
    this.#inSpace(inSpace(estimate));
    if (inSpace(estimate)) {
      this.#drawSpace(store, now);
      return;
    }
    const palms = palmsOf(store.get("palm/info"));
    const joints = jointsOf(palms, estimate, store.get("palm/motion"));
    this.#factor = 0;
    this.begin(Math.max(...palms.map(({ padM }) => padM ?? 0)) * MM || DEFAULT_PAD_MM);
    if (!joints) return;
    const stance = posture(palms, joints);
    const radii = palms.map(({ number }) => estimate[`r${number}_m`]);
    const touching = palms.map(({ number }, i) => onPalm(stance[i], estimate[`s${number}_m`] || 0));
    const centre = radii.every(Number.isFinite) ? centreFromRadii(touching, radii) : null;
    const hinge = centre && known(estimate, "com_x_m", "com_y_m")
      ? [estimate.com_x_m - centre[0], estimate.com_y_m - centre[1]] : null;
    this.#drawGrid(hinge);
    const truth = hinge && store.truthful(now) ? truthAt(store, estimate) : null;
    const turned = centre && Number.isFinite(estimate.psi_rad);
    if (turned) this.learnShape(store.get("palm/shape"));
    if (turned && this.#paths) this.drawObject(estimate, centre);
    if (truth) this.drawTruth(store.get("rig/object"), truth, hinge);
    const contact = store.get("palm/contact");
    palms.forEach((palm, i) => this.#drawPalm(palm, stance[i]));
    this.#drawHinge();
    const contacts = palms.map((palm, i) => this.drawContact(palm, stance[i], estimate, contact));
    if (centre) this.#drawCentre(centre, estimate.psi_rad);
    this.drawScale();
    if (this.#lensOn && turned && this.#paths && estimate.valid) {
      const truthOffset = truth && truthDifference(this.#points, store.get("rig/object"), truth, estimate);
      this.#drawLens(estimate, centre, truthOffset, contacts.find(Boolean));
    }
  }

  // -- three palms in space -----------------------------------------------------------------------------------------

  #drawSpace(store, now) {
    this.#factor = 0;
    this.#context.setTransform(1, 0, 0, 1, 0, 0);
    this.#clear();
    this.#space()?.draw(this.#context, this.#pixels, store, now);
  }

  /** Enables rotation of a view of space by the pointer or, with focus, by the arrow keys. */
  #inSpace(turns) {
    if (turns === this.#turns) return;
    this.#turns = turns;
    this.#canvas.tabIndex = turns ? 0 : -1;
    this.#canvas.classList.toggle("turns", turns);
  }

  #turn(around, above) {
    if (!this.#turns) return;
    this.#space()?.turn(around, above);
    this.#renew();
  }

  // -- outlines ---------------------------------------------------------------------------------------------------

  learnShape(shape) {
    if (shape === this.#shape || !shape.h_m) return;
    this.#shape = shape;
    this.#points = outline(shape.theta_rad, shape.h_m);
    this.#paths = { body: ring(this.#points), arcs: arcs(this.#points, shape.h_sd_m), chords: new Path2D() };
    for (const [begin, end] of chords(shape.theta_rad, shape.h_m, shape.touched)) {
      this.#paths.chords.moveTo(begin[0] * MM, begin[1] * MM);
      this.#paths.chords.lineTo(end[0] * MM, end[1] * MM);
    }
  }

  drawObject(estimate, centre) {
    const context = this.#context;
    context.save();
    context.translate(centre[0] * MM, centre[1] * MM);
    context.rotate(estimate.psi_rad);
    context.globalAlpha = estimate.valid ? 1 : 0.45;
    context.fillStyle = colours["estimate-fill"];
    context.fill(this.#paths.body);
    context.lineCap = context.lineJoin = "round";
    this.#paths.arcs.forEach((path, error) => {
      context.strokeStyle = colours[`error${error}`];
      context.lineWidth = this.thin(WIDTHS[error]);
      context.stroke(path);
    });
    dash(context, this.#paths.chords, this.thin(1), colours.panel);
    context.restore();
  }

  /** Draws the truth at its own pose, dashed. */
  drawTruth(object, truth, hinge) {
    const context = this.#context;
    if (object.h_m !== this.#truthShape) {
      this.#truthShape = object.h_m;
      this.#truthPath = ring(outline(object.theta_rad, object.h_m));
    }
    context.save();
    context.translate((truth.com_x_m - hinge[0]) * MM, (truth.com_y_m - hinge[1]) * MM);
    context.rotate(truth.psi_rad);
    dash(context, this.#truthPath, this.thin(1));
    context.restore();
  }

  /** Draws the lens at the outline point nearest to the pointer, else to the first contact, else at the first normal. */
  #drawLens(estimate, centre, truthOffset, contact) {
    const { ratio, width, height } = this.#pixels;
    const pointed = this.#pointer && [
      (this.#pointer[0] * ratio - width / 2) / this.#scale,
      (height - this.#pointer[1] * ratio) / this.#scale - this.#below,
    ];
    const lens = this.#lens();
    lens?.draw(this.#context, {
      points: this.#points, sds: this.#shape.h_sd_m, truthOffset, centre, psi: estimate.psi_rad, target: pointed ?? contact,
      screen: { ratio, width, height, scale: this.#scale, below: this.#below },
    });
    this.#factor = lens?.factor ?? 0;
  }

  #drawCentre([x, y], psi) {
    const context = this.#context;
    const size = this.thin(6);
    context.save();
    context.translate(x * MM, y * MM);
    context.lineWidth = this.thin(1.5);
    context.strokeStyle = colours.ink;
    if (Number.isFinite(psi)) {
      context.rotate(psi);
      line(context, [size, 0], [size * 2.6, 0]); // the object's x axis
    }
    disc(context, [0, 0], size, colours.panel);
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

  /** Draws a palm in full length, even beyond the picture, and its pad if its length is known. */
  #drawPalm({ number, lengthM, padM }, palm) {
    const length = (lengthM ?? 1) * MM;
    const pad = (padM ?? 0) * MM;
    const context = this.#context;
    const { along, normal, curvature } = palm;
    if (curvature) {
      this.#drawArc(palm, 0, Math.min(length, ARC_FRACTION * (pad || DEFAULT_PAD_MM)), THICK_MM, colours.line);
      this.#drawArc(palm, 0.5, pad, THICK_MM * 0.42, ofPalm(number));
    } else {
      context.save();
      context.transform(...along, ...normal, 0, 0); // x along the surface, y towards the object
      context.fillStyle = colours.line;
      context.beginPath();
      context.roundRect(0, -THICK_MM, length, THICK_MM, [0, 0.8, 0.8, 0]);
      context.fill();
      context.fillStyle = ofPalm(number);
      context.fillRect(0.5, -THICK_MM * 0.42, pad, THICK_MM * 0.42);
      context.restore();
    }
    this.label(`palm ${number}`, pad || DEFAULT_PAD_MM, palm, ofPalm(number));
  }

  /** Draws a strip below the surface of a curved palm between two arc lengths (mm). */
  #drawArc(palm, from, to, thick, colour) {
    const context = this.#context;
    const edge = Array.from({ length: ARC_POINTS + 1 }, (_, i) => onPalm(palm, (from + ((to - from) * i) / ARC_POINTS) / MM));
    context.beginPath();
    for (const { point } of edge) context.lineTo(point[0] * MM, point[1] * MM);
    for (const { point, normal } of edge.reverse()) {
      context.lineTo(point[0] * MM - normal[0] * thick, point[1] * MM - normal[1] * thick);
    }
    context.fillStyle = colour;
    context.fill();
  }

  #drawHinge() {
    disc(this.#context, [0, -THICK_MM / 2], THICK_MM * 0.8, colours.line);
    disc(this.#context, [0, -THICK_MM / 2], THICK_MM * 0.3, colours.panel);
  }

  /** Draws the contact with a palm and its force; returns its position (mm), null for none. */
  drawContact({ number }, palm, estimate, contact) {
    const s = estimate.valid ? estimate[`s${number}_m`] : contact[`s${number}_m`];
    if (!contact[`touch${number}`] || !Number.isFinite(s)) return null;
    const { point: place, normal } = onPalm(palm, s);
    const point = [place[0] * MM, place[1] * MM];
    this.#drawForce(estimate[`f${number}_n`], point, normal, ofPalm(number));
    mark(this.#context, point, ofPalm(number), this.thin(1));
    return point;
  }

  /** Writes a label below the surface, `s` mm from the hinge, shifted sideways on steep surfaces. */
  label(text, s, palm, colour) {
    const out = -THICK_MM - this.thin(11);
    const { point, normal } = onPalm(palm, s / MM);
    const x = point[0] * MM + normal[0] * (out - this.thin(LABEL_HALF));
    this.write(text, x, point[1] * MM + normal[1] * out, colour, 600);
  }

  #drawForce(force, point, normal, colour) {
    if (!(force > 0)) return;
    const length = Math.min(force * FORCE_MM_PER_N, 30);
    arrow(this.#context, point, [point[0] + normal[0] * length, point[1] + normal[1] * length], colour, this.thin(1));
    const below = -THICK_MM - this.thin(13);
    const beside = this.thin(14) * Math.sign(-normal[0]);
    this.write(`${force.toFixed(2)} N`, point[0] + normal[0] * below + beside, point[1] + normal[1] * below, colour, 600);
  }

  // -- surroundings -----------------------------------------------------------------------------------------------

  /** Clears the picture for pads of this length. */
  begin(padMm) {
    const { width, height } = this.#pixels;
    const context = this.#context;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.setLineDash([]);
    context.globalAlpha = 1;
    this.#clear();
    const scale = Math.min(width / VIEW.width, height / VIEW.height) / padMm;
    this.#scale = scale;
    this.#below = VIEW.below * padMm;
    context.setTransform(scale, 0, 0, -scale, width / 2, height - this.#below * scale);
  }

  /** Fills the opaque background, so that the browser need not blend. */
  #clear() {
    this.#context.fillStyle = colours.panel;
    this.#context.fillRect(0, 0, this.#pixels.width, this.#pixels.height);
  }

  /** Draws a grid fixed to the world, which shows the motion of the hinge. */
  #drawGrid(hinge) {
    if (!hinge) return;
    const context = this.#context;
    const { width, height } = this.#pixels;
    const half = width / this.#scale / 2;
    const top = height / this.#scale - this.#below;
    context.strokeStyle = colours.faint;
    context.lineWidth = this.thin(1);
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

  drawScale() {
    const context = this.#context;
    const left = -this.#pixels.width / this.#scale / 2 + this.thin(18);
    const y = -this.#below + 4;
    context.strokeStyle = colours.ink;
    context.lineWidth = this.thin(1.5);
    line(context, [left, y], [left + 10, y]);
    this.write("10 mm", left + 5, y + this.thin(10), colours.ink, 400);
  }

  write(text, x, y, colour, weight) {
    const context = this.#context;
    context.save();
    context.translate(x, y);
    context.scale(1 / this.#scale, -1 / this.#scale);
    write(context, text, [0, 0], colour, this.#pixels.ratio, weight);
    context.restore();
  }

  /** Converts CSS pixels to mm. */
  thin(pixels) {
    return (pixels * this.#pixels.ratio) / this.#scale;
  }

  #resize() {
    const ratio = devicePixelRatio || 1;
    const { width, height } = this.#canvas.getBoundingClientRect();
    this.#canvas.width = Math.round(width * ratio);
    this.#canvas.height = Math.round(height * ratio);
    this.#pixels = { width: this.#canvas.width, height: this.#canvas.height, ratio };
    this.#renew();
  }
}

/** The joint angles (rad) from the first source that has all; null for none. */
function jointsOf(palms, ...sources) {
  const names = palms.map(({ joint }) => `${joint}_rad`);
  const source = sources.find((fields) => known(fields, ...names));
  return source ? names.map((name) => source[name]) : null;
}

function known(fields, ...names) {
  return names.every((name) => Number.isFinite(fields[name]));
}

/** The parts of the outline by class of standard deviation, the smallest first; each part is one line, which is quick to draw. */
function arcs(points, sds) {
  const paths = [...CLASSES_M, Infinity].map(() => new Path2D());
  const count = sds.length;
  let path = null;
  for (let i = 0; i < count; i++) {
    const next = (i + 1) % count;
    const before = path;
    path = paths[classOf(Math.max(sds[i], sds[next]))];
    if (path !== before) path.moveTo(...place(points, i, 0));
    path.lineTo(...place(points, next, 0));
  }
  return paths;
}
