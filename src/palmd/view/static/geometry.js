// Palms, contacts and outlines. Pure. Lengths in m, angles in rad, world axes; equation numbers are CMU-CS-01-107's.

/** Along palm `number` away from the hinge (t1, −t2), and its normal towards the object (n1, n2): unit vectors. */
export function palm(number, phi1, phi2) {
  const angle = number === 1 ? phi1 : phi1 + phi2;
  const along = [Math.cos(angle), Math.sin(angle)];
  const normal = number === 1 ? [-along[1], along[0]] : [along[1], -along[0]];
  return { along, normal };
}

/** The centre of mass from the hinge: n1·c = r1, n2·c = r2. */
export function centreFromRadii(phi1, phi2, r1, r2) {
  const [n1, n2] = [palm(1, phi1, phi2).normal, palm(2, phi1, phi2).normal];
  const determinant = n1[0] * n2[1] - n1[1] * n2[0];
  return [(n2[1] * r1 - n1[1] * r2) / determinant, (n1[0] * r2 - n2[0] * r1) / determinant];
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

/** A function on evenly spaced directions from 0, at any direction. */
export function at(values, direction) {
  const place = (turn(direction) / (2 * Math.PI)) * values.length;
  const low = Math.floor(place);
  const share = place - low;
  return values[low % values.length] * (1 - share) + values[(low + 1) % values.length] * share;
}

/** An angle in [0, 2π). */
export function turn(angle) {
  const rest = angle % (2 * Math.PI);
  return rest < 0 ? rest + 2 * Math.PI : rest;
}

/**
 * How many times larger than they are errors may be drawn so that the largest of `errors` (m) stays within `room` (m).
 * It grows beyond `before` only when there is room to spare, so that it does not flicker.
 */
export function magnification(errors, room, before) {
  const most = room / Math.max(...errors);
  const largest = (limit) => [100, 50, 20, 10, 5, 2].find((factor) => factor <= limit) ?? 1;
  return Math.min(largest(most), Math.max(before, largest(most / 1.3)));
}
