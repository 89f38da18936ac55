// Height of the robot's wheels at the track point nearest to a place of the map: the zero of heights of the whole run.

import type { Pose } from "../scene.js";

const APART_M = 1;

export class TrackHeight {
  private readonly places: (readonly [number, number, number])[] = [];
  private readonly known = new Map<string, number>();

  constructor(poses: readonly Pose[]) {
    for (const [x, y, z] of poses) {
      const last = this.places.at(-1);
      if (!last || Math.hypot(x - last[0], y - last[1]) >= APART_M) this.places.push([x, y, z]);
    }
  }

  /** The height for the square metre that contains (x, y); 0 without any pose. */
  at(x: number, y: number): number {
    const [i, j] = [Math.floor(x), Math.floor(y)];
    const key = `${i},${j}`;
    const held = this.known.get(key);
    if (held !== undefined) return held;
    let [least, height_m] = [Infinity, 0];
    for (const [px, py, pz] of this.places) {
      const gap = (px - i - 0.5) ** 2 + (py - j - 0.5) ** 2;
      if (gap < least) [least, height_m] = [gap, pz];
    }
    this.known.set(key, height_m);
    return height_m;
  }
}
