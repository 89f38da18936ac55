// A worker has no import map, and its policy forbids later imports, so its modules name the library's file.

declare module "*/libraries/fzstd/esm/index.mjs" {
  export function decompress(content: Uint8Array): Uint8Array;
}
