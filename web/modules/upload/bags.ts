// Groups the chosen files into bags: a rosbag2 folder, the parts of a split bag (also ROS 1), or a single file.
//
// The rules are the platform's own (`stone_files/bag_fingerprint.py`), applied before anything is sent. Several bags in
// one folder without a metadata.yaml stay separate, unless they are numbered consecutively: run_0.mcap, run_1.mcap.

import { refusalOf } from "./magic.js";

/** A file and its path: `run/run_0.mcap` in a dropped folder, `run.mcap` for a single file. */
export interface Found {
  file: File;
  path: string;
}

/** The files of one recording. `trouble` is the reason why they are no bag, `code` the kind of fault; both are empty
 * for a valid bag. */
export interface Bag {
  name: string;
  files: File[];
  trouble: string;
  code: string;
}

/** The chosen files: bags by name, and the files outside bags, with the reason. */
export interface Sorted {
  bags: Bag[];
  left: { name: string; why: string }[];
}

const METADATA = "metadata.yaml";
const MOST_FILES = 512;
const LONGEST_NAME_BYTES = 255;
const BAG_FILE = /^.+\.(mcap|db3|bag)(\.active|\.zstd)?$/i;
const JOURNAL = /^(.+\.db3)-(wal|journal)$/i;
const DEFINITION = /^[a-z][a-z0-9_]{0,99}\.[A-Z][A-Za-z0-9]{0,99}\.msg$/;
const NUMBERED = /^(.+)_\d+\.(mcap|db3|bag)(\.active|\.zstd)?$/i;
const UNSEEN = /[\p{Cc}\p{Cf}\p{Cs}\p{Co}\p{Cn}\p{Zl}\p{Zp}/\\]/u;

/** Whether a file so called belongs to a bag. */
export function isBagPart(name: string): boolean {
  return name === METADATA || [BAG_FILE, JOURNAL, DEFINITION].some((form) => form.test(name));
}

/** The reason why files with these names are not one bag; empty if they are. */
export function troubleOf(names: readonly string[]): string {
  const unnameable = names.find((name) => UNSEEN.test(name) || new TextEncoder().encode(name).length > LONGEST_NAME_BYTES);
  if (unnameable) return `The name ${JSON.stringify(unnameable.slice(0, 100))} has non-printable characters, or is too long.`;
  return names.length > 1 ? severalTrouble(names) : "";
}

function severalTrouble(names: readonly string[]): string {
  if (names.length > MOST_FILES) return `These are ${names.length} files; a bag has at most ${MOST_FILES}.`;
  const folded = new Set(names.map((name) => name.toLowerCase()));
  if (folded.size < names.length) return `${names.length} files have only ${folded.size} different names if upper and lower case are equal.`;
  const storages = new Set(names.flatMap((name) => BAG_FILE.exec(name)?.[1]?.toLowerCase() ?? []));
  if (!storages.size) return "None of the files is a .mcap, .db3 or .bag file.";
  if (storages.size > 1) return `The files are of several kinds (${[...storages].sort().join(", ")}); a bag has one kind.`;
  const orphan = names.find((name) => folded.size && JOURNAL.test(name) && !folded.has(JOURNAL.exec(name)?.[1]?.toLowerCase() ?? ""));
  return orphan ? `${orphan} has no ${JOURNAL.exec(orphan)?.[1]} beside it.` : "";
}

/** The bags among files. */
export function sorted(found: readonly Found[]): Sorted {
  const parts = found.filter(({ file }) => isBagPart(file.name) && !(JOURNAL.test(file.name) && !file.size));
  const left = found
    .filter(({ file }) => !isBagPart(file.name))
    .map(({ file, path }) => ({ name: path, why: whyLeft(file.name) }));
  const folders = new Map<string, File[]>();
  for (const { file, path } of parts) {
    const folder = path.slice(0, Math.max(0, path.lastIndexOf("/")));
    folders.set(folder, [...(folders.get(folder) ?? []), file]);
  }
  const bags = [...folders].flatMap(([folder, files]) => bagsOf(folder, files));
  const alone = bags.filter((bag) => !bag.files.some((file) => BAG_FILE.test(file.name)));
  for (const bag of alone) left.push({ name: bag.name, why: "There is no .mcap, .db3 or .bag file beside it." });
  return { bags: bags.filter((bag) => !alone.includes(bag)).sort((a, b) => a.name.localeCompare(b.name)), left };
}

function bagsOf(folder: string, files: File[]): Bag[] {
  const called = folder.slice(folder.lastIndexOf("/") + 1);
  const stems = new Set(files.filter(({ name }) => BAG_FILE.test(name)).map(({ name }) => NUMBERED.exec(name)?.[1] ?? name));
  const isOne = files.some(({ name }) => name === METADATA) || stems.size <= 1;
  if (isOne) return [bagOf(called || [...stems][0] || METADATA, files)];
  const bases = files.filter(({ name }) => BAG_FILE.test(name));
  return bases.map((base) => bagOf(base.name, [base, ...files.filter((file) => belongs(file.name, base.name))]));
}

function belongs(name: string, base: string): boolean {
  return DEFINITION.test(name) || JOURNAL.exec(name)?.[1]?.toLowerCase() === base.toLowerCase();
}

function bagOf(name: string, files: File[]): Bag {
  const ordered = [...files].sort((a, b) => (a.name < b.name ? -1 : 1));
  const [only] = ordered;
  const isSeveral = ordered.length > 1;
  const trouble = troubleOf(ordered.map((file) => file.name));
  return { name: isSeveral || !only ? name : only.name, files: ordered, trouble, code: trouble && "bad_recording_files" };
}

/** The bag after a check of its files' first bytes: other kinds of files are refused before they are sent. */
export async function lookedInto(bag: Bag): Promise<Bag> {
  for (const file of bag.trouble ? [] : bag.files.filter(({ name }) => BAG_FILE.test(name))) {
    const hasWal = bag.files.some(({ name, size }) => name === `${file.name}-wal` && size > 0);
    const trouble = await refusalOf(file, hasWal).catch(() => ""); // unreadable files report it when they are sent
    if (trouble) return { ...bag, trouble, code: "BAG-001" };
  }
  return bag;
}

function whyLeft(name: string): string {
  if (/\.(ya?ml|json|zip)$/i.test(name)) return "Not part of a bag, and not a calibration: a calibration has 1 byte to 1 MiB.";
  return "Not part of a bag.";
}

/** The default name of a sequence of this bag: a plain name. */
export function plainName(bag: Bag): string {
  const stem = bag.files.length > 1 ? bag.name : bag.name.replace(/(\.(mcap|db3|bag|active|zstd))+$/i, "");
  return stem.replaceAll(/[^A-Za-z0-9._-]+/g, "-").replace(/^[^A-Za-z0-9]+/, "").slice(0, 100) || "sequence";
}

export function sizeOf(bag: Bag): number {
  return bag.files.reduce((sum, file) => sum + file.size, 0);
}
