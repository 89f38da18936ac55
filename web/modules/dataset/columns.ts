// The heads of the board's columns: amount, class shares and conditions of each column.

import { counted } from "../counts.js";
import { type Part, type Totals, totalsOf } from "./arrangement.js";
import type { EditorState } from "./editor_state.js";

const NAMES = ["traversable", "potentially", "non-traversable"] as const;

/** Shows in each column's head the content of the column. */
export function headColumns(board: HTMLElement, state: EditorState): void {
  const parts = (["train", "val", "test"] as const).flatMap((part) => state.within(part));
  const assigned_s = totalsOf(parts).duration_s;
  const words = totalsOf(state.entries.values()).words;
  for (const column of board.querySelectorAll<HTMLElement>("[data-part]")) {
    const part = (column.dataset["part"] ?? "") as Part;
    const totals = totalsOf(state.within(part));
    write(column, "[data-count]", String(totals.sequences));
    write(column, "[data-amount]", amount(totals, part ? assigned_s : 0));
    showShares(column.querySelector("[data-shares]"), totals.voxels);
    for (const tag of column.querySelectorAll<HTMLElement>("[data-word]")) cover(tag, totals.words, words);
    column.toggleAttribute("data-bare", totals.sequences === 0);
  }
}

/** Sets the class bar's lengths and its text for screen readers. */
export function showShares(bar: Element | null, voxels: readonly number[]): void {
  if (!bar) return;
  const total = voxels.reduce((sum, count) => sum + count, 0);
  let left = 0;
  bar.querySelectorAll("rect").forEach((rect, place) => {
    const width = total ? (100 * (voxels[place] ?? 0)) / total : 0;
    rect.setAttribute("x", String(left));
    rect.setAttribute("width", String(width));
    left += width;
  });
  const said = NAMES.map((name, place) => `${name} ${total ? percent((voxels[place] ?? 0) / total) : "–"}`).join(", ");
  bar.setAttribute("aria-label", total ? `Classes: ${said}` : "Classes: not known");
}

export function percent(ratio: number): string {
  return `${(100 * ratio).toFixed(ratio && ratio < 0.0995 ? 1 : 0)} %`;
}

export function minutes(duration_s: number): string {
  return duration_s < 600 ? `${(duration_s / 60).toFixed(1)} min` : `${Math.round(duration_s / 60)} min`;
}

function amount(totals: Totals, assigned_s: number): string {
  const share = assigned_s > 0 ? ` · ${percent(totals.duration_s / assigned_s)} of the time` : "";
  return `${minutes(totals.duration_s)} · ${counted(totals.frames, "frame")}${share}`;
}

function cover(tag: HTMLElement, here: ReadonlySet<string>, anywhere: ReadonlySet<string>): void {
  const word = tag.dataset["word"] ?? "";
  tag.hidden = !anywhere.has(word);
  tag.dataset["covered"] = String(here.has(word));
  tag.setAttribute("aria-label", here.has(word) ? word : `no ${word}`);
}

function write(column: HTMLElement, selector: string, text: string): void {
  const slot = column.querySelector(selector);
  if (slot) slot.textContent = text;
}
