// The labels as a camera sees them: for each pixel the voxel that its ray meets first.
//
// The rays of a lens come as a grid over its image, made from known intrinsics (`stone/sensors/projection.py`) and
// interpolated between its nodes. They start at the camera's position at exposure, which differs from that of the
// frame's labels, because the robot moved in between; the pose contains this motion.

import { type Columns, castRays } from "./columns.js";
import type { CameraFacts } from "./formats.js";
import { inVoxels } from "./grid.js";
import type { Pose, Vector } from "../scene.js";

/** A picture of labels, row by row: 1 + index of the voxel seen and its palette index, both 0 for none. */
export interface CameraView {
  camera: number;
  width: number;
  height: number;
  ids: Uint32Array;
  colours: Uint8Array;
}

/** How many pixels a view of this camera has. */
export interface ViewSize {
  camera: number;
  width: number;
  height: number;
}

/** The position of a frame's camera at exposure (`ego_from_camera`), and its field of view. */
export interface Frustum {
  channel: string;
  pose: Pose;
  /** Unit vectors of its optical frame through the edge of the picture, each side with as many, clockwise from the first corner. */
  edge: Vector[];
}

/** Parts of a side of the picture's edge: enough to see a lens that bends. */
const EDGE_PARTS = 6;

export class CameraRays {
  private readonly grids = new Map<string, Float32Array>();
  private turned = new Float32Array(0);

  constructor(private readonly facts: CameraFacts) {}

  /** 1 + index of the voxel in each pixel, 0 if no label is seen or the camera's pose is unknown. */
  cast(columns: Columns, size: ViewSize, frame: number): Uint32Array {
    const pixels = size.width * size.height;
    const ids = new Uint32Array(pixels);
    const pose = this.facts.egoFromCamera.subarray((size.camera * this.facts.frames + frame) * 7).subarray(0, 7);
    if (pose.length < 7 || Number.isNaN(pose[0]!)) return ids;
    const optical = this.directions(size);
    if (this.turned.length !== 3 * pixels) this.turned = new Float32Array(3 * pixels);
    turn(pose, optical, this.turned);
    castRays(columns, inVoxels(columns.grid, [pose[0]!, pose[1]!, pose[2]!]), this.turned, ids);
    return ids;
  }

  /** The frusta of a frame's cameras with known pose and lens; `channels` are the names in the playback. */
  frusta(channels: readonly string[], frame: number): Frustum[] {
    const { cameras, frames, columns, rows, rays, egoFromCamera, hasPicture } = this.facts;
    return channels.slice(0, cameras).flatMap((channel, camera) => {
      const number = camera * frames + frame;
      const pose = [...egoFromCamera.subarray(number * 7, number * 7 + 7)] as Pose;
      const ray = ([u, v]: readonly [number, number]): Vector => {
        const node = Math.round(v * (rows - 1)) * columns + Math.round(u * (columns - 1));
        const at = (camera * rows * columns + node) * 3;
        return [rays[at]!, rays[at + 1]!, rays[at + 2]!];
      };
      const edge = [0, 1, 2, 3].flatMap((side) => Array.from({ length: EDGE_PARTS }, (_, part) => ray(along(side, part / EDGE_PARTS))));
      const isKnown = hasPicture[number] === 1 && ![...pose, ...edge.flat()].some(Number.isNaN);
      return isKnown ? [{ channel, pose, edge }] : [];
    });
  }

  /** Through the middle of each pixel, in the optical frame; made once for each size. */
  private directions({ camera, width, height }: ViewSize): Float32Array {
    const key = `${camera} ${width} ${height}`;
    const held = this.grids.get(key);
    if (held) return held;
    const { columns, rows, rays } = this.facts;
    const grid = rays.subarray(camera * rows * columns * 3, (camera + 1) * rows * columns * 3);
    const made = new Float32Array(3 * width * height);
    for (let row = 0; row < height; row++) {
      const v = ((row + 0.5) / height) * (rows - 1);
      const top = Math.min(rows - 2, Math.floor(v));
      for (let column = 0; column < width; column++) {
        const u = ((column + 0.5) / width) * (columns - 1);
        const left = Math.min(columns - 2, Math.floor(u));
        const at = (top * columns + left) * 3;
        for (let axis = 0; axis < 3; axis++) {
          const above = grid[at + axis]! * (1 - u + left) + grid[at + 3 + axis]! * (u - left);
          const below = grid[at + columns * 3 + axis]! * (1 - u + left) + grid[at + columns * 3 + 3 + axis]! * (u - left);
          made[(row * width + column) * 3 + axis] = above * (1 - v + top) + below * (v - top);
        }
      }
    }
    this.grids.set(key, made);
    return made;
  }
}

/** A place on a side of the picture, as shares of its width and height. */
function along(side: number, share: number): readonly [number, number] {
  return ([[share, 0], [1, share], [1 - share, 1], [0, 1 - share]] as const)[side]!;
}

/** Each of the directions turned by the pose. */
function turn(pose: Float32Array, from: Float32Array, to: Float32Array): void {
  const [w, x, y, z] = [pose[3]!, pose[4]!, pose[5]!, pose[6]!];
  const [xx, xy, xz] = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)];
  const [yx, yy, yz] = [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)];
  const [zx, zy, zz] = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
  for (let at = 0; at < from.length; at += 3) {
    const a = from[at]!;
    const b = from[at + 1]!;
    const c = from[at + 2]!;
    to[at] = xx * a + xy * b + xz * c;
    to[at + 1] = yx * a + yy * b + yz * c;
    to[at + 2] = zx * a + zy * b + zz * c;
  }
}
