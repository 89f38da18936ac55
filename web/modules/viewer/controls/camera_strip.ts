// The cameras of a frame in a row, each with its visible labels; one of them large beside the 3D view.
//
// A click in a picture selects the voxel seen there. A selected voxel is marked in every picture that shows it.

import type { CameraFrame } from "../cameras.js";
import type { CameraView } from "../data/camera_views.js";
import { make } from "./elements.js";
import { paintView } from "./camera_paint.js";
import type { Theme } from "../drawing/theme.js";

export interface StripActs {
  /** The pixel shows this voxel, or 0 for none. */
  picked: (id: number) => void;
  /** The voxel of the pixel is unknown, for this reason. */
  unknown: (why: string) => void;
  /** This camera is wanted large, null: none. */
  enlarged: (camera: number | null) => void;
}

class CameraTile {
  readonly element: HTMLElement;
  readonly button: HTMLButtonElement;
  private readonly canvas = make("canvas", { "aria-hidden": "true", hidden: true });
  private readonly none = make("span", { class: "hint", hidden: true }, "No picture of this frame");
  private picture: HTMLImageElement | null = null;
  view: CameraView | null = null;

  constructor(readonly name: string, tool: HTMLButtonElement, picked: (id: number | null) => void, pressed: () => void) {
    this.button = make("button", { type: "button", class: "viewer-camera-picture" }, this.none, this.canvas);
    this.button.addEventListener("click", (event) => (event.detail === 0 ? pressed() : picked(this.at(event))));
    const caption = make("figcaption", { class: "row between" }, make("span", {}, name), tool);
    this.element = make("figure", { class: "viewer-camera" }, this.button, caption);
  }

  /** Changes picture and labels together. */
  put(picture: HTMLImageElement | null, view: CameraView | null, where: string): void {
    this.picture?.remove();
    this.picture = picture;
    if (picture) this.button.prepend(picture);
    this.none.hidden = picture !== null;
    this.view = view;
    this.canvas.hidden = view === null;
    this.button.setAttribute("aria-label", `${this.name} camera, ${where}. A click selects a voxel.`);
  }

  paint(palette: Uint8Array, theme: Theme, marked: number): void {
    if (this.view) paintView(this.canvas, this.view, palette, theme, marked);
  }

  /** The voxel below the mouse, 0 for none; null if no labels are drawn. */
  private at(event: MouseEvent): number | null {
    const { view } = this;
    const box = this.button.getBoundingClientRect();
    if (!view || !box.width || !box.height) return null;
    const column = Math.min(view.width - 1, Math.max(0, Math.floor(((event.clientX - box.left) / box.width) * view.width)));
    const row = Math.min(view.height - 1, Math.max(0, Math.floor(((event.clientY - box.top) / box.height) * view.height)));
    return view.ids[row * view.width + column]!;
  }
}

export class CameraStrip {
  readonly element = make("div", { class: "viewer-cameras", role: "group", "aria-label": "Camera pictures", hidden: true });
  readonly large = make("section", { class: "viewer-enlarged", "aria-label": "Camera picture, large", hidden: true });
  enlarged: number | null = null;
  private readonly row = make("div", { class: "viewer-camera-row" });
  private readonly said = make("p", { class: "hint", hidden: true });
  private readonly tiles: CameraTile[];
  private big: CameraTile | null = null;
  private shown: CameraFrame | null = null;
  private palette: Uint8Array = new Uint8Array(1024);
  private theme: Theme | null = null;
  private marked = 0;
  /** The 3D view shows another frame than these pictures. */
  private isLate = false;

  /** `channels` are in the order of the frames; they are shown in the order of `rig`. */
  constructor(private readonly channels: string[], rig: string[], private readonly frames: number, private readonly acts: StripActs) {
    this.tiles = channels.map((channel, camera) => {
      const words = namesOf(channel);
      const tool = make("button", { type: "button", class: "quiet small", "aria-label": `Enlarge ${words}` }, "Enlarge");
      tool.addEventListener("click", () => this.acts.enlarged(camera));
      return new CameraTile(words, tool, (id) => this.picked(id), () => this.acts.enlarged(camera));
    });
    const place = (channel: string): number => (rig.includes(bare(channel)) ? rig.indexOf(bare(channel)) : rig.length);
    const order = [...channels.keys()].sort((a, b) => place(channels[a]!) - place(channels[b]!) || channels[a]!.localeCompare(channels[b]!));
    this.row.append(...order.map((camera) => this.tiles[camera]!.element));
    this.element.append(this.row, this.said);
  }

  put(frame: CameraFrame, palette: Uint8Array, theme: Theme): void {
    [this.shown, this.palette, this.theme, this.isLate] = [frame, palette, theme, false];
    this.element.dataset["frame"] = String(frame.index);
    const where = `frame ${frame.index + 1} of ${this.frames}`;
    this.tiles.forEach((tile, camera) => tile.put(frame.pictures[camera] ?? null, frame.views[camera] ?? null, where));
    this.putLarge(where);
    this.paint();
  }

  /** The 3D view shows a frame whose pictures are still loading: nothing is marked or selected in them. */
  wait(): void {
    this.isLate = true;
    this.paint();
  }

  /** This camera large; ends nothing else. The next `put` may bring a finer view of it. */
  enlarge(camera: number | null, isAsked = true): void {
    const before = this.enlarged;
    this.enlarged = camera;
    this.large.hidden = camera === null;
    this.large.replaceChildren();
    this.big = null;
    if (camera === null) return void (before !== null && this.tiles[before]?.button.focus());
    const close = make("button", { type: "button", class: "quiet small" }, "Close");
    close.addEventListener("click", () => this.acts.enlarged(null));
    this.big = new CameraTile(namesOf(this.channels[camera]!), close, (id) => this.picked(id), () => this.acts.enlarged(null));
    this.large.append(this.big.element);
    if (this.shown) this.putLarge(`frame ${this.shown.index + 1} of ${this.frames}`);
    this.paint();
    if (isAsked) close.focus();
  }

  /** The voxel with this id is marked, 0: none. */
  mark(id: number): void {
    if (this.marked === id) return;
    this.marked = id;
    this.paint();
  }

  dress(palette: Uint8Array, theme: Theme): void {
    [this.palette, this.theme] = [palette, theme];
    this.paint();
  }

  get hasWords(): boolean {
    return !this.said.hidden;
  }

  /** Shows a sentence below the pictures, with a button for the remedy. */
  say(sentence: string | null, act?: HTMLElement): void {
    this.said.hidden = sentence === null;
    this.said.replaceChildren(sentence ?? "", ...(act ? [" ", act] : []));
  }

  private picked(id: number | null): void {
    if (this.isLate) this.acts.unknown("The pictures of this frame are still loading.");
    else if (id === null) this.acts.unknown("No labels are drawn in this picture, so no voxel can be selected in it.");
    else this.acts.picked(id);
  }

  private putLarge(where: string): void {
    const camera = this.enlarged;
    if (camera === null || !this.big || !this.shown) return;
    const picture = this.shown.pictures[camera]?.cloneNode() as HTMLImageElement | undefined;
    this.big.put(picture ?? null, this.shown.views[camera] ?? null, where);
  }

  private paint(): void {
    if (!this.theme) return;
    for (const tile of this.big ? [...this.tiles, this.big] : this.tiles) tile.paint(this.palette, this.theme, this.isLate ? 0 : this.marked);
  }
}

function bare(channel: string): string {
  return channel.replace(/^CAM_/, "");
}

/** CAM_FRONT_LEFT is Front left. */
function namesOf(channel: string): string {
  const words = bare(channel).toLowerCase().replaceAll("_", " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}
