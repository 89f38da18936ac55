// The state of the editor: the saved splits, the current ones, and the undo history.

import { type Arrangement, type Entry, type Move, type Part, differences, moved } from "./arrangement.js";

const MOST_STEPS = 200;

export class EditorState {
  private saved: Arrangement;
  private now: Arrangement;
  private readonly past: Arrangement[] = [];
  private readonly listeners: (() => void)[] = [];

  constructor(
    readonly entries: ReadonlyMap<string, Entry>,
    saved: Arrangement,
    public revision: number,
    /** Sequences that are in the saved splits and exist no more: saving takes them out. */
    public gone: number,
  ) {
    this.saved = saved;
    this.now = saved;
  }

  get current(): Arrangement {
    return this.now;
  }

  get changes(): Move[] {
    return differences(this.saved, this.now);
  }

  get isChanged(): boolean {
    return this.gone > 0 || this.changes.length > 0;
  }

  get canUndo(): boolean {
    return this.past.length > 0;
  }

  /** Entries in a part, in the order of the page. */
  within(part: Part): Entry[] {
    return [...this.entries.values()].filter((entry) => this.now.get(entry.id) === part);
  }

  savedPart(id: string): Part {
    return this.saved.get(id) ?? "";
  }

  onChange(listener: () => void): void {
    this.listeners.push(listener);
  }

  move(ids: Iterable<string>, part: Part): Move[] {
    return this.put(moved(this.now, ids, part));
  }

  /** Applies the arrangement and returns the moves. */
  put(next: Arrangement): Move[] {
    const moves = differences(this.now, next);
    if (!moves.length) return moves;
    this.past.push(this.now);
    if (this.past.length > MOST_STEPS) this.past.shift();
    this.now = next;
    this.tell();
    return moves;
  }

  undo(): void {
    const before = this.past.pop();
    if (!before) return;
    this.now = before;
    this.tell();
  }

  /** Takes `saved` at `revision` as the platform's state; the editor's arrangement stays. */
  rebase(saved: Arrangement, revision: number): void {
    this.saved = saved;
    this.revision = revision;
    this.gone = 0;
    this.tell();
  }

  private tell(): void {
    for (const listener of this.listeners) listener();
  }
}
