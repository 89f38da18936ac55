// The files of an archive held against the frames of a manifest, as stone_submissions/archive.py does it.

import { Fault, plain } from "./archive.js";
import { explained, isRubbish, OF_TOOLS } from "./other_layouts.js";
import { type Member, readDirectory } from "./zip.js";

/** The grid of manifests that name none: the paper's. */
const PAPER_SHAPE: Shape = [256, 256, 32];
const SPARE_FRAME_BYTES = 2 ** 20;
const SPARE_ENTRIES = 1000;
const MOST_FRAMES = 200_000;
const TOKEN = /^[0-9a-f]{32}$/;

/** How many voxels a frame has along x, y and z. */
export type Shape = readonly [number, number, number];

/** The frames of a submission by sequence, in the manifest's order, and the shape of their grid. */
export interface Manifest {
  shape: Shape;
  sequences: Map<string, string[]>;
  tokens: Set<string>;
}

/** One problem: its file and its frame. */
export interface Problem {
  code: string;
  file: string;
  frame: string | null;
  expected: string;
  actual: string;
}

/** The frames and the problems; a broken archive has one problem and no frames. */
export interface Verdict {
  frames: Map<string, Member>;
  problems: Problem[];
  folder: string;
}

/** The manifest as the API serves it. Throws if it is none. */
export function manifestOf(said: unknown): Manifest {
  const { sequences: listed, grid } = said as { sequences?: Record<string, unknown>; grid?: { shape: Shape } | null };
  const sequences = new Map(Object.entries(listed ?? {}).map(([name, tokens]) => [name, (tokens as string[]).map(String)]));
  const all = [...sequences.values()].flat();
  if (!all.length || all.length > MOST_FRAMES || !all.every((token) => TOKEN.test(token))) throw new Error("The manifest cannot be read.");
  return { shape: grid?.shape ?? PAPER_SHAPE, sequences, tokens: new Set(all) };
}

/** Reads the directory only, whatever the size of the file. */
export async function examined(file: File, manifest: Manifest): Promise<Verdict> {
  try {
    return matched(await readDirectory(file, manifest.tokens.size + SPARE_ENTRIES), manifest);
  } catch (error) {
    if (!(error instanceof Fault)) throw error;
    return { frames: new Map(), problems: [{ ...said(error), file: plain(file.name), frame: null }], folder: "" };
  }
}

function matched(members: readonly Member[], { tokens, shape }: Manifest): Verdict {
  const most_bytes = shape.reduce((product, size) => product * size) + SPARE_FRAME_BYTES;
  const folder = commonFolder(members, tokens);
  const frames = new Map<string, Member>();
  const problems: Problem[] = [];
  for (const member of members) {
    if (folder.startsWith(member.name) && isFolder(member)) continue;
    const token = tokenOf(member.name, folder);
    const isOurs = tokens.has(token) && member.name === `${folder}${token}.npz`;
    const fault = isOurs ? faultOf(member, most_bytes, frames.has(token)) : new Fault("unexpected_file", "only the frames of the manifest", stranger(member.name));
    if (fault) problems.push({ ...said(fault), file: plain(member.name), frame: isOurs ? token : null });
    if (isOurs && !frames.has(token)) frames.set(token, member);
  }
  for (const token of [...tokens].filter((one) => !frames.has(one)).sort()) {
    const file = plain(`${folder}${token}.npz`);
    problems.push({ code: "missing_frame", file, frame: token, expected: file, actual: "no such file" });
  }
  const told = explained(problems, frames.size, new Set(members.map(({ name }) => name)));
  for (const { frame } of told) if (frame) frames.delete(frame);
  return { frames, problems: told, folder };
}

function tokenOf(name: string, folder: string): string {
  const file = name.startsWith(folder) ? name.slice(folder.length) : name;
  return file.endsWith(".npz") ? file.slice(0, -".npz".length) : file;
}

function faultOf(member: Member, most_bytes: number, isSecond: boolean): Fault | null {
  if (isSecond) return new Fault("duplicate_frame", "each frame once", "a second file with the same name");
  const size_bytes = Math.max(member.packed_bytes, member.unpacked_bytes);
  if (size_bytes > most_bytes) return new Fault("too_large", `at most ${most_bytes} bytes per frame`, `${size_bytes} bytes`);
  return null;
}

function stranger(name: string): string {
  return isRubbish(name) ? OF_TOOLS : "another file";
}

function said({ code, expected, actual }: Fault): { code: string; expected: string; actual: string } {
  return { code, expected: plain(expected), actual: plain(actual) };
}

/** The folder that most of the manifest's frames are in; the first of several. */
function commonFolder(members: readonly Member[], tokens: ReadonlySet<string>): string {
  const counts = new Map<string, number>();
  for (const { name } of members) {
    const cut = name.lastIndexOf("/") + 1;
    const file = name.slice(cut);
    const token = file.endsWith(".npz") ? file.slice(0, -".npz".length) : file;
    if (tokens.has(token)) counts.set(name.slice(0, cut), (counts.get(name.slice(0, cut)) ?? 0) + 1);
  }
  const [likely = ""] = [...counts].reduce<[string, number]>((best, one) => (one[1] > best[1] ? one : best), ["", 0]);
  const parts = likely.split("/").slice(0, -1);
  const isPlain = !/[\p{C}\p{Z}]/u.test(likely.replaceAll(" ", "")) && !parts.includes("") && !parts.includes("..");
  return isPlain ? likely : "";
}

function isFolder(member: Member): boolean {
  return member.name.endsWith("/") && member.unpacked_bytes === 0 && member.packed_bytes <= 2;
}
