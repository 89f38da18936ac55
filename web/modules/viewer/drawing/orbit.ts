// Turning, moving and nearing the camera by mouse, touch and keys; z stays up, the camera stays above the ground.

import { PerspectiveCamera, Vector3 } from "three";

const LOWEST_RAD = 0.03;
const HIGHEST_RAD = Math.PI / 2 - 0.001;
/** Minimum height of the camera above the ground; its pivot is not below the ground. */
const ABOVE_GROUND_M = 0.5;
const NEAREST_M = 2;
const FARTHEST_M = 900;
const TURN_RAD_PER_PX = 0.006;
const KEY_TURN_RAD = Math.PI / 24;
const KEY_MOVE_RATIO = 0.05;

export class Orbit {
  readonly target = new Vector3();
  yaw_rad = Math.PI;
  pitch_rad = 0.6;
  distance_m = 40;
  /** Cooperative gestures: one finger scrolls the page, and the wheel zooms only if the view has the focus. */
  isShy = false;
  /** The ground's height at a place: camera and target stay above it. */
  floor: (x: number, y: number) => number = () => -Infinity;
  /** The reader moved the camera. */
  moved: () => void = () => undefined;
  private readonly fingers = new Map<number, { x: number; y: number }>();

  constructor(
    readonly camera: PerspectiveCamera,
    private readonly canvas: HTMLCanvasElement,
    private readonly changed: () => void,
  ) {
    camera.up.set(0, 0, 1);
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const kind of ["pointerup", "pointercancel"] as const) {
      canvas.addEventListener(kind, (event) => this.fingers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  place(): void {
    const flat = Math.cos(this.pitch_rad) * this.distance_m;
    this.target.z = Math.max(this.target.z, this.floor(this.target.x, this.target.y));
    const { x, y, z } = this.target;
    const [eyeX, eyeY] = [x + flat * Math.cos(this.yaw_rad), y + flat * Math.sin(this.yaw_rad)];
    const lowest = this.floor(eyeX, eyeY) + ABOVE_GROUND_M;
    this.camera.position.set(eyeX, eyeY, Math.max(lowest, z + Math.sin(this.pitch_rad) * this.distance_m));
    this.camera.near = Math.max(0.1, this.distance_m / 200);
    this.camera.far = this.distance_m + 1500;
    this.camera.updateProjectionMatrix();
    this.camera.lookAt(this.target);
  }

  turn(yaw_rad: number, pitch_rad: number): void {
    this.yaw_rad += yaw_rad;
    this.pitch_rad = Math.min(HIGHEST_RAD, Math.max(LOWEST_RAD, this.pitch_rad + pitch_rad));
    this.act();
  }

  near(ratio: number): void {
    this.distance_m = Math.min(FARTHEST_M, Math.max(NEAREST_M, this.distance_m * ratio));
    this.act();
  }

  /** Moves over the ground by shares of the distance to the right and ahead, relative to the camera. */
  slide(right: number, ahead: number): void {
    const [cos, sin] = [Math.cos(this.yaw_rad), Math.sin(this.yaw_rad)];
    this.target.x += this.distance_m * (-sin * right - cos * ahead);
    this.target.y += this.distance_m * (cos * right - sin * ahead);
    this.act();
  }

  /** Sets the view, within its limits. */
  stand(yaw_rad: number, pitch_rad: number, distance_m: number): void {
    this.yaw_rad = yaw_rad;
    this.pitch_rad = Math.min(HIGHEST_RAD, Math.max(LOWEST_RAD, pitch_rad));
    this.distance_m = Math.min(FARTHEST_M, Math.max(NEAREST_M, distance_m));
  }

  private act(): void {
    this.moved();
    this.changed();
  }

  /** Whether the key meant something here. */
  key(event: KeyboardEvent): boolean {
    const step = event.shiftKey ? 3 : 1;
    const move = KEY_MOVE_RATIO * step;
    const acts: Record<string, () => void> = {
      ArrowLeft: () => this.turn(-KEY_TURN_RAD * step, 0),
      ArrowRight: () => this.turn(KEY_TURN_RAD * step, 0),
      ArrowUp: () => this.turn(0, KEY_TURN_RAD * step),
      ArrowDown: () => this.turn(0, -KEY_TURN_RAD * step),
      "+": () => this.near(0.85),
      "=": () => this.near(0.85),
      "-": () => this.near(1 / 0.85),
      a: () => this.slide(-move, 0),
      d: () => this.slide(move, 0),
      w: () => this.slide(0, move),
      s: () => this.slide(0, -move),
    };
    const act = acts[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    act?.();
    return act !== undefined;
  }

  private down(event: PointerEvent): void {
    this.canvas.setPointerCapture(event.pointerId);
    this.fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  }

  private move(event: PointerEvent): void {
    const finger = this.fingers.get(event.pointerId);
    if (!finger) return;
    const [dx, dy] = [event.clientX - finger.x, event.clientY - finger.y];
    const before = this.spread();
    [finger.x, finger.y] = [event.clientX, event.clientY];
    if (this.fingers.size === 2) {
      const after = this.spread();
      this.drag(dx / 2, dy / 2);
      if (before > 0 && after > 0) this.near(before / after);
    } else if (event.shiftKey || (event.buttons & 6) !== 0) this.drag(dx, dy);
    else this.turn(-dx * TURN_RAD_PER_PX, dy * TURN_RAD_PER_PX);
  }

  private drag(dx: number, dy: number): void {
    const height = Math.max(1, this.canvas.clientHeight);
    this.slide(-dx / height, dy / height);
  }

  private spread(): number {
    const [a, b] = [...this.fingers.values()];
    return a && b ? Math.hypot(a.x - b.x, a.y - b.y) : 0;
  }

  private wheel(event: WheelEvent): void {
    if (this.isShy && document.activeElement !== this.canvas && !event.ctrlKey) return;
    event.preventDefault();
    this.near(Math.exp(Math.sign(event.deltaY) * Math.min(0.25, Math.abs(event.deltaY) * 0.0015)));
  }
}
