// The keys of the viewer: their descriptions, and when they apply.
//
// On its own page the viewer gets them with any focus; the reader can restrict them to the 3D view (WCAG 2.1.4), which
// the browser stores.

import { make } from "./elements.js";

const KEYS: [string[], string][] = [
  [["Space"], "play, pause"],
  [[",", "."], "previous, next frame"],
  [["<", ">"], "ten frames back, forward"],
  [["Home", "End"], "first, last frame"],
  [["←", "→", "↑", "↓"], "turn"],
  [["W", "A", "S", "D"], "move"],
  [["+", "−"], "zoom in, out"],
  [["1", "2"], "from behind, from above"],
  [["F"], "follow the robot"],
  [["V"], "camera pictures: with labels, without, hidden"],
  [["C"], "crosshair: arrows move it"],
  [["Esc"], "close the large picture, the crosshair, the selected voxel"],
];

const KEPT = "stone-keys-in-view-only";
const ENTERED = "textarea, select, [contenteditable], input:not([type=checkbox], [type=range])";
const OPERATED = "a, button, summary, input";
/** Keys that a focused link, button, box or slider handles itself. */
const OWN = [" ", "Enter", "Home", "End", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"];

/** Whether the key is for the viewer: not text input, nor a key that the focused element uses. */
export function isFree(event: KeyboardEvent, host: Element): boolean {
  if (event.defaultPrevented || event.isComposing || event.ctrlKey || event.metaKey || event.altKey) return false;
  const target = event.target instanceof Element ? event.target : document.body;
  if (target.closest(ENTERED) || document.querySelector("dialog[open]")) return false;
  if (target !== document.body && !host.contains(target) && OWN.includes(event.key)) return false;
  return !(target.closest(OPERATED) && OWN.includes(event.key)) && (host.contains(target) || !isInViewOnly());
}

function isInViewOnly(): boolean {
  return localStorage.getItem(KEPT) !== null;
}

export function keysPanel(): HTMLElement {
  const box = make("input", { type: "checkbox", checked: !isInViewOnly() });
  box.addEventListener("change", () => (box.checked ? localStorage.removeItem(KEPT) : localStorage.setItem(KEPT, "yes")));
  const everywhere = make("label", { class: "viewer-check" }, box, make("span", {}, "Keys work on the whole page"));
  const rows = KEYS.flatMap(([keys, words]) => [
    make("dt", {}, ...keys.flatMap((key) => [make("kbd", {}, key), " "])),
    make("dd", {}, words),
  ]);
  const mouse = make("p", { class: "hint" }, "Drag rotates, right drag or two fingers pan, the wheel zooms, a click selects a voxel, in 3D or in a camera picture.");
  return make("details", { class: "viewer-keys" }, make("summary", {}, "Keys and mouse"), everywhere, make("dl", { class: "facts" }, ...rows), mouse);
}
