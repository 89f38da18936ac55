// The binary responses of the scene's routes, once decompressed: voxels of a frame, tiles, meshes, clouds.
//
// All little endian behind a magic of four letters. Data whose length differs from the header is refused.

import { type Grid, voxelCount } from "./grid.js";

const MOST = 20_000_000;
/** Speed of radar detections beyond which their colour stays the same. */
export const FASTEST_M_S = 5;

/** Three bit planes over the grid, bit `index % 8` of byte `index >> 3`. */
export interface Planes {
  grid: Grid;
  low: Uint8Array;
  high: Uint8Array;
  observed: Uint8Array;
}

/** Labelled voxels of a square of the map, sorted by index; the centre of (i, j, k) is ((i, j, k) + ½) · the voxel of the map. */
export interface Tile {
  i: Int32Array;
  j: Int32Array;
  k: Int32Array;
  classes: Uint8Array;
  elevation_m: Float32Array;
  slope_rad: Float32Array;
  roughness: Float32Array;
  d2: Float32Array;
  /** The probability that the class is right, times 255; 0 if it is unknown. */
  confidence: Uint8Array;
}

/** Vertices relative to the tile's lowest corner. */
export interface Surface {
  vertices_m: Float32Array;
  classes: Uint8Array;
  triangles: Uint32Array;
}

/** Points in the ego frame, in centimetres. */
export interface Cloud {
  points_cm: Int16Array;
  intensity: Uint8Array;
}

/**
 * The cameras of a playback.
 *
 * For each camera: whether there is a picture of each frame, unit vectors of its rays, and its pose at each frame. The
 * vectors are in the optical frame, at rows × columns places from edge to edge of the image (NaN: outside the lens).
 * The poses are in the ego frame of the labels, tx ty tz qw qx qy qz (NaN: unknown).
 */
export interface CameraFacts {
  cameras: number;
  frames: number;
  columns: number;
  rows: number;
  hasPicture: Uint8Array;
  rays: Float32Array;
  egoFromCamera: Float32Array;
}

export class FormatError extends Error {}

/** Reads one array after another; copies them, so that none is unaligned. */
class Reader {
  private at = 4;
  constructor(private readonly content: Uint8Array, magic: string) {
    const found = String.fromCharCode(...content.subarray(0, 4));
    if (found !== magic) throw new FormatError(`The data starts with “${found}”, not with “${magic}”.`);
  }
  count(): number {
    const [value = 0] = new Uint32Array(this.take(4));
    if (value > MOST) throw new FormatError(`The header declares ${value} items; at most ${MOST} are allowed.`);
    return value;
  }
  take(bytes: number): ArrayBuffer {
    if (this.at + bytes > this.content.length) throw new FormatError("The data is shorter than its header declares.");
    const part = this.content.slice(this.at, this.at + bytes).buffer;
    this.at += bytes;
    return part;
  }
  /** Bytes missing in data of earlier releases, as zeros. */
  added(bytes: number): Uint8Array {
    return this.at === this.content.length ? new Uint8Array(bytes) : new Uint8Array(this.take(bytes));
  }
  end(): void {
    if (this.at !== this.content.length) throw new FormatError("The data is longer than its header declares.");
  }
}

/** `STV1`, or `STD1`, whose planes are the bits of a code. */
export function planesOf(content: Uint8Array, grid: Grid, magic: "STV1" | "STD1" = "STV1"): Planes {
  const reader = new Reader(content, magic);
  const planes = reader.count();
  if (planes !== 3) throw new FormatError(`The frame has ${planes} planes, not 3.`);
  const [low, high, observed] = [0, 1, 2].map(() => new Uint8Array(reader.take(voxelCount(grid) / 8)));
  reader.end();
  return { grid, low: low!, high: high!, observed: observed! };
}

export function tileOf(content: Uint8Array): Tile {
  const reader = new Reader(content, "STT1");
  const n = reader.count();
  const tile = {
    i: new Int32Array(reader.take(4 * n)),
    j: new Int32Array(reader.take(4 * n)),
    k: new Int32Array(reader.take(4 * n)),
    classes: new Uint8Array(reader.take(n)),
    elevation_m: new Float32Array(reader.take(4 * n)),
    slope_rad: new Float32Array(reader.take(4 * n)),
    roughness: new Float32Array(reader.take(4 * n)),
    d2: new Float32Array(reader.take(4 * n)),
    confidence: reader.added(n),
  };
  reader.end();
  return tile;
}

export function surfaceOf(content: Uint8Array): Surface {
  const reader = new Reader(content, "STM1");
  const [vertices, triangles] = [reader.count(), reader.count()];
  const surface = {
    vertices_m: new Float32Array(reader.take(12 * vertices)),
    classes: new Uint8Array(reader.take(vertices)),
    triangles: new Uint32Array(reader.take(12 * triangles)),
  };
  reader.end();
  if (surface.triangles.some((vertex) => vertex >= vertices)) throw new FormatError("A triangle refers to a missing vertex.");
  return surface;
}

export function cloudOf(content: Uint8Array): Cloud {
  const reader = new Reader(content, "STC1");
  const n = reader.count();
  const cloud = { points_cm: new Int16Array(reader.take(6 * n)), intensity: new Uint8Array(reader.take(n)) };
  reader.end();
  return cloud;
}

/** `STE1` as a cloud whose intensity is the speed over ground, 0 to `FASTEST_M_S` and more. */
export function radarOf(content: Uint8Array): Cloud {
  const reader = new Reader(content, "STE1");
  const n = reader.count();
  const points_cm = new Int16Array(reader.take(6 * n));
  const speeds_cm_s = new Int16Array(reader.take(2 * n));
  reader.end();
  const intensity = Uint8Array.from(speeds_cm_s, (speed) => Math.min(255, Math.round((2.55 * Math.abs(speed)) / FASTEST_M_S)));
  return { points_cm, intensity };
}

export function camerasOf(content: Uint8Array): CameraFacts {
  const reader = new Reader(content, "STR1");
  const [cameras, frames, columns, rows] = [reader.count(), reader.count(), reader.count(), reader.count()];
  const facts = {
    cameras, frames, columns, rows,
    hasPicture: new Uint8Array(reader.take(cameras * frames)),
    rays: new Float32Array(reader.take(12 * cameras * rows * columns)),
    egoFromCamera: new Float32Array(reader.take(28 * cameras * frames)),
  };
  reader.end();
  return facts;
}

/** The class of the voxel, 0–3. */
export function classAt(planes: Planes, index: number): number {
  const byte = index >> 3;
  const bit = index & 7;
  return ((planes.low[byte]! >> bit) & 1) | (((planes.high[byte]! >> bit) & 1) << 1);
}

export function isObserved(planes: Planes, index: number): boolean {
  return ((planes.observed[index >> 3]! >> (index & 7)) & 1) === 1;
}

/** The code of the voxel, 0–7, of planes of `STD1`. */
export function codeAt(planes: Planes, index: number): number {
  return classAt(planes, index) | (isObserved(planes, index) ? 4 : 0);
}

/** The indices of all voxels that have a class, ascending. */
export function labelled(planes: Planes): Uint32Array {
  return listed(planes, (byte) => planes.low[byte]! | planes.high[byte]!);
}

/** The indices of all voxels that have a code, ascending. */
export function coded(planes: Planes): Uint32Array {
  return listed(planes, (byte) => planes.low[byte]! | planes.high[byte]! | planes.observed[byte]!);
}

function listed({ low }: Planes, bitsOf: (byte: number) => number): Uint32Array {
  const found: number[] = [];
  for (let byte = 0; byte < low.length; byte++) {
    let bits = bitsOf(byte);
    while (bits) {
      found.push(byte * 8 + 31 - Math.clz32(bits & -bits));
      bits &= bits - 1;
    }
  }
  return Uint32Array.from(found);
}
