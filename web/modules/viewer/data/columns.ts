// Which labelled voxel each of many rays meets first: a walk from column to column of the frame's grid.
//
// A column of the grid is 32 voxels and so one word of 32 bits; what a ray crosses of it is a run of bits, and the first
// that is set is found without a step for each. Blocks of columns of which it crosses nothing are leapt over. Nothing is
// allocated along a ray.

import { type Planes, SHAPE } from "./formats.js";

const [ACROSS, ALONG, HIGH] = SHAPE;
/** Voxels from the camera within which nothing is met: what the camera itself stands in. */
const NEAR_VOXELS = 0.5;
/** Sides of the blocks of columns that a ray leaps over where it meets nothing of them. */
const BLOCK_BITS = 3;
const BLOCK = 1 << BLOCK_BITS;
const BLOCKS_ALONG = ALONG / BLOCK;

/** Bit k of word i · 256 + j is set where voxel (i, j, k) has a class, or in planes of differences a code. */
export function columnsOf(planes: Planes, isDifference: boolean): Uint32Array {
  const [low, high, third] = [words(planes.low), words(planes.high), words(planes.observed)];
  return low.map((word, column) => word | high[column]! | (isDifference ? third[column]! : 0));
}

/** Sides of the squares whose ground is told, in columns. */
export const GROUND_COLUMNS = 4;

/** The lowest voxel in each square of columns, row by row along y; −1 where there is none. The lowest: trees stand upon it. */
export function lowestOf(columns: Uint32Array): Int8Array {
  const side = ALONG / GROUND_COLUMNS;
  const lowest = new Int8Array((ACROSS / GROUND_COLUMNS) * side).fill(-1);
  columns.forEach((word, column) => {
    if (word === 0) return;
    const at = Math.floor(column / ALONG / GROUND_COLUMNS) * side + Math.floor((column % ALONG) / GROUND_COLUMNS);
    const k = 31 - Math.clz32(word & -word);
    if (lowest[at]! < 0 || k < lowest[at]!) lowest[at] = k;
  });
  return lowest;
}

function words(plane: Uint8Array): Uint32Array {
  return new Uint32Array(plane.buffer, plane.byteOffset, ACROSS * ALONG);
}

/**
 * Writes 1 + index of the first voxel that each ray meets, 0 where it meets none. `from` and the directions (three
 * numbers each, of any length; NaN meets nothing) are in voxels of the grid, its lowest corner at 0.
 */
export function castRays(columns: Uint32Array, from: readonly [number, number, number], directions: Float32Array, ids: Uint32Array): void {
  const [x, y, z] = from;
  const box = boxOf(columns);
  const blocks = blocksOf(columns);
  for (let ray = 0; ray < ids.length; ray++) {
    ids[ray] = met(columns, blocks, box, x, y, z, directions[3 * ray]!, directions[3 * ray + 1]!, directions[3 * ray + 2]!);
  }
}

/** The bounds of what is set, half-open: i from and to, j from and to, k from and to. */
function boxOf(columns: Uint32Array): Int32Array {
  const box = Int32Array.of(ACROSS, 0, ALONG, 0, HIGH, 0);
  columns.forEach((word, column) => {
    if (word === 0) return;
    const [i, j] = [Math.floor(column / ALONG), column % ALONG];
    box[0] = Math.min(box[0]!, i);
    box[1] = Math.max(box[1]!, i + 1);
    box[2] = Math.min(box[2]!, j);
    box[3] = Math.max(box[3]!, j + 1);
    box[4] = Math.min(box[4]!, 31 - Math.clz32(word & -word));
    box[5] = Math.max(box[5]!, 32 - Math.clz32(word));
  });
  return box;
}

/** What is set in any column of each block of `BLOCK` × `BLOCK`, as one word: a ray that misses it leaps over the block. */
function blocksOf(columns: Uint32Array): Uint32Array {
  const blocks = new Uint32Array((ACROSS / BLOCK) * BLOCKS_ALONG);
  columns.forEach((word, column) => {
    const at = Math.floor(column / ALONG / BLOCK) * BLOCKS_ALONG + Math.floor((column % ALONG) / BLOCK);
    blocks[at]! |= word;
  });
  return blocks;
}

function met(
  columns: Uint32Array, blocks: Uint32Array, box: Int32Array, x: number, y: number, z: number, dx: number, dy: number, dz: number,
): number {
  const ix = 1 / dx;
  const iy = 1 / dy;
  const iz = 1 / dz;
  const first = Math.max(
    NEAR_VOXELS / Math.hypot(dx, dy, dz),
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
    const block = (i >> BLOCK_BITS) * BLOCKS_ALONG + (j >> BLOCK_BITS);
    const blockX = leaving(x, dx, ix, lowI, BLOCK);
    const blockY = leaving(y, dy, iy, lowJ, BLOCK);
    const leavesBlock = Math.min(blockX, blockY, last);
    if ((blocks[block]! & crossed(z, dz, at, leavesBlock)) === 0) {
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
      const word = columns[i * ALONG + j]!;
      const bits = word === 0 ? 0 : word & crossed(z, dz, at, leaves);
      if (bits !== 0) return (i * ALONG + j) * HIGH + 32 - Math.clz32(dz > 0 ? bits & -bits : bits);
      if (leaves >= last) return 0;
      at = leaves;
      if (nextX <= nextY) i += dx > 0 ? 1 : -1;
      else j += dy > 0 ? 1 : -1;
    }
    if (i < 0 || i >= ACROSS || j < 0 || j >= ALONG) return 0;
  }
}

/** The first cell beyond the block that begins at `low`, as the ray goes. */
function beside(low: number, step: number): number {
  return step > 0 ? low + BLOCK : low - 1;
}

/** The bits of a column that the ray crosses between two places along it. */
function crossed(z: number, dz: number, from: number, to: number): number {
  const begins = within(Math.floor(z + dz * from), 0, HIGH);
  const ends = within(Math.floor(z + dz * to), 0, HIGH);
  return begins < ends ? (-1 >>> (31 - ends)) & (-1 << begins) : (-1 >>> (31 - begins)) & (-1 << ends);
}

/** Where along the ray it leaves the cells [low, low + size) of an axis. */
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
