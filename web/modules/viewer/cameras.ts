// The camera pictures of a frame, with the labels visible in each: fetched and cast together.

import { bytes } from "../api.js";
import { messageOf } from "../errors.js";
import type { CameraView, ViewSize } from "./data/camera_views.js";
import type { Asking } from "./data/worker_client.js";
import type { Look } from "./looks.js";
import type { SceneFacts } from "./scene.js";

/** Pixels of a view beside the 3D view, while frames play, and enlarged. */
export const VIEW_PX = { still: [320, 200], playing: [160, 100], enlarged: [640, 400] } as const;
const KEPT_AROUND = 2;

/** For each camera of `scene.playback.cameras`: its picture, null if it took none, and its view of the labels. */
export interface CameraFrame {
  index: number;
  pictures: (HTMLImageElement | null)[];
  views: (CameraView | null)[];
}

export interface CameraWish {
  look: Look;
  isPlaying: boolean;
  withLabels: boolean;
  /** The camera that is shown large. */
  enlarged: number | null;
}

export class CameraFrames {
  private readonly kept = new Map<number, Promise<(HTMLImageElement | null)[]>>();
  private hasPicture: ((camera: number, index: number) => boolean) | null = null;
  private hasRays = false;

  constructor(private readonly asking: Asking, private readonly scene: SceneFacts) {}

  /** Resolves when the lenses are loaded, with a sentence if pictures can be shown, but not the labels in them. */
  async open(): Promise<string | null> {
    const { sequence_id, playback, frames } = this.scene;
    if (!playback.has_rays) return "These pictures were made by an earlier release, before labels could be drawn in them.";
    try {
      const content = await bytes(`/api/v1/sequences/${sequence_id}/scene/cameras?v=${playback.export_id}`);
      const known = await this.asking.ask({ kind: "cameras", content });
      if (known.frames !== frames.tokens.length) return "These pictures were made from other frames, so labels are not drawn in them.";
      this.hasPicture = (camera, index) => known.hasPicture[camera * known.frames + index] === 1;
      this.hasRays = true;
      return null;
    } catch (error) {
      return `Labels cannot be drawn in the pictures: ${messageOf(error)}`;
    }
  }

  /** Resolves once all pictures of the frame are decoded and its labels are cast into them; the worker must hold the
   * frame. */
  async take(index: number, wish: CameraWish): Promise<CameraFrame> {
    const [pictures, views] = await Promise.all([this.picturesOf(index), this.viewsOf(index, wish)]);
    return { index, pictures, views };
  }

  /** The pictures of the next frame in this direction are on their way. */
  ahead(index: number, step: number): void {
    const next = index + step;
    if (next >= 0 && next < this.scene.frames.tokens.length) void this.picturesOf(next);
  }

  private async viewsOf(index: number, { look, isPlaying, withLabels, enlarged }: CameraWish): Promise<(CameraView | null)[]> {
    const { cameras } = this.scene.playback;
    const none = cameras.map(() => null);
    if (!withLabels || !this.hasRays) return none;
    const sizes = cameras.flatMap((_, camera): ViewSize[] => {
      if (!this.hasPicture!(camera, index)) return [];
      const [width, height] = VIEW_PX[enlarged === camera ? "enlarged" : isPlaying ? "playing" : "still"];
      return [{ camera, width, height }];
    });
    const token = this.scene.frames.tokens[index]!;
    const made = await this.asking.ask({ kind: "camera-views", token, look: { ...look }, sizes }).catch(() => []);
    return none.map((_, camera) => made.find((view) => view.camera === camera) ?? null);
  }

  private picturesOf(index: number): Promise<(HTMLImageElement | null)[]> {
    const held = this.kept.get(index);
    if (held) return held;
    const all = Promise.all(this.scene.playback.cameras.map((channel, camera) => this.picture(channel, camera, index)));
    this.kept.set(index, all);
    for (const other of this.kept.keys()) if (Math.abs(other - index) > KEPT_AROUND) this.kept.delete(other);
    return all;
  }

  private async picture(channel: string, camera: number, index: number): Promise<HTMLImageElement | null> {
    if (this.hasPicture && !this.hasPicture(camera, index)) return null;
    const picture = new Image();
    picture.alt = "";
    picture.draggable = false;
    picture.fetchPriority = "low";
    picture.src = `/api/v1/frames/${this.scene.frames.tokens[index]}/camera/${channel}.jpg?v=${this.scene.label_set_id}`;
    return picture.decode().then(() => picture, () => null);
  }
}
