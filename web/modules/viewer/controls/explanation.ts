// Why a voxel has its class, in words: the distance to what the robot drove, and which property sets it apart.

import type { Found } from "../data/lookup.js";
import type { Picked } from "../data/model.js";
import type { SceneFacts, Vector } from "../scene.js";

export const CLASS_NAMES = ["free", "Traversable", "Potentially traversable", "Non-traversable"] as const;
const DEGREE = 180 / Math.PI;

/** Name and value, as rows of the readout; imported labels have none. */
export function valuesOf(found: Found, scene: SceneFacts): [string, string][] {
  if (isImported(scene)) return [];
  return [
    [elevationName(scene), `${found.elevation_m.toFixed(2)} m`],
    ["Slope", `${(found.slope_rad * DEGREE).toFixed(1)}°`],
    ["Roughness", `${roughness_mm(found.roughness)} (log ${found.roughness.toFixed(1)})`],
    ["D²", number(found.d2)],
  ];
}

/** Labels of a published dataset: of their voxels the class is known and nothing else. */
export function isImported(scene: SceneFacts): boolean {
  return scene.profile === "imported";
}

export function elevationName(scene: SceneFacts): string {
  return scene.profile === "local" ? "Height above local ground" : "Elevation";
}

/** One or two sentences. */
export function reason(picked: Picked, scene: SceneFacts): string {
  const source = isImported(scene) ? "" : "; the label comes from the rest of the run";
  const unseen = picked.seen ? "" : ` This frame's LiDAR did not see it${source}.`;
  return `${because(picked, scene)}${unseen}`;
}

function because({ kind, found }: Picked, scene: SceneFacts): string {
  if (isImported(scene)) return "Imported labels: no features. The dataset says the class, and not why.";
  if (kind === 1) return "The robot drove here: it lies under the footprint swept along the track.";
  const { reference } = scene;
  if (!found || !reference) return "These labels were made without terrain values for the viewer; label the sequence again to see why.";
  const [d2, limit] = [number(found.d2), reference.d2_limit.toFixed(1)];
  if (found.d2 <= reference.d2_limit) return `D² ${d2} ≤ ${limit}: like what the robot drove.`;
  return `D² ${d2} > ${limit}: unlike what the robot drove, most of all in ${apart(found, scene)}.`;
}

/** The property that adds most to D², against the driven ground's mean ± standard deviation. */
function apart(found: Found, scene: SceneFacts): string {
  const { mean, covariance } = scene.reference!;
  const feature = mostApart(found, mean, covariance);
  const spread = Math.sqrt(covariance[feature]![feature]!);
  if (feature === 1) {
    return `slope (${degrees(found.slope_rad)} against ${degrees(mean[1])} ± ${degrees(spread)})`;
  }
  if (feature === 2) return `roughness (${roughness_mm(found.roughness)} against ${roughness_mm(mean[2])})`;
  const name = scene.profile === "local" ? "height above the local ground" : "elevation";
  return `${name} (${found.elevation_m.toFixed(2)} m against ${mean[0].toFixed(2)} ± ${spread.toFixed(2)} m)`;
}

/** D² = Σ dᵢ (Σ⁻¹ d)ᵢ: the index of the largest part. */
export function mostApart(found: Found, mean: Vector, covariance: [Vector, Vector, Vector]): 0 | 1 | 2 {
  const away: Vector = [found.elevation_m - mean[0], found.slope_rad - mean[1], found.roughness - mean[2]];
  const solved = solve(covariance, away);
  const parts = away.map((value, row) => value * solved[row]!);
  return parts.indexOf(Math.max(...parts)) as 0 | 1 | 2;
}

/** x of A x = b by Cramer's rule. */
function solve(a: [Vector, Vector, Vector], b: Vector): Vector {
  const whole = determinant(a);
  return [0, 1, 2].map((column) => {
    const replaced = a.map((row, r) => row.map((value, c) => (c === column ? b[r]! : value)) as Vector);
    return determinant(replaced as [Vector, Vector, Vector]) / whole;
  }) as Vector;
}

function determinant([a, b, c]: [Vector, Vector, Vector]): number {
  return (
    a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])
  );
}

function degrees(rad: number): string {
  return `${(rad * DEGREE).toFixed(0)}°`;
}

/** Roughness is the log of a mean square in m²: its root in millimetres is what one can picture. */
function roughness_mm(log_m2: number): string {
  return `${(1000 * Math.exp(log_m2 / 2)).toFixed(0)} mm`;
}

function number(value: number): string {
  return value < 100 ? value.toFixed(1) : value.toFixed(0);
}
