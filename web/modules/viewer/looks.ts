// How voxels are coloured: by class or by a value on a ramp, as an index into a palette of 256 colours.

import { fixed } from "../counts.js";
import type { SceneFacts } from "./scene.js";

export type Mode = "class" | "difference" | "d2" | "confidence" | "elevation" | "slope" | "roughness";
/** Look of labels that the frame's LiDAR did not observe. */
export type Unseen = "show" | "fade" | "hide";

/** From and to; null: no bound. */
export type Span = [number | null, number | null];

export interface Look {
  mode: Mode;
  /** Bit c is set if class c is shown. */
  classes: number;
  unseen: Unseen;
  /** Shown heights, metres above the robot's wheels; absent: all. */
  heights_m?: Span;
}

export interface Values {
  elevation_m: number;
  slope_rad: number;
  roughness: number;
  d2: number;
  /** The probability that the label is right, times 255; 0 if it is unknown. */
  confidence: number;
}

/** How a voxel differs between two label sets, by code (`stone/scoring/agreement.py`); 0 is free in both. */
export const DIFFERENCES = ["", "The same class", "Only in A", "Only in B", "More traversable in B", "Less traversable in B"] as const;
export const FADED = 3;
export const RAMP_FIRST = 10;
export const RAMP_LAST = 250;
export const NO_VALUE = 255;
const STEEPEST_RAD = Math.PI / 3;
const ROUGHNESS = [-14, -4] as const;
const CERTAIN = 255;
const LEAST_SHOWN = 0.5;

/** Position of the value on the ramp, 0–1; D² has its limit in the middle and ten times the limit at the end. */
export function shareOf(mode: Mode, values: Values, scene: SceneFacts): number {
  const share = rawShare(mode, values, scene);
  return Number.isFinite(share) ? Math.min(1, Math.max(0, share)) : 1;
}

function rawShare(mode: Mode, values: Values, scene: SceneFacts): number {
  if (mode === "confidence") return (values.confidence / CERTAIN - LEAST_SHOWN) / (1 - LEAST_SHOWN);
  if (mode === "slope") return values.slope_rad / STEEPEST_RAD;
  if (mode === "roughness") return (values.roughness - ROUGHNESS[0]) / (ROUGHNESS[1] - ROUGHNESS[0]);
  if (mode === "elevation") {
    const [low, high] = elevationRange(scene);
    return (values.elevation_m - low) / (high - low);
  }
  const ratio = values.d2 / (scene.reference?.d2_limit ?? 1);
  return ratio <= 1 ? ratio / 2 : 0.5 + Math.log10(ratio) / 2;
}

/** The probability in words; only a voxel that was driven over (class 1) has 100 %, all others have 99 % at most. */
export function percent(confidence: number, kind: number): string {
  return `${kind === 1 ? 100 : Math.min(99, Math.round((100 * confidence) / CERTAIN))} %`;
}

/** Range of elevation in metres around the driven track. */
export function elevationRange(scene: SceneFacts): [number, number] {
  const mean = scene.reference?.mean[0] ?? 0;
  const half = Math.max(2, 3 * Math.sqrt(scene.reference?.covariance[0][0] ?? 0));
  return [mean - half, mean + half];
}

/** The words at the beginning, in the middle and at the end of a ramp. */
export function ticksOf(mode: Mode, scene: SceneFacts): [string, string, string] {
  const limit = scene.reference?.d2_limit ?? 1;
  if (mode === "d2") return ["0", `${limit.toFixed(1)} (limit)`, `${(10 * limit).toFixed(0)} and more`];
  if (mode === "confidence") return ["50 % and less", "75 %", "100 %"];
  if (mode === "slope") return ["0°", "30°", "60° and more"];
  if (mode === "roughness") return ["smooth", `${(1000 * Math.exp((ROUGHNESS[0] + ROUGHNESS[1]) / 4)).toFixed(0)} mm`, "rough"];
  const [low, high] = elevationRange(scene);
  return [low, (low + high) / 2, high].map((value) => `${fixed(value, 1)} m`) as [string, string, string];
}

/** Whether the half-open span contains the value; an absent span contains all. */
export function isWithin(span: Span | undefined, value: number): boolean {
  const [low, high] = span ?? [null, null];
  return (low === null || value >= low) && (high === null || value < high);
}

export function isShown(look: Look, kind: number, seen: boolean): boolean {
  return ((look.classes >> kind) & 1) === 1 && (seen || look.unseen !== "hide");
}

/** The palette's index of a voxel; 0 if it is not shown. */
export function colourOf(look: Look, kind: number, seen: boolean, values: Values | null, scene: SceneFacts): number {
  if (!isShown(look, kind, seen)) return 0;
  if (look.mode === "difference") return 0; // the map has none
  if (look.mode === "class") return seen || look.unseen !== "fade" ? kind : kind + FADED;
  if (values === null || (look.mode === "confidence" && values.confidence === 0)) return NO_VALUE;
  return RAMP_FIRST + Math.round(shareOf(look.mode, values, scene) * (RAMP_LAST - RAMP_FIRST));
}
