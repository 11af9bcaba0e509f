// The published quantities and their presentation, from the server's table.

const table = await (await fetch("quantities.json")).json();

// Charts of the estimate: {title, group, names, colours, unit, factor, digits, span, low, good}
export const STRIPS = table.strips;
// Quantities of the estimate displayed as numbers: {name, title, compared}
export const NUMBERS = table.numbers;
// Ages of data in palm/contact: {name, title, palm}
export const AGES = table.ages;
export const ESTIMATE = table.shown["palm/estimate"];
// Quantities that are elements of a list in a message: {name, topic, list, index}
export const LISTED = table.listed;
// A sentence on the demo of each system; "" is two palms
export const SHOWS = table.shows;

/** Largest age (ms) of a topic's last message. */
export function staleMs(topic) {
  return table.stale_ms[topic];
}

/** The topic of two palms under which a topic of any system is stored. */
export function keptAs(topic) {
  return table.as[topic] ?? topic;
}

/** Adds the standard names to a message of an earlier release, as in an old recording. */
export function withStandardNames(topic, fields) {
  for (const [former, standard] of Object.entries(table.former[topic] ?? {})) fields[standard] ??= fields[former];
  return fields;
}

/** Whether the message `fields` has one of the quantities `names`; before the first message, those of two palms. */
export function hasAny(names, fields) {
  return names.some((name) => ("mono_ns" in fields ? name in fields : table.usual.includes(name)));
}

/** The presentation of a quantity: {symbol, meaning, unit, factor, digits, uncertain, truth}. */
export function shown(topic, name) {
  return table.shown[topic][name];
}

/** The presentation of a quantity of the estimate, also for palms with numbers beyond the table. */
export function shownOfPalm(name) {
  const family = (each) => each.replace(/[0-9]+/, "");
  return ESTIMATE[name] ?? ESTIMATE[Object.keys(ESTIMATE).find((each) => family(each) === family(name))];
}

/** The palms described by `palm/info`, from the hinge on: [{number, joint, side, lengthM, padM, curvature}]. */
export function palmsOf(info) {
  const { palms, joints, sides = [] } = info.palms ? info : table.system;
  return palms.map((number, i) => ({
    number, joint: joints[i], side: sides[i], lengthM: info[`palm${number}_length_m`], padM: info[`pad${number}_length_m`],
    curvature: info[`palm${number}_curvature_per_m`] ?? 0,
  }));
}
