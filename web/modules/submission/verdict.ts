// The result of the browser's check of a zip, drawn: a strip of frames for each sequence, and the problems by kind.

import { count, counted } from "../counts.js";
import { type ArrayCheck, shapeHint } from "./frame_arrays.js";
import type { Manifest, Problem, Shape, Verdict } from "./frames.js";

const MOST_STRIPS = 24;
const MOST_CELLS = 160;
const SHOWN = 100;
const SVG = "http://www.w3.org/2000/svg";
const CUT_SHORT = "The zip was cut short or damaged: its directory, which is written last, is missing or incomplete. Zip it again, or copy it again.";
const SAID: Record<string, [string, string]> = {
  missing_frame: ["missing frame", "missing frames"],
  unexpected_file: ["unexpected file", "unexpected files"],
  other_layout: ["unknown layout", "unknown layouts"],
  duplicate_frame: ["frame twice", "frames twice"],
  too_large: ["file too large", "files too large"],
  bad_shape: ["frame of wrong shape", "frames of wrong shape"],
  bad_dtype: ["frame of wrong type", "frames of wrong type"],
  label_out_of_range: ["frame with values beyond 3", "frames with values beyond 3"],
  missing_array: ["frame without its array", "frames without their array"],
  extra_array: ["frame with extra arrays", "frames with extra arrays"],
  not_npz: ["file that is not npz", "files that are not npz"],
};

/** Shows the verdict in `place`; `arrays` once they are checked. */
export function showVerdict(place: HTMLElement, file: File, manifest: Manifest, verdict: Verdict, arrays?: ArrayCheck): void {
  const head = part("div", "verdict-head");
  head.dataset["tone"] = verdict.problems.length ? "bad" : "good";
  head.append(part("p", "verdict-says", sentence(manifest, verdict, arrays)), part("p", "hint wraps", named(file, verdict)));
  place.replaceChildren(head);
  if (!isUnreadable(verdict)) place.append(strips(manifest, verdict));
  place.append(...kinds(verdict.problems).map((kind) => kindPart(kind, manifest.shape)));
}

/** Show how many of the frames have been checked; the function that is returned takes the number. */
export function showProgress(place: HTMLElement, total: number): (done: number) => true {
  const bar = Object.assign(document.createElement("progress"), { max: total, value: 0 });
  bar.setAttribute("aria-label", "Frames checked");
  const words = part("p", "hint", "");
  place.append(bar, words);
  return (done) => {
    bar.value = done;
    words.textContent = `Checking the arrays: ${count(done)} of ${counted(total, "frame")}`;
    return true;
  };
}

export function isUnreadable({ frames, problems }: Verdict): boolean {
  return !frames.size && problems.length === 1 && problems[0]?.frame === null && problems[0].code !== "other_layout";
}

function sentence(manifest: Manifest, verdict: Verdict, arrays?: ArrayCheck): string {
  const all = manifest.tokens.size;
  if (isUnreadable(verdict)) {
    return verdict.problems[0]?.code === "truncated" ? CUT_SHORT : "This cannot be read as a submission.";
  }
  const codes = new Set(verdict.problems.map(({ code }) => code));
  if (codes.has("other_layout")) return "The files have another layout; the command stone validate prints the line that converts them to a submission.";
  const absent = verdict.problems.filter(({ code }) => code === "missing_frame").length;
  if (absent) return `${count(all - absent)} of ${count(all)} frames are present.`;
  if (verdict.problems.length) return `All ${count(all)} frames are present, but not all files are as required.`;
  return arrays ? soundness(all, arrays) : `All ${count(all)} frames are present.`;
}

/** As much as was checked, and no more. */
function soundness(all: number, { valued, unread }: ArrayCheck): string {
  const begins = `All ${count(all)} frames are present`;
  if (unread) return `${begins}. ${counted(unread, "frame")} could not be read here: the platform checks ${unread === 1 ? "it" : "them"} after the upload.`;
  if (valued < all) return `${begins}, with the right shape and type. The values of ${count(valued)} of them were read; the platform reads all.`;
  return `${begins}, with the right shape, type and values.`;
}

function named(file: File, { folder }: Verdict): string {
  const size = `${file.name} · ${sized(file.size)}`;
  return folder ? `${size} · in folder ${folder}` : size;
}

/** A strip for each sequence: which of its frames are there, in the manifest's order. */
function strips(manifest: Manifest, { frames }: Verdict): HTMLElement {
  const list = part("ul", "strips");
  const gaps = (tokens: string[]): number => tokens.filter((token) => !frames.has(token)).length;
  const ordered = [...manifest.sequences].sort((one, other) => gaps(other[1]) - gaps(one[1]) || one[0].localeCompare(other[0]));
  for (const [name, tokens] of ordered.slice(0, MOST_STRIPS)) {
    const missing = gaps(tokens);
    const item = part("li", "strip");
    const says = missing ? `${count(missing)} of ${count(tokens.length)} missing or faulty` : `all ${count(tokens.length)}`;
    item.append(part("span", "strip-name wraps", name), strip(tokens.map((token) => frames.has(token)), `${name}: ${says}`), part("span", "hint", says));
    list.append(item);
  }
  const more = ordered.length - MOST_STRIPS;
  if (more > 0) list.append(part("li", "hint", `and ${counted(more, "more sequence")}`));
  return list;
}

/** At most `MOST_CELLS` cells; a cell for several frames is filled only if all of them are present. */
function strip(isThere: boolean[], label: string): SVGElement {
  const cells = Math.min(isThere.length, MOST_CELLS);
  const drawn = element("svg", { viewBox: `0 0 ${cells} 1`, preserveAspectRatio: "none", role: "img", "aria-label": label, class: "strip-bar" });
  for (let start = 0; start < cells; ) {
    const has = holds(isThere, start, cells);
    let stop = start + 1;
    while (stop < cells && holds(isThere, stop, cells) === has) stop++;
    drawn.append(element("rect", { x: `${start}`, width: `${stop - start}`, height: "1", class: has ? "is-there" : "is-missing" }));
    start = stop;
  }
  return drawn;
}

function holds(isThere: boolean[], cell: number, cells: number): boolean {
  const [from, to] = [cell, cell + 1].map((edge) => Math.floor((edge * isThere.length) / cells));
  return isThere.slice(from, to).every(Boolean);
}

/** The problems by code, in the order of occurrence: the number, and the first of them. */
function kinds(problems: readonly Problem[]): [string, number, Problem[]][] {
  const by_code = new Map<string, Problem[]>();
  for (const problem of problems) {
    const known = by_code.get(problem.code);
    if (known) known.push(problem);
    else by_code.set(problem.code, [problem]);
  }
  return [...by_code].map(([code, found]) => [code, found.length, found.slice(0, SHOWN)]);
}

function kindPart([code, total, problems]: [string, number, Problem[]], shape: Shape): HTMLElement {
  const group = part("details", "found-group");
  const list = part("ul", "found-list");
  if (code === "bad_shape") group.append(part("p", "hint", shapeHint(shape, problems[0]?.actual ?? "")));
  for (const one of problems) {
    const item = part("li", "");
    item.append(part("code", "", one.file));
    if (code !== "missing_frame") item.append(part("span", "hint", ` expected ${one.expected}, found ${one.actual}`));
    list.append(item);
  }
  if (total > problems.length) list.append(part("li", "hint", `and ${count(total - problems.length)} more`));
  group.prepend(part("summary", "", title(code, total)));
  group.append(list);
  return group;
}

function title(code: string, n: number): string {
  const [one, many] = SAID[code] ?? [code.replaceAll("_", " "), code.replaceAll("_", " ")];
  return `${count(n)} ${n === 1 ? one : many}`;
}

/** `2.5 GB`, as the server writes it. */
export function sized(n_bytes: number): string {
  const units = ["B", "kB", "MB", "GB", "TB"];
  let [value, unit] = [n_bytes, 0];
  while (value >= 999.5 && unit < units.length - 1) [value, unit] = [value / 1000, unit + 1];
  return `${unit === 0 || value >= 99.5 ? value.toFixed(0) : value.toFixed(1)} ${units[unit]}`;
}

function part(tag: string, kind: string, text = ""): HTMLElement {
  return Object.assign(document.createElement(tag), { className: kind, textContent: text });
}

function element(tag: string, attributes: Record<string, string>): SVGElement {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}
