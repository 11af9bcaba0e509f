// What is published and how it is shown: palmd's own table, as the server has it.

const table = await (await fetch("quantities.json")).json();

export const STRIPS = table.strips; // charts of the estimate: {title, group, names, colours, unit, factor, digits, span, low, good}
export const TOLD = table.told; // what of the estimate is told as a number: {name, title, compared}
export const AGES = table.ages; // of what was heard last, in palm/contact: {name, title, palm}
export const ESTIMATE = table.shown["palm/estimate"];
export const LISTED = table.listed; // drawn from a list in a message, one by one: {name, topic, list, index}
export const SHOWS = table.shows; // what a demo of each system shows, in a sentence; "" is that of two palms

/** How old (ms) a topic's last message may be. */
export function staleMs(topic) {
  return table.stale_ms[topic];
}

/** Under which topic of two palms one of any system is kept. */
export function keptAs(topic) {
  return table.as[topic] ?? topic;
}

/** Whether what is told of `names` belongs to the system whose message `fields` is; before the first, to two palms. */
export function told(names, fields) {
  return names.some((name) => ("mono_ns" in fields ? name in fields : table.usual.includes(name)));
}

/** How a quantity of a topic is shown: {symbol, meaning, unit, factor, digits, uncertain, truth}. */
export function shown(topic, name) {
  return table.shown[topic][name];
}

/** How a quantity of the estimate is shown, though its palm may be one more than the table has. */
export function shownOfPalm(name) {
  const family = (each) => each.replace(/[0-9]+/, "");
  return ESTIMATE[name] ?? ESTIMATE[Object.keys(ESTIMATE).find((each) => family(each) === family(name))];
}

/** The palms as `palm/info` describes them: [{number, joint, side, lengthM, padM}], from the hinge on. */
export function palmsOf(info) {
  const { palms, joints, sides = [] } = info.palms ? info : table.system;
  return palms.map((number, i) => ({
    number, joint: joints[i], side: sides[i], lengthM: info[`palm${number}_length_m`], padM: info[`pad${number}_length_m`],
    curvature: info[`palm${number}_curvature_per_m`] ?? 0,
  }));
}
