// The labelled map as tiles: the voxel at a place, and its terrain values.

import type { Tile } from "./formats.js";
import type { Values } from "../looks.js";
import type { Piece, Vector } from "../scene.js";

/** A voxel of the map with its values; `index` on the lattice. */
export interface Found extends Values {
  index: Vector;
  kind: number;
}

export class Tiles {
  private readonly held = new Map<string, { piece: Piece; tile: Tile }>();
  private last: { piece: Piece; tile: Tile } | undefined;

  constructor(private readonly voxel_m: number) {}

  keep(piece: Piece, tile: Tile): void {
    this.held.set(piece.name, { piece, tile });
  }

  of(name: string): Tile | undefined {
    return this.held.get(name)?.tile;
  }

  /** The voxel of this index. */
  at(i: number, j: number, k: number): Found | null {
    const near = this.pieceOf(i, j);
    if (!near) return null;
    const row = rowOf(near.tile, i, j, k);
    return row < 0 ? null : found(near.tile, row);
  }

  /** The voxel of the map that contains the place. */
  holding(point: Vector): Found | null {
    return this.at(...(point.map((value) => Math.floor(value / this.voxel_m)) as Vector));
  }

  /** The voxel at the place in the map, else the nearest one that touches it. */
  near(point: Vector): Found | null {
    const [i, j, k] = point.map((value) => Math.floor(value / this.voxel_m)) as Vector;
    const exact = this.at(i, j, k);
    if (exact) return exact;
    let best: Found | null = null;
    let least = Infinity;
    for (const [di, dj, dk] of AROUND) {
      const distance = this.distance(point, [i + di, j + dj, k + dk]);
      if (distance >= least) continue;
      const candidate = this.at(i + di, j + dj, k + dk);
      if (candidate) [best, least] = [candidate, distance];
    }
    return best;
  }

  private distance(point: Vector, index: Vector): number {
    return Math.hypot(...point.map((value, axis) => value - (index[axis]! + 0.5) * this.voxel_m));
  }

  private pieceOf(i: number, j: number): { piece: Piece; tile: Tile } | undefined {
    const [x, y] = [(i + 0.5) * this.voxel_m, (j + 0.5) * this.voxel_m];
    const holds = ({ piece }: { piece: Piece }): boolean =>
      x >= piece.min_m[0] && x < piece.max_m[0] && y >= piece.min_m[1] && y < piece.max_m[1];
    if (this.last && holds(this.last)) return this.last;
    for (const one of this.held.values()) if (holds(one)) return (this.last = one);
    return undefined;
  }
}

const STEPS = [-1, 0, 1];
const AROUND = STEPS.flatMap((i) => STEPS.flatMap((j) => STEPS.map((k): Vector => [i, j, k])));

/** The row of the voxel by bisection, or −1. */
export function rowOf(tile: Tile, i: number, j: number, k: number): number {
  let [low, high] = [0, tile.i.length - 1];
  while (low <= high) {
    const middle = (low + high) >> 1;
    const order = tile.i[middle]! - i || tile.j[middle]! - j || tile.k[middle]! - k;
    if (order === 0) return middle;
    if (order < 0) low = middle + 1;
    else high = middle - 1;
  }
  return -1;
}

export function found(tile: Tile, row: number): Found {
  return {
    index: [tile.i[row]!, tile.j[row]!, tile.k[row]!],
    kind: tile.classes[row]!,
    elevation_m: tile.elevation_m[row]!,
    slope_rad: tile.slope_rad[row]!,
    roughness: tile.roughness[row]!,
    d2: tile.d2[row]!,
    confidence: tile.confidence[row]!,
  };
}
