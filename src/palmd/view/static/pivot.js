// Adapter for the pivoting grasp: converts its fields to the names of two palms, which the rest of the page uses.

import { palmsOf } from "./quantities.js";

const CONVERSIONS = {
  "palm/pivot": ({ x_m, z_m, ...rest }) => ({ ...rest, gripper: [x_m, z_m] }),
  "palm/pivot_shape": ({ hP_m, hP_sd_m, ...rest }) => ({ ...rest, h_m: hP_m, h_sd_m: hP_sd_m }),
  "palm/pivot_info": (fields) => ({ ...fields, palms: [1], joints: ["x"], sides: [1] }),
  "rig/pivot_object": ({ hP_m, ...rest }) => ({ ...rest, h_m: hP_m }),
};

/** The fields of a message with the names of two palms; messages of other systems are unchanged. */
export function fieldsOf(topic, fields) {
  return CONVERSIONS[topic]?.(fields) ?? fields;
}

/** Whether an estimate belongs to a pivoting grasp. */
export function isOwn(estimate) {
  return Array.isArray(estimate.gripper);
}

/** Loads the module that draws it (`draw`). */
export const drawing = () => import("./pivotscene.js");

/** A summary of the picture; `format` formats a quantity with its unit. */
export function describe(store, format) {
  const estimate = store.get("palm/estimate"), [{ number }] = palmsOf(store.get("palm/info"));
  return `Pad touched at ${format(`s${number}_m`)}, pressed with ${format(`f${number}_n`)}; rotated by ${format("psi_rad")}. `
    + `Touched over ${(estimate.touched * 100).toFixed(0)} % of the outline about the pivot.`;
}
