// The split editor: a desk with the splits, a board to move them on, the rules beside it.

import { type Arrangement, type Entry, type Part, partOf } from "./arrangement.js";
import { Board } from "./board.js";
import { Desk } from "./desk.js";
import { installProposal } from "./proposal.js";
import { Saving } from "./saving.js";
import { Verdicts } from "./verdicts.js";

const root = document.querySelector<HTMLElement>("[data-splits]");
if (root) mount(root);

function mount(root: HTMLElement): void {
  const desk = deskOf(root);
  const place = root.querySelector<HTMLElement>("[data-board]");
  if (!place) return;
  const told = root.querySelector("[data-told]");
  const tell = (sentence: string): void => {
    if (told) told.textContent = sentence;
  };
  const board = new Board(place, desk, tell);
  root.querySelector<HTMLInputElement>("[data-filter]")?.addEventListener("input", (event) => {
    const shown = board.filter((event.target as HTMLInputElement).value);
    tell(shown === 1 ? "1 sequence is shown." : `${shown} sequences are shown.`);
  });
  if (root.hasAttribute("data-editable")) edit(root, desk, board, tell);
}

function edit(root: HTMLElement, desk: Desk, board: Board, tell: (sentence: string) => void): void {
  const [propose, save] = ["propose", "save"].map((id) => document.getElementById(id));
  if (!(propose instanceof HTMLDialogElement) || !(save instanceof HTMLDialogElement)) return;
  board.edit();
  installProposal(root, propose, desk, tell);
  const saving = new Saving(root, save, desk);
  const verdicts = new Verdicts(root, desk, board, (revision) => {
    saving.noteRevision(revision);
    showState();
  });
  const saves = root.querySelector<HTMLButtonElement>("[data-save-opens]");
  const undo = root.querySelector<HTMLButtonElement>("[data-undo]");
  const showState = (): void => {
    const moves = desk.changes.length;
    const changes = root.querySelector("[data-changes]");
    if (changes) changes.textContent = moves ? `${moves} moved, not saved` : desk.gone ? `${desk.gone} deleted since, not saved` : `Revision ${desk.revision}`;
    if (saves) saves.disabled = !desk.isChanged || !verdicts.canBePut;
    if (undo) undo.disabled = !desk.canUndo;
  };
  desk.onChange(showState);
  saves?.addEventListener("click", () => saving.open());
  undo?.addEventListener("click", () => desk.undo());
  addEventListener("keydown", (event) => {
    const isTyping = event.target instanceof HTMLInputElement || document.querySelector("dialog[open]") !== null;
    if (!(event.ctrlKey || event.metaKey) || event.key !== "z" || isTyping) return;
    event.preventDefault();
    desk.undo();
  });
  showState();
}

function deskOf(root: HTMLElement): Desk {
  const entries = new Map<string, Entry>();
  const saved = new Map<string, Part>();
  for (const card of root.querySelectorAll<HTMLElement>(".split-card")) {
    const entry = entryOf(card.dataset);
    entries.set(entry.id, entry);
    saved.set(entry.id, partOf(card.dataset["saved"]));
  }
  const arrangement: Arrangement = saved;
  return new Desk(entries, arrangement, Number(root.dataset["revision"]), Number(root.dataset["gone"] ?? 0));
}

function entryOf(data: DOMStringMap): Entry {
  const counts = data["voxels"]?.split(" ").map(Number);
  return {
    id: data["id"] ?? "",
    name: data["name"] ?? "",
    environment: data["environment"] ?? "",
    half: data["half"] ?? "",
    duration_s: Number(data["durationS"]),
    frames: Number(data["frames"]),
    voxels: counts ? [counts[0] ?? 0, counts[1] ?? 0, counts[2] ?? 0] : null,
  };
}
