// Checks the arrays of all frames before any is sent: name, type, shape and order by their headers, then the values.
//
// The platform reads every frame again and uses the same codes (stone_submissions/npz_frame.py). Only literals are
// parsed, and no stream is read beyond its bound.

import { Bytes, Fault, plain } from "./archive.js";
import type { Problem, Shape } from "./frames.js";
import { type Member, readDirectory } from "./zip.js";
import { beginsAsZip } from "./zip_end.js";

const LOCAL = 0x04034b50;
const LOCAL_BYTES = 30;
const HEAD_BYTES = 12 + 4096;
const MOST_ARRAYS = 64;
const KEYS = ["semantics", "arr_0"];
const HIGHEST_LABEL = 3;
/** Bytes of voxels that are read, a few seconds' work; beyond, only the values of every n-th frame are read. */
const MOST_VALUES_BYTES = 2 ** 31;
const BYTE_TYPES = ["|u1", "u1", "<u1", ">u1"];
/** The steps to the expected shape, by the actual one: as stone_submissions/errors.py. */
function stepsTo([x, y, z]: Shape): Record<string, string> {
  return {
    [`(${z}, ${x}, ${y})`]: "grid.transpose(1, 2, 0) if your axes are z, x, y; grid.transpose(2, 1, 0) if they are z, y, x",
    [`(${x}, ${z}, ${y})`]: "grid.transpose(0, 2, 1) if your axes are x, z, y; grid.transpose(2, 0, 1) if they are y, z, x",
    [`(1, ${x}, ${y}, ${z})`]: "grid[0]: a frame has no batch axis",
    [`(${x}, ${y}, ${z}, 1)`]: "grid[..., 0]: a frame has no channel axis",
    [`(4, ${x}, ${y}, ${z})`]: "grid.argmax(0): a frame contains one class per voxel, not a score per class",
    [`(${x}, ${y}, ${z}, 4)`]: "grid.argmax(-1): a frame contains one class per voxel, not a score per class",
    "Fortran order": "numpy.ascontiguousarray(grid)",
  };
}

/** The code that turns a frame of the actual shape or order into the expected shape. */
export function shapeHint(expected: Shape, found: string): string {
  const step = stepsTo(expected)[found];
  return step ? `Expected axis order x, y, z: ${step}` : `Expected axis order x, y, z, with ${expected.join(" × ")} voxels, in C order`;
}

/** The faults of the arrays, the number of frames whose values were read, and the number that cannot be read here. */
export interface ArrayCheck {
  problems: Problem[];
  valued: number;
  unread: number;
}

/** Checks the arrays of all frames; `heard` receives the progress, and ends the check by returning false. */
export async function checkArrays(archive: Blob, frames: ReadonlyMap<string, Member>, shape: Shape, heard: (done: number) => boolean): Promise<ArrayCheck> {
  const voxels = voxelsOf(shape);
  const every = Math.max(1, Math.ceil((frames.size * voxels) / MOST_VALUES_BYTES));
  const check: ArrayCheck = { problems: [], valued: 0, unread: 0 };
  let done = 0;
  for (const [token, member] of frames) {
    const readsValues = done % every === 0;
    const found = await faultIn(archive, member, shape, readsValues);
    if (found instanceof Fault) check.problems.push({ code: found.code, file: plain(member.name), frame: token, expected: plain(found.expected), actual: plain(found.actual) });
    else if (found === "unread") check.unread++;
    else if (readsValues) check.valued++;
    if (!heard(++done)) break;
  }
  return check;
}

/** The fault of this frame; null if there is none, "unread" if only the platform can read it. */
async function faultIn(archive: Blob, member: Member, shape: Shape, readsValues: boolean): Promise<Fault | null | "unread"> {
  try {
    const npz = new Blob(await unpacked(archive, member, member.unpacked_bytes));
    await refuseArray(npz, await arrayOf(npz), shape, readsValues);
    return null;
  } catch (error) {
    if (error instanceof Fault) return error.code === "unsaid" ? "unread" : error;
    if (error instanceof TypeError) return "unread"; // the browser cannot inflate, or the stream is broken
    throw error;
  }
}

function voxelsOf(shape: Shape): number {
  return shape.reduce((product, size) => product * size);
}

async function arrayOf(npz: Blob): Promise<Member> {
  const members = await readDirectory(npz, MOST_ARRAYS).catch(async (error: unknown) => {
    if (!(error instanceof Fault) || error.code !== "not_zip") throw error;
    const isCut = !npz.size || (await beginsAsZip(new Bytes(npz)));
    throw new Fault(isCut ? "truncated" : "not_npz", "an npz file (a zip of .npy arrays)", npz.size ? error.actual : "an empty file");
  });
  const listed = plain(members.map(({ name }) => name.replace(/\.npy$/, "")).join(", ")) || "no array";
  const known = KEYS.map((key) => members.find(({ name }) => name === `${key}.npy` || name === key)).find(Boolean);
  if (!known) throw new Fault("missing_array", KEYS.join(" or "), listed);
  if (members.length > 1) throw new Fault("extra_array", "one array", listed);
  return known;
}

async function refuseArray(npz: Blob, array: Member, size: Shape, readsValues: boolean): Promise<void> {
  const expected = size.join(", ");
  const pieces = await unpacked(npz, array, HEAD_BYTES + (readsValues ? voxelsOf(size) : 0));
  const head = new Uint8Array(await new Blob(pieces).slice(0, HEAD_BYTES).arrayBuffer());
  const view = new DataView(head.buffer);
  const isNpy = head.length >= 12 && String.fromCharCode(...head.subarray(0, 6)) === "\x93NUMPY" && [1, 2, 3].includes(head[6] ?? 0);
  if (!isNpy) throw new Fault("not_npz", "an npy array of version 1 to 3", "other bytes");
  const [at, length] = head[6] === 1 ? [10, view.getUint16(8, true)] : [12, view.getUint32(8, true)];
  if (at + length > head.length) throw new Fault("unsaid", "", "");
  const text = String.fromCharCode(...head.subarray(at, at + length));
  const descr = /'descr'\s*:\s*'([^'\\]{1,40})'/.exec(text)?.[1];
  const shape = /'shape'\s*:\s*\(([\d, ]*)\)/.exec(text)?.[1];
  const order = /'fortran_order'\s*:\s*(True|False)/.exec(text)?.[1];
  if (!descr || shape === undefined || !order) throw new Fault("unsaid", "", "");
  if (!BYTE_TYPES.includes(descr)) throw new Fault("bad_dtype", "uint8 ('|u1')", `'${descr}'`);
  if (shape !== expected) throw new Fault("bad_shape", `(${expected})`, `(${shape})`);
  if (order === "True") throw new Fault("bad_shape", `(${expected}) in C order`, "Fortran order");
  if (readsValues) refuseValues(pieces, at + length, voxelsOf(size));
}

/** Checks the voxels from byte `start` on: their number is the grid's, and none exceeds the highest class. */
function refuseValues(pieces: readonly Uint8Array[], start: number, voxels: number): void {
  let at = 0;
  let highest = 0;
  for (const piece of pieces) {
    for (let index = Math.max(0, start - at); index < piece.length; index++) if (piece[index]! > highest) highest = piece[index]!;
    at += piece.length;
  }
  if (at < start + voxels) throw new Fault("truncated", `${voxels} bytes of voxels`, `${Math.max(0, at - start)}`);
  if (at > start + voxels) throw new Fault("unsaid", "", "");
  if (highest > HIGHEST_LABEL) throw new Fault("label_out_of_range", "labels 0 to 3", `${highest}`);
}

/** The first `most` bytes of a member, inflated if it is packed. */
async function unpacked(archive: Blob, member: Member, most: number): Promise<Uint8Array<ArrayBuffer>[]> {
  const head = new DataView(await archive.slice(member.offset, member.offset + LOCAL_BYTES).arrayBuffer());
  if (head.byteLength < LOCAL_BYTES || head.getUint32(0, true) !== LOCAL) throw new Fault("unsaid", "", "");
  const start = member.offset + LOCAL_BYTES + head.getUint16(26, true) + head.getUint16(28, true);
  const packed = archive.slice(start, start + member.packed_bytes);
  return member.method === 0 ? [new Uint8Array(await packed.slice(0, most).arrayBuffer())] : inflated(packed, most);
}

async function inflated(packed: Blob, most: number): Promise<Uint8Array<ArrayBuffer>[]> {
  const reader = packed.stream().pipeThrough(new DecompressionStream("deflate-raw")).getReader();
  const pieces: Uint8Array<ArrayBuffer>[] = [];
  for (let had = 0; had < most; ) {
    const { done, value } = await reader.read();
    if (done) break;
    pieces.push(value.length > most - had ? value.slice(0, most - had) : value);
    had += value.length;
  }
  await reader.cancel();
  return pieces;
}
