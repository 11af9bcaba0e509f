// A list whose rows stay where they are: what is shown moves from row to row, and no row moves under a hand.

import { put } from "./text.js";

/** Shows `items` in the rows of `list`, made by `make()` and filled by `fill(row, item)`; rows without an item are hidden. */
export function showInSlots(list, items, make, fill) {
  while (list.children.length < items.length) list.append(make());
  [...list.children].forEach((row, i) => {
    put(row, "hidden", i >= items.length);
    if (!row.hidden) fill(row, items[i]);
  });
}

/** Sets a node's text where it changes, and the whole of it as its title. */
export function fillText(node, text) {
  if (node.textContent === text) return;
  node.textContent = text;
  node.title = text;
}
