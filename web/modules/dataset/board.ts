// The board: cards in columns, moved by keys, by dragging, and by the select on each card.
//
// One card is the board's tab stop (a roving tabindex). Arrows move the focus and Space selects several cards. The keys
// 1 2 3 0 move the selection, or else the focused card: a sequence, or a drive with all of its sequences. All moves go
// through the state, and the cards follow it.

import { type Part, PARTS, called, partOf } from "./arrangement.js";
import { headColumns } from "./columns.js";
import { Drives, seatByName } from "./drives.js";
import type { EditorState } from "./editor_state.js";

const KEYS: Readonly<Record<string, Part>> = { "1": "train", "2": "val", "3": "test", "0": "" };

export class Board {
  private readonly cards = new Map<string, HTMLElement>();
  private readonly picked = new Set<string>();
  private readonly drives: Drives;

  constructor(
    private readonly root: HTMLElement,
    private readonly state: EditorState,
    private readonly tell: (sentence: string) => void,
  ) {
    for (const card of root.querySelectorAll<HTMLElement>(".split-card[data-id]")) this.cards.set(card.dataset["id"] ?? "", card);
    this.drives = new Drives(root, this.cards);
    state.onChange(() => this.show());
    this.show();
  }

  /** Let people move things. */
  edit(): void {
    this.root.addEventListener("keydown", (event) => this.key(event));
    this.root.addEventListener("click", (event) => this.click(event));
    this.root.addEventListener("change", (event) => this.choose(event));
    this.root.addEventListener("focusin", (event) => this.rove(cardAt(event.target)));
    this.installDragging();
    this.rove(this.root.querySelector(".split-card"));
  }

  /** Draw the eye to these sequences, and to no others. */
  mark(ids: ReadonlySet<string>): void {
    for (const [id, card] of this.cards) card.toggleAttribute("data-marked", ids.has(id));
    this.drives.reflect();
    const first = this.shownCards().find((card) => card.hasAttribute("data-marked"));
    first?.scrollIntoView({ block: "nearest" });
  }

  /** Shows the cards that contain every word; returns their number. */
  filter(text: string): number {
    const words = text.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    for (const card of this.cards.values()) {
      const said = `${card.dataset["name"] ?? ""} ${card.dataset["said"] ?? ""} ${card.dataset["half"] ?? ""}`.toLowerCase();
      card.hidden = !words.every((word) => said.includes(word));
      shown += card.hidden ? 0 : 1;
    }
    this.drives.reflect();
    if (!this.root.querySelector('.split-card:not([hidden]) .split-name[tabindex="0"]')) this.rove(this.shownCards()[0] ?? null);
    return shown;
  }

  private show(): void {
    const focused = document.activeElement instanceof HTMLElement ? document.activeElement : null;
    const listOf = (part: Part): Element | null => this.listOf(part);
    this.drives.place(this.state, listOf);
    for (const [id, card] of this.cards) this.seat(card, this.state.current.get(id) ?? "");
    this.drives.describe(this.state, listOf);
    this.drives.reflect();
    headColumns(this.root, this.state);
    if (focused && document.activeElement !== focused && this.root.contains(focused)) focused.focus({ preventScroll: true });
  }

  private seat(card: HTMLElement, part: Part): void {
    const column = this.listOf(part);
    const list = column && this.drives.listFor(card, column);
    if (list && card.parentElement !== list) seatByName(list, card);
    const select = card.querySelector("select");
    if (select) select.value = part;
    const before = this.state.savedPart(card.dataset["id"] ?? "");
    const from = card.querySelector("[data-from]");
    if (from) from.textContent = before === part ? "" : `from ${before || "none"}`;
    card.toggleAttribute("data-moved", before !== part);
  }

  private move(ids: readonly string[], part: Part): void {
    const moves = this.state.move(ids, part);
    const names = moves.map((move) => this.state.entries.get(move.id)?.name ?? move.id);
    const [first = ""] = names;
    const drive = this.drives.nameOf(ids);
    const several = drive ? `Drive ${drive}, ${ids.length} sequences, is` : `${names.length} sequences are`;
    const who = names.length === 1 ? `${first} is` : several;
    if (moves.length) this.tell(`${who} in ${called(part)} now.`);
    this.pick([]);
  }

  private pick(ids: readonly string[]): void {
    this.picked.clear();
    for (const id of ids) this.picked.add(id);
    for (const [id, card] of this.cards) {
      card.toggleAttribute("data-picked", this.picked.has(id));
      card.querySelector(".split-name")?.setAttribute("aria-pressed", String(this.picked.has(id)));
    }
    this.drives.reflect();
  }

  /** The ids that a move of this card moves. */
  private takenWith(card: HTMLElement): string[] {
    const ids = this.drives.idsOf(card);
    return ids.some((id) => this.picked.has(id)) ? [...new Set([...this.picked, ...ids])] : [...ids];
  }

  private key(event: KeyboardEvent): void {
    const card = cardAt(event.target);
    const isOnName = event.target instanceof Element && event.target.matches(".split-name");
    if (!card || !isOnName || event.ctrlKey || event.metaKey || event.altKey) return;
    const part = KEYS[event.key];
    if (part !== undefined) this.sort(card, part);
    else if (event.shiftKey && isSideways(event.key)) this.move(this.takenWith(card), beside(partOfCard(card), event.key));
    else if (event.key === "Escape" && this.picked.size) this.pick([]);
    else if (event.key.startsWith("Arrow") || event.key === "Home" || event.key === "End") this.walk(card, event.key);
    else return;
    event.preventDefault();
  }

  /** Moves the card and selects the next one, so that a column is sorted key by key. */
  private sort(card: HTMLElement, part: Part): void {
    const taken = new Set(this.takenWith(card));
    const here = shownIn(listAt(card));
    const at = here.indexOf(card);
    const left = [...here.slice(at + 1), ...here.slice(0, at).reverse()].find((other) => !this.drives.idsOf(other).some((id) => taken.has(id)));
    this.move([...taken], part);
    focusOn(left ?? this.drives.standing(card));
  }

  private walk(card: HTMLElement, key: string): void {
    if (isSideways(key)) {
      const place = shownIn(listAt(card)).indexOf(card);
      let part = beside(partOfCard(card), key);
      while (part !== partOfCard(card) && !shownIn(this.listOf(part)).length && beside(part, key) !== part) part = beside(part, key);
      const there = shownIn(this.listOf(part));
      focusOn(there[Math.min(place, there.length - 1)]);
      return;
    }
    const here = shownIn(listAt(card));
    const at = here.indexOf(card);
    const places: Readonly<Record<string, number>> = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: here.length - 1 };
    focusOn(here[places[key] ?? at]);
  }

  private click(event: MouseEvent): void {
    const card = cardAt(event.target);
    if (!card || !(event.target instanceof Element) || !event.target.closest(".split-name")) return;
    const ids = this.drives.idsOf(card);
    const isPicked = ids.every((id) => this.picked.has(id));
    this.pick(isPicked ? [...this.picked].filter((one) => !ids.includes(one)) : [...this.picked, ...ids]);
    this.tell(this.picked.size === 1 ? "1 sequence picked." : `${this.picked.size} sequences picked.`);
  }

  private choose(event: Event): void {
    const card = cardAt(event.target);
    if (card && event.target instanceof HTMLSelectElement) this.move(this.takenWith(card), partOf(event.target.value));
  }

  /** Makes this card the board's tab stop. */
  private rove(card: HTMLElement | null): void {
    if (!card) return;
    for (const other of [...this.cards.values(), ...this.drives.heads()]) setStops(other, other === card);
  }

  private installDragging(): void {
    let taken: string[] = [];
    this.root.addEventListener("dragstart", (event) => {
      const card = cardAt(event.target);
      if (!card || !event.dataTransfer) return;
      taken = this.takenWith(card);
      event.dataTransfer.effectAllowed = "move";
      event.dataTransfer.setData("text/plain", taken.map((id) => this.state.entries.get(id)?.name ?? id).join("\n"));
      for (const one of [card, ...taken.map((id) => this.cards.get(id))]) one?.setAttribute("data-dragged", "");
    });
    this.root.addEventListener("dragover", (event) => {
      const column = columnAt(event.target);
      if (taken.length && column) event.preventDefault();
      this.aim(taken.length ? column : null);
    });
    this.root.addEventListener("drop", (event) => {
      const column = columnAt(event.target);
      if (!taken.length || !column) return;
      event.preventDefault();
      this.move(taken, partOf(column.dataset["part"]));
    });
    this.root.addEventListener("dragend", () => {
      for (const one of this.root.querySelectorAll("[data-dragged]")) one.removeAttribute("data-dragged");
      taken = [];
      this.aim(null);
    });
  }

  private aim(at: HTMLElement | null): void {
    for (const column of this.root.querySelectorAll("[data-part]")) column.toggleAttribute("data-aimed", column === at);
  }

  private shownCards(): HTMLElement[] {
    return PARTS.flatMap((part) => shownIn(this.listOf(part)));
  }

  private listOf(part: Part): HTMLElement | null {
    return this.root.querySelector(`[data-part="${part}"] [data-cards]`);
  }
}

function cardAt(target: EventTarget | null): HTMLElement | null {
  return target instanceof Element ? target.closest<HTMLElement>(".split-card") : null;
}

function columnAt(target: EventTarget | null): HTMLElement | null {
  return target instanceof Element ? target.closest<HTMLElement>("[data-part]") : null;
}

function partOfCard(card: HTMLElement): Part {
  return partOf(columnAt(card)?.dataset["part"]);
}

function isSideways(key: string): boolean {
  return key === "ArrowLeft" || key === "ArrowRight";
}

/** The part to the left or right; at the edge the part itself. */
function beside(part: Part, key: string): Part {
  return PARTS[PARTS.indexOf(part) + (key === "ArrowLeft" ? -1 : 1)] ?? part;
}

function listAt(card: HTMLElement): Element | null {
  return card.closest("[data-cards]");
}

/** The visible cards, without those of folded drives. */
function shownIn(list: Element | null): HTMLElement[] {
  return [...(list?.querySelectorAll<HTMLElement>(".split-card") ?? [])].filter((card) => !card.closest("[hidden]"));
}

function focusOn(card: HTMLElement | undefined): void {
  card?.querySelector<HTMLElement>(".split-name")?.focus();
}

function setStops(card: HTMLElement, isStop: boolean): void {
  for (const stop of card.querySelectorAll<HTMLElement>(".split-name, select, a, [data-unfolds]")) stop.tabIndex = isStop ? 0 : -1;
}
