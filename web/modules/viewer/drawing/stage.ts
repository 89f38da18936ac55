// The picture: renderer, camera and light. It is drawn when something changed, and coarser while it is slow.

import { Color, ColorManagement, LinearSRGBColorSpace, PerspectiveCamera, Scene, Vector2, WebGLRenderer } from "three";
import { Orbit } from "./orbit.js";
import { type Theme, onThemeChange, themeOf } from "./theme.js";

const FINEST_RATIO = 2;
const COARSEST_RATIO = 0.5;
const SLOW_MS = 45;
const RESTS_AFTER_MS = 220;

ColorManagement.enabled = false; // tokens are displayed unchanged

/** An object on the stage with callbacks for theme changes, or before each drawn picture. */
export interface Prop {
  themed?(theme: Theme): void;
  drawing?(camera: PerspectiveCamera): void;
}

export class Stage {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(42, 1, 0.1, 2000);
  readonly renderer: WebGLRenderer;
  readonly orbit: Orbit;
  theme: Theme;
  private readonly props: Prop[] = [];
  private readonly ends: (() => void)[] = [];
  private isAsked = false;
  private ratio = 1;
  private asked_ms = 0;
  private slowness = 0;
  private rest = 0;

  constructor(readonly canvas: HTMLCanvasElement) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true, powerPreference: "high-performance" });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.theme = themeOf(canvas);
    this.orbit = new Orbit(this.camera, canvas, () => this.ask());
    this.ends.push(onThemeChange(() => this.dress()));
    const observer = new ResizeObserver(() => this.resize(this.finest()));
    observer.observe(canvas);
    this.ends.push(() => observer.disconnect());
    this.dress();
  }

  add(prop: Prop): void {
    this.props.push(prop);
    prop.themed?.(this.theme);
  }

  /** Draw soon. */
  ask(): void {
    if (this.isAsked) return;
    this.isAsked = true;
    this.asked_ms = performance.now();
    requestAnimationFrame(() => this.frame());
  }

  draw(): void {
    this.orbit.place();
    this.camera.updateMatrixWorld();
    for (const prop of this.props) prop.drawing?.(this.camera);
    this.renderer.render(this.scene, this.camera);
  }

  /** Seconds for each of `frames` pictures, turning all the way round; each is waited for. */
  measure(frames: number): number[] {
    const context = this.renderer.getContext();
    const pixel = new Uint8Array(4);
    return Array.from({ length: frames }, () => {
      const began_ms = performance.now();
      this.orbit.yaw_rad += (2 * Math.PI) / frames;
      this.draw();
      context.readPixels(0, 0, 1, 1, context.RGBA, context.UNSIGNED_BYTE, pixel);
      return (performance.now() - began_ms) / 1000;
    });
  }

  end(): void {
    clearTimeout(this.rest);
    for (const end of this.ends) end();
    this.renderer.dispose();
  }

  private frame(): void {
    this.isAsked = false;
    this.adapt(performance.now() - this.asked_ms); // a card that is behind lets the next picture wait
    this.draw();
    clearTimeout(this.rest);
    if (this.ratio < this.finest()) {
      this.rest = window.setTimeout(() => this.resize(this.finest()), RESTS_AFTER_MS);
    }
  }

  /** Fewer pixels after three slow pictures in a row; all of them again once nothing moves. */
  private adapt(waited_ms: number): void {
    this.slowness = waited_ms > SLOW_MS ? this.slowness + 1 : 0;
    if (this.slowness < 3 || this.ratio <= COARSEST_RATIO) return;
    this.slowness = 0;
    this.resize(Math.max(COARSEST_RATIO, this.ratio * 0.75));
  }

  private finest(): number {
    return Math.min(FINEST_RATIO, devicePixelRatio);
  }

  private resize(ratio: number): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const size = this.renderer.getSize(new Vector2());
    if (ratio === this.ratio && size.x === width && size.y === height) return;
    this.ratio = ratio;
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.fov = width < height ? 58 : 42;
    this.draw();
  }

  private dress(): void {
    this.theme = themeOf(this.canvas);
    this.scene.background = new Color(...this.theme.paper.map((value) => value / 255));
    for (const prop of this.props) prop.themed?.(this.theme);
    this.ask();
  }
}
