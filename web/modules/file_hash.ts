// The sha256 of a file of any size, read piece by piece: the page stays alive and its memory small.

import "hash-wasm/sha256";

const PIECE_BYTES = 4 * 2 ** 20;

/** Returns lower-case hex. `heard` receives the number of bytes hashed. Throws `AbortError` when `signal` fires. */
export async function sha256Of(
  file: Blob,
  heard: (done_bytes: number) => void = () => undefined,
  signal?: AbortSignal,
): Promise<string> {
  const hasher = (await hashwasm.createSHA256()).init();
  for (let at = 0; at < file.size; at += PIECE_BYTES) {
    signal?.throwIfAborted();
    hasher.update(new Uint8Array(await file.slice(at, at + PIECE_BYTES).arrayBuffer()));
    heard(Math.min(at + PIECE_BYTES, file.size));
  }
  return hasher.digest();
}
