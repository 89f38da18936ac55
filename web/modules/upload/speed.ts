// Rate and time left, over the last seconds, so that a pause is forgotten soon.

const WINDOW_MS = 6000;

/** The rate of a count of bytes over time. */
export class Speed {
  readonly #marks: { at_ms: number; bytes: number }[] = [];

  mark(bytes: number, at_ms = performance.now()): void {
    const last = this.#marks.at(-1);
    if (last && bytes < last.bytes) this.#marks.length = 0; // it fell back to the platform's offset
    this.#marks.push({ at_ms, bytes });
    while (this.#marks.length > 2 && at_ms - (this.#marks[0]?.at_ms ?? 0) > WINDOW_MS) this.#marks.shift();
  }

  /** Seconds since something moved. */
  get still_s(): number {
    const last = this.#marks.at(-1);
    return last ? (performance.now() - last.at_ms) / 1000 : 0;
  }

  /** Bytes per second; 0 if unknown. */
  get per_s(): number {
    const [first, last] = [this.#marks[0], this.#marks.at(-1)];
    if (!first || !last || last.at_ms - first.at_ms < 200) return 0;
    return (1000 * (last.bytes - first.bytes)) / (last.at_ms - first.at_ms);
  }
}

const UNITS = ["B", "kB", "MB", "GB", "TB"];

/** `2.5 GB`, as `web/words.py` writes it. */
export function size(bytes: number): string {
  let value = bytes;
  let unit = 0;
  while (Math.abs(value) >= 999.5 && unit < UNITS.length - 1) [value, unit] = [value / 1000, unit + 1];
  return `${unit === 0 || value >= 99.5 ? value.toFixed(0) : value.toFixed(1)} ${UNITS[unit]}`;
}

/** `2 min 5 s`, whole seconds. */
export function span(seconds: number): string {
  const whole = Math.max(1, Math.round(seconds));
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${whole % 60} s`;
  return `${Math.floor(whole / 3600)} h ${Math.floor((whole % 3600) / 60)} min`;
}
