// The log of a job, live: fetches lines after the last one and scrolls to the end.
//
// Scrolling up stops the scrolling, so that a line can be read; the button, or scrolling to the end, resumes it. Styles
// filter the levels. A very long log keeps its last `MOST` lines.

import { call } from "../api.js";
import { sayError } from "../notices.js";
import { written } from "../times.js";

interface Line {
  job_id: string;
  attempt: number;
  logged_at: string;
  level: string;
  event: string;
  facts: Record<string, unknown>;
}

interface LogPage {
  items: Line[];
  next: string | null;
}

const MOST = 5000;
const AT_ONCE = 500;
const EVERY_MS = 1000;
const SLOWEST_MS = 15_000;
const ENDED = ["succeeded", "failed", "cancelled"];

function install(section: HTMLElement): void {
  const lines = section.querySelector<HTMLElement>("[data-log-lines]");
  const button = section.querySelector<HTMLButtonElement>("[data-log-follow]");
  const level = section.querySelector<HTMLSelectElement>("[data-log-level]");
  if (!lines || !button || !level) return;
  const tail = new Tail(section, lines, button);
  level.addEventListener("change", () => {
    lines.dataset["from"] = level.value;
    tail.keepEnd();
  });
  button.addEventListener("click", () => tail.follow(!tail.isFollowing));
  lines.addEventListener("scroll", () => tail.moved());
  void tail.run();
}

function isAtEnd(lines: HTMLElement): boolean {
  return lines.scrollTop + lines.clientHeight >= lines.scrollHeight - 8;
}

function sizeOf(lines: HTMLElement): string {
  return `${lines.clientHeight}/${lines.scrollHeight}`;
}

class Tail {
  isFollowing = true;
  #size = "";
  #after: string | null = null;
  #count = 0;

  constructor(readonly section: HTMLElement, readonly lines: HTMLElement, readonly button: HTMLButtonElement) {}

  follow(isFollowing: boolean): void {
    if (isFollowing !== this.isFollowing) {
      this.isFollowing = isFollowing;
      this.button.setAttribute("aria-pressed", String(isFollowing));
      this.button.textContent = isFollowing ? "Following" : "Follow again";
    }
    this.keepEnd();
  }

  keepEnd(): void {
    this.#size = sizeOf(this.lines);
    if (this.isFollowing) this.lines.scrollTop = this.lines.scrollHeight;
  }

  /** A reader who scrolls up stops the scrolling; layout changes (a late font, a smaller window) do not. */
  moved(): void {
    if (sizeOf(this.lines) === this.#size || isAtEnd(this.lines)) this.follow(isAtEnd(this.lines));
    else this.keepEnd();
  }

  async run(): Promise<void> {
    let wait_ms = EVERY_MS;
    for (;;) {
      try {
        const hadEnded = hasEnded();
        const got = await this.#more();
        this.keepEnd();
        if (!got && hadEnded) return;
        wait_ms = got === AT_ONCE ? 0 : EVERY_MS;
      } catch (error) {
        const place = this.section.querySelector<HTMLElement>("[data-log-empty]");
        if (place && !this.#count) sayError(place, error);
        wait_ms = Math.min(SLOWEST_MS, Math.max(EVERY_MS, wait_ms * 2));
      }
      await new Promise((resolve) => setTimeout(resolve, document.hidden ? SLOWEST_MS : wait_ms));
    }
  }

  /** Fetches and shows newer lines; returns their number. */
  async #more(): Promise<number> {
    const query = new URLSearchParams({ limit: String(AT_ONCE), ...(this.#after ? { after: this.#after } : {}) });
    const page = await call<LogPage>("GET", `${this.section.dataset["log"]}?${query.toString()}`);
    this.#after = page.next;
    if (!page.items.length) return 0;
    this.lines.append(...page.items.map(drawn));
    while (this.lines.childElementCount > MOST) this.lines.firstElementChild?.remove();
    this.#count += page.items.length;
    const count = this.section.querySelector("[data-log-count]");
    if (count) count.textContent = this.#count === 1 ? "1 line" : `${this.#count.toLocaleString("en")} lines`;
    this.section.querySelector("[data-log-empty]")?.setAttribute("hidden", "");
    return page.items.length;
  }
}

function hasEnded(): boolean {
  return ENDED.includes(document.querySelector<HTMLElement>("[data-run-state]")?.dataset["runState"] ?? "");
}

function drawn(line: Line): HTMLElement {
  const row = Object.assign(document.createElement("div"), { className: "log-line" });
  row.dataset["level"] = line.level;
  const at = Object.assign(document.createElement("time"), { dateTime: line.logged_at, textContent: clock(line.logged_at) });
  at.title = written(new Date(line.logged_at));
  const level = Object.assign(document.createElement("span"), { className: "log-level", textContent: line.level });
  const event = Object.assign(document.createElement("span"), { className: "log-event", textContent: line.event });
  row.append(at, level, event);
  const { traceback, ...facts } = line.facts;
  const said = Object.entries(facts).map(([name, value]) => `${name}=${typeof value === "string" ? value : JSON.stringify(value)}`);
  if (said.length) row.append(Object.assign(document.createElement("span"), { className: "log-facts", textContent: said.join(" ") }));
  if (typeof traceback === "string") row.append(folded(traceback));
  return row;
}

function folded(traceback: string): HTMLElement {
  const details = document.createElement("details");
  details.append(
    Object.assign(document.createElement("summary"), { textContent: "traceback" }),
    Object.assign(document.createElement("pre"), { textContent: traceback }),
  );
  return details;
}

function clock(iso: string): string {
  const moment = new Date(iso);
  return [moment.getHours(), moment.getMinutes(), moment.getSeconds()].map((value) => String(value).padStart(2, "0")).join(":");
}

for (const section of document.querySelectorAll<HTMLElement>("[data-log]")) install(section);
