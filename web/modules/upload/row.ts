// A bag's line in the page: its phase in words and bars, and its buttons.

import { size, span } from "./speed.js";
import type { Phase, Transfer } from "./transfer.js";

const SAID: Record<Phase, string> = {
  waiting: "waiting",
  counting: "hashing",
  sending: "uploading",
  away: "waiting for the platform",
  "signing-in": "waiting for sign-in",
  paused: "paused",
  reading: "reading",
  registered: "registered",
  refused: "refused",
};
/** The values of `data-state` with colours in `components.css`. */
const LOOKS: Record<Phase, string> = {
  waiting: "queued",
  counting: "running",
  sending: "uploading",
  away: "paused",
  "signing-in": "paused",
  paused: "paused",
  reading: "running",
  registered: "ready",
  refused: "refused",
};
const ANIMATION_MS = 120;
const CLOCK_MS = 1000;
const STALL_S = 4;

export class Row {
  readonly element: HTMLLIElement;
  #timer = 0;
  #drawn_ms = 0;
  #shown: Phase | undefined;

  constructor(template: HTMLTemplateElement, readonly transfer: () => Transfer, readonly say: (sentence: string) => void) {
    const copy = template.content.cloneNode(true) as DocumentFragment;
    this.element = copy.querySelector("li") as HTMLLIElement;
  }

  part<T extends HTMLElement = HTMLElement>(name: string): T | null {
    return this.element.querySelector<T>(`[data-${name}]`);
  }

  /** The act's button: pause, resume or remove. */
  button(act: string): HTMLButtonElement | null {
    return this.element.querySelector<HTMLButtonElement>(`[data-act-row="${act}"]`);
  }

  /** Updates the row a few times a second at most, and at once for a change of phase. */
  show(): void {
    const { phase } = this.transfer();
    if (phase !== this.#shown) {
      this.#shown = phase;
      this.#draw();
      this.say(`${this.transfer().bag.name}: ${SAID[phase]}`);
    } else if (performance.now() - this.#drawn_ms > ANIMATION_MS) {
      this.#draw();
    } else if (!this.#timer) {
      this.#timer = window.setTimeout(() => this.#draw(), ANIMATION_MS);
    }
  }

  #draw(): void {
    clearTimeout(this.#timer);
    this.#timer = 0;
    this.#drawn_ms = performance.now();
    const transfer = this.transfer();
    const { bag, phase } = transfer;
    this.element.dataset["phase"] = phase;
    fill(this.part("name"), bag.name);
    fill(this.part("size"), [size(transfer.size_bytes), bag.files.length > 1 ? `${bag.files.length} files` : ""].filter(Boolean).join(", "));
    const state = this.part("phase");
    if (state) state.dataset["state"] = LOOKS[phase];
    fill(state, SAID[phase]);
    this.#bar("counted", transfer.counted_bytes);
    this.#bar("sent", transfer.sent_bytes);
    fill(this.part("line"), lineOf(transfer));
    this.#acts(phase);
    this.#findings(transfer);
    if (phase === "away" || phase === "sending") this.#timer = window.setTimeout(() => this.#draw(), CLOCK_MS); // seconds go on
  }

  #bar(name: string, bytes: number): void {
    const { size_bytes } = this.transfer();
    const ratio = size_bytes ? bytes / size_bytes : Number(bytes > 0 || this.transfer().phase === "registered");
    const bar = this.part<HTMLProgressElement>(name);
    if (bar) bar.value = ratio;
    fill(this.part(`${name}-part`), `${Math.floor(100 * ratio)} %`);
  }

  #acts(phase: Phase): void {
    const { isUnderWay, bag, sequenceId, problem } = this.transfer();
    const resume = this.button("resume");
    this.part("counted")?.closest(".transfer-bars")?.toggleAttribute("hidden", bag.trouble !== "");
    this.part("sequence-name")?.closest("label")?.toggleAttribute("hidden", bag.trouble !== "");
    this.button("pause")?.toggleAttribute("hidden", !isUnderWay || phase === "reading");
    const mayTry = phase === "refused" && problem !== undefined && !bag.trouble; // a refusal after reading is final
    resume?.toggleAttribute("hidden", !(phase === "paused" || mayTry));
    fill(resume, phase === "paused" ? "Resume" : "Try again");
    this.button("remove")?.toggleAttribute("hidden", isUnderWay || phase === "registered");
    const open = this.part<HTMLAnchorElement>("open");
    if (!open || !sequenceId) return;
    open.href = `/sequences/${sequenceId}`;
    // Only once the platform has all bytes, because leaving the page interrupts the upload.
    open.hidden = location.pathname === open.pathname || !(phase === "registered" || phase === "refused");
  }

  #findings({ findings, problem }: Transfer): void {
    const list = this.part("findings");
    if (!list) return;
    const refused = problem ? [{ code: problem.code, severity: "error", message: problem.detail }] : [];
    const noticed = findings.map(({ code, severity, topic, message }) => ({ code, severity, message: topic ? `${topic}: ${message}` : message }));
    const shown = [...refused, ...noticed];
    list.hidden = !shown.length;
    list.replaceChildren(...shown.map(({ code, severity, message }) => findingOf(code, severity, message)));
  }
}

/** A finding as `parts/components.html` writes it. */
export function findingOf(code: string, severity: string, message: string): HTMLLIElement {
  const item = Object.assign(document.createElement("li"), { className: "finding" });
  item.dataset["severity"] = severity;
  const coded = Object.assign(document.createElement("code"), { textContent: code });
  item.append(linked(code, coded), " ", Object.assign(document.createElement("span"), { textContent: message }));
  return item;
}

/** Links the code to its page; codes of published datasets have none. */
function linked(code: string, coded: HTMLElement): HTMLElement {
  if (!/^[A-Z]{3}-\d{3}$/.test(code) || code.startsWith("DST-")) return coded;
  const link = Object.assign(document.createElement("a"), { className: "code", href: `/codes/${code}` });
  link.append(coded);
  return link;
}

function fill(place: HTMLElement | null, text: string): void {
  if (place && place.textContent !== text) place.textContent = text;
}

function lineOf(transfer: Transfer): string {
  const { size_bytes, step } = transfer;
  switch (transfer.phase) {
    case "counting":
      return rated("Computing sha256", size_bytes - transfer.counted_bytes, transfer.countedSpeed.per_s);
    case "sending": {
      const still_s = transfer.sentSpeed.still_s;
      if (still_s > STALL_S) return `${size(transfer.sent_bytes)} of ${size(size_bytes)} · no progress for ${span(still_s)}`;
      return rated(`${size(transfer.sent_bytes)} of ${size(size_bytes)}`, size_bytes - transfer.sent_bytes, transfer.sentSpeed.per_s);
    }
    case "away":
      return `${transfer.awaySentence} Trying again in ${span((transfer.awayUntil_ms - performance.now()) / 1000)}.`;
    case "signing-in":
      return "The session has ended. Uploaded data is kept; the upload resumes once you have signed in.";
    case "paused":
      return "Paused. Uploaded data is kept; resume at any time.";
    case "reading":
      return step.total ? `Reading the recording: step ${Math.min(step.total, step.done + 1)} of ${step.total}` : "Reading the recording";
    case "registered":
      return transfer.findings.length ? "Registered with findings:" : "Registered. No findings.";
    case "refused":
      return transfer.problem ? "" : "Refused after reading:";
    default:
      return "";
  }
}

function rated(begun: string, rest_bytes: number, per_s: number): string {
  return per_s > 0 ? `${begun} · ${size(per_s)}/s · ${span(rest_bytes / per_s)} left` : begun;
}
