// The reconstructed surface of a tile.

import { BufferAttribute, BufferGeometry, DoubleSide, GLSL3, Mesh, type PerspectiveCamera, ShaderMaterial, Vector3 } from "three";
import type { Surface } from "../data/formats.js";
import { SURFACE_FRAGMENT, SURFACE_VERTEX } from "./shaders.js";
import type { Prop } from "./stage.js";
import type { Rgb, Theme } from "./theme.js";
import type { VoxelPaint } from "./voxel_layer.js";

const SUN = new Vector3(-0.45, -0.62, 0.64).normalize();
const share = (rgb: Rgb): Vector3 => new Vector3(...rgb).divideScalar(255);

/** The paint of all surfaces: colours of the classes, and the sun as the camera sees it. */
export class SurfacePaint implements Prop {
  readonly material: ShaderMaterial;

  constructor(paint: VoxelPaint) {
    const kinds = [0, 1, 2, 3].map(() => new Vector3());
    const uniforms = { kinds: { value: kinds }, sun: { value: new Vector3() }, paper: paint.paper, fade: paint.fade, cut: paint.cut };
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
