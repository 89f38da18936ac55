// The table of contents of a zip, read from its end: every length is checked before anything is read.
//
// The rules of stone_files/zip_directory.py, as far as the directory allows; the platform checks the local headers and
// the data. Source: PKWARE APPNOTE 6.3.10, §4.3.12.

import { Bytes, Fault, wide } from "./archive.js";
import { type End, readEnd } from "./zip_end.js";
import { decoded, zip64Field } from "./zip_names.js";

const RECORD = 0x02014b50;
const RECORD_BYTES = 46;
const LOCAL_BYTES = 30;
const MOST_NAME_BYTES = 512;
const ENCRYPTED = (1 << 0) | (1 << 6) | (1 << 13);
const [STORED, DEFLATED] = [0, 8];
const BY_UNIX = [3, 19];
const [LINK, KIND] = [0o120000, 0o170000];

/** One file of an archive, as declared in the directory. */
export interface Member {
  name: string;
  method: number;
  packed_bytes: number;
  unpacked_bytes: number;
  offset: number;
}

/** The members in the order of the directory, at most `most`. Throws `Fault`. */
export async function readDirectory(file: Blob, most: number): Promise<Member[]> {
  const bytes = new Bytes(file);
  const end = await readEnd(bytes);
  const limit_bytes = most * (RECORD_BYTES + MOST_NAME_BYTES);
  if (end.entries > most) throw new Fault("too_large", `at most ${most} files in the archive`, `${end.entries} files`);
  if (end.directory_bytes > limit_bytes) {
    throw new Fault("too_large", `a directory of at most ${limit_bytes} bytes`, `${end.directory_bytes} bytes`);
  }
  if (end.entries * RECORD_BYTES > end.directory_bytes || end.directory_offset + end.directory_bytes > file.size) {
    throw new Fault("truncated", `${end.entries} directory records inside the file`, `${end.directory_bytes} bytes of directory records`);
  }
  const members = await parsed(bytes, end);
  refuseOverlap(members, end.directory_offset);
  return members;
}

async function parsed(bytes: Bytes, end: End): Promise<Member[]> {
  const members: Member[] = [];
  const stop = end.directory_offset + end.directory_bytes;
  let at = end.directory_offset;
  for (let number = 0; number < end.entries; number++) {
    const record = await bytes.at(at, Math.min(RECORD_BYTES, stop - at));
    if (record.byteLength < RECORD_BYTES || record.getUint32(0, true) !== RECORD) {
      throw new Fault("truncated", `${end.entries} directory records`, `${number}`);
    }
    const variable_bytes = [28, 30, 32].reduce((sum, field) => sum + record.getUint16(field, true), 0);
    if (at + RECORD_BYTES + variable_bytes > stop) {
      throw new Fault("truncated", `${end.entries} directory records`, `${number} whole ones`);
    }
    members.push(memberOf(record, await bytes.at(at + RECORD_BYTES, variable_bytes)));
    at += RECORD_BYTES + variable_bytes;
  }
  if (at !== stop) throw new Fault("unsupported_zip", "only directory records", `${stop - at} bytes more`);
  return members;
}

function memberOf(record: DataView, variable: DataView): Member {
  const [made_by, flags, method] = [record.getUint8(5), record.getUint16(8, true), record.getUint16(10, true)];
  const [name_bytes, extra_bytes] = [record.getUint16(28, true), record.getUint16(30, true)];
  if (name_bytes > MOST_NAME_BYTES) {
    throw new Fault("too_large", `names of at most ${MOST_NAME_BYTES} bytes`, `${name_bytes} bytes`);
  }
  const name = decoded(new Uint8Array(variable.buffer, variable.byteOffset, name_bytes), flags);
  if (flags & ENCRYPTED) throw new Fault("encrypted", "plain files", `an encrypted ${name}`);
  if (![STORED, DEFLATED].includes(method) || ![0, 0xffff].includes(record.getUint16(34, true))) {
    throw new Fault("unsupported_zip", "method 0 (store) or 8 (deflate)", `method ${method} for ${name}`);
  }
  if (BY_UNIX.includes(made_by) && (record.getUint16(40, true) & KIND) === LINK) {
    throw new Fault("symlink", "files", `a symbolic link ${name}`);
  }
  const field = zip64Field(new DataView(variable.buffer, variable.byteOffset + name_bytes, extra_bytes), name);
  const narrow = [record.getUint32(24, true), record.getUint32(20, true), record.getUint32(42, true)];
  const [unpacked_bytes = 0, packed_bytes = 0, offset = 0] = widened(narrow, field, name);
  if (method === STORED && packed_bytes !== unpacked_bytes) {
    throw new Fault("unsupported_zip", `${unpacked_bytes} stored bytes for ${name}`, `${packed_bytes}`);
  }
  return { name, method, packed_bytes, unpacked_bytes, offset };
}

/** The values; those equal to 0xFFFFFFFF are replaced, in this order, by the field's. */
function widened(values: number[], field: DataView, name: string): number[] {
  const needed = values.filter((value) => value === 0xffffffff).length;
  if (field.byteLength < 8 * needed) throw new Fault("truncated", `${needed} zip64 values for ${name}`, "fewer");
  let at = -8;
  return values.map((value) => (value === 0xffffffff ? wide(field, (at += 8)) : value));
}

/** Refuses archives whose members share bytes, or whose first member does not start the file. */
function refuseOverlap(members: readonly Member[], directory_offset: number): void {
  let limit = directory_offset;
  for (const member of [...members].sort((one, other) => other.offset - one.offset)) {
    const stop = member.offset + LOCAL_BYTES + member.packed_bytes;
    if (stop > limit) throw new Fault("overlapping_files", `${member.name} to end before byte ${limit}`, `an end after byte ${stop}`);
    limit = member.offset;
  }
  if (limit) throw new Fault("unsupported_zip", "the first file at byte 0", `${limit} bytes before it`);
}
