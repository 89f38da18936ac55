// Frames for the picture: fetched ahead, kept while near, and cancelled when the reader moves elsewhere.

import { bytes } from "../../api.js";
import type { Asking } from "./worker_client.js";
import type { Look } from "../looks.js";
import type { Drawn } from "./model.js";
import type { SceneFacts } from "../scene.js";

const AHEAD = 4;
const KEPT = 12;

export class FrameStore {
  private readonly kept = new Map<number, Promise<Drawn>>();
  private readonly fetching = new Map<number, AbortController>();
  private readonly decoded = new Set<string>();
  private look: Look;
  private course = 0;

  constructor(private readonly asking: Asking, private readonly scene: SceneFacts, look: Look) {
    this.look = look;
  }

  /** Draws frames with this look from then on; frames with another look are dropped. */
  looking(look: Look): void {
    this.look = look;
    this.kept.clear();
  }

  /** The frame; pending frames that are no longer near are cancelled. */
  take(index: number): Promise<Drawn> {
    for (const [other, controller] of this.fetching) {
      if (other < index - 1 || other > index + AHEAD) controller.abort();
    }
    return this.kept.get(index) ?? this.make(index);
  }

  /** Fetches the next frames in this direction, one after the other. */
  async ahead(index: number, step: number): Promise<void> {
    const course = ++this.course;
    for (let n = 1; n <= AHEAD && course === this.course; n++) {
      const next = index + n * step;
      if (next < 0 || next >= this.scene.frames.tokens.length) return;
      if (!this.kept.has(next)) await this.make(next).catch(() => undefined);
    }
  }

  private make(index: number): Promise<Drawn> {
    const drawn = this.drawn(index);
    this.kept.set(index, drawn);
    drawn.catch(() => this.kept.delete(index));
    this.forget(index);
    return drawn;
  }

  private async drawn(index: number): Promise<Drawn> {
    const token = this.scene.frames.tokens[index]!;
    const look = this.look;
    const address = this.address(token, look);
    if (this.decoded.has(address)) {
      try {
        return await this.asking.ask({ kind: "frame", token, content: null, look });
      } catch {
        this.decoded.delete(address); // the worker keeps only some
      }
    }
    const content = await this.fetched(index, address);
    const drawn = await this.asking.ask({ kind: "frame", token, content, look });
    this.decoded.add(address);
    return drawn;
  }

  /** The URL of the labels, or of their difference from others. */
  private address(token: string, look: Look): string {
    const { sequence_id, comparison_id, label_set_id } = this.scene;
    if (look.mode !== "difference") return `/api/v1/frames/${token}/voxels?v=${label_set_id}`;
    return `/api/v1/sequences/${sequence_id}/label-comparisons/${comparison_id}/frames/${token}/voxels`;
  }

  private async fetched(index: number, address: string): Promise<Uint8Array> {
    const controller = new AbortController();
    this.fetching.set(index, controller);
    try {
      return await bytes(address, controller.signal);
    } finally {
      if (this.fetching.get(index) === controller) this.fetching.delete(index);
    }
  }

  /** Drops the frames farthest from the current one first. */
  private forget(index: number): void {
    const farthest = [...this.kept.keys()].sort((a, b) => Math.abs(b - index) - Math.abs(a - index));
    for (const other of farthest.slice(0, Math.max(0, this.kept.size - KEPT))) this.kept.delete(other);
  }
}
