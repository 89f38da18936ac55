// Helpers that create elements of the page.

type Child = Node | string;

/** An element with these attributes (true is an empty one, false none) and children. */
export function make<Tag extends keyof HTMLElementTagNameMap>(
  tag: Tag,
  attributes: Record<string, string | boolean> = {},
  ...children: Child[]
): HTMLElementTagNameMap[Tag] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}

const SVG = "http://www.w3.org/2000/svg";

/** A drawing of one path in a box of 24, in the colour of its text; hidden from screen readers. */
export function icon(path: string): SVGSVGElement {
  const drawing = document.createElementNS(SVG, "svg");
  const shape = document.createElementNS(SVG, "path");
  for (const [name, value] of [["viewBox", "0 0 24 24"], ["width", "18"], ["height", "18"], ["aria-hidden", "true"]] as const) {
    drawing.setAttribute(name, value);
  }
  shape.setAttribute("d", path);
  shape.setAttribute("fill", "currentColor");
  drawing.append(shape);
  return drawing;
}

/** A button with a drawing and a word, which is the start or a part of its label. */
export function button(label: string, word: string, drawn: string, act: () => void): HTMLButtonElement {
  const attributes = { type: "button", class: "quiet small viewer-icon", "aria-label": label, title: label };
  const element = make("button", attributes, icon(drawn), make("span", {}, word));
  element.addEventListener("click", act);
  return element;
}
