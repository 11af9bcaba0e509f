// Palms, contacts and outlines. Pure. Lengths in m, angles in rad, world axes; equation numbers are CMU-CS-01-107's.

export const MM = 1e3;
export const DEFAULT_PAD_MM = 55.5; // length of pads until it is known
export const THICK_MM = 3.2; // drawn thickness of a palm

/** Each palm at the hinge: its direction away from the hinge (t1, −t2), its normal towards the object, its curvature (1/m). */
export function posture(palms, joints) {
  let angle = 0;
  return palms.map(({ side, curvature }, i) => {
    angle += joints[i];
    const along = [Math.cos(angle), Math.sin(angle)];
    return { along, normal: [-side * along[1], side * along[0]], curvature: curvature ?? 0 };
  });
}

/** The palm at the arc length s (m) from the hinge: point (m), direction and normal; it bends towards its normal by κs. */
export function onPalm({ along, normal, curvature }, s) {
  if (!curvature) return { point: [along[0] * s, along[1] * s], along, normal };
  const [cos, sin] = [Math.cos(curvature * s), Math.sin(curvature * s)];
  const [out, up] = [sin / curvature, (1 - cos) / curvature];
  const mixed = (a, b) => [a * along[0] + b * normal[0], a * along[1] + b * normal[1]];
  return { point: mixed(out, up), along: mixed(cos, sin), normal: mixed(-sin, cos) };
}

/** The centre of mass relative to the hinge from n·(c − point) = r for every contact, by least squares; null if singular. */
export function centreFromRadii(contacts, radii) {
  let [xx, xy, yy, x, y] = [0, 0, 0, 0, 0];
  contacts.forEach(({ normal: [nx, ny], point: [px, py] }, i) => {
    const height = radii[i] + nx * px + ny * py;
    xx += nx * nx;
    xy += nx * ny;
    yy += ny * ny;
    x += nx * height;
    y += ny * height;
  });
  const determinant = xx * yy - xy * xy;
  return determinant > 1e-9 ? [(yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant] : null;
}

/** The outline in the object's frame from its support function: x = h n + h′ n′ (section 3.1), with the normals and h. */
export function outline(theta, h) {
  const count = theta.length;
  const points = { x: new Float64Array(count), y: new Float64Array(count), nx: new Float64Array(count),
    ny: new Float64Array(count), theta, h };
  for (let i = 0; i < count; i++) {
    const [before, after] = [(i + count - 1) % count, (i + 1) % count];
    const slope = (h[after] - h[before]) / turn(theta[after] - theta[before]);
    const [cos, sin] = [Math.cos(theta[i]), Math.sin(theta[i])];
    points.nx[i] = cos;
    points.ny[i] = sin;
    points.x[i] = h[i] * cos - slope * sin;
    points.y[i] = h[i] * sin + slope * cos;
  }
  return points;
}

const STRAIGHT = 4; // STRAIGHT and LEAST as in palmd.chords
const LEAST = 1e-3;

/**
 * The touched straight parts of an outline (flat sides, or dents that the palms bridge): [begin, end] of each (m), the
 * first and last corner of the polygon of neighbouring tangents.
 */
export function chords(theta, h, touched) {
  const count = theta.length;
  const step = (2 * Math.PI) / count;
  const [cos, sin] = [Math.cos(step), Math.sin(step)];
  const limit = STRAIGHT * step * h.reduce((sum, each) => sum + each, 0) / count;
  const straight = h.map((each, i) => (h[(i + count - 1) % count] + h[(i + 1) % count] - 2 * each * cos) / sin > limit);
  if (straight.every(Boolean)) return [];
  const corner = (i) => {
    const slope = (h[(i + 1) % count] - h[i] * cos) / sin;
    return [h[i] * Math.cos(theta[i]) - slope * Math.sin(theta[i]), h[i] * Math.sin(theta[i]) + slope * Math.cos(theta[i])];
  };
  const found = [];
  for (let i = 0; i < count; i++) {
    const before = (i + count - 1) % count;
    if (!straight[i] || straight[before]) continue;
    let [j, anyTouched] = [i, touched[i]];
    while (straight[(j + 1) % count]) {
      j++;
      anyTouched ||= touched[j % count];
    }
    const [begin, end] = [corner(before), corner(j % count)];
    if (anyTouched && Math.hypot(end[0] - begin[0], end[1] - begin[1]) > LEAST) found.push([begin, end]);
  }
  return found;
}

/** Interpolates a function given on evenly spaced directions from 0. */
export function at(values, direction) {
  const position = (turn(direction) / (2 * Math.PI)) * values.length;
  const low = Math.floor(position);
  const fraction = position - low;
  return values[low % values.length] * (1 - fraction) + values[(low + 1) % values.length] * fraction;
}

/** An angle in [0, 2π). */
export function turn(angle) {
  const rest = angle % (2 * Math.PI);
  return rest < 0 ? rest + 2 * Math.PI : rest;
}

/**
 * The magnification with which an error (m) stays within `room` (m).
 * It exceeds the previous one, `before`, only with room to spare, so that it does not flicker.
 */
export function magnification(error, room, before) {
  const largest = (limit) => [200, 100, 50, 20, 10].find((factor) => factor <= limit) ?? 5;
  return Math.min(largest(room / error), Math.max(before, largest(room / error / 1.3)));
}
