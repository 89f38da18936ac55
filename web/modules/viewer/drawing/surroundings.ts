// Objects around the labels: the ground's grid, the robot's track and footprint, the frame of the selected voxel.

import {
  BoxGeometry, BufferAttribute, BufferGeometry, Color, DoubleSide, EdgesGeometry, GLSL3, Group, LineBasicMaterial, LineSegments,
  Mesh, MeshBasicMaterial, PlaneGeometry, ShaderMaterial, Vector2, Vector3,
} from "three";
import { type Pose, type Vector, toMap } from "../scene.js";
import { GROUND_FRAGMENT, GROUND_VERTEX } from "./shaders.js";
import type { Prop } from "./stage.js";
import type { Rgb, Theme } from "./theme.js";

const GROUND_REACH_M = 90;
const TRACK_LIFT_M = 0.16;
const TRACK_LINE_M = 0.1;
const BODY_M = [0.12, 0.34] as const;

const tint = (rgb: Rgb): Color => new Color(...rgb.map((value) => value / 255));

export class Ground implements Prop {
  readonly mesh: Mesh<PlaneGeometry, ShaderMaterial>;
  private readonly middle = new Vector2();

  constructor() {
    const uniforms = { ink: { value: new Vector3() }, middle: { value: this.middle }, reach: { value: GROUND_REACH_M } };
    const drawing = { vertexShader: GROUND_VERTEX, fragmentShader: GROUND_FRAGMENT, glslVersion: GLSL3 } as const;
    const material = new ShaderMaterial({ ...drawing, uniforms, transparent: true, depthWrite: false, side: DoubleSide });
    this.mesh = new Mesh(new PlaneGeometry(2 * GROUND_REACH_M, 2 * GROUND_REACH_M), material);
  }

  move([x, y, z]: Vector): void {
    this.mesh.position.set(x, y, z);
    this.middle.set(x, y);
  }

  themed(theme: Theme): void {
    this.mesh.material.uniforms["ink"]!.value.fromArray(theme.soft).divideScalar(255);
  }
}

/** The way the robot went: a ribbon as wide as its footprint, and a line that shows through hills. */
export class Track implements Prop {
  readonly group = new Group();
  private readonly ribbon = new MeshBasicMaterial({ transparent: true, opacity: 0.16, side: DoubleSide, depthWrite: false });
  private readonly line = new MeshBasicMaterial({ side: DoubleSide });
  private readonly through = new MeshBasicMaterial({ transparent: true, opacity: 0.3, depthTest: false, side: DoubleSide });

  constructor(poses: Pose[], width_m: number, origin: Vector) {
    const wide = ribbonOf(poses, width_m, origin);
    const narrow = ribbonOf(poses, TRACK_LINE_M, origin);
    this.group.add(new Mesh(wide, this.ribbon), new Mesh(narrow, this.line), new Mesh(narrow, this.through));
  }

  themed(theme: Theme): void {
    for (const material of [this.ribbon, this.line, this.through]) material.color = tint(theme.track);
  }
}

function ribbonOf(poses: Pose[], width_m: number, origin: Vector): BufferGeometry {
  const places = new Float32Array(poses.length * 6);
  poses.forEach((pose, row) => {
    [1, -1].forEach((side, which) => {
      const edge = toMap(pose, [0, (side * width_m) / 2, TRACK_LIFT_M]);
      places.set(edge.map((value, axis) => value - origin[axis]!), row * 6 + which * 3);
    });
  });
  const indices: number[] = [];
  for (let row = 0; row + 1 < poses.length; row++) {
    const [a, b, c, d] = [2 * row, 2 * row + 1, 2 * row + 2, 2 * row + 3] as const;
    indices.push(a, b, c, b, d, c);
  }
  return new BufferGeometry().setAttribute("position", new BufferAttribute(places, 3)).setIndex(indices);
}

/** The robot as its footprint: a low body with a nose, at its pose. */
export class Robot implements Prop {
  readonly group = new Group();
  private readonly body = new MeshBasicMaterial();
  private readonly edge = new LineBasicMaterial();
  private readonly nose = new MeshBasicMaterial({ side: DoubleSide });

  constructor([length_m, width_m]: [number, number]) {
    const box = new BoxGeometry(length_m, width_m, BODY_M[1]).translate(0, 0, BODY_M[0] + BODY_M[1] / 2);
    const top = BODY_M[0] + BODY_M[1] + 0.005;
    const corners = [0.42 * length_m, 0, top, 0.05 * length_m, 0.32 * width_m, top, 0.05 * length_m, -0.32 * width_m, top];
    const arrow = new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(corners), 3));
    this.group.add(new Mesh(box, this.body), new LineSegments(new EdgesGeometry(box), this.edge), new Mesh(arrow, this.nose));
    this.group.matrixAutoUpdate = false;
  }

  themed(theme: Theme): void {
    this.body.color = tint(theme.track);
    this.edge.color = tint(theme.paper);
    this.nose.color = tint(theme.sheet);
  }
}

/** The edges of the picked voxel, seen through everything. */
export class Marker implements Prop {
  readonly lines: LineSegments<BufferGeometry, LineBasicMaterial>;

  constructor() {
    const material = new LineBasicMaterial({ depthTest: false });
    this.lines = new LineSegments(new EdgesGeometry(new BoxGeometry(1.06, 1.06, 1.06)), material);
    this.lines.visible = false;
    this.lines.renderOrder = 5;
  }

  /** Around the voxel with this centre and side, turned as its grid is; null takes it away. */
  mark(centre: Vector | null, side_m: number, yaw_rad: number): void {
    this.lines.visible = centre !== null;
    if (centre === null) return;
    this.lines.position.set(...centre);
    this.lines.scale.setScalar(side_m);
    this.lines.rotation.z = yaw_rad;
  }

  themed(theme: Theme): void {
    this.lines.material.color = tint(theme.ink);
  }
}

