// The scene in numbers, in the worker: planes of frames, tiles of the map, and the faces and picks made from them.

import { type Faces, facesOf } from "./faces.js";
import { CameraRays, type CameraView, type Frustum, type ViewSize } from "./camera_views.js";
import { columnsOf, lowestOf } from "./columns.js";
import { type CameraFacts, type Planes, type Tile, classAt, codeAt, coded, isObserved, labelled } from "./formats.js";
import { idOf, inMetres, inVoxels, indexOf, voxelAt } from "./grid.js";
import { type Found, Tiles } from "./lookup.js";
import { TrackHeight } from "./track_height.js";
import { DIFFERENCES, type Look, type Mode, colourOf, isWithin } from "../looks.js";
import { type Piece, type Pose, type SceneFacts, type Vector, toEgo, toMap, turnedToEgo } from "../scene.js";
import { type Size, Solid } from "./solid.js";
import { firstVoxel } from "./ray_walk.js";

const KEPT_FRAMES = 24;

/**
 * A voxel under the cursor; its centre in the map and in the ego frame; `found` has the map's values there.
 *
 * `voxel` holds its index in the frame's grid (`semantics[i, j, k]`), null outside that grid; `id` is 1 + that index in
 * C order, as in camera pictures, or 0.
 */
export interface Picked {
  id: number;
  voxel: Vector | null;
  centre_ego_m: Vector;
  centre_m: Vector;
  kind: number;
  seen: boolean;
  scope: "frame" | "map";
  found: Found | null;
  /** The kind of difference, if differences are shown. */
  difference: number | null;
}

/** Faces, the number of voxels of each class (or difference), and their position in the ego frame or the map. */
export interface Drawn {
  faces: Faces;
  counts: number[];
  /** The lowest corner of voxel (0, 0, 0), and the side of a voxel. */
  corner_m: Vector;
  voxel_m: number;
  /** The lowest labelled voxel of a frame in each square of columns, by `lowestOf`. */
  lowest?: Int8Array;
}

export interface Ray {
  from_m: Vector;
  direction: Vector;
}

export class Model {
  readonly tiles: Tiles;
  private readonly frames = new Map<string, Planes>();
  private readonly wheels: TrackHeight;
  private cameras: CameraRays | null = null;

  constructor(readonly scene: SceneFacts) {
    this.tiles = new Tiles(scene.map_voxel_m);
    this.wheels = new TrackHeight(scene.frames.map_from_ego);
  }

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
    const lowest = lowestOf(columnsOf(planes, look.mode === "difference"));
    if (look.mode === "difference") return { ...drawnDifferences(planes, look), lowest };
    return { ...this.drawPlanes(planes, look, this.pose(token)), lowest };
  }

  /** Draws the labels around the robot's pose; for labels coloured by class the pose does not matter. */
  drawPlanes(planes: Planes, look: Look, pose: Pose): Drawn {
    const { grid } = planes;
    const solid = new Solid(grid.shape);
    const counts: [number, number, number] = [0, 0, 0];
    for (const index of labelled(planes)) {
      const kind = classAt(planes, index);
      counts[kind - 1]!++;
      if (isCut(planes, look, index)) continue;
      const values = look.mode === "class" ? null : this.foundIn(pose, planes, index);
      solid.paint(...voxelAt(grid, index), colourOf(look, kind, isObserved(planes, index), values, this.scene));
    }
    return { faces: facesOf(solid), counts, corner_m: grid.min_m, voxel_m: grid.voxel_m };
  }

  /** A tile with voxels of 2^level lattice steps, each with the majority class of its fine voxels. */
  drawTile(name: string, look: Look, level: number): Drawn {
    const tile = this.tiles.of(name);
    if (!tile?.i.length) throw new Error(`The tile ${name} is empty.`);
    const voxel = 2 ** level;
    const { low, size } = extent(tile, voxel);
    const solid = new Solid(size);
    const counts: [number, number, number] = [0, 0, 0];
    for (const [row, at] of rowsShown(tile, voxel, solid, low)) {
      const kind = tile.classes[row]!;
      counts[kind - 1]!++;
      if (this.isCutInMap(look, [tile.i[row]!, tile.j[row]!, tile.k[row]!])) continue;
      const values = look.mode === "class" ? null : valuesOf(tile, row);
      solid.paint(...at, colourOf(look, kind, true, values, this.scene));
    }
    const { map_voxel_m } = this.scene;
    const corner_m = low.map((value) => value * map_voxel_m) as Vector;
    return { faces: facesOf(solid), counts, corner_m, voxel_m: map_voxel_m * voxel };
  }

  openCameras(facts: CameraFacts): void {
    this.cameras = new CameraRays(facts);
  }

  /** None before the cameras are known. */
  frusta(token: string): Frustum[] {
    const { frames, playback } = this.scene;
    return this.cameras?.frusta(playback.cameras, frames.tokens.indexOf(token)) ?? [];
  }

  /** The view of each camera of the frame: every labelled voxel, even a hidden one, occludes those behind it. */
  cameraViews(token: string, look: Look, sizes: readonly ViewSize[]): CameraView[] {
    const { cameras } = this;
    if (!cameras) throw new Error("The scene has no cameras.");
    const planes = this.planes(token, look.mode);
    const columns = columnsOf(planes, look.mode === "difference");
    const frame = this.scene.frames.tokens.indexOf(token);
    const colour = this.colouring(token, look, planes);
    return sizes.map((size) => {
      const ids = cameras.cast(columns, size, frame);
      const colours = new Uint8Array(ids.length);
      let [last, same] = [0, 0]; // neighbouring pixels often see the same voxel
      for (let pixel = 0; pixel < ids.length; pixel++) {
        const id = ids[pixel]!;
        if (id === 0) continue;
        if (id !== last) [last, same] = [id, colour(id)];
        colours[pixel] = same;
      }
      return { ...size, ids, colours };
    });
  }

  /** The palette's index of a voxel by its id, looked up once for each. */
  private colouring(token: string, look: Look, planes: Planes): (id: number) => number {
    const [pose, known] = [this.pose(token), new Map<number, number>()];
    const made = (index: number): number => {
      if (isCut(planes, look, index)) return 0;
      if (look.mode === "difference") return codeAt(planes, index);
      const values = look.mode === "class" ? null : this.foundIn(pose, planes, index);
      return colourOf(look, classAt(planes, index), isObserved(planes, index), values, this.scene);
    };
    return (id) => {
      const held = known.get(id) ?? made(id - 1);
      known.set(id, held);
      return held;
    };
  }

  /**
   * The map in a voxel of the frame. A voxel of several of the map's is looked at in as many parts; the first part of its
   * own class counts, else the map at or around its centre.
   */
  private foundIn(pose: Pose, planes: Planes, index: number): Found | null {
    const { grid } = planes;
    const [i, j, k] = voxelAt(grid, index);
    const at = (x: number, y: number, z: number): Vector => toMap(pose, inMetres(grid, [i + x, j + y, k + z]));
    const parts = Math.round(grid.voxel_m / this.scene.map_voxel_m);
    const kind = classAt(planes, index);
    for (let part = 0; parts > 1 && part < parts ** 3; part++) {
      const [x, y, z] = [part % parts, Math.floor(part / parts) % parts, Math.floor(part / parts ** 2)] as const;
      const found = this.tiles.holding(at((x + 0.5) / parts, (y + 0.5) / parts, (z + 0.5) / parts));
      if (found?.kind === kind) return found;
    }
    return this.tiles.near(at(0.5, 0.5, 0.5));
  }

  pick(ray: Ray, scope: "frame" | "map", token: string, look: Look): Picked | null {
    return scope === "frame" ? this.pickFrame(ray, token, look) : this.pickMap(ray, token, look);
  }

  /** The voxel of the frame with this id. */
  pickedAt(token: string, id: number, look: Look): Picked {
    const [planes, at] = [this.planes(token, look.mode), id - 1];
    const [pose, voxel] = [this.pose(token), voxelAt(planes.grid, at)];
    const centre_ego_m = inMetres(planes.grid, voxel.map((value) => value + 0.5) as Vector);
    const picked = { id, voxel, centre_ego_m, centre_m: toMap(pose, centre_ego_m), scope: "frame" as const };
    if (look.mode === "difference") return { ...picked, kind: 0, seen: true, found: null, difference: codeAt(planes, at) };
    const [kind, seen] = [classAt(planes, at), isObserved(planes, at)];
    return { ...picked, kind, seen, found: this.foundIn(pose, planes, at), difference: null };
  }

  private pickFrame(ray: Ray, token: string, look: Look): Picked | null {
    const [planes, pose] = [this.planes(token, look.mode), this.pose(token)];
    const isDifference = look.mode === "difference";
    const { grid } = planes;
    const from = inVoxels(grid, toEgo(pose, ray.from_m));
    const sight = { from, direction: turnedToEgo(pose, ray.direction), low: [0, 0, 0] as Vector, high: grid.shape };
    const index = firstVoxel(sight, (i, j, k) => {
      const at = indexOf(grid, i, j, k);
      if (isCut(planes, look, at)) return false;
      if (isDifference) return codeAt(planes, at) > 0;
      const kind = classAt(planes, at);
      return kind > 0 && ((look.classes >> kind) & 1) === 1 && (look.unseen !== "hide" || isObserved(planes, at));
    });
    return index && this.pickedAt(token, idOf(grid, index), look);
  }

  private pickMap(ray: Ray, token: string, look: Look): Picked | null {
    const { grid, map_voxel_m, tiles } = this.scene;
    const from = ray.from_m.map((value) => value / map_voxel_m) as Vector;
    const [low, high] = bounds(tiles, map_voxel_m);
    const index = firstVoxel({ from, direction: ray.direction, low, high }, (i, j, k) => {
      const met = this.tiles.at(i, j, k);
      return met !== null && ((look.classes >> met.kind) & 1) === 1 && !this.isCutInMap(look, [i, j, k]);
    });
    const found = index && this.tiles.at(...index);
    if (!index || !found) return null;
    const centre_m = index.map((value) => (value + 0.5) * map_voxel_m) as Vector;
    const centre_ego_m = toEgo(this.pose(token), centre_m);
    const inFrame = inVoxels(grid, centre_ego_m).map(Math.floor) as Vector;
    const id = idOf(grid, inFrame);
    return { id, voxel: id ? inFrame : null, centre_ego_m, centre_m, kind: found.kind, seen: true, scope: "map", found, difference: null };
  }

  private isCutInMap({ heights_m }: Look, index: Vector): boolean {
    if (!heights_m) return false;
    const [x, y, z] = index.map((value) => (value + 0.5) * this.scene.map_voxel_m) as Vector;
    return !isWithin(heights_m, z - this.wheels.at(x, y));
  }

  private planes(token: string, mode: Mode): Planes {
    const planes = this.frames.get(keyOf(token, mode));
    if (!planes) throw new Error(`The frame ${token} is not loaded.`);
    this.keepFrame(token, mode, planes); // used last, forgotten last
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

/** The voxel's centre is not among the heights that are shown. */
function isCut({ grid }: Planes, { heights_m }: Look, index: number): boolean {
  return heights_m !== undefined && !isWithin(heights_m, grid.min_m[2] + ((index % grid.shape[2]) + 0.5) * grid.voxel_m);
}

function drawnDifferences(planes: Planes, look: Look): Drawn {
  const { grid } = planes;
  const solid = new Solid(grid.shape);
  const counts = DIFFERENCES.slice(1).map(() => 0);
  for (const index of coded(planes)) {
    const code = codeAt(planes, index);
    counts[code - 1]!++;
    if (!isCut(planes, look, index)) solid.paint(...voxelAt(grid, index), code);
  }
  return { faces: facesOf(solid), counts, corner_m: grid.min_m, voxel_m: grid.voxel_m };
}

/** The half-open range of the map's voxels that the tiles can contain, with a margin of one. */
function bounds(pieces: Piece[], voxel_m: number): [Vector, Vector] {
  const low = [0, 1, 2].map((axis) => Math.floor(Math.min(...pieces.map((one) => one.min_m[axis]!)) / voxel_m) - 1);
  const high = [0, 1, 2].map((axis) => Math.ceil(Math.max(...pieces.map((one) => one.max_m[axis]!)) / voxel_m) + 1);
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

/** One row for each coarse voxel, of the majority class of its fine voxels. */
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
  const { elevation_m, slope_rad, roughness, d2, confidence } = tile;
  return { elevation_m: elevation_m[row]!, slope_rad: slope_rad[row]!, roughness: roughness[row]!, d2: d2[row]!, confidence: confidence[row]! };
}
