// Finds the first labelled voxel on each of many rays: a walk from column to column of the frame's grid.
//
// A column of the grid has at most 32 voxels and is one word of 32 bits. A ray crosses a run of its bits, and the first
// set bit is found without a step for each. Blocks of columns without a set bit in the run are skipped. Nothing is
// allocated along a ray.

import type { Planes } from "./formats.js";
import type { Grid } from "./grid.js";

/** Metres from the camera within which voxels are ignored, because the camera itself stands there. */
const NEAR_M = 0.1;
/** Log₂ of the side of the blocks of columns that a ray skips if it meets nothing in them. */
const BLOCK_BITS = 3;
const BLOCK = 1 << BLOCK_BITS;

/** A word for each column of the grid: bit k of word i · Y + j is set if voxel (i, j, k) is set. */
export interface Columns {
  grid: Grid;
  words: Uint32Array;
}

/** The voxels that have a class, or in planes of differences a code. */
export function columnsOf(planes: Planes, isDifference: boolean): Columns {
  const [low, high, third] = [planes.low, planes.high, planes.observed].map((plane) => columnBits(plane, planes.grid));
  const words = new Uint32Array(low!);
  for (let column = 0; column < words.length; column++) words[column]! |= high![column]! | (isDifference ? third![column]! : 0);
  return { grid: planes.grid, words };
}

const BITS = { 8: Uint8Array, 16: Uint16Array, 32: Uint32Array };

/** The plane by columns: as many bits as these have voxels. */
function columnBits(plane: Uint8Array, { shape: [x, y, z] }: Grid): Uint8Array | Uint16Array | Uint32Array {
  return new BITS[z as keyof typeof BITS](plane.buffer as ArrayBuffer, plane.byteOffset, x * y);
}

/** About how wide the squares are whose lowest voxel is the ground. */
const SQUARE_M = 0.8;

/** How many columns are along a side of the squares of `lowestOf`: 1, 2 or 4, which divide every side of a grid. */
export function squareColumns({ voxel_m }: Grid): number {
  return Math.max(1, 2 ** Math.floor(Math.log2(SQUARE_M / voxel_m + 1e-9)));
}

/** The lowest voxel in each square of columns, row by row along y, or −1. The lowest, because trees stand upon it. */
export function lowestOf({ grid, words }: Columns): Int8Array {
  const [across, along] = grid.shape;
  const square = squareColumns(grid);
  const side = along / square;
  const lowest = new Int8Array((across / square) * side).fill(-1);
  words.forEach((word, column) => {
    if (word === 0) return;
    const at = Math.floor(column / along / square) * side + Math.floor((column % along) / square);
    const k = 31 - Math.clz32(word & -word);
    if (lowest[at]! < 0 || k < lowest[at]!) lowest[at] = k;
  });
  return lowest;
}

/** Writes 1 + index of the first voxel that each ray meets, or 0. `from` and the directions (three numbers each, of any
 * length; NaN meets nothing) are in voxels of the grid, its lowest corner at 0. */
export function castRays(columns: Columns, from: readonly [number, number, number], directions: Float32Array, ids: Uint32Array): void {
  const [x, y, z] = from;
  const sights = new Sights(columns);
  for (let ray = 0; ray < ids.length; ray++) {
    ids[ray] = sights.met(x, y, z, directions[3 * ray]!, directions[3 * ray + 1]!, directions[3 * ray + 2]!);
  }
}

/** The half-open bounds of the set voxels: i from and to, j from and to, k from and to. */
function boxOf({ grid, words }: Columns): Int32Array {
  const [across, along, high] = grid.shape;
  const box = Int32Array.of(across, 0, along, 0, high, 0);
  words.forEach((word, column) => {
    if (word === 0) return;
    const [i, j] = [Math.floor(column / along), column % along];
    box[0] = Math.min(box[0]!, i);
    box[1] = Math.max(box[1]!, i + 1);
    box[2] = Math.min(box[2]!, j);
    box[3] = Math.max(box[3]!, j + 1);
    box[4] = Math.min(box[4]!, 31 - Math.clz32(word & -word));
    box[5] = Math.max(box[5]!, 32 - Math.clz32(word));
  });
  return box;
}

/** The set bits of all columns of each block of `BLOCK` × `BLOCK`, as one word: a ray that misses it skips the block.
 * */
function blocksOf({ grid: { shape: [across, along] }, words }: Columns): Uint32Array {
  const blocksAlong = along / BLOCK;
  const blocks = new Uint32Array((across / BLOCK) * blocksAlong);
  words.forEach((word, column) => {
    const at = Math.floor(column / along / BLOCK) * blocksAlong + Math.floor((column % along) / BLOCK);
    blocks[at]! |= word;
  });
  return blocks;
}

/** The columns of one frame, prepared for many rays. */
class Sights {
  private readonly blocks: Uint32Array;
  private readonly box: Int32Array;
  private readonly near: number;

  constructor(private readonly columns: Columns) {
    this.blocks = blocksOf(columns);
    this.box = boxOf(columns);
    this.near = NEAR_M / columns.grid.voxel_m;
  }

  /** 1 + index of the first voxel that the ray meets, or 0. */
  met(x: number, y: number, z: number, dx: number, dy: number, dz: number): number {
    const { blocks, box } = this;
    const { grid: { shape: [across, along, high] }, words } = this.columns;
    const blocksAlong = along / BLOCK;
    const ix = 1 / dx;
    const iy = 1 / dy;
    const iz = 1 / dz;
    const first = Math.max(
      this.near / Math.hypot(dx, dy, dz),
      entry(x, dx, ix, box[0]!, box[1]!), entry(y, dy, iy, box[2]!, box[3]!), entry(z, dz, iz, box[4]!, box[5]!),
    );
    const last = Math.min(exit(x, dx, ix, box[0]!, box[1]!), exit(y, dy, iy, box[2]!, box[3]!), exit(z, dz, iz, box[4]!, box[5]!));
    if (!(first < last)) return 0; // also of NaN
    let at = first;
    let i = within(Math.floor(x + dx * at), box[0]!, box[1]!);
    let j = within(Math.floor(y + dy * at), box[2]!, box[3]!);
    for (;;) {
      const lowI = i & -BLOCK;
      const lowJ = j & -BLOCK;
      const block = (i >> BLOCK_BITS) * blocksAlong + (j >> BLOCK_BITS);
      const blockX = leaving(x, dx, ix, lowI, BLOCK);
      const blockY = leaving(y, dy, iy, lowJ, BLOCK);
      const leavesBlock = Math.min(blockX, blockY, last);
      if ((blocks[block]! & crossed(z, dz, at, leavesBlock, high)) === 0) {
        if (leavesBlock >= last) return 0;
        at = leavesBlock;
        const isX = blockX <= blockY;
        i = isX ? beside(lowI, dx) : within(Math.floor(x + dx * at), lowI, lowI + BLOCK);
        j = isX ? within(Math.floor(y + dy * at), lowJ, lowJ + BLOCK) : beside(lowJ, dy);
      }
      while ((i & -BLOCK) === lowI && (j & -BLOCK) === lowJ) {
        const nextX = leaving(x, dx, ix, i, 1);
        const nextY = leaving(y, dy, iy, j, 1);
        const leaves = Math.min(nextX, nextY, last);
        const word = words[i * along + j]!;
        const bits = word === 0 ? 0 : word & crossed(z, dz, at, leaves, high);
        if (bits !== 0) return (i * along + j) * high + 32 - Math.clz32(dz > 0 ? bits & -bits : bits);
        if (leaves >= last) return 0;
        at = leaves;
        if (nextX <= nextY) i += dx > 0 ? 1 : -1;
        else j += dy > 0 ? 1 : -1;
      }
      if (i < 0 || i >= across || j < 0 || j >= along) return 0;
    }
  }
}

/** The first cell along the ray beyond the block that starts at `low`. */
function beside(low: number, step: number): number {
  return step > 0 ? low + BLOCK : low - 1;
}

/** The bits of a column of `high` voxels that the ray crosses between two places along it. */
function crossed(z: number, dz: number, from: number, to: number, high: number): number {
  const begins = within(Math.floor(z + dz * from), 0, high);
  const ends = within(Math.floor(z + dz * to), 0, high);
  return begins < ends ? (-1 >>> (31 - ends)) & (-1 << begins) : (-1 >>> (31 - begins)) & (-1 << ends);
}

/** The position along the ray at which it leaves the cells [low, low + size) of an axis. */
function leaving(from: number, step: number, inverse: number, low: number, size: number): number {
  return step === 0 ? Infinity : ((step > 0 ? low + size : low) - from) * inverse;
}

function entry(from: number, step: number, inverse: number, low: number, high: number): number {
  if (step === 0) return from >= low && from < high ? 0 : Infinity;
  return ((step > 0 ? low : high) - from) * inverse;
}

function exit(from: number, step: number, inverse: number, low: number, high: number): number {
  if (step === 0) return from >= low && from < high ? Infinity : 0;
  return ((step > 0 ? high : low) - from) * inverse;
}

function within(value: number, low: number, high: number): number {
  return value < low ? low : value >= high ? high - 1 : value;
}
