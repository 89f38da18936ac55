// Types of third-party libraries that add themselves to `globalThis` when they are imported.

declare module "hash-wasm/sha256";

interface Sha256 {
  init(): Sha256;
  update(data: Uint8Array): Sha256;
  digest(): string;
}

declare var hashwasm: { createSHA256(): Promise<Sha256> };
declare var tus: typeof import("tus-js-client");
