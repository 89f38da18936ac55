// Point clouds of frames, each where the robot stood: by intensity, by height, or by age among those of the last second.

import {
  BufferAttribute, BufferGeometry, DataTexture, GLSL3, Group, type Matrix4, type PerspectiveCamera, Points, ShaderMaterial, Vector3,
} from "three";
import type { Cloud } from "../data/formats.js";
import { ramp } from "../ramps.js";
import { CLOUD_FRAGMENT, CLOUD_VERTEX } from "./shaders.js";
import type { Prop } from "./stage.js";
import type { Rgb, Theme } from "./theme.js";
import type { VoxelPaint } from "./voxel_layer.js";

export const POINT_COLOURS = ["intensity", "height", "time"] as const;
export type PointColour = (typeof POINT_COLOURS)[number];
/** Sweeps no older than this are shown by their age. */
export const OLDEST_S = 1;
const share = (rgb: Rgb): Vector3 => new Vector3(...rgb).divideScalar(255);

interface Sweep {
  index: number;
  stamp_ns: bigint;
  points: Points<BufferGeometry, ShaderMaterial>;
}

export class SweepLayer implements Prop {
  readonly group = new Group();
  private readonly shared;
  private sweeps: Sweep[] = [];
  private by: PointColour = "intensity";

  /** `heights_m`: above the robot's wheels, between which the ramp of heights runs. */
  constructor(paint: VoxelPaint, heights_m: readonly [number, number], private readonly height_px: () => number) {
    const colours = new Uint8Array(1024).fill(255);
    for (let place = 0; place < 256; place++) colours.set(ramp("viridis", place / 255), place * 4);
    const texture = new DataTexture(colours, 256, 1);
    texture.needsUpdate = true;
    this.shared = {
      dim: { value: new Vector3() }, bright: { value: new Vector3() }, pixels: { value: 800 }, paper: paint.paper, fade: paint.fade,
      ramp: { value: texture }, by: { value: 0 }, ground: { value: 0 }, heights: { value: heights_m },
    };
  }

  /** The cloud of a frame where the robot stood (`local_from_ego`, whose translation is the robot's place). */
  show(index: number, stamp_ns: bigint, cloud: Cloud, local_from_ego: Matrix4): void {
    this.drop((one) => one.index === index);
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(cloud.points_cm, 3));
    geometry.setAttribute("strength", new BufferAttribute(cloud.intensity, 1, true));
    const uniforms = { ...this.shared, age: { value: 0 } };
    const material = new ShaderMaterial({ glslVersion: GLSL3, vertexShader: CLOUD_VERTEX, fragmentShader: CLOUD_FRAGMENT, uniforms });
    const points = new Points(geometry, material);
    points.frustumCulled = false;
    points.matrixAutoUpdate = false;
    points.matrix.copy(local_from_ego).scale(new Vector3(0.01, 0.01, 0.01)); // centimetres
    points.matrixWorldNeedsUpdate = true;
    this.shared.ground.value = local_from_ego.elements[14]!;
    this.sweeps.push({ index, stamp_ns, points });
    this.group.add(points);
    this.stand(stamp_ns);
  }

  colourBy(by: PointColour): void {
    this.by = by;
    this.shared.by.value = POINT_COLOURS.indexOf(by);
    const newest = this.sweeps.at(-1);
    if (newest) this.stand(newest.stamp_ns);
  }

  /** Nothing is shown of what could not be fetched. */
  clear(): void {
    this.drop(() => true);
  }

  themed(theme: Theme): void {
    this.shared.dim.value = share(theme.soft);
    this.shared.bright.value = share(theme.accent);
  }

  drawing(camera: PerspectiveCamera): void {
    this.shared.pixels.value = this.height_px() / Math.tan((camera.fov * Math.PI) / 360);
  }

  /** It is so late now: what is older than a second, or later, is no longer kept. */
  private stand(now_ns: bigint): void {
    const age_s = (one: Sweep): number => Number(now_ns - one.stamp_ns) / 1e9;
    this.drop((one) => age_s(one) < 0 || age_s(one) > OLDEST_S);
    for (const one of this.sweeps) {
      one.points.material.uniforms["age"]!.value = age_s(one) / OLDEST_S;
      one.points.visible = this.by === "time" || one.stamp_ns === now_ns;
    }
  }

  private drop(isGone: (one: Sweep) => boolean): void {
    for (const { points } of this.sweeps.filter(isGone)) {
      points.removeFromParent();
      points.geometry.dispose();
      points.material.dispose();
    }
    this.sweeps = this.sweeps.filter((one) => !isGone(one));
  }
}
