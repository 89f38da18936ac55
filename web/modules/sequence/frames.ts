// One frame at a time: the slider, the keys and the player choose it; pictures, numbers and the URL follow.
//
// The pictures of a frame are shown together once all are loaded, so that cameras never show different moments; the
// next frames are fetched ahead.

import { withColours } from "../colours.js";
import { Player } from "./player.js";
import { onDrag, nearest, pageData, part, placeCursors } from "./parts.js";

interface Points {
  tokens: string[];
  times_s: number[];
  voxels: [number, number, number][];
}

const AHEAD = 4;
const BIG_STEP = 10;

class FramePage {
  private readonly points = pageData<Points>("frame-points");
  private readonly slider: HTMLInputElement;
  private readonly pictures: HTMLImageElement[];
  private readonly player: Player;
  private readonly held = new Map<string, Promise<void>>();
  private index: number;

  constructor(private readonly root: HTMLElement) {
    this.slider = part<HTMLInputElement>(root, "[data-scrub]");
    this.index = Number(this.slider.value);
    this.pictures = Array.from(root.querySelectorAll<HTMLImageElement>("[data-bev], [data-camera]"));
    const play = part<HTMLButtonElement>(root, "[data-play]");
    this.player = new Player(this.points.times_s, (index) => this.show(index), (isOn) => {
      play.textContent = isOn ? "Pause" : "Play";
      play.setAttribute("aria-pressed", String(isOn));
    });
    this.listen(play);
    this.tell();
    this.fetchAhead();
  }

  private listen(play: HTMLButtonElement): void {
    this.slider.addEventListener("input", () => this.choose(Number(this.slider.value)));
    this.slider.addEventListener("keydown", (event) => this.key(event));
    play.addEventListener("click", () => this.toggle());
    for (const button of this.root.querySelectorAll<HTMLElement>("[data-step]")) {
      button.addEventListener("click", () => this.choose(this.index + Number(button.dataset["step"])));
    }
    const speed = part<HTMLSelectElement>(this.root, "[data-speed]");
    speed.addEventListener("change", () => {
      this.player.restart(this.index);
      this.player.speed = Number(speed.value);
    });
    const last_s = this.points.times_s.at(-1) ?? 0;
    onDrag(part(this.root, "[data-strip]"), (share) => this.choose(nearest(this.points.times_s, share * last_s)));
    document.addEventListener("colours", () => this.held.clear());
    document.addEventListener("visibilitychange", () => document.hidden && this.player.pause());
  }

  private key(event: KeyboardEvent): void {
    const far = { PageUp: BIG_STEP, PageDown: -BIG_STEP }[event.key];
    if (far !== undefined) this.choose(this.index + far);
    else if (event.key === " ") this.toggle();
    else return;
    event.preventDefault();
  }

  private toggle(): void {
    if (this.player.isPlaying) this.player.pause();
    else this.player.play(this.index);
  }

  private choose(index: number): void {
    this.player.pause();
    void this.show(Math.min(this.points.tokens.length - 1, Math.max(0, index)));
  }

  private async show(index: number): Promise<void> {
    this.index = index;
    this.tell();
    await this.fetched(index);
    if (this.index !== index) return;
    for (const picture of this.pictures) picture.src = this.address(picture, index);
    this.fetchAhead();
  }

  /** Updates every text that names the frame. */
  private tell(): void {
    const token = this.points.tokens[this.index] ?? "";
    const at_s = this.points.times_s[this.index] ?? 0;
    const last_s = this.points.times_s.at(-1) || 1;
    this.slider.value = String(this.index);
    this.slider.setAttribute("aria-valuetext", `frame ${this.index + 1} of ${this.points.tokens.length}, ${at_s.toFixed(1)} s`);
    part(this.root, "[data-number]").textContent = String(this.index + 1);
    part(this.root, "[data-at]").textContent = at_s.toFixed(1);
    part(this.root, "[data-token]").textContent = token;
    part<HTMLAnchorElement>(this.root, "[data-in-3d]").href = `${this.root.dataset["view"] ?? ""}?frame=${token}`;
    placeCursors(this.root, at_s / last_s);
    this.tellShares();
    history.replaceState(null, "", `?frame=${token}`);
  }

  private tellShares(): void {
    const counts = this.points.voxels[this.index] ?? [0, 0, 0];
    const total = counts[0] + counts[1] + counts[2] || 1;
    const bars = this.root.querySelectorAll<SVGRectElement>("[data-shares] rect");
    let x = 0;
    bars.forEach((bar, place) => {
      const width = (100 * (counts[place] ?? 0)) / total;
      bar.setAttribute("x", x.toFixed(3));
      bar.setAttribute("width", width.toFixed(3));
      x += width;
    });
    const words = ["traversable", "potentially", "non-traversable"].map((word, place) => `${word} ${((100 * (counts[place] ?? 0)) / total).toFixed(1)} %`);
    part(this.root, "[data-share-words]").textContent = `Share of this frame's occupied voxels: ${words.join(" · ")}`;
    this.root.querySelector("[data-shares] svg")?.setAttribute("aria-label", `This frame: ${words.join(", ")}`);
  }

  private address(picture: HTMLImageElement, index: number): string {
    const camera = picture.dataset["camera"];
    const name = camera ? `camera/${camera}.jpg` : "bev.png";
    const address = `/api/v1/frames/${this.points.tokens[index] ?? ""}/${name}?v=${this.root.dataset["version"] ?? ""}`;
    return camera ? address : withColours(address);
  }

  private fetchAhead(): void {
    for (let step = 1; step <= AHEAD; step += 1) void this.fetched(this.index + step);
  }

  /** Resolves with all pictures of the frame decoded; a failed one is shown as broken by the browser. */
  private fetched(index: number): Promise<void> {
    const token = this.points.tokens[index];
    if (token === undefined) return Promise.resolve();
    const known = this.held.get(token);
    if (known) return known;
    const loads = this.pictures.map((picture) => {
      const ahead = new Image();
      ahead.src = this.address(picture, index);
      return ahead.decode().catch(() => undefined);
    });
    const all = Promise.all(loads).then(() => undefined);
    this.held.set(token, all);
    return all;
  }
}

const root = document.querySelector<HTMLElement>("[data-frames]");
if (root) new FramePage(root);
