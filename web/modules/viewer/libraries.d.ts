// A worker's modules know no import map, and its policy lets none be imported later: they name the library's file.

declare module "*/libraries/fzstd/esm/index.mjs" {
  export function decompress(content: Uint8Array): Uint8Array;
}
