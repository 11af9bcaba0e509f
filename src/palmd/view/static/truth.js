// The emulated rig's truth at the time of the estimate. Pure.

import { at } from "./geometry.js";
import { seconds, TURN } from "./store.js";
import { icosphere, rotation, support, surfaceOf, turned, turnedBack, unit } from "./surface.js";

const COMPARED = 120; // most directions compared of a body in space

/** The truth interpolated at the time of `estimate`: {psi_rad, com_x_m, com_y_m}; both have 100 Hz, but not the same times. */
export function truthAt(store, estimate) {
  const place = store.truths.place(seconds(estimate));
  if (!place) return store.get("rig/truth");
  const between = (name) => store.truths.between(name, place);
  return { psi_rad: between("psi_rad"), com_x_m: between("com_x_m"), com_y_m: between("com_y_m") };
}

/** True minus estimated support function (m), each about its own centre of mass, at every `theta`. */
export function truthDifference({ theta, h }, object, truth, estimate) {
  const turned = estimate.psi_rad - truth.psi_rad;
  return Array.from(theta, (direction, i) => at(object.h_m, direction + turned) - h[i]);
}

/** The true orientation of a body in space at the time of `estimate` (a quaternion), interpolated. */
export function turnAt(store, estimate) {
  const place = store.truths.place(seconds(estimate));
  return place ? unit(TURN.map((part) => store.truths.between(part, place))) : store.get("rig/truth").quat_xyzw;
}

/** As `truthDifference` for a body in space, at some of the touched directions. */
export function truthDifferenceInSpace(shape, object, turn, estimate) {
  const { directions } = icosphere(shape.halvings);
  const { sphere, surface } = surfaceOf(object);
  const touchedDirections = directions.map((_, i) => i).filter((i) => shape.touched[i]);
  const some = touchedDirections.filter((_, k) => k % Math.ceil(touchedDirections.length / COMPARED) === 0);
  const [estimatedRotation, trueRotation] = [rotation(estimate.quat_xyzw), rotation(turn)];
  return some.map((i) => support(sphere, surface, turnedBack(trueRotation, turned(estimatedRotation, directions[i]))) - shape.h_m[i]);
}
