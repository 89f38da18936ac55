// A file in pieces, each with its sha256: a damaged piece is sent again, not the whole file.
//
// An interrupted piece does not count, because half of it cannot be verified. The size of a piece follows the speed of
// the line, so that an interruption costs a second or two of sending on any line.

import "hash-wasm/sha256";

const SMALLEST_BYTES = 2 ** 20;
const LARGEST_BYTES = 16 * 2 ** 20;
const SHORT_MS = 700;
const LONG_MS = 3000;

/** Size of the next piece: twice the last one if it was quick, half of it if it was slow. */
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

interface Piece {
  value: Blob;
  checksum: string;
}

/** The file source of the tus library; `checksum` is that of the last piece, as `Upload-Checksum`. While a piece is
 * being sent, the next one is read and hashed. */
export class CheckedPieces {
  checksum = "";
  #ahead: { start: number; end: number; piece: Promise<Piece> } | undefined;

  constructor(private readonly file: File) {}

  get size(): number {
    return this.file.size;
  }

  async slice(start: number, end: number): Promise<{ value: Blob; done: boolean }> {
    const isAhead = this.#ahead?.start === start && this.#ahead.end === end;
    const { value, checksum } = await (isAhead && this.#ahead ? this.#ahead.piece : this.#read(start, end));
    this.checksum = checksum;
    this.#readAhead(end, Math.min(this.size, end + (end - start)));
    return { value, done: end >= this.size };
  }

  close(): void {
    this.#ahead = undefined;
  }

  #readAhead(start: number, end: number): void {
    const piece = start < end ? this.#read(start, end) : undefined;
    this.#ahead = piece && { start, end, piece };
    piece?.catch(() => undefined); // the consumer of the piece gets the error
  }

  /** Reads a piece once, so that the hashed bytes are the sent ones. */
  async #read(start: number, end: number): Promise<Piece> {
    const bytes = new Uint8Array(await this.file.slice(start, end).arrayBuffer());
    const hex = (await hashwasm.createSHA256()).init().update(bytes).digest();
    return { value: new Blob([bytes]), checksum: `sha256 ${base64OfHex(hex)}` };
  }
}

function base64OfHex(hex: string): string {
  return btoa(hex.replaceAll(/../g, (two) => String.fromCharCode(Number.parseInt(two, 16))));
}
