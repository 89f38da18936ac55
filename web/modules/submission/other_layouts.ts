// Layouts that predictions are often written in and that are no submission's, as stone_submissions/other_layouts.py.

import type { Problem } from "./frames.js";

const NUMBER = /^[^0-9]{0,40}[0-9]{1,19}$/u;
const UNPRINTABLE = /[\p{C}\p{Z}]/u;
const RUBBISH = [".DS_Store", "._", "Thumbs.db", "desktop.ini"];
const NUMBERED = "files numbered instead of named by token";
export const OF_TOOLS = "files that macOS's Finder or Windows adds to a zip (`zip -r -X` does not)";

/** Kinds of files, and the token of the frame that a name stands for, "" for none. */
const LAYOUTS: [string, (name: string) => string][] = [
  ["files in the label layout gts/<scene>/<token>/labels.npz", (name) => (name.endsWith(".npz") && !name.includes("\\") ? parentOf(name) : "")],
  ["names with backslashes, as written by some Windows programs", (name) => (name.includes("\\") && name.endsWith(".npz") ? stemOf(name) : "")],
  ["each frame in its own folder", (name) => (name.includes("/") && name.endsWith(".npz") ? stemOf(name) : "")],
  ["arrays as .npy instead of .npz", (name) => (name.endsWith(".npy") ? stemOf(name) : "")],
  ["tokens in upper case or with dashes", (name) => (name.toLowerCase().endsWith(".npz") ? stemOf(name).toLowerCase().replaceAll("-", "") : "")],
];

/** Whether a file manager added this file to a zip automatically. */
export function isRubbish(name: string): boolean {
  const base = name.split("/").at(-1) ?? "";
  return name.startsWith("__MACOSX/") || RUBBISH.some((one) => base.startsWith(one));
}

/**
 * The problems, with a single one for all files in another layout, and one for all files of a file manager.
 *
 * `found` is the number of valid frames, `names` are the names that problems quote unchanged.
 */
export function explained(problems: Problem[], found: number, names: ReadonlySet<string>): Problem[] {
  const strangers = problems.filter(({ code }) => code === "unexpected_file").map(({ file }) => file);
  const missing = new Set(problems.flatMap(({ code, frame }) => (code === "missing_frame" && frame ? [frame] : [])));
  const rubbish = new Set(strangers.filter(isRubbish));
  const [what, tokens] = layoutOf(strangers.filter((name) => !rubbish.has(name) && names.has(name)), missing);
  const there = new Set(tokens.values());
  const merged: Problem[] = [];
  const [first = ""] = tokens.keys();
  const right = found ? ` (${found.toLocaleString("en")} ${found === 1 ? "frame" : "frames"} named right)` : "";
  if (tokens.size) merged.push({ code: "other_layout", file: first, frame: null, expected: "<frame_token>.npz", actual: `${tokens.size} ${what}${right}` });
  const [aside = ""] = rubbish;
  if (rubbish.size > 1) merged.push({ code: "unexpected_file", file: aside, frame: null, expected: "only the frames of the manifest", actual: `${rubbish.size} files: ${OF_TOOLS}` });
  const isTold = ({ code, file, frame }: Problem): boolean =>
    (code === "unexpected_file" && (tokens.has(file) || (rubbish.size > 1 && rubbish.has(file)))) || (code === "missing_frame" && there.has(frame ?? ""));
  return [...merged, ...problems.filter((one) => !isTold(one))];
}

function layoutOf(strangers: string[], missing: ReadonlySet<string>): [string, Map<string, string>] {
  const names = strangers.filter((name) => !UNPRINTABLE.test(name.replaceAll(" ", "")) && !name.split("/").some((part) => ["", ".", ".."].includes(part)));
  for (const [what, tokenOf] of LAYOUTS) {
    const tokens = new Map(names.map((name): [string, string] => [name, tokenOf(name)]).filter(([, token]) => missing.has(token)));
    if (tokens.size) return [what, tokens];
  }
  const arrays = names.filter((name) => name.endsWith(".npz"));
  const numbered = arrays.filter((name) => NUMBER.test(stemOf(name))).sort();
  if (numbered.length !== missing.size || arrays.length !== missing.size) return ["", new Map()];
  const tokens = [...missing].sort();
  return [NUMBERED, new Map(numbered.map((name, at): [string, string] => [name, tokens[at] ?? ""]))];
}

function stemOf(name: string): string {
  const base = name.replaceAll("\\", "/").split("/").at(-1) ?? "";
  return base.includes(".") ? base.slice(0, base.lastIndexOf(".")) : "";
}

function parentOf(name: string): string {
  return name.replaceAll("\\", "/").split("/").at(-2) ?? "";
}
