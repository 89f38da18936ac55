// The label grid around the robot: the positions of its voxels, and the voxel at a place.
//
// A grid is aligned with the ego frame. The index of voxel (i, j, k) is its position in C order, its id 1 + that index.

import type { Vector } from "../scene.js";

export interface Grid {
  /** Voxels along x, y and z; those along x and y are multiples of 8, those along z are 8, 16 or 32. */
  shape: Vector;
  /** The lowest corner in the ego frame. */
  min_m: Vector;
  voxel_m: number;
}

export function voxelCount({ shape: [x, y, z] }: Grid): number {
  return x * y * z;
}

export function indexOf({ shape: [, y, z] }: Grid, i: number, j: number, k: number): number {
  return (i * y + j) * z + k;
}

/** The voxel with this index. */
export function voxelAt({ shape: [, y, z] }: Grid, index: number): Vector {
  return [Math.floor(index / (y * z)), Math.floor(index / z) % y, index % z];
}

/** 1 + index of the voxel; 0 outside of the grid. */
export function idOf(grid: Grid, voxel: Vector): number {
  if (voxel.some((value, axis) => value < 0 || value >= grid.shape[axis]!)) return 0;
  return indexOf(grid, ...voxel) + 1;
}

/** A point of the ego frame in voxels, the lowest corner at 0. */
export function inVoxels({ min_m, voxel_m }: Grid, point_m: Vector): Vector {
  return [(point_m[0] - min_m[0]) / voxel_m, (point_m[1] - min_m[1]) / voxel_m, (point_m[2] - min_m[2]) / voxel_m];
}

/** A point in voxels in the ego frame. */
export function inMetres({ min_m, voxel_m }: Grid, point: Vector): Vector {
  return [min_m[0] + point[0] * voxel_m, min_m[1] + point[1] * voxel_m, min_m[2] + point[2] * voxel_m];
}

/** The highest corner in the ego frame, rounded to a micrometre. */
export function highestOf(grid: Grid): Vector {
  return inMetres(grid, grid.shape).map((value) => Math.round(value * 1e6) / 1e6) as Vector;
}

/** The lowest and the highest place in the grid, metres above the robot's wheels. */
export function heightsOf(grid: Grid): [number, number] {
  return [grid.min_m[2], highestOf(grid)[2]];
}

/** How far the grid reaches from the robot along x and along y: the farther side of each. */
export function reachOf(grid: Grid): [number, number] {
  const high = highestOf(grid);
  return [Math.max(-grid.min_m[0], high[0]), Math.max(-grid.min_m[1], high[1])];
}
