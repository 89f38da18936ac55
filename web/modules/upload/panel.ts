// The drop area for bags, and the list of their transfers (`parts/uploading.html`, `uploader`).

import { valuesOf } from "../acts.js";
import { call } from "../api.js";
import { ASKING } from "../session.js";
import { type Bag, type Found, isBagPart, lookedInto, plainName, sorted } from "./bags.js";
import { mayBeCalibration } from "./calibration_file.js";
import { takeCalibrations } from "./dropped_calibrations.js";
import { chosen, dropped } from "./dropped_files.js";
import { Row } from "./row.js";
import { freshKey } from "./file_upload.js";
import { size, span, Speed } from "./speed.js";
import { type Target, Transfer } from "./transfer.js";
import { begunOf, showUnfinished, type Unfinished, unfinished } from "./unfinished.js";

/** A recording of the sequence is there; with `isWhole` none of its others is still under way in this panel. */
export interface Registered {
  sequenceId: string;
  isWhole: boolean;
}

interface Line {
  transfer: Transfer;
  row: Row;
}

export class Panel {
  readonly #lines: Line[] = [];
  readonly #speed = new Speed();
  /** Idempotency keys of created sequences by body, so that a repetition, also by another bag, is the same sequence. */
  readonly #keys = new Map<string, string>();
  readonly #made = new Map<string, Promise<string>>(); // while they are being made
  #begun: Unfinished[] = [];
  /** Until the calibrations that were dropped are read: a sequence that is made meanwhile would have none. */
  #calibrating: Promise<unknown> = Promise.resolve();

  constructor(private readonly root: HTMLElement) {
    this.#listen();
    void this.#lookForUnfinished();
  }

  get #sequenceId(): string {
    return this.root.dataset["sequence"] ?? "";
  }

  get #facts(): HTMLFormElement | null {
    return document.querySelector<HTMLFormElement>(`form#${this.root.dataset["facts"] || "none"}`);
  }

  #part<T extends HTMLElement = HTMLElement>(name: string): T | null {
    return this.root.querySelector<T>(`[data-${name}]`);
  }

  #listen(): void {
    const [files, folder] = [this.#part<HTMLInputElement>("files"), this.#part<HTMLInputElement>("folder")];
    for (const input of [files, folder]) {
      const takeChosen = (): void => {
        if (input?.files?.length) void this.add(chosen(input.files));
        if (input) input.value = "";
      };
      input?.addEventListener("change", takeChosen);
      queueMicrotask(takeChosen); // files chosen before this module was loaded
    }
    this.root.addEventListener("click", (event) => this.#clicked(event));
    listenForDrops(this.#part("drop"), (found) => void this.add(found));
    this.#facts?.addEventListener("submit", (event) => {
      event.preventDefault();
      for (const { transfer } of this.#lines) void this.#start(transfer);
    });
    addEventListener(ASKING, (event) => {
      for (const { transfer } of this.#lines) transfer.signingIn((event as CustomEvent<boolean>).detail);
    });
    addEventListener("pageshow", ({ persisted }) => {
      if (persisted) void this.#lookForUnfinished(); // a page restored from the cache: uploads have progressed or stopped since
    });
    addEventListener("beforeunload", (event) => {
      if (this.#lines.some(({ transfer }) => transfer.isUnderWay)) event.preventDefault();
    });
  }

  #clicked(event: Event): void {
    const button = event.target instanceof Element ? event.target.closest<HTMLElement>("button") : null;
    const { choose, all } = button?.dataset ?? {};
    if (choose) this.#part(choose)?.click();
    for (const { transfer } of all ? this.#lines : []) {
      if (all === "pause") transfer.pause();
      else if (transfer.phase === "paused") void this.#start(transfer);
    }
  }

  /** Take files in: bags and calibrations get a line each, the rest is named with the reason. */
  async add(found: readonly Found[]): Promise<void> {
    const maybe = found.filter(({ file }) => !isBagPart(file.name) && mayBeCalibration(file));
    const { bags, left } = sorted(found.filter((one) => !maybe.includes(one)));
    for (const bag of await Promise.all(bags.map(lookedInto))) if (!this.#has(bag)) this.#addBag(bag);
    this.#showLeft(left, !bags.length && !maybe.length);
    const lines = this.#part("transfers");
    if (!maybe.length || !lines) return;
    const isCalibrated = this.root.dataset["calibrated"] !== undefined;
    const taking = takeCalibrations(maybe, { lines, sequenceId: this.#sequenceId, isCalibrated, facts: this.#facts });
    this.#calibrating = Promise.allSettled([this.#calibrating, taking]);
    const none = await taking;
    if (none.length) this.#showLeft([...none, ...left], true);
  }

  #showLeft(left: readonly { name: string; why: string }[], isOpen: boolean): void {
    const place = this.#part<HTMLDetailsElement>("left");
    if (!place) return;
    place.hidden = !left.length;
    place.open = isOpen;
    fill(this.#part("left-line"), `${left.length} ${left.length === 1 ? "file was" : "files were"} left out`);
    const items = left.map(({ name, why }) => Object.assign(document.createElement("li"), { textContent: `${name}: ${why}` }));
    this.#part("left-list")?.replaceChildren(...items);
  }

  #has(bag: Bag): boolean {
    const same = (other: Bag): boolean =>
      other.name === bag.name && other.files.every((file, at) => file.size === bag.files[at]?.size && file.lastModified === bag.files[at]?.lastModified);
    return this.#lines.some(({ transfer }) => same(transfer.bag) && transfer.phase !== "refused");
  }

  #addBag(bag: Bag): void {
    const template = this.#part<HTMLTemplateElement>("row");
    if (!template) return;
    const row = new Row(template, () => transfer, (sentence) => fill(this.#part("live"), sentence));
    const target = this.#targetOf(bag, row);
    const transfer = new Transfer(bag, target, () => {
      row.show();
      this.#total();
    });
    this.#lines.push({ transfer, row });
    this.#part("transfers")?.append(row.element);
    row.button("pause")?.addEventListener("click", () => transfer.pause());
    row.button("resume")?.addEventListener("click", () => void this.#start(transfer));
    row.button("remove")?.addEventListener("click", () => this.#remove(transfer));
    row.show();
    this.#total();
    if (this.#sequenceId || begunOf(bag, this.#begun)) void this.#start(transfer);
  }

  async #start(transfer: Transfer): Promise<void> {
    await transfer.start();
    await this.#lookForUnfinished();
    const { sequenceId } = transfer;
    const ofSequence = this.#lines.map(({ transfer: one }) => one.sequenceId === sequenceId ? one.phase : "refused");
    if (!sequenceId || !ofSequence.includes("registered")) return;
    const isWhole = ofSequence.every((phase) => phase === "registered" || phase === "refused");
    this.root.dispatchEvent(new CustomEvent<Registered>("registered", { bubbles: true, detail: { sequenceId, isWhole } }));
  }

  #remove(transfer: Transfer): void {
    const at = this.#lines.findIndex((line) => line.transfer === transfer);
    this.#lines.splice(at, 1)[0]?.row.element.remove();
    this.#total();
    this.#part<HTMLButtonElement>("choose")?.focus();
  }

  /** The sequence of this panel; that of the unfinished upload; or a new one, created at the start. */
  #targetOf(bag: Bag, row: Row): Target {
    const begun = this.#sequenceId ? undefined : begunOf(bag, this.#begun);
    const known = this.#sequenceId || begun?.sequenceId;
    const field = row.part<HTMLInputElement>("sequence-name");
    if (field) field.value = begun?.sequenceName ?? plainName(bag);
    if (field && known) field.disabled = true;
    if (known) return () => Promise.resolve(known);
    return async () => {
      await this.#calibrating;
      const body = JSON.stringify({ ...said(this.#facts), name: field?.value.trim() ?? "" });
      const key = this.#keys.get(body) ?? freshKey();
      this.#keys.set(body, key);
      const making = this.#made.get(body) ?? created(body, key, this.#facts);
      this.#made.set(body, making);
      const id = await making.finally(() => this.#made.delete(body));
      if (field) field.disabled = true;
      return id;
    };
  }

  async #lookForUnfinished(): Promise<void> {
    const place = this.#part("unfinished");
    if (!place) return;
    try {
      this.#begun = await unfinished(this.#sequenceId);
    } catch {
      return; // the platform is unreachable; the rows show it
    }
    const isShown = (one: Unfinished): boolean =>
      !this.#lines.some(({ transfer }) => begunOf(transfer.bag, [one]));
    showUnfinished(place, this.#begun.filter(isShown), () => void this.#lookForUnfinished());
  }

  #total(): void {
    const transfers = this.#lines.map(({ transfer }) => transfer);
    const waiting = transfers.filter(({ phase }) => phase === "waiting" || phase === "paused").length;
    this.root.dispatchEvent(new CustomEvent("bags", { bubbles: true, detail: waiting }));
    const place = this.#part("totals");
    if (!place) return;
    place.hidden = transfers.length < 2 || transfers.every(({ phase }) => phase === "waiting");
    const size_bytes = total(transfers, ({ size_bytes: one }) => one);
    const sent_bytes = total(transfers, ({ sent_bytes: one }) => one);
    this.#speed.mark(sent_bytes);
    const done = transfers.filter(({ phase }) => phase === "registered").length;
    const rate = this.#speed.per_s;
    const rated = rate > 0 && sent_bytes < size_bytes ? ` · ${size(rate)}/s · ${span((size_bytes - sent_bytes) / rate)} left` : "";
    fill(this.#part("totals-line"), `${done} of ${transfers.length} bags · ${size(sent_bytes)} of ${size(size_bytes)}${rated}`);
    const bar = this.#part<HTMLProgressElement>("totals-bar");
    if (bar) bar.value = size_bytes ? sent_bytes / size_bytes : 0;
    this.root.querySelector('[data-all="pause"]')?.toggleAttribute("hidden", !transfers.some(({ isUnderWay }) => isUnderWay));
    this.root.querySelector('[data-all="resume"]')?.toggleAttribute("hidden", !transfers.some(({ phase }) => phase === "paused"));
  }
}

/** Passes files dropped on `place` to `take`, and highlights `place` during a drag. */
export function listenForDrops(place: HTMLElement | null, take: (found: Found[]) => void): void {
  place?.addEventListener("dragover", (event) => {
    event.preventDefault();
    place.dataset["over"] = "";
  });
  for (const name of ["dragleave", "drop"]) place?.addEventListener(name, () => delete place.dataset["over"]);
  place?.addEventListener("drop", (event) => {
    event.preventDefault();
    if (event.dataTransfer) void dropped(event.dataTransfer).then(take);
  });
}

/** The form's values for every sequence. */
function said(facts: HTMLFormElement | null): Record<string, unknown> {
  const { calibration_id: _calibration, process: _process, ...rest } = facts ? valuesOf(facts) : {};
  return rest;
}

/** A sequence with this body, and the calibration that the form names; its id. */
async function created(body: string, key: string, facts: HTMLFormElement | null): Promise<string> {
  const { id } = await call<{ id: string }>("POST", "/api/v1/sequences", JSON.parse(body), { "Idempotency-Key": key });
  const calibration = facts ? valuesOf(facts)["calibration_id"] : "";
  if (calibration) await call("PUT", `/api/v1/sequences/${id}/calibration`, { calibration_id: calibration });
  return id;
}

function total(transfers: readonly Transfer[], of: (transfer: Transfer) => number): number {
  return transfers.reduce((sum, transfer) => sum + of(transfer), 0);
}

function fill(place: HTMLElement | null, text: string): void {
  if (place && place.textContent !== text) place.textContent = text;
}
