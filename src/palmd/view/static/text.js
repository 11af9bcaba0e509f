// Text on the page, set only if it changes.

/** Shows `text` in the element with the given id. */
export function set(id, text) {
  put(document.getElementById(id), "textContent", text);
}

/** Sets a property of a node, or of its dataset, if it changes: browsers restyle a node whenever a property is set. */
export function put(node, name, value) {
  if (node[name] !== value) node[name] = value;
}

export function element(name, className, text = "") {
  return Object.assign(document.createElement(name), { className, textContent: text });
}

/** A number with its unit and a proper minus sign, a dash for none. */
export function number(value, digits, unit = "") {
  if (!Number.isFinite(value)) return "–";
  return value.toFixed(digits).replace(/^-(?=[0.]*$)/, "").replace("-", "−") + (unit && ` ${unit}`);
}

/** A table row whose first cell is its header. */
export function row(first, ...cells) {
  const line = document.createElement("tr");
  line.append(Object.assign(element("th", "", first), { scope: "row" }), ...cells.map(({ id = "", text = "–", words = false }) =>
    Object.assign(element("td", words ? "" : "number", text), { id })));
  return line;
}
