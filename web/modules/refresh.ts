// Parts of a page that are fetched again: on an interval, on a server's event, after an act.
//
// `<section id="jobs" data-refresh="2s">` fetches this page and morphs the part with the same id, so that the focus
// stays. `data-follow="/api/v1/…/events"` does this when the platform reports a change. While a dialog is open nothing
// is replaced, because the dialog may be inside and would close; the update follows when it closes.

import { followStream } from "./event_stream.js";
import { toast } from "./notices.js";
import htmx from "htmx.org";

const SLOWEST_MS = 30_000;
const owed = new Set<string>();

/** Fetches this page again and replaces the part `selector`. */
export async function refresh(selector: string): Promise<void> {
  const shown = document.querySelector<HTMLElement>(selector);
  if (!shown) return;
  if (isAsking()) return void owed.add(selector);
  const source = shown.dataset["source"] ?? location.href;
  await htmx.ajax("GET", source, { source: shown, target: shown, select: selector, swap: "outerMorph" });
}

/** Whether a dialog is open. */
function isAsking(): boolean {
  return document.querySelector("dialog[open]") !== null;
}

export function installRefreshing(root: ParentNode = document): void {
  document.addEventListener("htmx:before:swap", (event) => {
    if (!isAsking()) return;
    event.preventDefault(); // it was under way when the dialog opened
    if (event.target instanceof Element && event.target.id) owed.add(`#${event.target.id}`);
  });
  document.addEventListener("close", () => {
    const selectors = [...owed];
    owed.clear();
    for (const selector of selectors) void refresh(selector);
  }, true);
  for (const part of root.querySelectorAll<HTMLElement>("[data-refresh][id]")) keepFresh(part);
  for (const part of root.querySelectorAll<HTMLElement>("[data-follow][id]")) followEvents(part);
}

function keepFresh(part: HTMLElement): void {
  const every_ms = Number.parseFloat(part.dataset["refresh"] ?? "2") * 1000;
  let wait_ms = every_ms;
  const again = async (): Promise<void> => {
    if (!document.getElementById(part.id)?.dataset["refresh"]) return; // gone, or fetched without: it has come to rest
    if (!document.hidden && !isAsking()) {
      try {
        await refresh(`#${part.id}`);
        wait_ms = every_ms;
      } catch {
        wait_ms = Math.min(SLOWEST_MS, wait_ms * 2);
      }
    }
    setTimeout(() => void again(), wait_ms);
  };
  setTimeout(() => void again(), wait_ms);
}

function followEvents(part: HTMLElement): void {
  followStream(part.dataset["follow"] ?? "", {
    progress: () => void refresh(`#${part.id}`),
    ended: () => void refresh(`#${part.id}`).then(() => toast("Finished.")),
  });
}
