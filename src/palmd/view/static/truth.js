// The emulated rig's truth beside the estimate, at the estimate's own instant. Pure.

import { at } from "./geometry.js";
import { seconds, TURN } from "./store.js";
import { icosphere, rotation, support, surfaceOf, turned, turnedBack, unit } from "./surface.js";

const COMPARED = 120; // directions of a body in space, at most

/** What the rig says of the instant of `estimate`: {psi_rad, com_x_m, com_y_m}; both come at 100 Hz, not at the same times. */
export function truthAt(store, estimate) {
  const place = store.truths.place(seconds(estimate));
  if (!place) return store.get("rig/truth");
  const between = (name) => store.truths.between(name, place);
  return { psi_rad: between("psi_rad"), com_x_m: between("com_x_m"), com_y_m: between("com_y_m") };
}

/** By how much (m) the true support function exceeds the estimated one, about each's centre of mass, at every `theta`. */
export function offTruth({ theta, h }, object, truth, estimate) {
  const turned = estimate.psi_rad - truth.psi_rad;
  return Array.from(theta, (direction, i) => at(object.h_m, direction + turned) - h[i]);
}

/** The turn of a body in space at the instant of `estimate` (a quaternion), which the rig tells at times of its own. */
export function turnAt(store, estimate) {
  const place = store.truths.place(seconds(estimate));
  return place ? unit(TURN.map((part) => store.truths.between(part, place))) : store.get("rig/truth").quat_xyzw;
}

/** As `offTruth` of a body in space, at some of the directions that were felt. */
export function offTruthInSpace(shape, object, turn, estimate) {
  const { directions } = icosphere(shape.halvings);
  const { sphere, surface } = surfaceOf(object);
  const felt = directions.map((_, i) => i).filter((i) => shape.touched[i]);
  const some = felt.filter((_, k) => k % Math.ceil(felt.length / COMPARED) === 0);
  const [believed, real] = [rotation(estimate.quat_xyzw), rotation(turn)];
  return some.map((i) => support(sphere, surface, turnedBack(real, turned(believed, directions[i]))) - shape.h_m[i]);
}
