// The end record of a zip, narrow or wide (zip64): the position of its directory and the declared number of files.
//
// Source: PKWARE APPNOTE 6.3.10, §4.3.14-4.3.16. The same checks as stone_files/zip_directory.py.

import { type Bytes, Fault, wide } from "./archive.js";

const END_BYTES = 22;
const LOCATOR_BYTES = 20;
const WIDE_BYTES = 56;
const MOST_COMMENT_BYTES = 0xffff;
const [END, LOCATOR, WIDE, FIRST_FILE] = [0x06054b50, 0x07064b50, 0x06064b50, 0x04034b50];
const SATURATED = 0xffffffff;

/** The directory as the archive's end announces it. */
export interface End {
  entries: number;
  directory_bytes: number;
  directory_offset: number;
}

/** Reads at most 66 kB. Throws `Fault`. */
export async function readEnd(bytes: Bytes): Promise<End> {
  const tail_bytes = Math.min(bytes.size, END_BYTES + MOST_COMMENT_BYTES);
  const tail = await bytes.at(bytes.size - tail_bytes, tail_bytes);
  const at = lastEnd(tail);
  if (at < 0 || tail.byteLength - at < END_BYTES) {
    if (await beginsAsZip(bytes)) throw cutShort(bytes.size);
    throw new Fault("not_zip", "a zip that ends with its directory", bytes.size ? "none" : "an empty file");
  }
  const comment_bytes = tail.getUint16(at + 20, true);
  const position = bytes.size - tail_bytes + at;
  const [here, entries] = [tail.getUint16(at + 8, true), tail.getUint16(at + 10, true)];
  const narrow: End = {
    entries,
    directory_bytes: tail.getUint32(at + 12, true),
    directory_offset: tail.getUint32(at + 16, true),
  };
  const more = tail.byteLength - at - END_BYTES - comment_bytes;
  if (more) {
    if (!mayEndAt(narrow, position) && (await beginsAsZip(bytes))) throw cutShort(bytes.size);
    throw new Fault("not_zip", "the end record last in the file", `${more} bytes more`);
  }
  const isOne = !tail.getUint16(at + 4, true) && !tail.getUint16(at + 6, true) && here === entries;
  const locator_at = position - LOCATOR_BYTES;
  const locator = locator_at >= 0 ? await bytes.at(locator_at, LOCATOR_BYTES) : null;
  if (locator?.byteLength === LOCATOR_BYTES && locator.getUint32(0, true) === LOCATOR) {
    return same(narrow, await readWide(bytes, locator, locator_at));
  }
  return checked(narrow, isOne, position);
}

function lastEnd(tail: DataView): number {
  for (let at = tail.byteLength - 4; at >= 0; at--) if (tail.getUint32(at, true) === END) return at;
  return -1;
}

export async function beginsAsZip(bytes: Bytes): Promise<boolean> {
  const first = await bytes.at(0, 4);
  return first.byteLength === 4 && first.getUint32(0, true) === FIRST_FILE;
}

/** Whether a record at byte `position` can be of this archive; records of nested archives have other offsets. */
function mayEndAt({ directory_bytes, directory_offset }: End, position: number): boolean {
  if (directory_bytes === SATURATED || directory_offset === SATURATED) return true;
  return [0, WIDE_BYTES + LOCATOR_BYTES].includes(position - directory_offset - directory_bytes);
}

function cutShort(size_bytes: number): Fault {
  return new Fault("truncated", "the zip's directory at its end", `none: the file is cut off after ${size_bytes} bytes`);
}

async function readWide(bytes: Bytes, locator: DataView, at: number): Promise<End> {
  const [disk, position, disks] = [locator.getUint32(4, true), wide(locator, 8), locator.getUint32(16, true)];
  if (position + WIDE_BYTES > at) {
    throw new Fault("truncated", `a zip64 end record before byte ${at}`, `a record at byte ${position}`);
  }
  const record = await bytes.at(position, WIDE_BYTES);
  if (record.getUint32(0, true) !== WIDE) {
    throw new Fault("truncated", `a zip64 end record at byte ${position}`, "other bytes");
  }
  if (wide(record, 4) !== at - position - 12) {
    throw new Fault("truncated", `a zip64 end record that ends at byte ${at}`, "a record of another length");
  }
  const isOne = !disk && disks <= 1 && !record.getUint32(16, true) && !record.getUint32(20, true);
  const [here, entries] = [wide(record, 24), wide(record, 32)];
  const end = { entries, directory_bytes: wide(record, 40), directory_offset: wide(record, 48) };
  return checked(end, isOne && here === entries, position);
}

/** An end whose directory stops at byte `position`. */
function checked(end: End, isOne: boolean, position: number): End {
  if (!isOne) throw new Fault("unsupported_zip", "an archive in one part", "an archive in several parts");
  const stop = end.directory_offset + end.directory_bytes;
  if (stop !== position) {
    throw new Fault("truncated", `the directory to end at byte ${position}`, `a directory that ends at byte ${stop}`);
  }
  return end;
}

function same(narrow: End, meant: End): End {
  const agrees = (said: number, value: number, elsewhere: number): boolean => said === value || said === elsewhere;
  const isSame =
    agrees(narrow.entries, meant.entries, 0xffff) &&
    agrees(narrow.directory_bytes, meant.directory_bytes, 0xffffffff) &&
    agrees(narrow.directory_offset, meant.directory_offset, 0xffffffff);
  if (!isSame) throw new Fault("unsupported_zip", "equal values in both end records", "different values");
  return meant;
}
