// A look into one frame before all are sent: its array's name, type, shape and order, as its header says.
//
// What most often is wrong is wrong in every frame. The platform looks into all of them; the codes are its own
// (stone_submissions/npz_frame.py). Nothing but literals is read, and no stream is followed beyond its bound.

import { Bytes, Fault, plain } from "./archive.js";
import type { Shape } from "./frames.js";
import { type Member, readDirectory } from "./zip.js";
import { beginsAsZip } from "./zip_end.js";

const LOCAL = 0x04034b50;
const LOCAL_BYTES = 30;
const HEAD_BYTES = 12 + 4096;
const MOST_ARRAYS = 64;
const KEYS = ["semantics", "arr_0"];
const BYTE_TYPES = ["|u1", "u1", "<u1", ">u1"];
/** How to make a frame of the expected shape of one that was found, by what was found: as stone_submissions/errors.py. */
function stepsTo([x, y, z]: Shape): Record<string, string> {
  return {
    [`(${z}, ${x}, ${y})`]: "grid.transpose(1, 2, 0) if its axes are z, x, y; grid.transpose(2, 1, 0) if z, y, x",
    [`(${x}, ${z}, ${y})`]: "grid.transpose(0, 2, 1) if its axes are x, z, y; grid.transpose(2, 0, 1) if y, z, x",
    [`(1, ${x}, ${y}, ${z})`]: "grid[0]: a frame has no batch axis",
    [`(${x}, ${y}, ${z}, 1)`]: "grid[..., 0]: a frame has no channel axis",
    [`(4, ${x}, ${y}, ${z})`]: "grid.argmax(0): a frame holds one class per voxel, not a score per class",
    [`(${x}, ${y}, ${z}, 4)`]: "grid.argmax(-1): a frame holds one class per voxel, not a score per class",
    "Fortran order": "numpy.ascontiguousarray(grid)",
  };
}

/** What makes a frame of the shape or order that was found one of the expected shape. */
export function shapeHint(expected: Shape, found: string): string {
  const step = stepsTo(expected)[found];
  return step ? `axes are x, y, z: ${step}` : `axes are x, y, z, with ${expected.join(" × ")} voxels, in C order`;
}

/** What would be refused of this frame of the shape; null where nothing is seen, or nothing can be said. */
export async function faultIn(archive: Blob, member: Member, shape: Shape): Promise<Fault | null> {
  try {
    const npz = await unpacked(archive, member, member.unpacked_bytes);
    await refuseArray(npz, await arrayOf(npz), shape.join(", "));
    return null;
  } catch (error) {
    if (error instanceof Fault) return error.code === "unsaid" ? null : error;
    if (error instanceof TypeError) return null; // the browser cannot inflate, or the stream is broken: the platform says
    throw error;
  }
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

async function refuseArray(npz: Blob, array: Member, expected: string): Promise<void> {
  const head = new Uint8Array(await (await unpacked(npz, array, HEAD_BYTES)).arrayBuffer());
  const view = new DataView(head.buffer);
  const isNpy = head.length >= 12 && String.fromCharCode(...head.subarray(0, 6)) === "\x93NUMPY" && [1, 2, 3].includes(head[6] ?? 0);
  if (!isNpy) throw new Fault("not_npz", "a npy array of version 1 to 3", "other bytes");
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
}

/** The first `most` bytes of a member, inflated where it is packed. */
async function unpacked(archive: Blob, member: Member, most: number): Promise<Blob> {
  const head = new DataView(await archive.slice(member.offset, member.offset + LOCAL_BYTES).arrayBuffer());
  if (head.byteLength < LOCAL_BYTES || head.getUint32(0, true) !== LOCAL) throw new Fault("unsaid", "", "");
  const start = member.offset + LOCAL_BYTES + head.getUint16(26, true) + head.getUint16(28, true);
  const packed = archive.slice(start, start + member.packed_bytes);
  return member.method === 0 ? packed.slice(0, most) : inflated(packed, most);
}

async function inflated(packed: Blob, most: number): Promise<Blob> {
  const reader = packed.stream().pipeThrough(new DecompressionStream("deflate-raw")).getReader();
  const pieces: Uint8Array<ArrayBuffer>[] = [];
  for (let had = 0; had < most; ) {
    const { done, value } = await reader.read();
    if (done) break;
    pieces.push(value.slice(0, most - had));
    had += value.length;
  }
  await reader.cancel();
  return new Blob(pieces);
}
