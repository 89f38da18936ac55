// The scene: the JSON of `/api/v1/sequences/{id}/scene`, and poses.

import type { Grid } from "./data/grid.js";

export type Vector = [number, number, number];
/** Translation in metres and a unit quaternion wxyz. */
export type Pose = [number, number, number, number, number, number, number];

export interface Piece {
  name: string;
  min_m: Vector;
  max_m: Vector;
  voxels: number;
  bytes: number;
}

/** A sensor of the rig; the pose is `ego_from_sensor`. */
export interface SensorFacts {
  channel: string;
  kind: string;
  ego_from_sensor: Pose;
}

export interface PlaybackFacts {
  export_id: string | null;
  state: "none" | "making" | "ready";
  cameras: string[];
  has_clouds: boolean;
  has_rays: boolean;
  sensors: SensorFacts[];
  has_radars: boolean;
}

/** A label set as in the API's list. */
export interface LabelSetFacts {
  id: string;
  profile: string;
  grid: Grid;
  created_at: string;
}

export interface SceneFacts {
  sequence_id: string;
  name: string;
  label_set_id: string;
  /** A comparison of two label sets, whose differences can be shown; set by the page. */
  comparison_id?: string;
  /** Whether the page was opened for the differences; else they are one of the selectable colours. */
  starts_with_difference?: boolean;
  profile: string;
  grid: Grid;
  /** The side of a voxel of the map, whose lattice the tiles are on. */
  map_voxel_m: number;
  /** The confidence of some voxel is known. */
  has_confidence: boolean;
  footprint_m: [number, number];
  reference: { mean: Vector; covariance: [Vector, Vector, Vector]; d2_limit: number } | null;
  frames: { tokens: string[]; stamps_ns: string[]; map_from_ego: Pose[] };
  tiles: Piece[];
  meshes: { name: string; min_m?: Vector; triangles: number; bytes: number }[];
  playback: PlaybackFacts;
}

/** The point of the ego frame in the map. */
export function toMap(pose: Pose, point: Vector): Vector {
  const [x, y, z] = rotated(pose[3], [pose[4], pose[5], pose[6]], point);
  return [x + pose[0], y + pose[1], z + pose[2]];
}

/** The point of the map in the ego frame. */
export function toEgo(pose: Pose, point: Vector): Vector {
  const centred: Vector = [point[0] - pose[0], point[1] - pose[1], point[2] - pose[2]];
  return rotated(pose[3], [-pose[4], -pose[5], -pose[6]], centred);
}

/** The direction of the map in the ego frame. */
export function turnedToEgo(pose: Pose, direction: Vector): Vector {
  return rotated(pose[3], [-pose[4], -pose[5], -pose[6]], direction);
}

/** The robot's heading in the map's plane, radians from x. */
export function headingOf(pose: Pose): number {
  const [x, y] = rotated(pose[3], [pose[4], pose[5], pose[6]], [1, 0, 0]);
  return Math.atan2(y, x);
}

function rotated(w: number, [qx, qy, qz]: Vector, [x, y, z]: Vector): Vector {
  const [cx, cy, cz] = [2 * (qy * z - qz * y), 2 * (qz * x - qx * z), 2 * (qx * y - qy * x)];
  return [
    x + w * cx + (qy * cz - qz * cy),
    y + w * cy + (qz * cx - qx * cz),
    z + w * cz + (qx * cy - qy * cx),
  ];
}
