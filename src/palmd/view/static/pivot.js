// A pivoting grasp for the rest of the page, which knows palms: its messages by the names that theirs have. Pure.

const AS = {
  "palm/pivot": ["palm/estimate", ({ x_m, z_m, ...rest }) => ({ ...rest, gripper: [x_m, z_m] })],
  "palm/pivot_shape": ["palm/shape", ({ hP_m, hP_sd_m, ...rest }) => ({ ...rest, h_m: hP_m, h_sd_m: hP_sd_m })],
  "palm/pivot_contact": ["palm/contact", (fields) => fields],
  "palm/pivot_motion": ["palm/motion", (fields) => fields],
  "palm/pivot_info": ["palm/info", (fields) => ({ ...fields, palms: [1], joints: ["x"], sides: [1] })],
  "rig/pivot": ["rig/truth", (fields) => fields],
  "rig/pivot_object": ["rig/object", ({ hP_m, ...rest }) => ({ ...rest, h_m: hP_m })],
};

/** The topic and the fields as they are kept: those of a pivoting grasp by the names of two palms'. */
export function named(topic, fields) {
  if (!(topic in AS)) return [topic, fields];
  const [name, fieldsAs] = AS[topic];
  return [name, fieldsAs(fields)];
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
