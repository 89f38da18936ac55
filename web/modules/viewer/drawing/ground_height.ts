// How high the ground is at a place of the map, as far as the frame's labels say: what the camera stays above.

import { GROUND_COLUMNS } from "../data/columns.js";
import { GRID_MIN_M, SHAPE, VOXEL_M } from "../data/formats.js";
import { type Pose, toEgo, toMap } from "../scene.js";

const SQUARE_M = GROUND_COLUMNS * VOXEL_M;
const ALONG = SHAPE[1] / GROUND_COLUMNS;

export class GroundHeight {
  private lowest: Int8Array | null = null;
  private pose: Pose = [0, 0, 0, 1, 0, 0, 0];

  constructor(private readonly track: readonly Pose[]) {}

  /** `lowest` as `Drawn` gives it, of the frame with this pose. */
  stand(lowest: Int8Array | undefined, pose: Pose): void {
    this.lowest = lowest ?? null;
    this.pose = pose;
  }

  /** Metres in the map: the lowest labelled voxel there; where there is none, where the robot drove nearest to it. */
  at(x: number, y: number): number {
    const [ahead, left] = toEgo(this.pose, [x, y, this.pose[2]]);
    const i = Math.floor((ahead - GRID_MIN_M[0]) / SQUARE_M);
    const j = Math.floor((left - GRID_MIN_M[1]) / SQUARE_M);
    const k = i < 0 || j < 0 || j >= ALONG ? -1 : (this.lowest?.[i * ALONG + j] ?? -1);
    return k < 0 ? this.driven(x, y) : toMap(this.pose, [ahead, left, GRID_MIN_M[2] + k * VOXEL_M])[2];
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
