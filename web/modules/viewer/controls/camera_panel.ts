// The cameras beside the 3D view: their pictures change together with the frame; without pictures a text gives the
// reason.

import { call } from "../../api.js";
import { messageOf } from "../../errors.js";
import { CameraFrames, type CameraFrame } from "../cameras.js";
import { CameraStrip } from "./camera_strip.js";
import type { Choices } from "./choices.js";
import { make } from "./elements.js";
import type { Asking } from "../data/worker_client.js";
import { paletteOf } from "../drawing/theme.js";
import type { Stage } from "../drawing/stage.js";
import type { SceneFacts } from "../scene.js";

/** Longest wait of a frame for its pictures; then it is shown, and they follow. */
const PATIENCE_MS = 1500;
/** Views are coarse while frames play, and fine once none came for so long. */
const RESTS_AFTER_MS = 250;

const IN_PREPARATION = "The camera pictures are being prepared; reload the page in a minute or two.";

export interface CameraActs {
  picked: (id: number) => void;
  unknown: (why: string) => void;
  /** Called when another camera, or none, is shown large. */
  enlarged: () => void;
}

export class CameraPanel {
  readonly strip: CameraStrip;
  private readonly frames: CameraFrames;
  private ready: CameraFrame | null = null;
  private coming: Promise<void> = Promise.resolve();
  private isOpen = false;
  private wasPlaying = false;
  private round = 0;
  private rest = 0;

  constructor(
    private readonly host: HTMLElement,
    private readonly scene: SceneFacts,
    private readonly stage: Stage,
    asking: Asking,
    private readonly choices: Choices,
    private readonly acts: CameraActs,
  ) {
    const { playback, frames } = scene;
    this.frames = new CameraFrames(asking, scene);
    this.strip = new CameraStrip(playback.cameras, (host.dataset["rig"] ?? "").split(" "), frames.tokens.length, {
      picked: acts.picked,
      unknown: acts.unknown,
      enlarged: (camera) => this.enlarge(camera),
    });
    stage.add({ themed: (theme) => this.strip.dress(paletteOf(theme, choices.look.mode), theme) });
    this.sayMissing();
    this.show();
  }

  /** The channel that is shown large. */
  get enlarged(): string | null {
    return this.strip.enlarged === null ? null : this.scene.playback.cameras[this.strip.enlarged]!;
  }

  /** Starts with this frame, which the worker must hold, and with this camera large. */
  async open(index: number, enlarged: string | null): Promise<void> {
    const { cameras } = this.scene.playback;
    if (!cameras.length) return;
    const missing = await this.frames.open();
    this.isOpen = true;
    if (missing) this.strip.say(missing, this.remake());
    const camera = enlarged === null ? -1 : cameras.indexOf(enlarged);
    if (camera >= 0) this.strip.enlarge(camera, false);
    this.acts.enlarged();
    await this.take(index, false);
    this.put(index);
  }

  /** Ends once the pictures of the frame are there, or have taken too long. */
  take(index: number, isPlaying: boolean): Promise<unknown> {
    clearTimeout(this.rest);
    this.show();
    if (!this.isOpen || this.choices.cameras === "off") return Promise.resolve();
    const round = ++this.round;
    this.wasPlaying = isPlaying;
    const { look, cameras } = this.choices;
    const wish = { look, isPlaying, withLabels: cameras === "labels", enlarged: this.strip.enlarged };
    this.coming = this.frames.take(index, wish).then((frame) => {
      if (round === this.round) this.ready = frame;
    });
    return Promise.race([this.coming, new Promise((resolve) => setTimeout(resolve, PATIENCE_MS))]);
  }

  /** The frame that was taken last is shown now. */
  put(index: number): void {
    if (!this.isOpen || this.choices.cameras === "off") return;
    if (this.ready?.index === index) return this.putReady(this.ready);
    const { round } = this;
    this.strip.element.setAttribute("aria-busy", "true");
    this.strip.wait();
    void this.coming.then(() => {
      if (round === this.round && this.ready?.index === index) this.putReady(this.ready);
    });
  }

  end(): void {
    this.round++;
    clearTimeout(this.rest);
  }

  mark(id: number): void {
    this.strip.mark(id);
  }

  private putReady(frame: CameraFrame): void {
    const { theme } = this.stage;
    this.ready = null;
    this.strip.element.removeAttribute("aria-busy");
    this.strip.put(frame, paletteOf(theme, this.choices.look.mode), theme);
    this.frames.ahead(frame.index, 1);
    if (this.wasPlaying) this.rest = window.setTimeout(() => void this.again(frame.index), RESTS_AFTER_MS);
  }

  /** This camera large; null: none. */
  enlarge(camera: number | null): void {
    this.strip.enlarge(camera);
    this.acts.enlarged();
    const index = Number(this.strip.element.dataset["frame"] ?? NaN);
    if (camera !== null && !Number.isNaN(index)) void this.again(index);
  }

  /** The same frame with finer views. */
  private async again(index: number): Promise<void> {
    await this.take(index, false);
    this.put(index);
  }

  private show(): void {
    const isOff = this.choices.cameras === "off";
    const hasRow = this.scene.playback.cameras.length > 0;
    this.strip.element.hidden = isOff || !(hasRow || this.strip.hasWords);
    if (isOff && this.strip.enlarged !== null) this.strip.enlarge(null);
  }

  private sayMissing(): void {
    const { state, cameras } = this.scene.playback;
    if (cameras.length || state === "ready") return;
    if (state === "making") this.strip.say(IN_PREPARATION);
    else this.strip.say("There are no camera pictures of these labels.", this.remake());
  }

  /** The button that has the pictures made, for users who may change the sequence. */
  private remake(): HTMLElement | undefined {
    if (this.host.dataset["mayChange"] === undefined) return undefined;
    const button = make("button", { type: "button", class: "small" }, "Prepare camera pictures");
    button.addEventListener("click", () => {
      button.disabled = true;
      const asked = call("POST", `/api/v1/sequences/${this.scene.sequence_id}/exports`, { format: "playback" });
      asked.then(
        () => this.strip.say(IN_PREPARATION),
        (error: unknown) => this.strip.say(`They cannot be prepared: ${messageOf(error)}`),
      );
    });
    return button;
  }
}
