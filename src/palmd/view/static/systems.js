// The systems that the page draws differently from two palms: each converts its fields to the names of two palms,
// and draws and describes itself.

import * as pivot from "./pivot.js";

export const SYSTEMS = [pivot];

/** The fields of a message of any system, with the names of two palms. */
export function fieldsOf(topic, fields) {
  return SYSTEMS.reduce((converted, own) => own.fieldsOf(topic, converted), fields);
}
