// A pivoting grasp for the rest of the page, which knows palms: its fields by the names that theirs have. Pure.

const AS = {
  "palm/pivot": ({ x_m, z_m, ...rest }) => ({ ...rest, gripper: [x_m, z_m] }),
  "palm/pivot_shape": ({ hP_m, hP_sd_m, ...rest }) => ({ ...rest, h_m: hP_m, h_sd_m: hP_sd_m }),
  "palm/pivot_info": (fields) => ({ ...fields, palms: [1], joints: ["x"], sides: [1] }),
  "rig/pivot_object": ({ hP_m, ...rest }) => ({ ...rest, h_m: hP_m }),
};

/** The fields of a message of any system, a pivoting grasp's by two palms' names. */
export function fieldsOf(topic, fields) {
  return AS[topic]?.(fields) ?? fields;
}

/** Whether an estimate is of a pivoting grasp. */
export function pivots(estimate) {
  return Array.isArray(estimate.gripper);
}

/** Whether a body is clear of the pad: it touches, or the hand that holds it has it above. */
export function clear(object, truth) {
  const { z_m, psi_rad } = truth, touches = Object.keys(truth).some((name) => name.startsWith("touch") && truth[name]);
  const [first, second] = object.theta_rad, count = object.theta_rad.length;
  const below = Math.round((-Math.PI / 2 - psi_rad - first) / (second - first));
  return touches || object.h_m[((below % count) + count) % count] <= z_m;
}
