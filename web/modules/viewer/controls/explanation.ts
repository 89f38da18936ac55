// Explains the class of a voxel: its distance from the driven ground, and the property that differs most.

import { fixed } from "../../counts.js";
import type { Found } from "../data/lookup.js";
import type { Picked } from "../data/model.js";
import { percent } from "../looks.js";
import type { SceneFacts, Vector } from "../scene.js";

export const CLASS_NAMES = ["free", "Traversable", "Potentially traversable", "Non-traversable"] as const;
const DEGREE = 180 / Math.PI;
/** Half the last digit that is shown beyond upright: a wall that is stored as 90.000003° is no overhang. */
const OVERHANG_DEG = 90.05;
/** The properties of a voxel are rounded in its file, D² is not: a D² this much larger is not of the properties alone. */
const ROUNDED = 1.01;

/** Name and value, as rows of the readout; imported labels have none. */
export function valuesOf(found: Found, scene: SceneFacts): [string, string][] {
  if (isImported(scene)) return [];
  return [
    [elevationName(scene), `${fixed(found.elevation_m, 2)} m`],
    ["Slope", slopeWords(found.slope_rad)],
    ["Roughness", `${roughness_mm(found.roughness)} (log ${found.roughness.toFixed(1)})`],
    ["D²", number(found.d2)],
    ...(found.confidence ? [["Probability that this label is right", percent(found.confidence, found.kind)] as [string, string]] : []),
  ];
}

/** Whether the labels come from a published dataset: only the class of their voxels is known. */
export function isImported(scene: SceneFacts): boolean {
  return scene.profile === "imported";
}

export function elevationName(scene: SceneFacts): string {
  return isLocal(scene) ? "Height above local ground" : "Elevation";
}

/** Every profile but the paper's takes heights above the ground nearby. */
function isLocal(scene: SceneFacts): boolean {
  return scene.profile === "local" || isOneSided(scene);
}

/** Whether only higher, steeper or rougher ground than the driven ground counts (profile field); D² then includes the
 * vehicle's limits. */
function isOneSided(scene: SceneFacts): boolean {
  return scene.profile === "field";
}

/** The explanation in one or two sentences. */
export function reason(picked: Picked, scene: SceneFacts): string {
  const source = isImported(scene) ? "" : "; its label comes from the whole run";
  const unseen = picked.seen ? "" : ` Not observed by this frame's LiDAR${source}.`;
  return `${because(picked, scene)}${unseen}`;
}

function because({ kind, found }: Picked, scene: SceneFacts): string {
  if (isImported(scene)) return "Imported labels have no features, so there is no explanation.";
  if (kind === 1) return "Driven over: under the robot's footprint swept along the track.";
  const { reference } = scene;
  if (!found || !reference) return "These labels have no terrain values for the viewer; process the sequence again for an explanation.";
  const [d2, limit] = [number(found.d2), reference.d2_limit.toFixed(1)];
  if (found.d2 <= reference.d2_limit) {
    const alike = isOneSided(scene) ? "no harder than the terrain driven over, and within the vehicle's limits" : "similar to the terrain driven over";
    return `D² ${d2} ≤ ${limit}: ${alike}.`;
  }
  const { mean, covariance } = reference;
  const away: Vector = [found.elevation_m - mean[0], found.slope_rad - mean[1], found.roughness - mean[2]];
  const parts = partsOf(away, covariance, isOneSided(scene));
  const own = sum(parts);
  if (isOneSided(scene) && own <= reference.d2_limit && found.d2 > ROUNDED * own) {
    return `D² ${d2} > ${limit}: beyond what the vehicle can do: slope under the footprint, step or clearance.`;
  }
  return `D² ${d2} > ${limit}: unlike the terrain driven over, mainly in ${apart(found, scene, parts.indexOf(Math.max(...parts)))}.`;
}

/** A property against the driven ground's mean ± standard deviation. */
function apart(found: Found, scene: SceneFacts, feature: number): string {
  const { mean, covariance } = scene.reference!;
  const spread = Math.sqrt(covariance[feature]![feature]!);
  if (feature === 1) {
    return `slope (${degrees(found.slope_rad)}${isOverhang(found.slope_rad) ? ", an overhang," : ""} against ${degrees(mean[1])} ± ${degrees(spread)})`;
  }
  if (feature === 2) return `roughness (${roughness_mm(found.roughness)} against ${roughness_mm(mean[2])})`;
  const name = isLocal(scene) ? "height above the local ground" : "elevation";
  return `${name} (${fixed(found.elevation_m, 2)} m against ${fixed(mean[0], 2)} ± ${spread.toFixed(2)} m)`;
}

/** D² = Σ dᵢ (Σ⁻¹ d)ᵢ in its three parts. The one-sided D² is the least of all ground at least as high, steep and
 * rough. It equals the greatest marginal D² of the subsets of properties whose multipliers Σ_AA⁻¹ d_A are not negative
 * (`stone/labels/profiles.py`). */
export function partsOf(away: Vector, covariance: [Vector, Vector, Vector], isOneSided: boolean): Vector {
  let most: Vector = [0, 0, 0];
  for (const subset of isOneSided ? [1, 2, 3, 4, 5, 6, 7] : [7]) {
    const isIn = (row: number): boolean => ((subset >> row) & 1) === 1;
    const block = covariance.map((line, row) => line.map((value, column) => (isIn(row) && isIn(column) ? value : +(row === column))));
    const multipliers = solve(block as [Vector, Vector, Vector], away.map((value, row) => (isIn(row) ? value : 0)) as Vector);
    const parts = away.map((value, row) => value * multipliers[row]!) as Vector;
    if (!isOneSided || (Math.min(...multipliers) >= 0 && sum(parts) > sum(most))) most = parts;
  }
  return most;
}

function sum(values: Vector): number {
  return values[0] + values[1] + values[2];
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

/** The slope is the angle between the surface's normal and up: beyond 90° the surface faces down. */
function slopeWords(rad: number): string {
  const value = `${(rad * DEGREE).toFixed(1)}°`;
  return isOverhang(rad) ? `${value} (overhang: the surface faces down)` : value;
}

function isOverhang(rad: number): boolean {
  return rad * DEGREE >= OVERHANG_DEG;
}

function degrees(rad: number): string {
  return `${(rad * DEGREE).toFixed(0)}°`;
}

/** The root of the mean square in millimetres, because the stored log of m² is hard to picture. */
function roughness_mm(log_m2: number): string {
  return `${(1000 * Math.exp(log_m2 / 2)).toFixed(0)} mm`;
}

function number(value: number): string {
  return value < 100 ? value.toFixed(1) : value.toFixed(0);
}
