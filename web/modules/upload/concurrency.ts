// Several things at once, but not too many; and patience with a platform that is away for a while.

import { RefusedError, type Problem } from "../api.js";

/** At most `limit` tasks at a time; the others wait in the order in which they came. */
export class Lane {
  #free: number;
  readonly #waiting: (() => void)[] = [];

  constructor(limit: number) {
    this.#free = limit;
  }

  async run<T>(task: () => Promise<T>, signal: AbortSignal): Promise<T> {
    await this.#enter(signal);
    try {
      signal.throwIfAborted();
      return await task();
    } finally {
      this.#leave();
    }
  }

  #enter(signal: AbortSignal): Promise<void> {
    signal.throwIfAborted();
    if (this.#free > 0) {
      this.#free -= 1;
      return Promise.resolve();
    }
    return new Promise((resolve, reject) => {
      const begin = (): void => resolve();
      this.#waiting.push(begin);
      signal.addEventListener("abort", () => {
        const at = this.#waiting.indexOf(begin);
        if (at < 0) return;
        this.#waiting.splice(at, 1);
        reject(signal.reason as Error);
      }, { once: true });
    });
  }

  #leave(): void {
    const next = this.#waiting.shift();
    if (next) next();
    else this.#free += 1;
  }
}

const FIRST_MS = 500;
const LONGEST_MS = 20_000;
const PASSING = [0, 408, 423, 429, 500, 502, 503, 504];
const PASSING_CODES = ["offset_mismatch", "checksum_mismatch", "request_in_flight"];

/** Whether the next attempt may succeed: no response, a lock, or a piece damaged in transit. */
export function mayPass(error: unknown): error is RefusedError {
  return error instanceof RefusedError && (PASSING.includes(error.problem.status) || PASSING_CODES.includes(error.problem.code));
}

/** Tries again with growing pauses while the error may pass; `away` receives the error and the pause. */
export async function patiently<T>(
  task: () => Promise<T>,
  signal: AbortSignal,
  away: (problem: Problem, wait_ms: number) => void,
): Promise<T> {
  for (let next_ms = FIRST_MS; ; next_ms = Math.min(LONGEST_MS, next_ms * 2)) {
    const begun_ms = performance.now();
    try {
      return await task();
    } catch (error) {
      if (!mayPass(error)) throw error;
      if (performance.now() - begun_ms > LONGEST_MS) next_ms = FIRST_MS; // it had gone well for a while
      const wait_ms = Math.max(next_ms, 1000 * Number(error.headers.get("Retry-After") ?? 0));
      away(error.problem, wait_ms);
      await pause(wait_ms, signal);
    }
  }
}

/** Wait, or throw at once when the signal fires. */
export function pause(wait_ms: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    signal.throwIfAborted();
    const timer = setTimeout(done, wait_ms);
    const stop = (): void => {
      clearTimeout(timer);
      reject(signal.reason as Error);
    };
    signal.addEventListener("abort", stop, { once: true });
    function done(): void {
      signal.removeEventListener("abort", stop);
      resolve();
    }
  });
}
