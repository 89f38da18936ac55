// The reader's choices in the page's URL, so that everyone who opens it sees the same frame, layers, colours and view.
//
// Only values that differ from the viewer's defaults are written; unknown or unavailable values are ignored. `at` is
// the viewpoint relative to the robot: heading and pitch in radians, distance, and the pivot in metres ahead, left and
// up of the robot. So the same link fits every frame.

import { type CameraChoice, type Choices, type LayerName, POINT_SIZES, missing } from "./choices.js";
import { isImported } from "./explanation.js";
import { POINT_COLOURS, type PointColour } from "../drawing/sweeps.js";
import type { Mode, Span, Unseen } from "../looks.js";
import type { SceneFacts } from "../scene.js";

/** Heading and pitch relative to the robot, distance, and the pivot in the robot's frame. */
export type Viewpoint = [number, number, number, number, number, number];

export interface Standing {
  token: string;
  choices: Choices;
  /** The channel shown large. */
  enlarged: string | null;
  /** Null: the default view from behind. */
  at: Viewpoint | null;
}

const CLASSES: [number, string][] = [[1, "t"], [2, "p"], [3, "n"]];
const MODES: Mode[] = ["class", "difference", "d2", "confidence", "elevation", "slope", "roughness"];
const WRITES_AFTER_MS = 300;

/** Values of the URL that are applied later: the large channel, the second label set, the view. */
export interface Begins {
  enlarged: string | null;
  second: string | null;
  at: Viewpoint | null;
}

/** Applies the URL to the choices, and returns its other values. */
export function read(address: URL, scene: SceneFacts, choices: Choices): Begins {
  const said = (key: string): string | null => address.searchParams.get(key);
  const { look, layers } = choices;
  const hidden = (said("hide") ?? "").split(",");
  look.classes = CLASSES.reduce((bits, [kind, letter]) => (hidden.includes(letter) ? bits & ~(1 << kind) : bits), look.classes);
  look.unseen = oneOf<Unseen>(said("unseen"), ["show", "fade", "hide"]) ?? look.unseen;
  const mode = oneOf<Mode>(said("colour"), MODES);
  if (mode && isThere(mode, scene)) look.mode = mode;
  if (said("show") === "map" && scene.tiles.length && look.mode !== "difference") choices.scope = "map";
  const shown = said("layers")?.split(",");
  if (shown) {
    for (const name of Object.keys(layers) as LayerName[]) layers[name] = shown.includes(name) && missing(name, scene) === undefined;
  }
  choices.points = oneOf<PointColour>(said("points"), [...POINT_COLOURS]) ?? choices.points;
  look.heights_m = spanOf(said("heights")) ?? look.heights_m!;
  choices.range = spanOf(said("range")) ?? choices.range;
  const size = Number(said("size") ?? NaN);
  if (size >= POINT_SIZES[0] && size <= POINT_SIZES[1]) choices.size = size;
  choices.cameras = oneOf<CameraChoice>(said("cameras"), ["labels", "plain", "off"]) ?? choices.cameras;
  if (said("follow") === "off") choices.follows = false;
  return { enlarged: said("camera"), second: said("second"), at: viewpointOf(said("at")) };
}

function isThere(mode: Mode, scene: SceneFacts): boolean {
  if (mode === "difference") return scene.comparison_id !== undefined;
  if (mode === "confidence" && !scene.has_confidence) return false;
  return mode === "class" || (scene.tiles.length > 0 && !isImported(scene));
}

/** The URL of the current view, from another URL; `first` are the viewer's defaults. */
export function written(from: URL, { token, choices, enlarged, at }: Standing, first: Choices): URL {
  const address = new URL(from);
  const put = (key: string, value: string | null): void => {
    if (value === null) address.searchParams.delete(key);
    else address.searchParams.set(key, value);
  };
  const { look, layers } = choices;
  const differing = <Value extends string>(value: Value, usual: Value): Value | null => (value === usual ? null : value);
  const on = (all: Choices): string => (Object.keys(layers) as LayerName[]).filter((name) => all.layers[name]).join(",");
  const hidden = CLASSES.filter(([kind]) => !((look.classes >> kind) & 1)).map(([, letter]) => letter);
  put("frame", token);
  put("show", differing(choices.scope, first.scope));
  put("colour", differing(look.mode, first.look.mode));
  put("hide", hidden.length ? hidden.join(",") : null);
  put("unseen", differing(look.unseen, first.look.unseen));
  put("layers", differing(on(choices), on(first)));
  put("points", differing(choices.points, first.points));
  put("heights", differing(wordsOf(look.heights_m!), ","));
  put("range", differing(wordsOf(choices.range), ","));
  put("size", differing(String(choices.size), String(first.size)));
  put("cameras", differing(choices.cameras, first.cameras));
  put("second", choices.second?.id ?? null);
  put("camera", enlarged);
  put("follow", choices.follows ? null : "off");
  put("at", at && at.map((value) => Number(value.toPrecision(4))).join(","));
  address.search = address.search.replaceAll("%2C", ",");
  return address;
}

/** Writes the page's address once nothing changed for a while: browsers refuse it ten times a second. */
export class Address {
  private timer = 0;

  constructor(private readonly standing: () => Standing, private readonly first: Choices) {}

  changed(): void {
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => this.write(), WRITES_AFTER_MS);
  }

  end(): void {
    clearTimeout(this.timer);
  }

  private write(): void {
    const address = written(new URL(location.href), this.standing(), this.first);
    if (address.href === location.href) return;
    try {
      history.replaceState(null, "", address);
    } catch {
      this.changed(); // refused for being too often: once more, later
    }
  }
}

function oneOf<Value extends string>(said: string | null, known: Value[]): Value | null {
  return known.find((value) => value === said) ?? null;
}

function wordsOf(span: Span): string {
  return span.map((value) => value ?? "").join(",");
}

/** Two bounds, either of them empty for none; null if it is no span or has no bound. */
function spanOf(said: string | null): Span | null {
  const bounds = (said ?? "").split(",").map((word) => (word === "" ? null : Number(word)));
  if (bounds.length !== 2 || bounds.some((value) => value !== null && !Number.isFinite(value))) return null;
  const [low, high] = bounds as Span;
  return low !== null && high !== null && low >= high ? null : [low, high];
}

function viewpointOf(said: string | null): Viewpoint | null {
  const numbers = (said ?? "").split(",").map(Number);
  return said && numbers.length === 6 && numbers.every((value) => Number.isFinite(value) && Math.abs(value) < 1e5) ? (numbers as Viewpoint) : null;
}
