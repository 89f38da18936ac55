// A dense block of voxels, each empty or of a colour, with an empty layer around it that replaces bounds checks.

export type Size = readonly [number, number, number];

/** Maximum number of cells of a block: a tile of 256 × 256 columns may be 200 m high. */
const MOST_CELLS = 80_000_000;

export class Solid {
  /** 0 is empty, 1–255 a colour of the palette. */
  readonly colours: Uint8Array;
  readonly strides: Size;
  private readonly filled: number[] = [];

  constructor(readonly size: Size) {
    const [x, y, z] = [size[0] + 2, size[1] + 2, size[2] + 2];
    if (x * y * z > MOST_CELLS) throw new RangeError(`A block of ${size.join(" × ")} voxels is too large to draw.`);
    this.colours = new Uint8Array(x * y * z);
    this.strides = [y * z, z, 1];
  }

  /** The place of the voxel in `colours`. */
  cell(i: number, j: number, k: number): number {
    return (i + 1) * this.strides[0] + (j + 1) * this.strides[1] + k + 1;
  }

  paint(i: number, j: number, k: number, colour: number): void {
    const cell = this.cell(i, j, k);
    if (this.colours[cell] === 0 && colour) this.filled.push(cell);
    this.colours[cell] = colour;
  }

  /** The cells that were painted, in the order of painting. */
  get cells(): readonly number[] {
    return this.filled;
  }

  at(i: number, j: number, k: number): number {
    const [x, y, z] = this.size;
    return i < 0 || j < 0 || k < 0 || i >= x || j >= y || k >= z ? 0 : this.colours[this.cell(i, j, k)]!;
  }
}
