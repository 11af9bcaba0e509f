// A lens in an upper corner of the scene: a magnified piece of the outline with band and truth.

import { magnification } from "./geometry.js";
import { classOf } from "./knowledge.js";
import { dash, disc, line, place, polygon, ring } from "./paths.js";
import { colours } from "./theme.js";

const RADIUS = 84; // CSS pixels, less in a small picture
const SHARE = 0.2; // largest radius as a fraction of the picture's height
const MARGIN = 10;
const BAND_SDS = 2;
const BAND_SHARE = 0.45; // largest half-width of the band as a fraction of the radius
const MM = 1e3;

export class Lens {
  factor = 0; // magnification; 0 while nothing is shown
  #before = 5;
  #right = true;

  /**
   * Draws the part of the outline nearest to `target` (mm). `points` in the object's frame with standard deviations `sds` (m)
   * and, if the truth is known, `truthOffset` (m), its distance outside the estimate; the frame is at `centre` (m), rotated by
   * `psi` (rad).
   */
  draw(context, { points, sds, truthOffset, centre, psi, target, screen }) {
    const { ratio, width, height, scale, below } = screen;
    const nearest = nearestTo(points, centre, psi, target);
    const radius = Math.min(RADIUS * ratio, SHARE * height);
    this.factor = this.#before = magnification(BAND_SDS * sds[nearest] * MM * scale, BAND_SHARE * radius, this.#before);
    const [px, py] = world(points, centre, psi, nearest);
    const seen = [px * scale + width / 2, height - (py + below) * scale];
    const y = radius + MARGIN * ratio;
    const x = this.#centreX(centre[0] * MM * scale, y, width);
    context.save();
    context.setTransform(1, 0, 0, 1, 0, 0);
    this.#drawRim(context, [x, y], radius, seen, ratio);
    context.translate(x, y);
    context.scale(scale * this.factor, -scale * this.factor);
    context.rotate(psi);
    context.translate(...place(points, nearest, 0).map((each) => -each));
    const thin = ratio / (scale * this.factor);
    const near = pieceOf(points, nearest, radius / (scale * this.factor) / MM);
    const band = near.map((i) => place(points, i, BAND_SDS * sds[i]))
      .concat(near.toReversed().map((i) => place(points, i, -BAND_SDS * sds[i])));
    context.fillStyle = colours.band;
    context.fill(polygon(band));
    context.strokeStyle = colours[`error${classOf(sds[nearest])}`];
    context.lineWidth = 2.4 * thin;
    context.stroke(ring(points));
    if (truthOffset) dash(context, ring(points, truthOffset), thin);
    context.restore();
    this.#drawFactor(context, [x, y], radius, ratio);
  }

  /** X of the lens' centre: in the upper corner farther from the object, which is `objectX` to the right of the hinge. */
  #centreX(objectX, margin, width) {
    if (Math.abs(objectX) > 0.1 * width) this.#right = objectX < 0;
    return this.#right ? width - margin : margin;
  }

  /** Draws the rim and a line to the magnified point, and clips drawing to the lens. */
  #drawRim(context, [x, y], radius, seen, ratio) {
    const away = Math.hypot(seen[0] - x, seen[1] - y);
    context.strokeStyle = colours.ink;
    context.lineWidth = 1.2 * ratio;
    if (away > radius) {
      line(context, [x + ((seen[0] - x) / away) * radius, y + ((seen[1] - y) / away) * radius], seen);
    }
    disc(context, seen, 2.5 * ratio, colours.ink);
    disc(context, [x, y], radius, colours.panel);
    context.stroke();
    context.clip();
  }

  #drawFactor(context, [x, y], radius, ratio) {
    context.save();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.font = `650 ${14 * ratio}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.fillStyle = colours.ink;
    context.fillText(`×${this.factor}`, x, y + radius + 16 * ratio);
    context.restore();
  }
}

/** The position of a point of the outline (mm, relative to the hinge). */
function world(points, [cx, cy], psi, i) {
  const [cos, sin] = [Math.cos(psi), Math.sin(psi)];
  const [x, y] = [points.x[i], points.y[i]];
  return [(cx + cos * x - sin * y) * MM, (cy + sin * x + cos * y) * MM];
}

function nearestTo(points, centre, psi, target) {
  if (!target) return 0;
  let [nearest, least] = [0, Infinity];
  for (let i = 0; i < points.x.length; i++) {
    const [x, y] = world(points, centre, psi, i);
    const away = Math.hypot(x - target[0], y - target[1]);
    if (away < least) [nearest, least] = [i, away];
  }
  return nearest;
}

/** The indices of the points around `middle` within `reach` (m) and one beyond, in order. */
function pieceOf(points, middle, reach) {
  const count = points.x.length;
  const far = (i) => Math.hypot(points.x[i] - points.x[middle], points.y[i] - points.y[middle]) > reach;
  let [first, last] = [1, 1];
  while (first < count / 2 && !far((middle + count - first) % count)) first += 1;
  while (last < count / 2 && !far((middle + last) % count)) last += 1;
  return Array.from({ length: first + last + 1 }, (_, i) => (middle + count - first + i) % count);
}
