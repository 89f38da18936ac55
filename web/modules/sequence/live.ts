// A sequence's page while its run is in progress: one stream of events refreshes the live parts.
//
// `#standing` has the stream's URL and the id of the shown labels. Parts marked `data-live-part` are fetched again with
// it. If other labels become active or another run is followed (`data-run`), the whole page is reloaded, unless a
// dialog is open. The run's log and buttons are elsewhere on the page.

import { followStream } from "../event_stream.js";
import { toast } from "../notices.js";
import htmx from "htmx.org";

interface Told {
  labels: { id: string } | null;
}

const LEAST_BETWEEN_MS = 700;
/** Whether something happened that was not fetched, for a dialog was open. */
let isOwed = false;

const followed = runShown();
const standing = document.getElementById("standing");
if (standing?.dataset["live"]) follow(standing, standing.dataset["live"]);

function follow(part: HTMLElement, address: string): void {
  const shown = part.dataset["labels"] ?? "";
  const freshen = calmly(fetchAgain);
  followStream(address, {
    progress: (data) => {
      const told = JSON.parse(data) as Told;
      if (told.labels && told.labels.id !== shown) renew();
      else freshen();
    },
    ended: () => toast("The sequence was deleted."),
  });
  document.addEventListener("close", () => isOwed && freshen(), true); // close of a dialog
}

/** Fetches all live parts in one response. The first event covers changes since the page was made. */
async function fetchAgain(): Promise<void> {
  const live = Array.from(document.querySelectorAll<HTMLElement>("[data-live-part][id]"), (part) => `#${part.id}`);
  const others = ["#word", ...live].map((selector) => `${selector}:outerMorph`).join(",");
  isOwed = document.querySelector("dialog[open]") !== null;
  if (isOwed) return;
  await htmx.ajax("GET", location.href, { target: "#standing", select: "#standing", selectOOB: others, swap: "outerMorph" });
  if (runShown() !== followed) location.reload();
}

function runShown(): string {
  return document.querySelector<HTMLElement>("#runs[data-run]")?.dataset["run"] ?? "";
}

function renew(): void {
  if (document.querySelector("dialog[open]")) toast("New labels are ready: load the page again to see them.");
  else location.reload();
}

/** Runs at most once per interval, and once more for events in between. */
function calmly(act: () => Promise<void>): () => void {
  let isBusy = false;
  let isAsked = false;
  const run = async (): Promise<void> => {
    isBusy = true;
    isAsked = false;
    await act().catch(() => undefined); // the next event tries again
    await new Promise((resolve) => setTimeout(resolve, LEAST_BETWEEN_MS));
    isBusy = false;
    if (isAsked) void run();
  };
  return () => {
    if (isBusy) isAsked = true;
    else void run();
  };
}
