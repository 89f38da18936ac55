// The sensors of the rig: the axes of each, x red, y green, z blue, with its name, and the fields of view of cameras.
//
// A camera is drawn at its pose at exposure, if known. Loaded once the layer is shown.

import { BufferAttribute, BufferGeometry, Color, Group, LineBasicMaterial, LineSegments, type Matrix4, type PerspectiveCamera, Vector3 } from "three";
import { make } from "../controls/elements.js";
import type { Frustum } from "../data/camera_views.js";
import { type SensorFacts, type Vector, toMap } from "../scene.js";
import type { Prop } from "./stage.js";
import type { Theme } from "./theme.js";

const AXIS_M = 0.35;
/** So far from its camera the picture's edge is drawn. */
const EDGE_M = 1.2;
/** Height of a name, and width of a letter; a name that would overlap an earlier one is left out. */
const [NAME_PX, LETTER_PX] = [18, 8];
const AXES: [Vector, Vector][] = [[[1, 0, 0], [0.85, 0.16, 0.16]], [[0, 1, 0], [0.1, 0.6, 0.2]], [[0, 0, 1], [0.2, 0.4, 0.95]]];

interface Name {
  element: HTMLElement;
  place: Vector3;
}

export class SensorLayer implements Prop {
  readonly group = new Group();
  readonly names = make("div", { class: "viewer-names", "aria-hidden": "true", hidden: true });
  private readonly axes = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ vertexColors: true, depthTest: false }));
  private readonly edges = new LineSegments(new BufferGeometry(), new LineBasicMaterial());
  private shown: Name[] = [];

  constructor(private readonly sensors: readonly SensorFacts[], private readonly canvas: HTMLCanvasElement) {
    this.axes.renderOrder = 4;
    for (const lines of [this.axes, this.edges]) lines.frustumCulled = false;
    this.group.add(this.axes, this.edges);
    this.group.matrixAutoUpdate = false;
  }

  /** Shows the sensors and the fields of view of a frame, at the robot's pose. */
  show(frusta: readonly Frustum[], local_from_ego: Matrix4): void {
    const seen = new Map(frusta.map((one) => [one.channel, one]));
    const known = this.sensors.map(({ channel, ego_from_sensor }) => [channel, seen.get(channel)?.pose ?? ego_from_sensor] as const);
    const others = frusta.filter(({ channel }) => !this.sensors.some((one) => one.channel === channel));
    const placed = [...known, ...others.map(({ channel, pose }) => [channel, pose] as const)];
    const [places, colours]: [number[], number[]] = [[], []];
    for (const [, pose] of placed) {
      for (const [axis, colour] of AXES) {
        places.push(pose[0], pose[1], pose[2], ...toMap(pose, axis.map((value) => value * AXIS_M) as Vector));
        colours.push(...colour, ...colour);
      }
    }
    put(this.axes.geometry, places).setAttribute("color", new BufferAttribute(Float32Array.from(colours), 3));
    put(this.edges.geometry, frusta.flatMap(edgesOf));
    this.group.matrix.copy(local_from_ego);
    this.group.matrixWorldNeedsUpdate = true;
    this.shown = placed.map(([channel, pose]) => {
      const frustum = seen.get(channel);
      const named = frustum ? toMap(pose, middleOf(frustum)) : pose.slice(0, 3); // names of cameras are placed in their pictures
      return { element: make("span", {}, channel), place: new Vector3().fromArray(named).applyMatrix4(local_from_ego) };
    });
    this.names.replaceChildren(...this.shown.map(({ element }) => element));
  }

  set isShown(isShown: boolean) {
    this.group.visible = isShown;
    this.names.hidden = !isShown;
  }

  themed(theme: Theme): void {
    this.edges.material.color = new Color(...theme.ink.map((value) => value / 255));
  }

  drawing(camera: PerspectiveCamera): void {
    if (!this.group.visible) return;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const taken: [number, number, number][] = [];
    for (const { element, place } of this.shown) {
      const at = place.clone().project(camera);
      const [x, y, wide] = [((at.x + 1) / 2) * width, ((1 - at.y) / 2) * height, LETTER_PX * (element.textContent ?? "").length];
      const isOver = taken.some(([left, top, other]) => Math.abs(top - y) < NAME_PX && x < left + other && left < x + wide);
      element.hidden = Math.abs(at.z) > 1 || isOver;
      if (!element.hidden) taken.push([x, y, wide]);
      element.style.setProperty("transform", `translate(${x}px, ${y}px)`);
    }
  }
}

function put(geometry: BufferGeometry, places: readonly number[]): BufferGeometry {
  geometry.dispose();
  return geometry.setAttribute("position", new BufferAttribute(Float32Array.from(places), 3));
}

/** The middle of the picture's edge, in the optical frame. */
function middleOf({ edge }: Frustum): Vector {
  return [0, 1, 2].map((axis) => (EDGE_M * edge.reduce((sum, ray) => sum + ray[axis]!, 0)) / edge.length) as Vector;
}

/** Lines from the camera to the corners of its picture, and around its edge, ego frame. */
function edgesOf({ pose, edge }: Frustum): number[] {
  const at = edge.map((ray) => toMap(pose, ray.map((value) => value * EDGE_M) as Vector));
  const around = at.flatMap((point, number) => [...point, ...at[(number + 1) % at.length]!]);
  const corners = [0, 1, 2, 3].map((corner) => at[(corner * at.length) / 4]!);
  return [...around, ...corners.flatMap((corner) => [pose[0], pose[1], pose[2], ...corner])];
}

