// A body's surface from its support function on the vertices of a subdivided icosahedron. Pure. Lengths in m, body frame.

const GOLDEN = (1 + Math.sqrt(5)) / 2;
const CORNERS = [[-1, GOLDEN, 0], [1, GOLDEN, 0], [-1, -GOLDEN, 0], [1, -GOLDEN, 0], [0, -1, GOLDEN], [0, 1, GOLDEN],
  [0, -1, -GOLDEN], [0, 1, -GOLDEN], [GOLDEN, 0, -1], [GOLDEN, 0, 1], [-GOLDEN, 0, -1], [-GOLDEN, 0, 1]];
const FACES = [[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6],
  [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]];
const spheres = new Map();
const surfaces = new WeakMap(); // by the message

export const dot = ([a, b, c], [x, y, z]) => a * x + b * y + c * z;
export const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];
export const scaled = (v, by) => v.map((each) => each * by);
export const unit = (v) => scaled(v, 1 / Math.hypot(...v));
export const plus = (v, w, by = 1) => v.map((each, i) => each + by * w[i]);

/** Whether an estimate describes a body in space. */
export function inSpace(estimate) {
  return Array.isArray(estimate.quat_xyzw);
}

/**
 * Unit directions, triangles (counterclockwise seen from outside), and `slopes`: weights of the neighbours' support
 * function for the gradient at each direction. Each subdivision appends the midpoints of all edges, ordered by the numbers
 * of their ends.
 */
export function icosphere(halvings) {
  if (!spheres.has(halvings)) spheres.set(halvings, halved(halvings));
  return spheres.get(halvings);
}

function halved(halvings) {
  let [directions, faces] = [CORNERS.map(unit), FACES];
  for (let k = 0; k < halvings; k++) {
    const count = directions.length;
    const keyOf = (i, j) => Math.min(i, j) * count + Math.max(i, j);
    const keys = [...new Set(faces.flatMap(([a, b, c]) => [keyOf(a, b), keyOf(b, c), keyOf(c, a)]))].sort((a, b) => a - b);
    const place = new Map(keys.map((key, i) => [key, count + i]));
    directions = directions.concat(keys.map((key) => unit(plus(directions[Math.floor(key / count)], directions[key % count]))));
    faces = faces.flatMap(([a, b, c]) => {
      const [ab, bc, ca] = [place.get(keyOf(a, b)), place.get(keyOf(b, c)), place.get(keyOf(c, a))];
      return [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]];
    });
  }
  const neighbours = directions.map(() => []);
  for (const [a, b, c] of faces) {
    neighbours[a].push(b);
    neighbours[b].push(c);
    neighbours[c].push(a);
  }
  return { directions, faces, slopes: directions.map((_, i) => slopesAt(directions, i, neighbours[i])) };
}

/** [[j, along, rise, bend]…]: a gradient is Σ (h_j − rise h_i) along, in least squares; `bend` is 2 over the distance's square. */
function slopesAt(directions, i, neighbours) {
  const n = directions[i];
  const e = unit(cross(n, Math.abs(n[0]) < 0.7 ? [1, 0, 0] : [0, 1, 0])), f = cross(n, e);
  const beside = neighbours.map((j) => [dot(directions[j], e), dot(directions[j], f)]);
  const sum = (of) => beside.reduce((total, each) => total + of(each), 0);
  const [ee, ef, ff] = [sum(([u]) => u * u), sum(([u, v]) => u * v), sum(([, v]) => v * v)];
  const determinant = ee * ff - ef * ef;
  return neighbours.map((j, k) => {
    const [u, v] = beside[k], rise = dot(directions[j], n);
    return [j, plus(scaled(e, (ff * u - ef * v) / determinant), f, (ee * v - ef * u) / determinant), rise, 1 / (1 - rise)];
  });
}

/**
 * The surface points of a body with support function `h`, x = h n + grad h for each direction n as normal, and the mean
 * radius of curvature there: {points, bends}.
 */
export function surface({ directions, slopes }, h) {
  const points = directions.map((n, i) => slopes[i].reduce((x, [j, along, rise]) => plus(x, along, h[j] - rise * h[i]), scaled(n, h[i])));
  const bends = points.map((x, i) => slopes[i].reduce((sum, [j, , , bend]) => sum + bend * (h[j] - dot(x, directions[j])), 0) / slopes[i].length);
  return { points, bends };
}

/** The sphere and surface of a message's `halvings` and `h_m`, cached: {sphere, surface}. */
export function surfaceOf(message) {
  if (!surfaces.has(message)) {
    const sphere = icosphere(message.halvings);
    surfaces.set(message, { sphere, surface: surface(sphere, message.h_m) });
  }
  return surfaces.get(message);
}

/** The support function at any unit direction, to second order from the point with the nearest normal. */
export function support({ directions }, { points, bends }, direction) {
  let [nearest, most] = [0, -1];
  for (let i = 0; i < directions.length; i++) {
    const along = dot(directions[i], direction);
    if (along > most) [nearest, most] = [i, along];
  }
  return dot(points[nearest], direction) + bends[nearest] * (1 - most);
}

/** The rotation matrix of a unit quaternion x, y, z, w, as rows. */
export function rotation([x, y, z, w]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
  ];
}

/** Rotates a vector from the body frame to the world frame. */
export function turned(rows, v) {
  return rows.map((row) => dot(row, v));
}

/** Rotates a vector from the world frame to the body frame. */
export function turnedBack(rows, v) {
  return [0, 1, 2].map((i) => rows[0][i] * v[0] + rows[1][i] * v[1] + rows[2][i] * v[2]);
}
