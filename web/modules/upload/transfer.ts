// One bag in transit: hashed, sent, registered. After any interruption, a restart resumes.

import { type Problem, RefusedError } from "../api.js";
import type { Bag } from "./bags.js";
import { sizeOf } from "./bags.js";
import { patiently } from "./concurrency.js";
import { type Finding, read, type Recording, sealed, standing } from "./recording_creation.js";
import { type Heard, type Purpose, sent, summed } from "./file_upload.js";
import { Speed } from "./speed.js";
import { forgetSum } from "./checksums.js";

export type Phase = "waiting" | "counting" | "sending" | "away" | "signing-in" | "paused" | "reading" | "registered" | "refused";

/** Phases that progress automatically. */
export const UNDER_WAY: readonly Phase[] = ["counting", "sending", "away", "signing-in", "reading"];

/** The id of the bag's sequence, which is created if there is none yet. */
export type Target = (signal: AbortSignal) => Promise<string>;

export class Transfer implements Heard {
  phase: Phase = "waiting";
  problem: Problem | undefined;
  sequenceId: string | undefined;
  findings: Finding[] = [];
  awaySentence = "";
  awayUntil_ms = 0;
  step: { done: number; total: number } = { done: 0, total: 0 };
  readonly countedSpeed = new Speed();
  readonly sentSpeed = new Speed();
  readonly #counted = new Map<File, number>();
  readonly #sent = new Map<File, number>();
  #stop: AbortController | undefined;

  constructor(
    readonly bag: Bag,
    readonly target: Target,
    private readonly changed: (transfer: Transfer) => void,
  ) {
    if (!bag.trouble) return;
    this.problem = { title: "No bag", status: 422, detail: bag.trouble, code: bag.code, request_id: "" };
    this.phase = "refused"; // not by a change, because the row is still being constructed
  }

  get size_bytes(): number {
    return sizeOf(this.bag);
  }

  get counted_bytes(): number {
    return sum(this.#counted);
  }

  get sent_bytes(): number {
    return sum(this.#sent);
  }

  get isUnderWay(): boolean {
    return UNDER_WAY.includes(this.phase);
  }

  pause(): void {
    this.#stop?.abort();
  }

  /** Starts or resumes; resolves when it is registered, refused or paused. */
  async start(): Promise<void> {
    if (this.isUnderWay || this.phase === "registered" || this.bag.trouble) return;
    const stop = new AbortController();
    this.#stop = stop;
    this.problem = undefined;
    this.#enter("counting");
    try {
      const recording = await this.#brought(stop.signal);
      this.findings = recording.findings;
      this.#enter(recording.state === "registered" ? "registered" : "refused");
    } catch (error) {
      const isPaused = stop.signal.aborted;
      stop.abort(); // stops the other files of the bag too
      if (isPaused) this.#enter("paused");
      else this.#refuse(problemOf(error));
    }
  }

  async #brought(signal: AbortSignal): Promise<Recording> {
    const ask = <T>(task: () => Promise<T>): Promise<T> =>
      patiently(task, signal, (problem, wait_ms) => this.away(problem, wait_ms));
    const sequenceId = await ask(() => this.target(signal));
    this.sequenceId = sequenceId;
    const sums = (): Promise<string[]> => Promise.all(this.bag.files.map((file) => summed(file, this, signal)));
    const known = await ask(() => standing(this.bag, sums, sequenceId));
    this.back();
    if (known) {
      for (const file of this.bag.files) this.sent(file, file.size);
      return read(known, sequenceId, undefined, this, signal);
    }
    const purpose: Purpose = { name: "recording", target_id: sequenceId };
    const ids = await Promise.all(
      this.bag.files.map(async (file) => sent(file, await summed(file, this, signal), purpose, this, signal)),
    );
    this.#enter("reading");
    const { recording, job } = await ask(() => sealed(this.bag, ids, sequenceId));
    return read(recording, sequenceId, job.id, this, signal);
  }

  counted(file: File, bytes: number): void {
    this.#counted.set(file, bytes);
    this.countedSpeed.mark(this.counted_bytes);
    this.changed(this);
  }

  sent(file: File, bytes: number): void {
    this.#sent.set(file, bytes);
    this.sentSpeed.mark(this.sent_bytes);
    if (this.phase === "counting" && bytes > 0) this.#enter("sending");
    else this.changed(this);
  }

  reading(done: number, total: number): void {
    this.step = { done, total };
    this.changed(this);
  }

  away(problem: Problem, wait_ms: number): void {
    this.awaySentence = problem.status ? problem.detail : "The platform does not respond; uploaded data is kept.";
    this.awayUntil_ms = performance.now() + wait_ms;
    this.#enter("away");
  }

  /** The session has ended and the sign-in dialog is open: transfers pause until the reader has answered. */
  signingIn(isAsked: boolean): void {
    if (isAsked && this.isUnderWay) this.#enter("signing-in");
    else if (!isAsked) this.back();
  }

  /** The platform answers again. */
  back(): void {
    if (this.phase !== "away" && this.phase !== "signing-in") return;
    const isSent = this.sent_bytes >= this.size_bytes;
    this.#enter(isSent ? "reading" : this.sent_bytes > 0 ? "sending" : "counting");
  }

  #refuse(problem: Problem): void {
    this.problem = problem;
    if (problem.code === "sha256_mismatch") this.bag.files.forEach(forgetSum);
    this.#enter("refused");
  }

  #enter(phase: Phase): void {
    this.phase = phase;
    this.changed(this);
  }
}

function sum(by: ReadonlyMap<File, number>): number {
  return [...by.values()].reduce((all, one) => all + one, 0);
}

function problemOf(error: unknown): Problem {
  if (error instanceof RefusedError) return error.problem;
  const isUnreadable = error instanceof DOMException && ["NotReadableError", "NotFoundError"].includes(error.name);
  const detail = isUnreadable
    ? "The file can no longer be read: it was changed or removed since it was selected. Select it again."
    : String(error);
  return { title: "Not sent", status: 0, detail, code: isUnreadable ? "file_changed" : "error", request_id: "" };
}
