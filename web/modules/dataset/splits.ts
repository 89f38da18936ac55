// The split editor: a state with the splits, a board to move them on, the rules beside it.

import { type Arrangement, type Entry, type Part, partOf } from "./arrangement.js";
import { Board } from "./board.js";
import { EditorState } from "./editor_state.js";
import { installProposal } from "./proposal.js";
import { Saving } from "./save.js";
import { Verdicts } from "./verdicts.js";

const root = document.querySelector<HTMLElement>("[data-splits]");
if (root) mount(root);

function mount(root: HTMLElement): void {
  const state = stateOf(root);
  const place = root.querySelector<HTMLElement>("[data-board]");
  if (!place) return;
  const told = root.querySelector("[data-told]");
  const tell = (sentence: string): void => {
    if (told) told.textContent = sentence;
  };
  const board = new Board(place, state, tell);
  root.querySelector<HTMLInputElement>("[data-filter]")?.addEventListener("input", (event) => {
    const shown = board.filter((event.target as HTMLInputElement).value);
    tell(shown === 1 ? "1 sequence is shown." : `${shown} sequences are shown.`);
  });
  if (root.hasAttribute("data-editable")) edit(root, state, board, tell);
}

function edit(root: HTMLElement, state: EditorState, board: Board, tell: (sentence: string) => void): void {
  const [propose, save] = ["propose", "save"].map((id) => document.getElementById(id));
  if (!(propose instanceof HTMLDialogElement) || !(save instanceof HTMLDialogElement)) return;
  board.edit();
  installProposal(root, propose, state, tell);
  const saving = new Saving(root, save, state);
  const verdicts = new Verdicts(root, state, board, (revision) => {
    saving.noteRevision(revision);
    showState();
  });
  const saves = root.querySelector<HTMLButtonElement>("[data-save-opens]");
  const undo = root.querySelector<HTMLButtonElement>("[data-undo]");
  const showState = (): void => {
    const moves = state.changes.length;
    const changes = root.querySelector("[data-changes]");
    if (changes) changes.textContent = moves ? `${moves} moved, not saved` : state.gone ? `${state.gone} deleted since, not saved` : `Revision ${state.revision}`;
    if (saves) saves.disabled = !state.isChanged || !verdicts.canBePut;
    if (undo) undo.disabled = !state.canUndo;
  };
  state.onChange(showState);
  saves?.addEventListener("click", () => saving.open());
  undo?.addEventListener("click", () => state.undo());
  addEventListener("keydown", (event) => {
    const isTyping = event.target instanceof HTMLInputElement || document.querySelector("dialog[open]") !== null;
    if (!(event.ctrlKey || event.metaKey) || event.key !== "z" || isTyping) return;
    event.preventDefault();
    state.undo();
  });
  showState();
}

function stateOf(root: HTMLElement): EditorState {
  const entries = new Map<string, Entry>();
  const saved = new Map<string, Part>();
  for (const card of root.querySelectorAll<HTMLElement>(".split-card[data-id]")) {
    const entry = entryOf(card.dataset);
    entries.set(entry.id, entry);
    saved.set(entry.id, partOf(card.dataset["saved"]));
  }
  const arrangement: Arrangement = saved;
  return new EditorState(entries, arrangement, Number(root.dataset["revision"]), Number(root.dataset["gone"] ?? 0));
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
