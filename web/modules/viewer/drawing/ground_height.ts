// Height of the ground at a place of the map, from the frame's labels: the camera stays above it.

import { squareColumns } from "../data/columns.js";
import { type Grid, inVoxels } from "../data/grid.js";
import { type Pose, toEgo, toMap } from "../scene.js";

export class GroundHeight {
  private lowest: Int8Array | null = null;
  private pose: Pose = [0, 0, 0, 1, 0, 0, 0];

  constructor(private readonly track: readonly Pose[], private readonly grid: Grid) {}

  /** `lowest` as `Drawn` gives it, of the frame with this pose. */
  stand(lowest: Int8Array | undefined, pose: Pose): void {
    this.lowest = lowest ?? null;
    this.pose = pose;
  }

  /** Height in metres in the map: the lowest labelled voxel there, else that of the nearest track point. */
  at(x: number, y: number): number {
    const [ahead, left] = toEgo(this.pose, [x, y, this.pose[2]]);
    const { shape, min_m, voxel_m } = this.grid;
    const square = squareColumns(this.grid);
    const [i, j] = inVoxels(this.grid, [ahead, left, 0]).map((value) => Math.floor(value / square)) as [number, number];
    const along = shape[1] / square;
    const k = i < 0 || j < 0 || j >= along ? -1 : (this.lowest?.[i * along + j] ?? -1);
    return k < 0 ? this.driven(x, y) : toMap(this.pose, [ahead, left, min_m[2] + k * voxel_m])[2];
  }

  private driven(x: number, y: number): number {
    let [height, least] = [this.pose[2], Infinity];
    for (const pose of this.track) {
      const away = (pose[0] - x) ** 2 + (pose[1] - y) ** 2;
      if (away < least) [height, least] = [pose[2], away];
    }
    return height;
  }
}
