// Drives on the board: the sequences of a drive in one column are folded below one card, which moves the drive.
//
// A drive has a group in each column with one of its sequences. The server renders those of the saved splits; a group
// moves with its sequences, and is copied if the drive is split.

import { count, counted } from "../counts.js";
import { type Part, PARTS, totalsOf } from "./arrangement.js";
import type { EditorState } from "./editor_state.js";

export class Drives {
  private readonly members = new Map<string, string[]>();

  constructor(
    private readonly root: HTMLElement,
    private readonly cards: ReadonlyMap<string, HTMLElement>,
  ) {
    for (const [id, card] of cards) {
      const drive = card.dataset["drive"];
      if (drive) this.members.set(drive, [...(this.members.get(drive) ?? []), id]);
    }
    root.addEventListener("click", (event) => this.unfold(event));
  }

  /** The sequences of a card: its own, or all of its drive, including those in other columns. */
  idsOf(card: HTMLElement): readonly string[] {
    const id = card.dataset["id"];
    return id === undefined ? (this.members.get(card.dataset["heads"] ?? "") ?? []) : [id];
  }

  /** The drive that has these sequences and no others. */
  nameOf(ids: readonly string[]): string | null {
    const name = this.cards.get(ids[0] ?? "")?.dataset["drive"] ?? "";
    const members = this.members.get(name) ?? [];
    return members.length === ids.length && members.every((id) => ids.includes(id)) ? name : null;
  }

  /** The card of a drive or sequence on the board; if a drive's card is gone, another card of that drive. */
  standing(card: HTMLElement): HTMLElement | undefined {
    return card.isConnected ? card : (this.heads().find((head) => head.dataset["heads"] === card.dataset["heads"]) ?? undefined);
  }

  heads(): HTMLElement[] {
    return [...this.root.querySelectorAll<HTMLElement>("[data-heads]")];
  }

  /** The list in a column that a card belongs to. */
  listFor(card: HTMLElement, column: Element): Element {
    const group = [...column.querySelectorAll<HTMLElement>(".split-drive")].find((one) => one.dataset["drive"] === card.dataset["drive"]);
    return group?.querySelector("[data-members]") ?? column;
  }

  /** Creates a group in each column with a sequence of a drive. */
  place(state: EditorState, listOf: (part: Part) => Element | null): void {
    for (const [name, ids] of this.members) {
      const parts = PARTS.filter((part) => ids.some((id) => state.current.get(id) === part));
      const groups = [...this.root.querySelectorAll<HTMLElement>(".split-drive")].filter((group) => group.dataset["drive"] === name);
      const standing = new Map(groups.map((group) => [group.parentElement, group]));
      const spare = groups.filter((group) => !parts.some((part) => listOf(part) === group.parentElement));
      for (const part of parts) {
        const list = listOf(part);
        if (!list || standing.has(list as HTMLElement)) continue;
        const group = spare.pop() ?? copyOf(groups[0]);
        if (group) seatByName(list, group);
      }
    }
  }

  /** Removes empty groups, and updates the texts of the others. */
  describe(state: EditorState, listOf: (part: Part) => Element | null): void {
    for (const group of this.root.querySelectorAll<HTMLElement>(".split-drive")) {
      const held = [...group.querySelectorAll<HTMLElement>("[data-members] > .split-card")].map((card) => card.dataset["id"] ?? "");
      if (held.length) this.say(group, held, state, PARTS.find((part) => listOf(part) === group.parentElement) ?? "");
      else group.remove();
    }
  }

  /** Shows the state of folded cards in the head: any marked, all selected or filtered out. */
  reflect(): void {
    for (const group of this.root.querySelectorAll<HTMLElement>(".split-drive")) {
      const cards = [...group.querySelectorAll<HTMLElement>("[data-members] > .split-card")];
      const head = group.querySelector<HTMLElement>("[data-heads]");
      group.hidden = cards.every((card) => card.hidden);
      head?.toggleAttribute("data-marked", cards.some((card) => card.hasAttribute("data-marked")));
      const isPicked = cards.every((card) => card.hasAttribute("data-picked"));
      head?.toggleAttribute("data-picked", isPicked);
      head?.querySelector("button.split-name")?.setAttribute("aria-pressed", String(isPicked));
    }
  }

  private say(group: HTMLElement, held: readonly string[], state: EditorState, part: Part): void {
    const all = this.members.get(group.dataset["drive"] ?? "")?.length ?? held.length;
    const totals = totalsOf(held.flatMap((id) => state.entries.get(id) ?? []));
    const sequences = held.length === all ? counted(all, "sequence") : `${held.length} of ${counted(all, "sequence")}`;
    const before = new Set(held.map((id) => state.savedPart(id)));
    const isMoved = before.size > 1 || !before.has(part);
    write(group, "[data-drive-amount]", `${sequences} · ${counted(totals.frames, "frame")} · ${count(Math.round(totals.duration_s))} s`);
    write(group, "[data-heads] [data-from]", !isMoved ? "" : `from ${[...before].map((one) => one || "none").join(", ")}`);
    group.querySelector("[data-heads]")?.toggleAttribute("data-moved", isMoved);
    const select = group.querySelector<HTMLSelectElement>("[data-heads] select");
    if (select) select.value = part;
  }

  private unfold(event: MouseEvent): void {
    const button = event.target instanceof Element ? event.target.closest<HTMLElement>("[data-unfolds]") : null;
    const list = button?.closest(".split-drive")?.querySelector<HTMLElement>("[data-members]");
    if (!button || !list) return;
    list.hidden = !list.hidden;
    button.setAttribute("aria-expanded", String(!list.hidden));
  }
}

/** Inserts an element into a list sorted by name. */
export function seatByName(list: Element, element: HTMLElement): void {
  const name = element.dataset["name"] ?? "";
  const next = [...list.children].find((other) => other !== element && ((other as HTMLElement).dataset["name"] ?? "").localeCompare(name) > 0);
  list.insertBefore(element, next ?? null);
}

let copies = 0;

/** An empty folded group of the same drive. */
function copyOf(group: HTMLElement | undefined): HTMLElement | undefined {
  const copy = group?.cloneNode(true) as HTMLElement | undefined;
  const list = copy?.querySelector<HTMLElement>("[data-members]");
  list?.replaceChildren();
  if (list) list.hidden = true;
  copy?.querySelector("[data-unfolds]")?.setAttribute("aria-expanded", "false");
  const said = copy?.querySelector(".split-said");
  if (said) said.id = `drive-said-${++copies}`;
  copy?.querySelector("button.split-name")?.setAttribute("aria-describedby", said?.id ?? "");
  for (const stop of copy?.querySelectorAll<HTMLElement>("[tabindex]") ?? []) stop.tabIndex = -1;
  return copy;
}

function write(group: HTMLElement, selector: string, text: string): void {
  const slot = group.querySelector(selector);
  if (slot) slot.textContent = text;
}
