// The page's end of the worker: a question, a promise of its answer.

import type { Answers, Asked } from "./worker.js";

type Waiting = { resolve: (value: never) => void; reject: (error: Error) => void };

export class Asking {
  private readonly worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  private readonly waiting = new Map<number, Waiting>();
  private next = 1;

  constructor() {
    this.worker.addEventListener("message", ({ data }: MessageEvent<{ id: number; value: never; error?: string }>) => {
      const waiting = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if (data.error === undefined) waiting?.resolve(data.value);
      else waiting?.reject(new Error(data.error));
    });
    this.worker.addEventListener("error", () => {
      for (const one of this.waiting.values()) one.reject(new Error("The decoder stopped. Reload the page."));
      this.waiting.clear();
    });
  }

  /** `content` is moved, not copied: it is empty afterwards. */
  ask<Kind extends Asked["kind"]>(asked: Extract<Asked, { kind: Kind }>): Promise<Answers[Kind]> {
    const id = this.next++;
    const content = "content" in asked ? asked.content : null;
    return new Promise<Answers[Kind]>((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      this.worker.postMessage({ ...asked, id }, content ? [content.buffer] : []);
    });
  }

  end(): void {
    this.worker.terminate();
  }
}
