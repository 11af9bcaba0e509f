// The systems that the page draws otherwise than two palms: each tells its fields by two palms' names,
// and draws and describes itself.

import * as pivot from "./pivot.js";

export const SYSTEMS = [pivot];

/** The fields of a message of any system, by two palms' names. */
export function fieldsOf(topic, fields) {
  return SYSTEMS.reduce((told, own) => own.fieldsOf(topic, told), fields);
}
