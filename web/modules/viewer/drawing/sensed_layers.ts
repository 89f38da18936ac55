// What was sensed and made of it: the frame's point cloud, and the reconstructed surface of a tile.

import { BufferAttribute, BufferGeometry, DoubleSide, GLSL3, Group, Mesh, type PerspectiveCamera, Points, ShaderMaterial, Vector3 } from "three";
import type { Cloud, Surface } from "../data/formats.js";
import { CLOUD_FRAGMENT, CLOUD_VERTEX, SURFACE_FRAGMENT, SURFACE_VERTEX } from "./shaders.js";
import type { Prop } from "./stage.js";
import type { Rgb, Theme } from "./theme.js";
import type { VoxelPaint } from "./voxel_layer.js";

const SUN = new Vector3(-0.45, -0.62, 0.64).normalize();
const share = (rgb: Rgb): Vector3 => new Vector3(...rgb).divideScalar(255);

/** The points of one frame, by how strongly they shone back. */
export class CloudLayer implements Prop {
  readonly group = new Group();
  private readonly material: ShaderMaterial;
  private readonly points: Points<BufferGeometry, ShaderMaterial>;

  constructor(paint: VoxelPaint, private readonly height_px: () => number) {
    const uniforms = {
      dim: { value: new Vector3() }, bright: { value: new Vector3() }, pixels: { value: 800 }, paper: paint.paper, fade: paint.fade,
    };
    this.material = new ShaderMaterial({ glslVersion: GLSL3, vertexShader: CLOUD_VERTEX, fragmentShader: CLOUD_FRAGMENT, uniforms });
    this.points = new Points(new BufferGeometry(), this.material);
    this.points.frustumCulled = false;
    this.points.scale.setScalar(0.01); // centimetres
    this.group.add(this.points);
    this.group.matrixAutoUpdate = false;
  }

  show(cloud: Cloud | null): void {
    this.points.geometry.dispose();
    this.points.geometry = new BufferGeometry();
    this.points.visible = cloud !== null;
    if (!cloud) return;
    this.points.geometry.setAttribute("position", new BufferAttribute(cloud.points_cm, 3));
    this.points.geometry.setAttribute("strength", new BufferAttribute(cloud.intensity, 1, true));
  }

  themed(theme: Theme): void {
    this.material.uniforms["dim"]!.value = share(theme.soft);
    this.material.uniforms["bright"]!.value = share(theme.accent);
  }

  drawing(camera: PerspectiveCamera): void {
    this.material.uniforms["pixels"]!.value = this.height_px() / Math.tan((camera.fov * Math.PI) / 360);
  }
}

/** The paint of all surfaces: colours of the classes, and the sun as the camera sees it. */
export class SurfacePaint implements Prop {
  readonly material: ShaderMaterial;

  constructor(paint: VoxelPaint) {
    const kinds = [0, 1, 2, 3].map(() => new Vector3());
    const uniforms = { kinds: { value: kinds }, sun: { value: new Vector3() }, paper: paint.paper, fade: paint.fade };
    const drawing = { vertexShader: SURFACE_VERTEX, fragmentShader: SURFACE_FRAGMENT, glslVersion: GLSL3, side: DoubleSide } as const;
    this.material = new ShaderMaterial({ ...drawing, uniforms });
  }

  themed(theme: Theme): void {
    this.material.uniforms["kinds"]!.value = [theme.unseen, ...theme.classes].map(share);
  }

  drawing(camera: PerspectiveCamera): void {
    this.material.uniforms["sun"]!.value = SUN.clone().transformDirection(camera.matrixWorldInverse);
  }
}

export function surfaceMesh(surface: Surface, paint: SurfacePaint): Mesh<BufferGeometry, ShaderMaterial> {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(surface.vertices_m, 3));
  geometry.setAttribute("kind", new BufferAttribute(surface.classes, 1));
  geometry.setIndex(new BufferAttribute(surface.triangles, 1));
  return new Mesh(geometry, paint.material);
}
