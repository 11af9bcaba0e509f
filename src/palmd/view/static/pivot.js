// A pivoting grasp for the rest of the page, which knows palms: its fields by the names that theirs have.

import { palmsOf } from "./quantities.js";

const AS = {
  "palm/pivot": ({ x_m, z_m, ...rest }) => ({ ...rest, gripper: [x_m, z_m] }),
  "palm/pivot_shape": ({ hP_m, hP_sd_m, ...rest }) => ({ ...rest, h_m: hP_m, h_sd_m: hP_sd_m }),
  "palm/pivot_info": (fields) => ({ ...fields, palms: [1], joints: ["x"], sides: [1] }),
  "rig/pivot_object": ({ hP_m, ...rest }) => ({ ...rest, h_m: hP_m }),
};

/** The fields of a message by two palms' names; of another system as they are. */
export function fieldsOf(topic, fields) {
  return AS[topic]?.(fields) ?? fields;
}

/** Whether an estimate is of a pivoting grasp. */
export function tells(estimate) {
  return Array.isArray(estimate.gripper);
}

/** What draws it, loaded when it is first needed: `draw`. */
export const drawing = () => import("./pivotscene.js");

/** A summary of the picture; `say` tells a quantity of palms with its unit. */
export function describe(store, say) {
  const estimate = store.get("palm/estimate"), [{ number }] = palmsOf(store.get("palm/info"));
  return `Pad touched at ${say(`s${number}_m`)}, pressed with ${say(`f${number}_n`)}; turned by ${say("psi_rad")}. `
    + `Touched over ${(estimate.touched * 100).toFixed(0)} % of the outline about the pivot.`;
}
