// Elements made in modules, a line each.

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  values: Partial<HTMLElementTagNameMap[K]> = {},
): HTMLElementTagNameMap[K] {
  return Object.assign(document.createElement(tag), values);
}

/** A button that does something. */
export function pressed(text: string, kind: string, act: () => void): HTMLButtonElement {
  const button = make("button", { type: "button", className: kind, textContent: text });
  button.addEventListener("click", act);
  return button;
}
