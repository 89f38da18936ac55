// Pointing at a voxel: by a click or tap, or by a crosshair that keys move.

import { Raycaster, Vector2 } from "three";
import { make } from "./elements.js";
import type { Ray } from "../data/model.js";
import type { Vector } from "../scene.js";
import type { Stage } from "../drawing/stage.js";

const CLICK_PX = 5;
const STEP_PX = 8;
const STEP_FAR_PX = 40;
const ARROWS: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class Aiming {
  readonly crosshair = make("div", { class: "viewer-crosshair", "aria-hidden": "true", hidden: true });
  private at = { x: 0, y: 0 };
  private pressed: { x: number; y: number } | null = null;

  constructor(private readonly stage: Stage, private readonly origin: Vector, private readonly aimed: (ray: Ray) => void) {
    const { canvas } = stage;
    canvas.addEventListener("pointerdown", (event) => (this.pressed = { x: event.clientX, y: event.clientY }));
    canvas.addEventListener("pointerup", (event) => {
      const { pressed } = this;
      this.pressed = null;
      if (!pressed || Math.hypot(event.clientX - pressed.x, event.clientY - pressed.y) > CLICK_PX) return;
      const box = canvas.getBoundingClientRect();
      this.aimAt(event.clientX - box.left, event.clientY - box.top);
    });
  }

  get isOn(): boolean {
    return !this.crosshair.hidden;
  }

  /** The crosshair in the middle, aimed; or away. */
  toggle(isOn = !this.isOn): void {
    this.crosshair.hidden = !isOn;
    if (isOn) this.moveTo(this.stage.canvas.clientWidth / 2, this.stage.canvas.clientHeight / 2);
  }

  /** Whether the key moved the crosshair. */
  key(event: KeyboardEvent): boolean {
    const arrow = ARROWS[event.key];
    if (!this.isOn || !arrow) return false;
    const step = event.shiftKey ? STEP_FAR_PX : STEP_PX;
    this.moveTo(this.at.x + arrow[0] * step, this.at.y + arrow[1] * step);
    return true;
  }

  /** Aims again at the crosshair, because the picture below it changed. */
  again(): void {
    if (this.isOn) this.aimAt(this.at.x, this.at.y);
  }

  private moveTo(x: number, y: number): void {
    const { clientWidth, clientHeight } = this.stage.canvas;
    this.at = { x: Math.min(clientWidth, Math.max(0, x)), y: Math.min(clientHeight, Math.max(0, y)) };
    this.crosshair.style.setProperty("transform", `translate(${this.at.x}px, ${this.at.y}px)`);
    this.aimAt(this.at.x, this.at.y);
  }

  private aimAt(x: number, y: number): void {
    const { canvas, camera, orbit } = this.stage;
    orbit.place();
    camera.updateMatrixWorld();
    const caster = new Raycaster();
    caster.setFromCamera(new Vector2((2 * x) / canvas.clientWidth - 1, 1 - (2 * y) / canvas.clientHeight), camera);
    const { origin, direction } = caster.ray;
    const from_m: Vector = [origin.x + this.origin[0], origin.y + this.origin[1], origin.z + this.origin[2]];
    this.aimed({ from_m, direction: [direction.x, direction.y, direction.z] });
  }
}
