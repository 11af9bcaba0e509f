// Text on the page: it is only touched where it changes.

/** Shows `text` in the element of that id. */
export function set(id, text) {
  put(document.getElementById(id), "textContent", text);
}

/** Sets a property of a node, or of its dataset, where it changes: a browser styles a node anew whenever one is set. */
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

/** A table's row; the first cell heads it. */
export function row(first, ...cells) {
  const line = document.createElement("tr");
  line.append(Object.assign(element("th", "", first), { scope: "row" }), ...cells.map(({ id = "", text = "–", words = false }) =>
    Object.assign(element("td", words ? "" : "number", text), { id })));
  return line;
}
