// Small tools for the document. Text goes in by textContent only: a name is never read as HTML.

export const $ = (id) => document.getElementById(id);

/** An element with attributes and children (strings become text). */
export function make(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined && value !== false) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

/** An SVG element with attributes. */
export function draw(tag, attributes = {}, text = null) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  if (text !== null) node.textContent = text;
  return node;
}

/** One of the signs of icons/set.svg; the word beside it says the same. */
export function icon(name) {
  const node = draw("svg", { class: "icon", "aria-hidden": "true" });
  node.append(draw("use", { href: `icons/set.svg#${name}` }));
  return node;
}

/** Change text only where it differs, so that a screen reader is not told the same twice. */
export function say(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** Show a line with text, or hide it where there is none. */
export function sayOrHide(node, text) {
  say(node, text ?? "");
  node.hidden = !text;
}
