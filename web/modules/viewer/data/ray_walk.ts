// Which voxel a line of sight meets first: a walk from voxel to voxel (Amanatides and Woo, 1987).

import type { Vector } from "../scene.js";

export interface Sight {
  /** In voxels: integer coordinates are corners. */
  from: Vector;
  direction: Vector;
  /** Half-open bounds of the data, in voxels. */
  low: Vector;
  high: Vector;
}

/** The first voxel within the bounds for which `stops` is true. */
export function firstVoxel(sight: Sight, stops: (i: number, j: number, k: number) => boolean): Vector | null {
  const entered = entry(sight);
  if (entered === null) return null;
  const { from, direction, low, high } = sight;
  const at = from.map((value, axis) =>
    Math.min(high[axis]! - 1, Math.max(low[axis]!, Math.floor(value + direction[axis]! * entered))),
  ) as Vector;
  const step = direction.map(Math.sign) as Vector;
  const next = at.map((cell, axis) => (cell + (step[axis]! > 0 ? 1 : 0) - from[axis]!) / direction[axis]!) as Vector;
  const each = direction.map((value) => Math.abs(1 / value)) as Vector;
  for (;;) {
    if (stops(...at)) return at;
    const axis = nearest(next, step);
    at[axis]! += step[axis]!;
    if (at[axis]! < low[axis]! || at[axis]! >= high[axis]!) return null;
    next[axis]! += each[axis]!;
  }
}

function nearest(next: Vector, step: Vector): 0 | 1 | 2 {
  const [x, y, z] = next.map((value, axis) => (step[axis] ? value : Infinity)) as Vector;
  return x <= y && x <= z ? 0 : y <= z ? 1 : 2;
}

/** The distance along the line to the bounds; null if it misses them. */
function entry({ from, direction, low, high }: Sight): number | null {
  let [first, last] = [0, Infinity];
  for (const axis of [0, 1, 2] as const) {
    if (direction[axis] === 0) {
      if (from[axis] < low[axis] || from[axis] >= high[axis]) return null;
      continue;
    }
    const [a, b] = [(low[axis] - from[axis]) / direction[axis], (high[axis] - from[axis]) / direction[axis]];
    first = Math.max(first, Math.min(a, b));
    last = Math.min(last, Math.max(a, b));
  }
  return first < last ? first : null;
}
