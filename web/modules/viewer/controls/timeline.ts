// The frames of a run in time: a slider that steps by keys, play and pause, and the speed.
//
// Playback waits for each frame, so that a slow network or picture plays slower instead of skipping.

import { button, icon, make } from "./elements.js";

const PLAY = "M8 5v14l11-7z";
const PAUSE = "M7 5h4v14H7zM13 5h4v14h-4z";
const BACK = "M15.5 5v14L6 12zM5 5h2v14H5z";
const ON = "M8.5 5v14L18 12zM17 5h2v14h-2z";
const SPEEDS = [0.5, 1, 2, 5];
const SHORTEST_MS = 40;
const LONGEST_MS = 1000;

/** Shows the frame, and ends once it is seen. */
export type Show = (index: number) => Promise<void>;

export class Timeline {
  readonly element: HTMLElement;
  private readonly slider: HTMLInputElement;
  private readonly where: HTMLOutputElement;
  private readonly playing: HTMLButtonElement;
  private readonly speed: HTMLSelectElement;
  private run = 0;
  index = 0;

  constructor(private readonly stamps_ns: bigint[], private readonly show: Show) {
    const last = String(Math.max(0, stamps_ns.length - 1));
    this.slider = make("input", { type: "range", min: "0", max: last, step: "1", value: "0", "aria-label": "Frame" });
    this.slider.addEventListener("input", () => this.seek(this.slider.valueAsNumber));
    this.where = make("output", { class: "viewer-where" });
    this.playing = button("Play", "Play", PLAY, () => this.toggle());
    this.speed = make("select", { "aria-label": "Speed", class: "viewer-speed" });
    this.speed.append(...SPEEDS.map((value) => make("option", { value: String(value), selected: value === 1 }, `${value}×`)));
    this.element = make(
      "div", { class: "viewer-timeline", role: "group", "aria-label": "Timeline" },
      button("Previous frame", "Previous", BACK, () => this.step(-1)), this.playing, button("Next frame", "Next", ON, () => this.step(1)),
      this.slider, this.where, this.speed,
    );
  }

  get isPlaying(): boolean {
    return this.run > 0 && this.element.dataset["playing"] === "true";
  }

  step(by: number): void {
    this.seek(this.index + by);
  }

  /** Go there and stay. */
  seek(index: number): void {
    this.pause();
    void this.show(this.clamped(index));
  }

  toggle(): void {
    if (this.isPlaying) this.pause();
    else void this.play();
  }

  pause(): void {
    this.run++;
    this.say(false);
  }

  /** This frame is seen now. */
  stand(index: number): void {
    this.index = index;
    this.slider.value = String(index);
    const seconds = this.seconds(index).toFixed(1);
    this.slider.setAttribute("aria-valuetext", `Frame ${index + 1} of ${this.stamps_ns.length}, ${seconds} s`);
    this.where.value = `${index + 1} / ${this.stamps_ns.length} · ${seconds} s`;
  }

  private async play(): Promise<void> {
    const run = ++this.run;
    this.say(true);
    if (this.index === this.stamps_ns.length - 1) await this.show(0);
    while (run === this.run && this.index < this.stamps_ns.length - 1) {
      const wait = new Promise((resolve) => setTimeout(resolve, this.wait_ms()));
      const next = this.index + 1;
      await wait;
      if (run === this.run) await this.show(next);
      if (run === this.run && this.index !== next) break; // it could not be shown, which was reported
    }
    if (run === this.run) this.pause();
  }

  private wait_ms(): number {
    const real_ms = (this.seconds(this.index + 1) - this.seconds(this.index)) * 1000;
    return Math.min(LONGEST_MS, Math.max(SHORTEST_MS, real_ms / Number(this.speed.value)));
  }

  private seconds(index: number): number {
    return Number((this.stamps_ns[index] ?? 0n) - (this.stamps_ns[0] ?? 0n)) / 1e9;
  }

  private say(isPlaying: boolean): void {
    this.element.dataset["playing"] = String(isPlaying);
    const label = isPlaying ? "Pause" : "Play";
    this.playing.replaceChildren(icon(isPlaying ? PAUSE : PLAY), make("span", {}, label));
    this.playing.setAttribute("aria-label", label);
    this.playing.title = label;
  }

  private clamped(index: number): number {
    return Math.min(this.stamps_ns.length - 1, Math.max(0, index));
  }
}
