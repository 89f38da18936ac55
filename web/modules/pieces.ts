// A file in pieces, each with its sha256: what is damaged on its way is sent again, and not the whole file.

import "hash-wasm/sha256";

export const PIECE_BYTES = 16 * 2 ** 20;

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
