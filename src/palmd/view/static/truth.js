// The emulated rig's truth beside the estimate, at the estimate's own instant. Pure.

import { at } from "./geometry.js";
import { seconds } from "./store.js";

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
