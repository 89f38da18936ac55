// Fields of the panel: a list to choose from, a box to check, a span of two numbers, a slider.

import type { Span } from "../looks.js";
import { make } from "./elements.js";

let made = 0;

export function group(title: string, ...children: HTMLElement[]): HTMLElement {
  return make("fieldset", {}, make("legend", {}, title), ...children);
}

/** Disabled with the reason `why` as its title. */
export function check(label: string, isOn: boolean, set: (on: boolean) => void, why?: string): HTMLElement {
  const box = make("input", { type: "checkbox", checked: isOn, disabled: why !== undefined });
  box.addEventListener("change", () => set(box.checked));
  return make("label", { class: "viewer-check", ...(why ? { title: why } : {}) }, box, make("span", {}, label));
}

export function pick<Value extends string>(
  label: string, options: [Value, string][], chosen: Value, set: (value: Value) => void, isThere: boolean, name = "",
): HTMLElement {
  const id = `viewer-pick-${++made}`;
  const select = make("select", { id, disabled: !isThere, ...(name ? { "data-chooses": name } : {}) });
  select.append(...options.map(([value, words]) => make("option", { value, selected: value === chosen }, words)));
  select.addEventListener("change", () => set(select.value as Value));
  return make("div", { class: "viewer-pick" }, make("label", { for: id }, label), select);
}

/** The list shows this value from now on. */
export function choose(picker: HTMLElement, value: string): void {
  picker.querySelector("select")!.value = value;
}

/** Two fields, lower and upper; `usual` names the bound of an empty one. An empty span is not set. */
export function span(label: string, [low, high]: Span, usual: string, set: (value: Span) => void): HTMLElement {
  const field = (end: string, value: number | null): HTMLInputElement =>
    make("input", { type: "number", step: "any", placeholder: usual, value: String(value ?? ""), "aria-label": `${label}, ${end}` });
  const fields = [field("from", low), field("to", high)] as const;
  const changed = (): void => {
    const value = fields.map((one) => (one.value === "" ? null : one.valueAsNumber)) as Span;
    const isEmpty = value[0] !== null && value[1] !== null && value[0] >= value[1];
    fields[1].setCustomValidity(isEmpty ? "The second number must be the greater one." : "");
    if (isEmpty) fields[1].reportValidity();
    else set(value);
  };
  for (const one of fields) one.addEventListener("change", changed);
  const row = make("div", { class: "viewer-span" }, fields[0], "to", fields[1]);
  return make("div", { class: "viewer-pick", role: "group", "aria-label": label }, make("span", {}, label), row);
}

export function slider(label: string, [low, high, step]: readonly [number, number, number], value: number, set: (value: number) => void): HTMLElement {
  const id = `viewer-pick-${++made}`;
  const field = make("input", { id, type: "range", min: String(low), max: String(high), step: String(step), value: String(value) });
  field.addEventListener("input", () => set(field.valueAsNumber));
  return make("div", { class: "viewer-pick" }, make("label", { for: id }, label), field);
}
