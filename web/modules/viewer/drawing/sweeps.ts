// Point clouds of frames, each at the robot's pose: by intensity, by height, or by age within the last second.

import {
  BufferAttribute, BufferGeometry, DataTexture, GLSL3, Group, type Matrix4, type PerspectiveCamera, Points, ShaderMaterial, Vector2, Vector3,
} from "three";
import type { Cloud } from "../data/formats.js";
import type { Span } from "../looks.js";
import { ramp } from "../ramps.js";
import { CLOUD_FRAGMENT, CLOUD_VERTEX } from "./shaders.js";
import type { Prop } from "./stage.js";
import type { VoxelPaint } from "./voxel_layer.js";

export const POINT_COLOURS = ["intensity", "height", "time"] as const;
export type PointColour = (typeof POINT_COLOURS)[number];
/** Sweeps no older than this are shown by their age. */
export const OLDEST_S = 1;
/** Per cent of a sweep's intensities below and above the ramp of colours, unless the reader sets it. */
const BEYOND_PERCENT = 2;

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
  private wanted: Span = [null, null];
  private intensities: [number, number] | null = null;

  /** `heights_m`: ends of the ramp of heights, above the robot's wheels, unless the reader sets them. */
  constructor(paint: VoxelPaint, private readonly heights_m: readonly [number, number], private readonly height_px: () => number) {
    const colours = new Uint8Array(1024).fill(255);
    for (let place = 0; place < 256; place++) colours.set(ramp("lighter", place / 255), place * 4);
    const texture = new DataTexture(colours, 256, 1);
    texture.needsUpdate = true;
    this.shared = {
      pixels: { value: 800 }, size: { value: 1 }, paper: paint.paper, fade: paint.fade, cut: paint.cut,
      ramp: { value: texture }, by: { value: 0 }, ground: { value: 0 }, range: { value: new Vector2(0, 255) },
    };
  }

  /** Shows the cloud of a frame at the robot's pose (`local_from_ego`, whose translation is the robot's position). */
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
    this.intensities ??= usual(cloud.intensity);
    this.dress();
    this.shared.ground.value = local_from_ego.elements[14]!;
    this.sweeps.push({ index, stamp_ns, points });
    this.group.add(points);
    this.stand(stamp_ns);
  }

  /** The values at the ends of the colours: intensities of 0 to 255, metres above the robot's wheels, seconds of age. */
  get range(): [number, number] {
    if (this.by === "time") return [OLDEST_S, 0];
    const [low, high] = this.by === "height" ? this.heights_m : (this.intensities ?? [0, 255]);
    const from = this.wanted[0] ?? low;
    const to = this.wanted[1] ?? high;
    return from < to ? [from, to] : this.wanted[1] === null ? [from, from + 1] : [to - 1, to];
  }

  colourBy(by: PointColour, range: Span, size: number): void {
    [this.by, this.wanted, this.shared.size.value] = [by, range, size];
    this.dress();
    this.shared.by.value = POINT_COLOURS.indexOf(by);
    const newest = this.sweeps.at(-1);
    if (newest) this.stand(newest.stamp_ns);
  }

  /** Clears the layer if the cloud could not be fetched. */
  clear(): void {
    this.drop(() => true);
  }

  drawing(camera: PerspectiveCamera): void {
    this.shared.pixels.value = this.height_px() / Math.tan((camera.fov * Math.PI) / 360);
  }

  private dress(): void {
    this.shared.range.value.set(...this.range);
  }

  /** Sets the time: sweeps older than a second, or later, are dropped. */
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

/** Between these lie all intensities but the weakest and the strongest few. */
function usual(intensity: Uint8Array): [number, number] | null {
  if (!intensity.length) return null;
  const sorted = intensity.slice().sort();
  const at = (percent: number): number => sorted[Math.round(((sorted.length - 1) * percent) / 100)]!;
  return [at(BEYOND_PERCENT), at(100 - BEYOND_PERCENT)];
}
