// Bytes of a file that is never loaded whole, and the fault of a malformed one.
//
// Codes and bounds are those of the platform's own reader (services/eval); a test compares both.

/** The reason to refuse an archive or a file in it. */
export class Fault extends Error {
  constructor(readonly code: string, readonly expected: string, readonly actual: string) {
    super(`${code}: expected ${expected}, found ${actual}`);
  }
}

const WINDOW_BYTES = 2 ** 20;
const LONGEST_TEXT = 200;
const UNPRINTABLE = /[\p{C}\p{Z}]/u;

/** A window into a file: at most a mebibyte of it, or one requested range, is in memory. */
export class Bytes {
  private start = 0;
  private held = new DataView(new ArrayBuffer(0));

  constructor(private readonly file: Blob) {}

  get size(): number {
    return this.file.size;
  }

  /** The bytes [offset, offset + count), fewer at the end of the file. */
  async at(offset: number, count: number): Promise<DataView> {
    const stop = Math.min(offset + count, this.size);
    if (offset >= stop) return new DataView(new ArrayBuffer(0));
    if (offset < this.start || stop > this.start + this.held.byteLength) {
      const until = Math.min(this.size, Math.max(stop, offset + WINDOW_BYTES));
      this.held = new DataView(await this.file.slice(offset, until).arrayBuffer());
      this.start = offset;
    }
    return new DataView(this.held.buffer, offset - this.start, stop - offset);
  }
}

/** The eight bytes as a number; one beyond 2^53 is rounded, and larger than any file. */
export function wide(view: DataView, at: number): number {
  return Number(view.getBigUint64(at, true));
}

/** One line of at most 200 characters; non-printable characters (controls, bidirectional marks) are escaped. */
export function plain(text: string): string {
  const shown = (one: string): string => (one === " " || !UNPRINTABLE.test(one) ? one : escaped(one));
  const line = [...text].slice(0, LONGEST_TEXT).map(shown).join("");
  return [...line].slice(0, LONGEST_TEXT).join("");
}

function escaped(character: string): string {
  const code = character.codePointAt(0) ?? 0;
  const short: Record<number, string> = { 9: "\\t", 10: "\\n", 13: "\\r" };
  const digits = code.toString(16);
  if (code < 0x100) return short[code] ?? `\\x${digits.padStart(2, "0")}`;
  return code < 0x10000 ? `\\u${digits.padStart(4, "0")}` : `\\U${digits.padStart(8, "0")}`;
}
