// The labels and the surface of the whole run, in tiles: near ones in full detail, far ones coarser, within a memory
// limit.

import { Group, type Mesh, type PerspectiveCamera } from "three";
import { bytes } from "../../api.js";
import type { Asking } from "../data/worker_client.js";
import type { Look } from "../looks.js";
import type { Piece, SceneFacts, Vector } from "../scene.js";
import { SurfacePaint, surfaceMesh } from "./sensed_layers.js";
import type { Prop } from "./stage.js";
import { VoxelBlock, type VoxelPaint } from "./voxel_layer.js";

/** Up to these distances voxels are drawn of 1, 2 and 4 lattice steps. */
const LEVELS_M = [60, 130, Infinity];
const MOST_VOXELS = 700_000;
const MOST_VOXELS_TOUCH = 250_000;

/** Number of tiles fetched at once. */
const FETCHED_AHEAD = 4;

interface Wanted {
  piece: Piece;
  level: number;
}

interface Shown {
  level: number;
  block: VoxelBlock;
}

export class MapLayer implements Prop {
  readonly voxels = new Group();
  readonly surfaces = new Group();
  private readonly loading = new Map<string, Promise<unknown>>();
  private readonly shown = new Map<string, Shown>();
  private readonly meshes = new Map<string, Promise<Mesh | null>>();
  private round = 0;

  constructor(
    private readonly asking: Asking,
    private readonly scene: SceneFacts,
    private readonly paint: VoxelPaint,
    private readonly origin: Vector,
    private readonly surfacePaint: SurfacePaint,
  ) {}

  drawing(camera: PerspectiveCamera): void {
    if (this.voxels.visible) for (const { block } of this.shown.values()) block.drawing(camera);
  }

  /** Resolves when the worker has the terrain within `reach_m` of the place. */
  async know(place: Vector, reach_m: number): Promise<void> {
    const near = this.scene.tiles.filter((tile) => distance(tile, place) <= reach_m);
    await Promise.all(near.map((tile) => this.load(tile)));
  }

  /** Draws the tiles around the place, nearest first; tiles of a later call go first. `drawn` receives the counts of
   * drawn and all tiles. */
  async show(place: Vector, look: Look, drawn: (done: number, of: number) => void): Promise<void> {
    const round = ++this.round;
    const wanted = levelled(this.scene.tiles, place);
    for (const [name, { block }] of this.shown) if (!wanted.has(name)) this.drop(name, block);
    const missing = [...wanted].filter(([name, { level }]) => this.shown.get(name)?.level !== level);
    try {
      await this.draw(missing, round, look, (done) => drawn(wanted.size - missing.length + done, wanted.size));
    } finally {
      if (round === this.round) drawn(wanted.size, wanted.size);
    }
  }

  private async draw(missing: [string, Wanted][], round: number, look: Look, drawn: (done: number) => void): Promise<void> {
    if (missing.length) drawn(0);
    for (const [done, [name, { piece, level }]] of missing.entries()) {
      for (const [, { piece: next }] of missing.slice(done, done + FETCHED_AHEAD)) void this.load(next).catch(() => undefined);
      await this.load(piece);
      const made = await this.asking.ask({ kind: "draw-tile", name, look, level });
      if (round !== this.round) return;
      const block = this.shown.get(name)?.block ?? new VoxelBlock(this.paint);
      const lowest = made.corner_m.map((value, axis) => value - this.origin[axis]!) as Vector;
      block.show(made, lowest);
      this.voxels.add(block.group);
      this.shown.set(name, { level, block });
      drawn(done + 1);
    }
  }

  /** All tiles are drawn anew at the next `show`. */
  forget(): void {
    for (const [name, { block }] of this.shown) this.shown.set(name, { level: -1, block });
  }

  async showSurfaces(place: Vector, reach_m: number, drawn: () => void): Promise<void> {
    const near = this.scene.meshes.filter((mesh) => {
      const tile = this.scene.tiles.find((one) => one.name === mesh.name);
      return !tile || distance(tile, place) <= reach_m;
    });
    for (const name of this.meshes.keys()) if (!near.some((one) => one.name === name)) this.dropSurface(name);
    for (const { name } of near) {
      if (!this.meshes.has(name)) this.meshes.set(name, this.surface(name).catch(() => null));
      await this.meshes.get(name);
      drawn();
    }
  }

  end(): void {
    for (const { block } of this.shown.values()) block.end();
  }

  private async surface(name: string): Promise<Mesh | null> {
    const content = await bytes(`/api/v1/sequences/${this.scene.sequence_id}/scene/meshes/${encodeURIComponent(name)}?v=${this.scene.label_set_id}`);
    const mesh = surfaceMesh(await this.asking.ask({ kind: "mesh", content }), this.surfacePaint);
    const entry = this.scene.meshes.find((one) => one.name === name);
    const low = entry?.min_m ?? this.scene.tiles.find((one) => one.name === name)?.min_m ?? [0, 0, 0];
    mesh.position.set(low[0] - this.origin[0], low[1] - this.origin[1], low[2] - this.origin[2]);
    this.surfaces.add(mesh);
    return mesh;
  }

  private load(piece: Piece): Promise<unknown> {
    const under = this.loading.get(piece.name);
    if (under) return under;
    const path = `/api/v1/sequences/${this.scene.sequence_id}/scene/tiles/${encodeURIComponent(piece.name)}?v=${this.scene.label_set_id}`;
    const loaded = bytes(path).then((content) => this.asking.ask({ kind: "tile", piece, content }));
    this.loading.set(piece.name, loaded);
    loaded.catch(() => this.loading.delete(piece.name));
    return loaded;
  }

  private dropSurface(name: string): void {
    void this.meshes.get(name)?.then((mesh) => {
      mesh?.removeFromParent();
      mesh?.geometry.dispose();
    });
    this.meshes.delete(name);
  }

  private drop(name: string, block: VoxelBlock): void {
    block.end();
    this.shown.delete(name);
  }
}

/** The tiles to draw with their level, nearest first, until there are as many voxels as are drawn at once. */
function levelled(tiles: Piece[], place: Vector): Map<string, Wanted> {
  const most = matchMedia("(pointer: coarse)").matches ? MOST_VOXELS_TOUCH : MOST_VOXELS;
  const wanted = new Map<string, Wanted>();
  let voxels = 0;
  for (const piece of [...tiles].sort((a, b) => distance(a, place) - distance(b, place))) {
    const level = LEVELS_M.findIndex((reach) => distance(piece, place) < reach);
    voxels += piece.voxels / 4 ** level; // a surface: a quarter at each level
    if (voxels > most && wanted.size) break;
    if (piece.voxels) wanted.set(piece.name, { piece, level });
  }
  return wanted;
}

/** Metres over the ground from the place to the tile; 0 within it. */
function distance(tile: Piece, place: Vector): number {
  const beside = (axis: 0 | 1): number => Math.max(0, tile.min_m[axis] - place[axis], place[axis] - tile.max_m[axis]);
  return Math.hypot(beside(0), beside(1));
}
