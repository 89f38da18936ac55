// Names in a zip: in UTF-8 if declared, else in code page 437; and the extra fields that may rename.

import { Fault } from "./archive.js";

const UPPER =
  "ÇüéâäàåçêëèïîìÄÅÉæÆôöòûùÿÖÜ¢£¥₧ƒáíóúñÑªº¿⌐¬½¼¡«»░▒▓│┤╡╢╖╕╣║╗╝╜╛┐└┴┬├─┼╞╟╚╔╩╦╠═╬╧╨╤╥╙╘╒╓╫╪┘┌█▄▌▐▀αßΓπΣσµτΦΘΩδ∞φε∩≡±≥≤⌠⌡÷≈°∙·√ⁿ²■\u00a0";
const IN_UTF8 = 1 << 11;
const [ZIP64, UNICODE_PATH] = [0x0001, 0x7075];
const BEFORE_THE_PATH = 5;

/** Throws `Fault`. */
export function decoded(name: Uint8Array, flags: number): string {
  if (!(flags & IN_UTF8)) return Array.from(name, (byte) => (byte < 128 ? String.fromCharCode(byte) : UPPER[byte - 128])).join("");
  try {
    return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(name);
  } catch {
    throw new Fault("unsupported_zip", "a name in UTF-8, as the header declares", "other bytes");
  }
}

/** The zip64 field's bytes, or empty; refuses a second name that differs. Throws `Fault`. */
export function zip64Field(extra: DataView, name: string): DataView {
  const fields = new Map<number, DataView>();
  for (let at = 0; at + 4 <= extra.byteLength; ) {
    const [tag, count] = [extra.getUint16(at, true), extra.getUint16(at + 2, true)];
    if (at + 4 + count > extra.byteLength) throw new Fault("truncated", `an extra field of ${count} bytes for ${name}`, "fewer");
    if (fields.has(tag) && (tag === ZIP64 || tag === UNICODE_PATH)) {
      throw new Fault("unsupported_zip", `each extra field of ${name} only once`, "a repeated field");
    }
    fields.set(tag, new DataView(extra.buffer, extra.byteOffset + at + 4, count));
    at += 4 + count;
  }
  refuseOtherName(fields.get(UNICODE_PATH), name);
  return fields.get(ZIP64) ?? new DataView(new ArrayBuffer(0));
}

/** Only the file's name counts: Info-ZIP writes folders as code page 437 cannot. */
function refuseOtherName(path: DataView | undefined, name: string): void {
  if (!path) return;
  const told = new Uint8Array(path.buffer, path.byteOffset, path.byteLength).subarray(BEFORE_THE_PATH);
  const file = told.subarray(told.lastIndexOf(0x2f) + 1);
  const own = new TextEncoder().encode(name.slice(name.lastIndexOf("/") + 1));
  if (file.length !== own.length || file.some((byte, index) => byte !== own[index])) {
    throw new Fault("unsupported_zip", `one name for ${name}`, "another name in an extra field");
  }
}
