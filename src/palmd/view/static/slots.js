// A list with fixed rows: items move between rows, and rows never move under the pointer.

import { put } from "./text.js";

/** Shows `items` in the rows of `list`, made by `make()` and filled by `fill(row, item)`; rows without an item are hidden. */
export function showInSlots(list, items, make, fill) {
  while (list.children.length < items.length) list.append(make());
  [...list.children].forEach((row, i) => {
    put(row, "hidden", i >= items.length);
    if (!row.hidden) fill(row, items[i]);
  });
}

/** Sets a node's text and title if the text changes. */
export function fillText(node, text) {
  if (node.textContent === text) return;
  node.textContent = text;
  node.title = text;
}
