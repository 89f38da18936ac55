// A proposal of the solver: requested by sizes, shown beside the current splits, adopted by a button.

import { call } from "../api.js";
import { counted } from "../counts.js";
import { sayError } from "../notices.js";
import { type Part, arranged, differences } from "./arrangement.js";
import { percent, showShares } from "./columns.js";
import type { EditorState } from "./editor_state.js";
import { make, pressed } from "./elements.js";
import { type Finding, asItem } from "./verdicts.js";

interface Share {
  sequences: number;
  duration_ratio: number;
  class_ratios: { traversable: number; potentially_traversable: number; non_traversable: number } | null;
}

interface Listed {
  sequence_id: string;
}

interface Proposal {
  is_feasible: boolean;
  is_best: boolean;
  train: Listed[];
  val: Listed[];
  test: Listed[];
  conflict: Finding[];
  shares: Record<"whole" | "train" | "val" | "test", Share>;
}

type Sized = "train" | "val" | "test";
const SIZED: readonly Sized[] = ["train", "val", "test"];
/** Train, val and test of the paper's 43 sequences. */
const PAPER: Readonly<Record<Sized, number>> = { train: 31, val: 7, test: 5 };

export function installProposal(root: HTMLElement, dialog: HTMLDialogElement, state: EditorState, tell: (sentence: string) => void): void {
  const form = dialog.querySelector("form");
  const place = root.querySelector<HTMLElement>("[data-proposed]");
  if (!form || !place) return;
  suggest(form, state);
  form.addEventListener("input", () => count(form, state));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void propose(form, state).then((found) => {
      if (!found) return;
      dialog.close();
      show(place, found, state, tell);
    });
  });
}

async function propose(form: HTMLFormElement, state: EditorState): Promise<Proposal | null> {
  const said = form.querySelector<HTMLElement>(".said");
  const solving = form.querySelector<HTMLElement>("[data-solving]");
  const button = form.querySelector<HTMLButtonElement>('[type="submit"]');
  const sizes = Object.fromEntries(SIZED.map((part) => [part, sizeOf(form, part)]));
  said?.replaceChildren();
  if (solving) solving.hidden = false;
  if (button) button.disabled = true;
  try {
    return await call<Proposal>("POST", "/api/v1/splits/proposal", { sizes, leave_out: leftOut(form, state) });
  } catch (error) {
    if (said) sayError(said, error);
    return null;
  } finally {
    if (solving) solving.hidden = true;
    if (button) button.disabled = false;
  }
}

function show(place: HTMLElement, found: Proposal, state: EditorState, tell: (sentence: string) => void): void {
  const ids = (part: Sized): string[] => found[part].map((entry) => entry.sequence_id);
  const next = arranged(state.entries.keys(), { train: ids("train"), val: ids("val"), test: ids("test") });
  const moves = differences(state.current, next).length;
  const done = (sentence: string): void => {
    place.hidden = true;
    place.replaceChildren();
    tell(sentence);
  };
  place.replaceChildren(
    make("h2", { textContent: found.is_feasible ? "A proposal that satisfies every rule" : "No splits of these sizes satisfy every rule" }),
    make("p", { textContent: sentenceOf(found, moves) }),
    ...(found.conflict.length ? [list(found.conflict)] : []),
    shares(found),
    row(
      pressed("Adopt", "primary", () => {
        state.put(next);
        done(`${counted(moves, "sequence")} moved; nothing is saved yet.`);
      }),
      pressed("Discard", "quiet", () => done("Proposal discarded.")),
    ),
  );
  place.hidden = false;
  place.scrollIntoView({ block: "nearest" });
  place.querySelector("button")?.focus();
}

function sentenceOf(found: Proposal, moves: number): string {
  const moved = moves === 1 ? "1 sequence would move." : `${moves} sequences would move.`;
  const proven = found.is_best ? "No other is better balanced." : "The solver reached its limit; there may be a better one.";
  return found.is_feasible ? `${moved} ${proven}` : `These rules cannot all be satisfied. This proposal violates the fewest; ${moved.toLowerCase()}`;
}

/** Time and class shares of each part beside those of the whole, for comparison. */
function shares(found: Proposal): HTMLElement {
  const table = make("div", { className: "shares" });
  for (const name of ["whole", ...SIZED] as const) {
    const share = found.shares[name];
    const bar = document.querySelector("[data-shares]")?.cloneNode(true) as Element;
    const ratios = share.class_ratios;
    showShares(bar, ratios ? [ratios.traversable, ratios.potentially_traversable, ratios.non_traversable] : []);
    const amount = name === "whole" ? counted(share.sequences, "sequence") : `${share.sequences} · ${percent(share.duration_ratio)} of the time`;
    table.append(make("strong", { textContent: name }), make("span", { className: "hint", textContent: amount }), bar);
  }
  return table;
}

function list(conflict: readonly Finding[]): HTMLElement {
  const items = make("ul", { className: "findings" });
  items.append(...conflict.map((finding) => asItem({ ...finding, sequence_ids: [] })));
  return items;
}

function row(...buttons: HTMLElement[]): HTMLElement {
  const made = make("div", { className: "row" });
  made.append(...buttons);
  return made;
}

/** The sizes there are, or, while there are none, the paper's in proportion. */
function suggest(form: HTMLFormElement, state: EditorState): void {
  const total = state.entries.size;
  const isEmpty = SIZED.every((part) => !state.within(part).length);
  const val = Math.round((total * PAPER.val) / 43);
  const test = Math.round((total * PAPER.test) / 43);
  const wanted = isEmpty ? { train: total - val - test, val, test } : undefined;
  for (const part of SIZED) {
    const input = form.elements.namedItem(part);
    if (input instanceof HTMLInputElement) input.value = String(wanted ? wanted[part] : state.within(part).length);
  }
  count(form, state);
}

function count(form: HTMLFormElement, state: EditorState): void {
  const asked = SIZED.reduce((sum, part) => sum + sizeOf(form, part), 0);
  const there = state.entries.size - leftOut(form, state).length;
  const said = form.querySelector("[data-sizes-said]");
  if (said) said.textContent = `${asked} of ${counted(there, "sequence")}${asked > there ? ": more than there are" : ""}`;
}

function sizeOf(form: HTMLFormElement, part: Part): number {
  const input = form.elements.namedItem(part);
  return input instanceof HTMLInputElement ? Number(input.value) : 0;
}

function leftOut(form: HTMLFormElement, state: EditorState): string[] {
  const box = form.elements.namedItem("only_assigned");
  const isChecked = box instanceof HTMLInputElement && box.checked;
  return isChecked ? state.within("").map((entry) => entry.id) : [];
}
