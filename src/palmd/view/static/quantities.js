// What is published and how it is shown: palmd's own table, as the server has it.

const table = await (await fetch("quantities.json")).json();

export const STRIPS = table.strips; // charts of the estimate: {title, names, unit, factor, digits, span, low}
export const TOLD = table.told; // what of the estimate is told as a number: {name, title}
export const ESTIMATE = table.shown["palm/estimate"];

/** How old (ms) a topic's last message may be. */
export function staleMs(topic) {
  return table.stale_ms[topic];
}

/** How a quantity of a topic is shown: {symbol, meaning, unit, factor, digits, uncertain, truth, colour}. */
export function shown(topic, name) {
  return table.shown[topic][name];
}
