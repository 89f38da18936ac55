// The keys of the viewer, in words.

import { make } from "./elements.js";

const KEYS: [string[], string][] = [
  [["Space"], "play, pause"],
  [[",", "."], "previous, next frame"],
  [["<", ">"], "ten frames back, on"],
  [["Home", "End"], "first, last frame"],
  [["←", "→", "↑", "↓"], "turn"],
  [["W", "A", "S", "D"], "move"],
  [["+", "−"], "zoom in, out"],
  [["1", "2"], "from behind, from above"],
  [["F"], "follow the robot"],
  [["V"], "camera pictures: with labels, without, hidden"],
  [["C"], "crosshair: arrows move it, Esc leaves"],
];

export function keysPanel(): HTMLElement {
  const rows = KEYS.flatMap(([keys, words]) => [
    make("dt", {}, ...keys.flatMap((key) => [make("kbd", {}, key), " "])),
    make("dd", {}, words),
  ]);
  const mouse = make("p", { class: "hint" }, "Drag rotates, right drag or two fingers pan, the wheel zooms, a click selects a voxel, in 3D or in a camera picture.");
  return make("details", { class: "viewer-keys" }, make("summary", {}, "Keys and mouse"), make("dl", { class: "facts" }, ...rows), mouse);
}
