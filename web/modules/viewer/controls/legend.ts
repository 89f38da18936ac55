// The legend of the colours: classes with their counts, or a ramp with its values.

import { fixed } from "../../counts.js";
import { FASTEST_M_S } from "../data/formats.js";
import { swatch } from "./choices.js";
import type { PointColour } from "../drawing/sweeps.js";
import { make } from "./elements.js";
import { DIFFERENCES, type Mode, ticksOf } from "../looks.js";
import { type RampName, ramp } from "../ramps.js";
import type { SceneFacts } from "../scene.js";
import { rampOf } from "../drawing/theme.js";

const CLASSES = [["Traversable", "fill-t"], ["Potentially", "fill-p"], ["Non-traversable", "fill-n"]] as const;
const FILLS = ["fill-same", "fill-only-a", "fill-only-b", "fill-easier", "fill-harder"] as const;
const TITLES: Record<Mode, string> = { class: "", difference: "", d2: "D²", confidence: "Confidence: probability that the label is right", elevation: "Elevation", slope: "Slope", roughness: "Roughness" };
const WIDTH_PX = 180;

/** The legend of the classes, with shares if there are counts. */
export function classLegend(counts: readonly number[]): HTMLElement {
  return shareLegend(CLASSES, counts);
}

/** How two label sets differ, with the share of each of the voxels that are labelled in either. */
export function differenceLegend(counts: readonly number[]): HTMLElement {
  return shareLegend(FILLS.map((fill, number) => [DIFFERENCES[number + 1]!, fill] as const), counts);
}

function shareLegend(entries: readonly (readonly [string, string])[], counts: readonly number[]): HTMLElement {
  const total = counts.reduce((sum, count) => sum + count, 0);
  const items = entries.map(([name, fill], number) => {
    const share = total ? `${((100 * counts[number]!) / total).toFixed(0)} %` : "";
    return make("li", {}, swatch(fill), make("span", {}, name), make("span", { class: "viewer-share" }, share));
  });
  const list = make("ul", { class: "legend" }, ...items);
  return make("div", { class: "viewer-legend" }, list, ...(total ? [make("span", { class: "viewer-share" }, "shares of this frame's voxels")] : []));
}

/** The legend of the colours of points, from the first value to the last. */
export function pointLegend(by: PointColour, [first, last]: readonly [number, number]): HTMLElement {
  const values = [first, (first + last) / 2, last];
  if (by === "time") return ramped("Points, age", "lighter", [`${values[0]} s`, `${values[1]} s`, "now"]);
  const words = values.map((value) => (by === "height" ? `${fixed(value, 1)} m` : fixed(value, last - first < 4 ? 1 : 0)));
  return ramped(by === "height" ? "Points, height" : "Points, intensity (0–255)", "lighter", words);
}

export function secondLegend(name: string): HTMLElement {
  return make("p", { class: "viewer-legend viewer-second" }, `Hatched: ${name}`);
}

export function radarLegend(): HTMLElement {
  return ramped("Radar, speed over ground", "lighter", ["0 m/s", `${FASTEST_M_S / 2} m/s`, `${FASTEST_M_S} m/s and more`]);
}

export function rampLegend(mode: Mode, scene: SceneFacts): HTMLElement {
  return ramped(TITLES[mode], rampOf(mode), ticksOf(mode, scene));
}

function ramped(title: string, name: RampName, words: readonly string[]): HTMLElement {
  const canvas = make("canvas", { width: String(WIDTH_PX), height: "10", role: "presentation" });
  const context = canvas.getContext("2d");
  for (let x = 0; context && x < WIDTH_PX; x++) {
    context.fillStyle = `rgb(${ramp(name, x / (WIDTH_PX - 1)).join(" ")})`;
    context.fillRect(x, 0, 1, 10);
  }
  const ticks = words.map((tick) => make("span", {}, tick));
  return make(
    "div", { class: "viewer-legend viewer-ramp" }, make("strong", {}, title), canvas, make("div", { class: "viewer-ticks" }, ...ticks),
  );
}
