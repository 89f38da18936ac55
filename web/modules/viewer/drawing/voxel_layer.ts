// Voxels on the stage: the faces of one block, lit by direction.

import {
  BufferAttribute, BufferGeometry, DataTexture, GLSL3, Group, IntType, Matrix3, Mesh, MeshBasicMaterial, type PerspectiveCamera,
  ShaderMaterial, Sphere, Vector2, Vector3,
} from "three";
import type { Mode } from "../looks.js";
import type { Drawn } from "../data/model.js";
import { VOXEL_FRAGMENT, VOXEL_VERTEX } from "./shaders.js";
import type { Prop } from "./stage.js";
import { type Theme, paletteOf } from "./theme.js";

const NORMALS = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]] as const;
const SUN = new Vector3(-0.45, -0.62, 0.64).normalize();
const HIDDEN = new MeshBasicMaterial({ visible: false });

/** Palette and light that all blocks of a view share. */
export class VoxelPaint implements Prop {
  readonly palette = new DataTexture(new Uint8Array(1024), 256, 1);
  readonly paper = { value: new Vector3() };
  readonly fade = { value: new Vector2(60, 140) };
  /** The heights between which points and surfaces are drawn; voxels that are not shown are not built. */
  readonly cut = { value: new Vector2(-1e9, 1e9) };
  private mode: Mode = "class";
  private theme: Theme | null = null;

  paint(mode: Mode): void {
    this.mode = mode;
    if (this.theme) this.themed(this.theme);
  }

  themed(theme: Theme): void {
    this.theme = theme;
    this.paper.value.fromArray(theme.paper).divideScalar(255);
    this.palette.image.data?.set(paletteOf(theme, this.mode));
    this.palette.needsUpdate = true;
  }

  /** Sets the distance of the fog: the wider the view, the farther it starts. */
  reach(distance_m: number): void {
    this.fade.value.set(distance_m + 60, distance_m * 2 + 260);
  }
}

export class VoxelBlock {
  readonly group = new Group();
  private readonly mesh: Mesh<BufferGeometry, ShaderMaterial[]>;
  private readonly material: ShaderMaterial;
  private readonly light = { value: [1, 1, 1, 1, 1, 1] };
  private high = new Vector3();

  /** A second block over another one is hatched, and drawn over equal faces. */
  constructor(paint: VoxelPaint, isSecond = false) {
    this.material = new ShaderMaterial({
      ...(isSecond ? { polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -1 } : {}),
      glslVersion: GLSL3,
      vertexShader: VOXEL_VERTEX,
      fragmentShader: VOXEL_FRAGMENT,
      uniforms: { palette: { value: paint.palette }, light: this.light, edges: { value: 0.16 }, hatch: { value: isSecond ? 0.6 : 0 }, paper: paint.paper, fade: paint.fade },
    });
    this.mesh = new Mesh(new BufferGeometry(), NORMALS.map(() => this.material));
    this.mesh.matrixAutoUpdate = false;
    this.group.matrixAutoUpdate = false;
    this.group.add(this.mesh);
  }

  /** These faces from now on; `lowest_m` is the corner of voxel (0, 0, 0) in the group. */
  show(drawn: Drawn, lowest_m: readonly [number, number, number]): void {
    this.mesh.geometry.dispose();
    this.mesh.geometry = geometryOf(drawn);
    this.high = highestOf(drawn.faces.vertices);
    this.mesh.matrix.makeScale(drawn.voxel_m, drawn.voxel_m, drawn.voxel_m).setPosition(...lowest_m);
    this.mesh.matrixWorldNeedsUpdate = true;
  }

  /** Skips the directions that face away, and lights the others by the block's orientation. */
  drawing(camera: PerspectiveCamera): void {
    this.mesh.updateWorldMatrix(true, false);
    const turned = new Matrix3().setFromMatrix4(this.group.matrixWorld);
    this.light.value = NORMALS.map((normal) => {
      const world = new Vector3(...normal).applyMatrix3(turned);
      return 0.86 + 0.04 * world.z + 0.12 * Math.max(0, world.dot(SUN)); // never so dark that a class resembles another
    });
    const eye = camera.position.clone().applyMatrix4(this.mesh.matrixWorld.clone().invert());
    const [x, y, z] = [eye.x, eye.y, eye.z];
    const isSeen = [x > 0, x < this.high.x, y > 0, y < this.high.y, z > 0, z < this.high.z];
    this.mesh.material = isSeen.map((seen) => (seen ? this.material : HIDDEN)) as ShaderMaterial[];
  }

  end(): void {
    this.group.removeFromParent();
    this.mesh.geometry.dispose();
    this.material.dispose();
  }
}

function geometryOf({ faces }: Drawn): BufferGeometry {
  const geometry = new BufferGeometry();
  const corners = new BufferAttribute(faces.vertices, 4);
  corners.gpuType = IntType;
  geometry.setAttribute("corner", corners);
  geometry.setIndex(new BufferAttribute(faces.indices, 1));
  faces.groups.forEach(({ first, count }, direction) => geometry.addGroup(first, count, direction));
  const high = highestOf(faces.vertices);
  geometry.boundingSphere = new Sphere(high.clone().divideScalar(2), high.length() / 2 + 1);
  return geometry;
}

function highestOf(vertices: Uint16Array): Vector3 {
  const high = [0, 0, 0];
  for (let at = 0; at < vertices.length; at += 4) {
    for (let axis = 0; axis < 3; axis++) if (vertices[at + axis]! > high[axis]!) high[axis] = vertices[at + axis]!;
  }
  return new Vector3(...high);
}
