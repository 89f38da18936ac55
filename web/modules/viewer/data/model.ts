// The scene in numbers, in the worker: planes of frames, tiles of the map, and what is drawn or picked of them.

import { type Faces, facesOf } from "./faces.js";
import { type Planes, type Tile, GRID_MIN_M, SHAPE, VOXEL_M, classAt, codeAt, coded, isObserved, labelled } from "./formats.js";
import { type Found, Tiles } from "./lookup.js";
import { DIFFERENCES, type Look, type Mode, colourOf } from "../looks.js";
import { type Piece, type Pose, type SceneFacts, type Vector, toEgo, toMap, turnedToEgo } from "../scene.js";
import { type Size, Solid } from "./solid.js";
import { firstVoxel } from "./ray_walk.js";

const KEPT_FRAMES = 24;

/** A voxel under the cursor; `index` and `centre_m` (map) of the grid it was picked in, `found` what the map says there. */
export interface Picked {
  index: Vector;
  centre_m: Vector;
  kind: number;
  seen: boolean;
  scope: "frame" | "map";
  found: Found | null;
  /** How it differs, where differences are shown. */
  difference: number | null;
}

/** Faces, how many voxels of each class (or difference) they stand for, and the place of voxel (0, 0, 0)'s lowest corner on its lattice. */
export interface Drawn {
  faces: Faces;
  counts: number[];
  origin: Vector;
  voxel: number;
}

export interface Ray {
  from_m: Vector;
  direction: Vector;
}

export class Model {
  readonly tiles = new Tiles();
  private readonly frames = new Map<string, Planes>();

  constructor(private readonly scene: SceneFacts) {}

  keepFrame(token: string, mode: Mode, planes: Planes): void {
    const key = keyOf(token, mode);
    this.frames.delete(key);
    this.frames.set(key, planes);
    for (const oldest of this.frames.keys()) {
      if (this.frames.size <= KEPT_FRAMES) break;
      this.frames.delete(oldest);
    }
  }

  drawFrame(token: string, look: Look): Drawn {
    const planes = this.planes(token, look.mode);
    if (look.mode === "difference") return drawnDifferences(planes);
    const pose = this.pose(token);
    const solid = new Solid(SHAPE);
    const counts: [number, number, number] = [0, 0, 0];
    for (const index of labelled(planes)) {
      const [i, j, k] = place(index);
      const kind = classAt(planes, index);
      counts[kind - 1]!++;
      const values = look.mode === "class" ? null : this.tiles.near(toMap(pose, centre(i, j, k)));
      solid.paint(i, j, k, colourOf(look, kind, isObserved(planes, index), values, this.scene));
    }
    return { faces: facesOf(solid), counts, origin: [0, 0, 0], voxel: 1 };
  }

  /** A tile with voxels of 2^level lattice steps, each of the class that most of its own have. */
  drawTile(name: string, look: Look, level: number): Drawn {
    const tile = this.tiles.of(name);
    if (!tile?.i.length) throw new Error(`The tile ${name} holds nothing.`);
    const voxel = 2 ** level;
    const { low, size } = extent(tile, voxel);
    const solid = new Solid(size);
    const counts: [number, number, number] = [0, 0, 0];
    for (const [row, at] of rowsShown(tile, voxel, solid, low)) {
      const kind = tile.classes[row]!;
      counts[kind - 1]!++;
      const values = look.mode === "class" ? null : valuesOf(tile, row);
      solid.paint(...at, colourOf(look, kind, true, values, this.scene));
    }
    return { faces: facesOf(solid), counts, origin: low, voxel };
  }

  pick(ray: Ray, scope: "frame" | "map", token: string, look: Look): Picked | null {
    return scope === "frame" ? this.pickFrame(ray, token, look) : this.pickMap(ray, look);
  }

  private pickFrame(ray: Ray, token: string, look: Look): Picked | null {
    const [planes, pose] = [this.planes(token, look.mode), this.pose(token)];
    const isDifference = look.mode === "difference";
    const from = toEgo(pose, ray.from_m).map((value, axis) => (value - GRID_MIN_M[axis]!) / VOXEL_M) as Vector;
    const sight = { from, direction: turnedToEgo(pose, ray.direction), low: [0, 0, 0] as Vector, high: [...SHAPE] as Vector };
    const index = firstVoxel(sight, (i, j, k) => {
      const at = (i * SHAPE[1] + j) * SHAPE[2] + k;
      if (isDifference) return codeAt(planes, at) > 0;
      const kind = classAt(planes, at);
      return kind > 0 && ((look.classes >> kind) & 1) === 1 && (look.unseen !== "hide" || isObserved(planes, at));
    });
    if (!index) return null;
    const at = (index[0] * SHAPE[1] + index[1]) * SHAPE[2] + index[2];
    const centre_m = toMap(pose, centre(...index));
    if (isDifference) return { index, centre_m, kind: 0, seen: true, scope: "frame", found: null, difference: codeAt(planes, at) };
    const kind = classAt(planes, at);
    return { index, centre_m, kind, seen: isObserved(planes, at), scope: "frame", found: this.tiles.near(centre_m), difference: null };
  }

  private pickMap(ray: Ray, look: Look): Picked | null {
    const from = ray.from_m.map((value) => value / VOXEL_M) as Vector;
    const [low, high] = bounds(this.scene.tiles);
    const index = firstVoxel({ from, direction: ray.direction, low, high }, (i, j, k) => {
      const met = this.tiles.at(i, j, k);
      return met !== null && ((look.classes >> met.kind) & 1) === 1;
    });
    const found = index && this.tiles.at(...index);
    if (!index || !found) return null;
    const centre_m = index.map((value) => (value + 0.5) * VOXEL_M) as Vector;
    return { index, centre_m, kind: found.kind, seen: true, scope: "map", found, difference: null };
  }

  private planes(token: string, mode: Mode): Planes {
    const planes = this.frames.get(keyOf(token, mode));
    if (!planes) throw new Error(`The frame ${token} is not here.`);
    return planes;
  }

  private pose(token: string): Pose {
    const pose = this.scene.frames.map_from_ego[this.scene.frames.tokens.indexOf(token)];
    if (!pose) throw new Error(`The scene has no frame ${token}.`);
    return pose;
  }
}

function keyOf(token: string, mode: Mode): string {
  return mode === "difference" ? `${token} difference` : token;
}

function drawnDifferences(planes: Planes): Drawn {
  const solid = new Solid(SHAPE);
  const counts = DIFFERENCES.slice(1).map(() => 0);
  for (const index of coded(planes)) {
    const code = codeAt(planes, index);
    counts[code - 1]!++;
    solid.paint(...place(index), code);
  }
  return { faces: facesOf(solid), counts, origin: [0, 0, 0], voxel: 1 };
}

function place(index: number): Vector {
  return [Math.floor(index / (SHAPE[1] * SHAPE[2])), Math.floor(index / SHAPE[2]) % SHAPE[1], index % SHAPE[2]];
}

/** The centre of the frame's voxel in the ego frame. */
function centre(i: number, j: number, k: number): Vector {
  return [GRID_MIN_M[0] + (i + 0.5) * VOXEL_M, GRID_MIN_M[1] + (j + 0.5) * VOXEL_M, GRID_MIN_M[2] + (k + 0.5) * VOXEL_M];
}

function bounds(pieces: Piece[]): [Vector, Vector] {
  const low = [0, 1, 2].map((axis) => Math.floor(Math.min(...pieces.map((one) => one.min_m[axis]!)) / VOXEL_M) - 1);
  const high = [0, 1, 2].map((axis) => Math.ceil(Math.max(...pieces.map((one) => one.max_m[axis]!)) / VOXEL_M) + 1);
  return [low as Vector, high as Vector];
}

function extent(tile: Tile, voxel: number): { low: Vector; size: Size } {
  const spans = [tile.i, tile.j, tile.k].map((indices) => {
    let [low, high] = [Infinity, -Infinity];
    for (const value of indices) [low, high] = [Math.min(low, value), Math.max(high, value)];
    const first = Math.floor(low / voxel);
    return [first * voxel, Math.floor(high / voxel) - first + 1] as const;
  });
  return {
    low: spans.map((span) => span[0]) as Vector,
    size: spans.map((span) => span[1]) as unknown as Size,
  };
}

/** One row for each coarse voxel, of the class that most of its own have. */
function* rowsShown(tile: Tile, voxel: number, solid: Solid, low: Vector): Generator<[number, Vector]> {
  const votes = voxel === 1 ? null : new Map<number, { at: Vector; rows: number[] }>();
  for (let row = 0; row < tile.i.length; row++) {
    const fine = [tile.i[row]!, tile.j[row]!, tile.k[row]!];
    const at = fine.map((value, axis) => Math.floor((value - low[axis]!) / voxel)) as Vector;
    if (votes === null) yield [row, at];
    else {
      const cell = solid.cell(...at);
      const vote = votes.get(cell);
      if (vote) vote.rows.push(row);
      else votes.set(cell, { at, rows: [row] });
    }
  }
  for (const { at, rows } of votes?.values() ?? []) yield [mostOf(tile, rows), at];
}

function mostOf(tile: Tile, rows: number[]): number {
  const tally = [0, 0, 0, 0];
  for (const row of rows) tally[tile.classes[row]!]!++;
  const kind = tally.lastIndexOf(Math.max(...tally));
  return rows.find((row) => tile.classes[row] === kind) ?? rows[0]!;
}

function valuesOf(tile: Tile, row: number): Omit<Found, "index" | "kind"> {
  return { elevation_m: tile.elevation_m[row]!, slope_rad: tile.slope_rad[row]!, roughness: tile.roughness[row]!, d2: tile.d2[row]! };
}
