// The visible faces of a block, merged with equal neighbours, for the graphics card.
//
// A quad is four vertices of four uint16: the corner in voxels, and a word. The word holds colour (bits 0–7), direction
// (8–10), light in the corner (11–12) and which corner it is (13–14). Directions are +x, −x, +y, −y, +z, −z. Each
// direction is a separate group, so that faces that look away from the camera are not drawn.

import type { Size, Solid } from "./solid.js";

export interface Faces {
  vertices: Uint16Array;
  indices: Uint32Array;
  /** First and count of the indices of each direction. */
  groups: { first: number; count: number }[];
  quads: number;
}

const LIT = 3;
const ALL_LIT = 0xff;

/** Parameters of one direction of faces: along the normal, and along both edges (strides and axes). */
interface Side {
  direction: number;
  axis: 0 | 1 | 2;
  out: number;
  u: 0 | 1 | 2;
  v: 0 | 1 | 2;
}

const SIDES: Side[] = [0, 1, 2, 3, 4, 5].map((direction) => {
  const axis = (direction >> 1) as 0 | 1 | 2;
  return { direction, axis, out: direction % 2 ? -1 : 1, u: ((axis + 1) % 3) as 0 | 1 | 2, v: ((axis + 2) % 3) as 0 | 1 | 2 };
});

export function facesOf(solid: Solid): Faces {
  const drawing = new Drawing(solid.cells.length);
  const keys = new Uint16Array(solid.colours.length);
  const groups = SIDES.map((side) => {
    const first = drawing.indexCount;
    expose(solid, side, keys);
    merge(solid, side, keys, drawing);
    return { first, count: drawing.indexCount - first };
  });
  return drawing.done(groups);
}

/** Writes a key for each visible face of the side: colour and the light in its corners. */
function expose(solid: Solid, side: Side, keys: Uint16Array): void {
  const { colours, strides } = solid;
  const out = side.out * strides[side.axis];
  const [u, v] = [strides[side.u], strides[side.v]];
  for (const cell of solid.cells) {
    if (colours[cell + out] !== 0) continue;
    keys[cell] = colours[cell]! | (lightOf(colours, cell + out, u, v) << 8);
  }
}

/** Two bits per corner (−−, +−, −+, ++): 3 in the open, less with neighbours around the corner. */
function lightOf(colours: Uint8Array, open: number, u: number, v: number): number {
  const [west, east, south, north] = [colours[open - u], colours[open + u], colours[open - v], colours[open + v]];
  const around = (a: unknown, b: unknown, corner: number): number =>
    a && b ? 0 : LIT - (a ? 1 : 0) - (b ? 1 : 0) - (colours[corner] ? 1 : 0);
  return (
    around(west, south, open - u - v) |
    (around(east, south, open + u - v) << 2) |
    (around(west, north, open - u + v) << 4) |
    (around(east, north, open + u + v) << 6)
  );
}

/** Replaces the keys by one quad for each rectangle of equal ones; only evenly lit faces are merged. */
function merge(solid: Solid, side: Side, keys: Uint16Array, drawing: Drawing): void {
  const [su, sv] = [solid.strides[side.u], solid.strides[side.v]];
  for (const cell of solid.cells) {
    const key = keys[cell]!;
    if (key === 0) continue;
    let [across, along] = [1, 1];
    if (key >> 8 === ALL_LIT) {
      while (keys[cell + along * sv] === key) along++;
      while (isRow(keys, cell + across * su, sv, along, key)) across++;
    }
    for (let a = 0; a < across; a++) for (let b = 0; b < along; b++) keys[cell + a * su + b * sv] = 0;
    drawing.quad(place(cell, solid.strides), side, [across, along], key);
  }
}

function isRow(keys: Uint16Array, from: number, stride: number, length: number, key: number): boolean {
  for (let n = 0; n < length; n++) if (keys[from + n * stride] !== key) return false;
  return true;
}

function place(cell: number, strides: Size): [number, number, number] {
  const i = Math.floor(cell / strides[0]);
  const j = Math.floor((cell - i * strides[0]) / strides[1]);
  return [i - 1, j - 1, cell - i * strides[0] - j * strides[1] - 1];
}

/** Buffers that grow. */
class Drawing {
  private vertices: Uint16Array;
  private indices: Uint32Array;
  private quads = 0;

  constructor(voxels: number) {
    const quads = Math.max(64, voxels);
    this.vertices = new Uint16Array(quads * 16);
    this.indices = new Uint32Array(quads * 6);
  }

  get indexCount(): number {
    return this.quads * 6;
  }

  quad(at: [number, number, number], side: Side, lengths: [number, number], key: number): void {
    if (this.quads * 16 === this.vertices.length) this.grow();
    const base = this.quads * 16;
    for (let corner = 0; corner < 4; corner++) {
      const to = base + corner * 4;
      this.vertices.set(at, to);
      this.vertices[to + side.axis]! += side.out > 0 ? 1 : 0;
      this.vertices[to + side.u]! += corner & 1 ? lengths[0] : 0;
      this.vertices[to + side.v]! += corner & 2 ? lengths[1] : 0;
      const light = (key >> (8 + 2 * corner)) & 3;
      this.vertices[to + 3] = (key & 0xff) | (side.direction << 8) | (light << 11) | (corner << 13);
    }
    this.indices.set(this.triangles(side.out > 0, key >> 8), this.quads * 6);
    this.quads++;
  }

  /** The two triangles, cut along the diagonal with equally lit ends, so that shades are symmetric. */
  private triangles(isOutward: boolean, light: number): number[] {
    const [a, b, c, d] = [0, 1, 2, 3].map((corner) => (light >> (2 * corner)) & 3) as [number, number, number, number];
    const ring = a + d > b + c ? [0, 1, 3, 0, 3, 2] : [0, 1, 2, 1, 3, 2];
    const first = this.quads * 4;
    return (isOutward ? ring : ring.reverse()).map((corner) => first + corner);
  }

  private grow(): void {
    const [vertices, indices] = [this.vertices, this.indices];
    this.vertices = new Uint16Array(vertices.length * 2);
    this.vertices.set(vertices);
    this.indices = new Uint32Array(indices.length * 2);
    this.indices.set(indices);
  }

  done(groups: Faces["groups"]): Faces {
    const { vertices, indices, quads } = this;
    return { vertices: vertices.slice(0, quads * 16), indices: indices.slice(0, quads * 6), groups, quads };
  }
}
