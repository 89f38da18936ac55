// The reader's choices of what to see, and the panel for them.

import { make } from "./elements.js";
import { isImported } from "./explanation.js";
import { check, choose, group, pick, slider, span } from "./fields.js";
import { reachOf } from "../data/grid.js";
import type { PointColour } from "../drawing/sweeps.js";
import type { Look, Mode, Span, Unseen } from "../looks.js";
import type { LabelSetFacts, SceneFacts } from "../scene.js";

export type LayerName = "labels" | "mesh" | "points" | "radar" | "sensors" | "track" | "robot" | "grid";
export interface Choices {
  scope: "frame" | "map";
  look: Look;
  layers: Record<LayerName, boolean>;
  points: PointColour;
  /** Start and end of the colours of points, in the unit of the coloured quantity; null: by the points themselves. */
  range: Span;
  /** Size of a point, relative to its default size. */
  size: number;
  /** The label set drawn over the active one; null: none. */
  second: LabelSetFacts | null;
  cameras: CameraChoice;
  follows: boolean;
}
/** Pictures of cameras with labels in them, without, or none. */
export type CameraChoice = "labels" | "plain" | "off";

/** Differences if requested, else classes. */
export function firstChoices(scene: SceneFacts): Choices {
  return {
    scope: "frame",
    look: { mode: scene.starts_with_difference ? "difference" : "class", classes: 0b1110, unseen: "fade", heights_m: [null, null] },
    layers: { labels: true, mesh: false, points: false, radar: false, sensors: false, track: true, robot: true, grid: true },
    points: "intensity",
    range: [null, null],
    size: 1,
    second: null,
    cameras: "labels",
    follows: true,
  };
}

const SCOPES: [Choices["scope"], string][] = [["frame", "Frame"], ["map", "Whole run"]];
const MODES: [Mode, string][] = [
  ["class", "Class"], ["d2", "D², distance to reference terrain"],
  ["confidence", "Confidence: probability that the label is right"], ["elevation", "Elevation"], ["slope", "Slope"], ["roughness", "Roughness"],
];
const DIFFERENCE: [Mode, string] = ["difference", "Difference of A and B"];
const UNSEEN: [Unseen, string][] = [["fade", "Faded"], ["show", "Same as observed"], ["hide", "Hidden"]];
const POINTS: [PointColour, string][] = [["intensity", "Intensity"], ["height", "Height above the ground under the robot"], ["time", "Age, sweeps of the last second"]];
/** The smallest, the largest, and the step between them, relative to the default size. */
export const POINT_SIZES = [0.5, 4, 0.5] as const;
const CAMERAS: [CameraChoice, string][] = [["labels", "Shown with labels"], ["plain", "Shown without labels"], ["off", "Hidden"]];
const CLASSES: [number, string, string][] = [[1, "Traversable", "fill-t"], [2, "Potentially", "fill-p"], [3, "Non-traversable", "fill-n"]];
const NO_CONFIDENCE = "No confidence: only labels of profile field have one, and those of earlier releases do not. Process the sequence again with profile field.";

/** The reason why a layer is unavailable; undefined if it is available. */
export function missing(layer: LayerName, scene: SceneFacts): string | undefined {
  if (layer === "mesh" && !scene.meshes.length) return "No surface is stored for this label set.";
  const { has_clouds, has_radars, has_rays, sensors, state } = scene.playback;
  const isThere: Partial<Record<LayerName, boolean>> = { points: has_clouds, radar: has_radars, sensors: has_rays || sensors.length > 0 };
  if (isThere[layer] ?? true) return undefined;
  if (layer === "radar") return "No radar detections were prepared for this sequence.";
  if (layer === "sensors") return "The sensor poses were not prepared for this sequence.";
  return state === "making" ? "The point clouds are being prepared." : "Point clouds were not prepared for this sequence.";
}

/** The panel; every change is written into `choices` and calls back: `changed` for any, `dressed` only for the look of
 * points. */
export function choicesPanel(scene: SceneFacts, choices: Choices, changed: () => void, dressed: () => void): HTMLElement {
  const layer = (name: LayerName, label: string): HTMLElement =>
    check(label, choices.layers[name], (on) => ((choices.layers[name] = on), changed()), missing(name, scene));
  const { look } = choices;
  const classes = CLASSES.map(([kind, label, fill]) => {
    const row = check(label, ((look.classes >> kind) & 1) === 1, (on) => {
      look.classes = on ? look.classes | (1 << kind) : look.classes & ~(1 << kind);
      changed();
    });
    row.querySelector("input")?.after(swatch(fill));
    return row;
  });
  const hasValues = scene.tiles.length > 0;
  const known = MODES.slice(0, isImported(scene) ? 1 : MODES.length);
  const modes = scene.comparison_id ? [...known, DIFFERENCE] : known;
  const scopes = pick("Show", SCOPES, choices.scope, (value) => {
    choices.scope = value;
    if (value === "map" && look.mode === "difference") choose(colours, (look.mode = "class")); // they are of frames
    changed();
  }, hasValues);
  const colours = pick("Colour by", modes, look.mode, (value) => {
    look.mode = value;
    if (value === "difference") choose(scopes, (choices.scope = "frame"));
    changed();
  }, hasValues || scene.comparison_id !== undefined);
  if (!scene.has_confidence) colours.querySelector("option[value=confidence]")?.setAttribute("disabled", "");
  const notes = (["mesh", "points"] as const).flatMap((name) => missing(name, scene) ?? []);
  return make(
    "div", { class: "viewer-choices" },
    group("Labels", scopes,
      ...classes,
      colours,
      ...(hasValues && !scene.has_confidence && !isImported(scene) ? [make("p", { class: "hint" }, NO_CONFIDENCE)] : []),
      pick("Voxels not observed in this frame", UNSEEN, look.unseen, (value) => ((look.unseen = value), changed()), true)),
    group("Layers", layer("labels", "Labels"), layer("mesh", "Surface"), layer("points", "Point cloud"),
      layer("radar", "Radar"), layer("sensors", "Sensors and camera views"), layer("track", "Track"),
      layer("robot", "Robot"), layer("grid", "Ground grid"),
      span("Heights shown, metres above the ground under the robot", look.heights_m ?? [null, null], "all", (value) => ((look.heights_m = value), changed())),
      ...pointFields(scene, choices, dressed),
      pick("Cameras", CAMERAS, choices.cameras, (value) => ((choices.cameras = value), changed()), scene.playback.cameras.length > 0, "cameras"),
      ...(scene.playback.cameras.length ? [make("p", { class: "hint" }, `Labels are drawn up to ${Math.floor(Math.max(...reachOf(scene.grid)))} m from the robot; beyond, the image is unchanged.`)] : []),
      ...notes.map((note) => make("p", { class: "hint" }, note)),
      ...(hasValues ? [] : [make("p", { class: "hint" }, "Labelled by an earlier release without terrain values: process the sequence again for D² and slope.")]),
      ...(isImported(scene) ? [make("p", { class: "hint" }, "Imported labels have no features: D², confidence, slope and roughness are not available.")] : [])),
  );
}

/** How points are coloured, between which values, and how large they are. */
function pointFields(scene: SceneFacts, choices: Choices, dressed: () => void): HTMLElement[] {
  if (missing("points", scene) !== undefined) return [];
  const range = span("Colours of points", choices.range, "auto", (value) => ((choices.range = value), dressed()));
  range.hidden = choices.points === "time";
  const by = pick("Points by", POINTS, choices.points, (value) => {
    [choices.points, choices.range, range.hidden] = [value, [null, null], value === "time"];
    for (const field of range.querySelectorAll("input")) field.value = "";
    dressed();
  }, true);
  return [by, range, slider("Point size", POINT_SIZES, choices.size, (value) => ((choices.size = value), dressed()))];
}

/** A list of the sequence's other label sets, to draw one over the active one. */
export function secondField(others: readonly LabelSetFacts[], choices: Choices, changed: () => void): HTMLElement {
  const options = others.map((one): [string, string] => [one.id, namedSet(one)]);
  return pick("Second label set, hatched", [["", "None"], ...options], choices.second?.id ?? "", (id) => {
    choices.second = others.find((one) => one.id === id) ?? null;
    changed();
  }, true);
}

/** Its profile and when it was made. */
export function namedSet({ profile, created_at }: LabelSetFacts): string {
  return `${profile}, ${new Date(created_at).toLocaleString([], { dateStyle: "medium", timeStyle: "short" })}`;
}

export function swatch(fill: string): SVGSVGElement {
  const drawing = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  drawing.setAttribute("viewBox", "0 0 10 10");
  drawing.setAttribute("aria-hidden", "true");
  const rect = document.createElementNS("http://www.w3.org/2000/svg", "rect");
  for (const [name, value] of [["width", "10"], ["height", "10"], ["rx", "2"], ["class", fill]] as const) rect.setAttribute(name, value);
  drawing.append(rect);
  return drawing;
}
