// Everything on the stage of one scene; it follows the robot from frame to frame.

import { Matrix4, type Object3D, Quaternion, Vector3 } from "three";
import { bytes } from "../api.js";
import type { Asking } from "./data/worker_client.js";
import type { Viewpoint } from "./controls/address.js";
import type { Choices } from "./controls/choices.js";
import { FrameStore } from "./data/frame_store.js";
import { heightsOf, highestOf, reachOf } from "./data/grid.js";
import { GroundHeight } from "./drawing/ground_height.js";
import { MapLayer } from "./drawing/map_layer.js";
import type { Picked, Ray } from "./data/model.js";
import { type Pose, type SceneFacts, type Vector, headingOf, toEgo, toMap } from "./scene.js";
import { SurfacePaint } from "./drawing/sensed_layers.js";
import type { SensorLayer } from "./drawing/sensors.js";
import type { Stage } from "./drawing/stage.js";
import { SweepLayer } from "./drawing/sweeps.js";
import { Ground, Marker, Robot, Track } from "./drawing/surroundings.js";
import { VoxelBlock, VoxelPaint } from "./drawing/voxel_layer.js";

/** So far beyond the corners of the frame's grid the terrain is fetched. */
const KNOWN_BEYOND_M = 9;
/** Size of a radar detection relative to a LiDAR point. */
const RADAR_RATIO = 3;
const SURFACE_REACH_M = 80;
const START_DISTANCE_M = 34;
/** Larger than every height; graphics cards may lack infinity. */
const FAR_M = 1e9;
/** From above the camera is so far away, in sides of the grid. */
const ABOVE_RATIO = 62 / 51.2;

export class World {
  readonly origin: Vector;
  readonly map: MapLayer;
  index = 0;
  /** Another sweep is shown. */
  clouded: () => void = () => undefined;
  /** Called with the number of drawn tiles of the whole run. */
  tiled: (done: number, of: number) => void = () => undefined;
  private readonly paint = new VoxelPaint();
  private readonly frame = new VoxelBlock(this.paint);
  private readonly ground = new Ground();
  private readonly robot: Robot;
  private readonly track: Track;
  private readonly marker = new Marker();
  private readonly height: GroundHeight;
  private readonly known_m: number;
  private readonly cloud: SweepLayer;
  private readonly radar: SweepLayer;
  private readonly store: FrameStore;
  private second: VoxelBlock | null = null;
  private sensors: SensorLayer | null = null;
  private round = 0;

  constructor(readonly scene: SceneFacts, readonly asking: Asking, private readonly stage: Stage, private readonly choices: Choices) {
    const first = scene.frames.map_from_ego[0] ?? [0, 0, 0, 1, 0, 0, 0];
    this.origin = [first[0], first[1], first[2]];
    this.height = new GroundHeight(scene.frames.map_from_ego, scene.grid);
    this.known_m = Math.hypot(...reachOf(scene.grid)) + KNOWN_BEYOND_M;
    const surfaces = new SurfacePaint(this.paint);
    this.map = new MapLayer(this.asking, scene, this.paint, this.origin, surfaces);
    this.robot = new Robot(scene.footprint_m);
    this.track = new Track(scene.frames.map_from_ego, scene.footprint_m[1], this.origin);
    this.cloud = new SweepLayer(this.paint, heightsOf(scene.grid), () => stage.canvas.clientHeight);
    this.radar = new SweepLayer(this.paint, heightsOf(scene.grid), () => stage.canvas.clientHeight);
    stage.orbit.floor = (x, y) => this.height.at(x + this.origin[0], y + this.origin[1]) - this.origin[2];
    this.paint.paint(choices.look.mode);
    this.store = new FrameStore(this.asking, scene, { ...choices.look });
    for (const prop of [this.paint, surfaces, this.frame, this.map, this.ground, this.robot, this.track, this.marker, this.cloud, this.radar]) {
      stage.add(prop);
    }
    stage.add({ drawing: () => this.paint.reach(stage.orbit.distance_m) });
    const standing: Object3D[] = [this.frame.group, this.map.voxels, this.map.surfaces, this.ground.mesh, this.track.group];
    stage.scene.add(...standing, this.robot.group, this.cloud.group, this.radar.group, this.marker.lines);
  }

  open(): Promise<unknown> {
    return this.asking.ask({ kind: "open", scene: this.scene });
  }

  /** Resolves with the frame's counts by class once it is drawn; null if another frame was requested meanwhile.
   * `beside` is awaited once the worker holds the frame, so that both change together. */
  async show(index: number, beside?: () => Promise<unknown>): Promise<readonly number[] | null> {
    const round = ++this.round;
    const before = this.pose(this.index);
    const pose = this.pose(index);
    if (!["class", "difference"].includes(this.choices.look.mode)) await this.map.know(place(pose), this.known_m);
    const drawn = await this.store.take(index);
    if (round === this.round) await beside?.();
    if (round !== this.round) return null;
    const forwards = index >= this.index ? 1 : -1;
    this.index = index;
    this.frame.show(drawn, drawn.corner_m);
    this.height.stand(drawn.lowest, pose);
    this.stand(pose, before);
    void this.choose()
      .catch(() => undefined) // reported at the choice
      .then(() => (this.choices.scope === "frame" ? this.store.ahead(index, forwards) : undefined));
    return drawn.counts;
  }

  /** Shows the choices; resolves when their data are loaded. */
  async choose(): Promise<void> {
    const { layers, scope } = this.choices;
    this.frame.group.visible = layers.labels && scope === "frame";
    this.map.voxels.visible = layers.labels && scope === "map";
    this.map.surfaces.visible = layers.mesh;
    this.track.group.visible = layers.track;
    this.robot.group.visible = layers.robot;
    this.ground.mesh.visible = layers.grid;
    this.cloud.group.visible = layers.points;
    this.radar.group.visible = layers.radar;
    this.dressPoints();
    const redraw = (): void => this.stage.ask();
    redraw();
    const drawn = (done: number, of: number): void => (this.tiled(done, of), redraw());
    const here = place(this.pose(this.index));
    await Promise.all([
      scope === "map" && layers.labels ? this.map.show(here, { ...this.choices.look }, drawn) : null,
      layers.mesh ? this.map.showSurfaces(here, SURFACE_REACH_M, redraw) : null,
      layers.points ? this.showSweep(this.cloud, "cloud", this.index) : null,
      layers.radar ? this.showSweep(this.radar, "radar", this.index) : null,
      this.choices.second || this.second ? this.showSecond(this.index) : null,
      layers.sensors || this.sensors ? this.showSensors(this.index) : null,
    ]);
  }

  dressPoints(): void {
    const { points, range, size } = this.choices;
    this.cloud.colourBy(points, range, size);
    this.radar.colourBy("intensity", [0, 255], RADAR_RATIO * size);
    this.stage.ask();
  }

  /** The values at the ends of the points' colours. */
  get pointRange(): [number, number] {
    return this.cloud.range;
  }

  /** Applies changed colours or filters. */
  relook(): void {
    this.paint.paint(this.choices.look.mode);
    this.store.looking({ ...this.choices.look });
    this.map.forget();
  }

  /** The voxel that the ray meets; its terrain is fetched if missing. */
  async pick(ray: Ray): Promise<Picked | null> {
    await this.map.know(place(this.pose(this.index)), this.known_m).catch(() => undefined);
    const token = this.scene.frames.tokens[this.index] ?? "";
    return this.asking.ask({ kind: "pick", ray, scope: this.choices.scope, token, look: { ...this.choices.look } });
  }

  /** The voxel of the frame with this id (1 + its index), as `pick` returns it. */
  async pickVoxel(id: number): Promise<Picked> {
    await this.map.know(place(this.pose(this.index)), this.known_m).catch(() => undefined);
    const token = this.scene.frames.tokens[this.index] ?? "";
    return this.asking.ask({ kind: "pick-voxel", token, voxel: id, look: { ...this.choices.look } });
  }

  mark(picked: Picked | null): void {
    const centre = picked && (picked.centre_m.map((value, axis) => value - this.origin[axis]!) as Vector);
    const { grid, map_voxel_m } = this.scene;
    const isOfFrame = picked?.scope === "frame";
    this.marker.mark(centre, isOfFrame ? grid.voxel_m : map_voxel_m, isOfFrame ? headingOf(this.pose(this.index)) : 0);
    this.stage.ask();
  }

  /** Behind the robot, or the grid from above with the robot's heading up. */
  look(from: "behind" | "above"): void {
    const { orbit } = this.stage;
    const pose = this.pose(this.index);
    const { min_m, shape, voxel_m } = this.scene.grid;
    const high = highestOf(this.scene.grid);
    const middle: Vector = [(min_m[0] + high[0]) / 2, (min_m[1] + high[1]) / 2, 0];
    orbit.target.set(...this.local(toMap(pose, from === "behind" ? [3, 0, 0.5] : middle)));
    orbit.yaw_rad = headingOf(pose) + Math.PI + (from === "behind" ? 0.42 : 0);
    orbit.pitch_rad = from === "behind" ? 0.56 : Math.PI / 2 - 0.002;
    orbit.distance_m = from === "behind" ? START_DISTANCE_M : ABOVE_RATIO * voxel_m * Math.max(shape[0], shape[1]);
    this.stage.ask();
  }

  /** The camera's position relative to the robot. */
  get viewpoint(): Viewpoint {
    const { orbit } = this.stage;
    const pose = this.pose(this.index);
    const { x, y, z } = orbit.target;
    const target = toEgo(pose, [x + this.origin[0], y + this.origin[1], z + this.origin[2]]);
    return [turned(orbit.yaw_rad - headingOf(pose)), orbit.pitch_rad, orbit.distance_m, target[0], target[1], target[2]];
  }

  set viewpoint([yaw_rad, pitch_rad, distance_m, ahead, left, up]: Viewpoint) {
    const pose = this.pose(this.index);
    this.stage.orbit.target.set(...this.local(toMap(pose, [ahead, left, up])));
    this.stage.orbit.stand(yaw_rad + headingOf(pose), pitch_rad, distance_m);
    this.stage.ask();
  }

  end(): void {
    this.asking.end();
    this.frame.end();
    this.second?.end();
    this.map.end();
  }

  private stand(pose: Pose, before: Pose): void {
    const matrix = this.matrixOf(pose);
    for (const group of [this.frame.group, this.robot.group]) {
      group.matrix.copy(matrix);
      group.matrixWorldNeedsUpdate = true;
    }
    const [x, y, z] = this.local(place(pose));
    this.ground.move([x, y, z + this.scene.grid.min_m[2]]);
    this.marker.mark(null, 1, 0);
    this.cut(z);
    if (this.choices.follows) this.follow(pose, before);
  }

  /** Points and surfaces are drawn between the heights that are shown, counted from the robot's wheels. */
  private cut(wheels_m: number): void {
    const [low, high] = this.choices.look.heights_m ?? [null, null];
    this.paint.cut.value.set(low === null ? -FAR_M : low + wheels_m, high === null ? FAR_M : high + wheels_m);
  }

  /** The camera keeps its place beside the robot, and turns with it. */
  private follow(pose: Pose, before: Pose): void {
    const { orbit } = this.stage;
    const turned = headingOf(pose) - headingOf(before);
    const [from, to] = [this.local(place(before)), this.local(place(pose))];
    const aside = orbit.target.clone().sub(new Vector3(...from)).applyAxisAngle(new Vector3(0, 0, 1), turned);
    orbit.target.copy(aside.add(new Vector3(...to)));
    orbit.yaw_rad += turned;
  }

  /** Draws another label set's frame over the active one; there is none for differences and the whole run. */
  private async showSecond(index: number): Promise<void> {
    const { second, scope, look } = this.choices;
    if (!this.second) {
      this.second = new VoxelBlock(this.paint, true);
      this.second.group.visible = false;
      this.stage.add(this.second);
      this.stage.scene.add(this.second.group);
    }
    const isShown = second !== null && scope === "frame" && look.mode !== "difference";
    if (!isShown) this.second.group.visible = false;
    else {
      const path = `/api/v1/sequences/${this.scene.sequence_id}/label-sets/${second.id}/frames/${this.scene.frames.tokens[index]}/voxels`;
      const content = await bytes(path).catch((error: unknown) => {
        if (index === this.index) this.second!.group.visible = false; // none rather than another frame's
        throw error;
      });
      const drawn = await this.asking.ask({ kind: "second", content, grid: second.grid, look: { ...look } });
      if (index !== this.index || second !== this.choices.second) return;
      this.second.show(drawn, drawn.corner_m);
      this.second.group.matrix.copy(this.matrixOf(this.pose(index)));
      this.second.group.matrixWorldNeedsUpdate = true;
      this.second.group.visible = true;
    }
    this.stage.ask();
  }

  private async showSensors(index: number): Promise<void> {
    if (!this.sensors) {
      const { SensorLayer } = await import("./drawing/sensors.js");
      if (!this.sensors) {
        this.sensors = new SensorLayer(this.scene.playback.sensors, this.stage.canvas);
        this.stage.add(this.sensors);
        this.stage.scene.add(this.sensors.group);
        this.stage.canvas.after(this.sensors.names);
      }
    }
    this.sensors.isShown = this.choices.layers.sensors;
    const frusta = await this.asking.ask({ kind: "frusta", token: this.scene.frames.tokens[index]! });
    if (index === this.index) this.sensors.show(frusta, this.matrixOf(this.pose(index)));
    this.stage.ask();
  }

  private async showSweep(layer: SweepLayer, kind: "cloud" | "radar", index: number): Promise<void> {
    const path = `/api/v1/frames/${this.scene.frames.tokens[index]}/${kind}?v=${this.scene.label_set_id}`;
    const content = await bytes(path).catch((error: unknown) => {
      if (index === this.index) layer.clear(); // none rather than another frame's
      throw error;
    });
    const cloud = await this.asking.ask({ kind, content });
    if (index !== this.index) return;
    layer.show(index, BigInt(this.scene.frames.stamps_ns[index]!), cloud, this.matrixOf(this.pose(index)));
    this.clouded();
    this.stage.ask();
  }

  private matrixOf(pose: Pose): Matrix4 {
    const [place_m, turned] = [new Vector3(...this.local(place(pose))), new Quaternion(pose[4], pose[5], pose[6], pose[3])];
    return new Matrix4().compose(place_m, turned, new Vector3(1, 1, 1));
  }

  private pose(index: number): Pose {
    return this.scene.frames.map_from_ego[index] ?? [0, 0, 0, 1, 0, 0, 0];
  }

  private local(point: Vector): Vector {
    return [point[0] - this.origin[0], point[1] - this.origin[1], point[2] - this.origin[2]];
  }
}

/** The same direction between −π and π. */
function turned(yaw_rad: number): number {
  return Math.atan2(Math.sin(yaw_rad), Math.cos(yaw_rad));
}

function place(pose: Pose): Vector {
  return [pose[0], pose[1], pose[2]];
}
