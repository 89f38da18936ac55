// Saving the splits: the moves, the reason, and the merge if another user saved meanwhile.
//
// The platform accepts a change only of the revision that was read (If-Match). The second user loses nothing: their
// moves stay in the editor, they see the other user's version, and decide.

import { RefusedError, call } from "../api.js";
import { sayError, toast } from "../notices.js";
import { type Arrangement, type Move, arranged, called, differences, listsOf } from "./arrangement.js";
import type { EditorState } from "./editor_state.js";
import { make, pressed } from "./elements.js";

const NAMED = 8;
const SPLITS = "/api/v1/splits";

interface Listed {
  sequence_id: string;
}

interface Saved {
  revision: number;
  train: Listed[];
  val: Listed[];
  test: Listed[];
}

interface Line {
  actor: string;
  reason: string;
}

export class Saving {
  private isAsking = false;
  /** The shown revision of another user; 0 for none. */
  private shown = 0;

  constructor(
    private readonly root: HTMLElement,
    private readonly dialog: HTMLDialogElement,
    private readonly state: EditorState,
  ) {
    const form = dialog.querySelector("form");
    form?.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.save(form);
    });
    addEventListener("beforeunload", (event) => {
      if (state.changes.length) event.preventDefault();
    });
  }

  open(): void {
    const { changes } = this.state;
    const items = changes.slice(0, NAMED).map((move) => make("li", { textContent: this.sentence(move) }));
    if (changes.length > NAMED) items.push(make("li", { textContent: `and ${changes.length - NAMED} more` }));
    if (this.state.gone) items.push(make("li", { textContent: `${this.state.gone} deleted and removed` }));
    this.dialog.querySelector("[data-moves]")?.replaceChildren(...items);
    this.dialog.querySelector(".said")?.replaceChildren();
    this.dialog.showModal();
  }

  /** Takes the revision of the platform's splits; if it is not ours, another user has saved. */
  noteRevision(revision: number): void {
    if (revision !== this.state.revision && revision !== this.shown) void this.showTheirs();
  }

  private async save(form: HTMLFormElement): Promise<void> {
    const said = form.querySelector<HTMLElement>(".said");
    const reason = form.elements.namedItem("reason");
    const button = form.querySelector<HTMLButtonElement>('[type="submit"]');
    if (button) button.disabled = true;
    try {
      const body = { ...listsOf(this.state.current), reason: reason instanceof HTMLInputElement ? reason.value : "" };
      const saved = await call<Saved>("PUT", SPLITS, body, { "If-Match": `"${this.state.revision}"` });
      this.state.rebase(this.arrangementOf(saved), saved.revision);
      form.reset();
      this.dialog.close();
      toast(`Saved as revision ${saved.revision}.`);
    } catch (error) {
      if (error instanceof RefusedError && error.problem.code === "precondition_failed") {
        this.dialog.close();
        await this.showTheirs();
      } else if (said) sayError(said, error);
    } finally {
      if (button) button.disabled = false;
    }
  }

  private async showTheirs(): Promise<void> {
    const place = this.root.querySelector<HTMLElement>("[data-theirs]");
    if (!place || this.isAsking) return;
    this.isAsking = true;
    try {
      const [theirs, who] = await Promise.all([call<Saved>("GET", SPLITS), lastSaved()]);
      if (theirs.revision !== this.state.revision) this.sayTheirs(place, theirs, who);
    } catch (error) {
      place.hidden = false;
      sayError(place, error);
    } finally {
      this.isAsking = false;
    }
  }

  private sayTheirs(place: HTMLElement, theirs: Saved, who: Line | null): void {
    const saved = this.arrangementOf(theirs);
    const apart = differences(this.state.current, saved);
    const named = apart.slice(0, NAMED).map((move) => `${this.nameOf(move.id)} (${called(move.from)} here, ${called(move.to)} there)`);
    const more = apart.length > NAMED ? `, and ${apart.length - NAMED} more` : "";
    this.shown = theirs.revision;
    const settle = (): void => {
      this.shown = 0;
      place.hidden = true;
      place.replaceChildren();
    };
    place.replaceChildren(
      make("h2", { textContent: `${who?.actor ?? "Another user"} saved the splits while you worked on them` }),
      make("p", {
        textContent: `${who?.reason ? `Revision ${theirs.revision}: “${who.reason}”. ` : `They are at revision ${theirs.revision}. `}${
          apart.length ? `They differ from yours in ${named.join(", ")}${more}.` : "They equal yours."
        } Nothing of yours was saved or lost.`,
      }),
      pressed("Use theirs", "", () => {
        this.state.rebase(saved, theirs.revision);
        this.state.put(saved);
        settle();
      }),
      pressed("Keep mine", "primary", () => {
        this.state.rebase(saved, theirs.revision);
        settle();
      }),
    );
    place.hidden = false;
    place.querySelector("button")?.focus();
  }

  private arrangementOf(saved: Saved): Arrangement {
    const ids = (listed: Listed[]): string[] => listed.map((one) => one.sequence_id);
    return arranged(this.state.entries.keys(), { train: ids(saved.train), val: ids(saved.val), test: ids(saved.test) });
  }

  private sentence(move: Move): string {
    return `${this.nameOf(move.id)}: ${called(move.from)} → ${called(move.to)}`;
  }

  private nameOf(id: string): string {
    return this.state.entries.get(id)?.name ?? id;
  }
}

/** The user who saved last, and the reason. */
async function lastSaved(): Promise<Line | null> {
  const lines = await call<{ items: Line[] }>("GET", "/api/v1/admin/audit-log?act=splits.put&limit=1");
  return lines.items[0] ?? null;
}
