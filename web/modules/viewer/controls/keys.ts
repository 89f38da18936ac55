// The keys of the viewer, in words.

import { make } from "./elements.js";

const KEYS: [string[], string][] = [
  [["Space"], "play, pause"],
  [[",", "."], "one frame back, on"],
  [["<", ">"], "ten frames"],
  [["Home", "End"], "first, last frame"],
  [["←", "→", "↑", "↓"], "turn"],
  [["W", "A", "S", "D"], "move"],
  [["+", "−"], "nearer, farther"],
  [["1", "2"], "from behind, from above"],
  [["F"], "follow the robot"],
  [["C"], "crosshair: arrows move it, Esc leaves"],
];

export function keysPanel(): HTMLElement {
  const rows = KEYS.flatMap(([keys, words]) => [
    make("dt", {}, ...keys.flatMap((key) => [make("kbd", {}, key), " "])),
    make("dd", {}, words),
  ]);
  const mouse = make("p", { class: "hint" }, "Drag turns, right drag or two fingers move, the wheel nears, a click picks a voxel.");
  return make("details", { class: "viewer-keys" }, make("summary", {}, "Keys and mouse"), make("dl", { class: "facts" }, ...rows), mouse);
}
