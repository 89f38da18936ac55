// A file in pieces, each with its sha256: what is damaged on its way is sent again, and not the whole file.
//
// A piece that breaks off does not count, since nobody can check half of one. So pieces are as large as the line is fast:
// a break costs a second or two of sending, on a slow line as on a fast one.

import "hash-wasm/sha256";

const SMALLEST_BYTES = 2 ** 20;
const LARGEST_BYTES = 32 * 2 ** 20;
const SHORT_MS = 700;
const LONG_MS = 3000;

/** How large the next piece is: twice the last where that was quick, half of it where it was slow. */
export class Pace {
  bytes = SMALLEST_BYTES;
  #since_ms = performance.now();

  /** A piece has arrived; the size of the next. */
  next(): number {
    const took_ms = performance.now() - this.#since_ms;
    this.#since_ms = performance.now();
    if (took_ms < SHORT_MS) this.bytes = Math.min(LARGEST_BYTES, 2 * this.bytes);
    else if (took_ms > LONG_MS) this.bytes = Math.max(SMALLEST_BYTES, this.bytes / 2);
    return this.bytes;
  }
}

/** What the tus library reads a file through; `checksum` is that of the piece it took last, as `Upload-Checksum`. */
export class CheckedPieces {
  checksum = "";

  constructor(private readonly file: File) {}

  get size(): number {
    return this.file.size;
  }

  /** The bytes that were counted are the ones that are sent: the piece is read once. */
  async slice(start: number, end: number): Promise<{ value: Blob; done: boolean }> {
    const bytes = new Uint8Array(await this.file.slice(start, end).arrayBuffer());
    const hex = (await hashwasm.createSHA256()).init().update(bytes).digest();
    this.checksum = `sha256 ${base64OfHex(hex)}`;
    return { value: new Blob([bytes]), done: end >= this.file.size };
  }

  close(): void {
    // nothing is held
  }
}

function base64OfHex(hex: string): string {
  return btoa(hex.replaceAll(/../g, (two) => String.fromCharCode(Number.parseInt(two, 16))));
}
