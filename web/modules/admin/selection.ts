// Selected rows, and one act on all of them: the administrator's list of jobs.
//
// The selection is kept by id and survives every refresh of the list. Space or a click selects a row; with shift, the
// range since the last one. The arrows move between the boxes, with shift they select on the way; Escape clears the
// selection.

import { call } from "../api.js";
import { refresh } from "../refresh.js";
import { sayError, toast } from "../notices.js";

interface Outcome {
  job_id: string;
  root_id: string | null;
  state: string | null;
  failure: { code: string; sentence: string } | null;
}

type Act = "retry" | "cancel" | "terminate";

const WORDS: Record<Act, { title: string; says: string; done: string }> = {
  retry: { title: "Retry", says: "Failed and cancelled jobs are queued again; succeeded ones are kept.", done: "queued again" },
  cancel: { title: "Cancel", says: "Queued jobs will not start; running jobs stop at their next step.", done: "cancelled" },
  terminate: { title: "Terminate", says: "Their processes are killed immediately.", done: "terminated" },
};

/** The states that an act applies to. */
const APPLIES: Record<Act, readonly string[]> = { retry: ["failed", "cancelled"], cancel: ["queued", "running"], terminate: ["queued", "running"] };

/** The chosen rows: id → name, and the state when the row was seen last. */
const picked = new Map<string, { name: string; state: string }>();
let last: string | null = null;
let act: Act = "retry";

const list = document.getElementById("jobs");
const dialog = document.getElementById("act-on-picked");
if (list && dialog instanceof HTMLDialogElement) install(list, dialog);

function install(jobs: HTMLElement, asking: HTMLDialogElement): void {
  jobs.addEventListener("click", (event) => {
    if (event.target instanceof HTMLInputElement) pick(event.target, event.shiftKey);
  });
  jobs.addEventListener("keydown", walk);
  new MutationObserver(show).observe(jobs, { childList: true, subtree: true, attributeFilter: ["data-pick"] });
  document.querySelector("[data-pick-none]")?.addEventListener("click", pickNone);
  for (const button of document.querySelectorAll<HTMLElement>("[data-act-on]")) {
    button.addEventListener("click", () => ask(asking, button.dataset["actOn"] as Act));
  }
  asking.querySelector("form")?.addEventListener("submit", (event) => {
    event.preventDefault();
    void go(asking);
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && picked.size && !asking.open) pickNone();
  });
}

function boxes(): HTMLInputElement[] {
  return [...document.querySelectorAll<HTMLInputElement>("[data-pick]")];
}

function idOf(box: HTMLInputElement): string {
  return box.dataset["pick"] ?? "";
}

function mark(box: HTMLInputElement, isPicked: boolean): void {
  if (isPicked) picked.set(idOf(box), { name: box.dataset["name"] ?? "", state: box.dataset["pickState"] ?? "" });
  else picked.delete(idOf(box));
}

function pick(box: HTMLInputElement, isRange: boolean): void {
  if (box.matches("[data-pick-all]")) {
    for (const one of boxes()) mark(one, box.checked);
  } else if (box.matches("[data-pick]")) {
    const from = isRange ? boxes().findIndex((one) => idOf(one) === last) : -1;
    const to = boxes().indexOf(box);
    const range = from < 0 ? [box] : boxes().slice(Math.min(from, to), Math.max(from, to) + 1);
    for (const one of range) mark(one, box.checked);
    last = idOf(box);
  }
  show();
}

function pickNone(): void {
  picked.clear();
  show();
}

function walk(event: KeyboardEvent): void {
  const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (!step || !(event.target instanceof HTMLInputElement) || !event.target.matches("[data-pick]")) return;
  event.preventDefault();
  const next = boxes()[boxes().indexOf(event.target) + step];
  if (!next) return;
  if (event.shiftKey) {
    mark(event.target, true);
    mark(next, true);
    last = idOf(next);
  }
  next.focus();
  show();
}

/** Draws the selection: after a choice, and after every refresh of the list. */
function show(): void {
  for (const box of boxes()) {
    const isPicked = picked.has(idOf(box));
    if (box.checked !== isPicked) box.checked = isPicked;
    if (isPicked) mark(box, true); // its state may have changed
    box.closest("tr")?.toggleAttribute("data-is-picked", isPicked);
  }
  const all = document.querySelector<HTMLInputElement>("[data-pick-all]");
  const here = boxes().filter((box) => box.checked).length;
  if (all) {
    all.checked = here > 0 && here === boxes().length;
    all.indeterminate = here > 0 && !all.checked;
  }
  const bar = document.querySelector<HTMLElement>("[data-picked]");
  if (bar) bar.hidden = picked.size === 0;
  const count = document.querySelector("[data-picked-count]");
  if (count && count.textContent !== String(picked.size)) count.textContent = String(picked.size);
  for (const button of document.querySelectorAll<HTMLButtonElement>("[data-act-on]")) button.disabled = !concerned(button.dataset["actOn"] as Act).length;
}

/** The ids of the picked jobs that the act applies to. */
function concerned(one: Act): string[] {
  return [...picked].filter(([, { state }]) => APPLIES[one].includes(state)).map(([id]) => id);
}

function ask(asking: HTMLDialogElement, chosen: Act): void {
  act = chosen;
  const words = WORDS[act];
  const count = concerned(act).length;
  const jobs = count === 1 ? "1 job" : `${count} jobs`;
  const left = picked.size - count;
  text(asking, "#act-on-picked-title", `${words.title} ${jobs}`);
  text(asking, "[data-picked-says]", left ? `${words.says} ${left} of the selected ${left === 1 ? "is" : "are"} left as ${left === 1 ? "it is" : "they are"}.` : words.says);
  text(asking, "[data-picked-go]", `${words.title} ${jobs}`);
  asking.querySelector("[data-outcomes]")?.replaceChildren();
  asking.querySelector(".said")?.replaceChildren();
  asking.querySelector("[data-picked-go]")?.classList.toggle("danger", act === "terminate");
  asking.showModal();
}

async function go(asking: HTMLDialogElement): Promise<void> {
  const reason = asking.querySelector<HTMLInputElement>("[name=reason]");
  const button = asking.querySelector<HTMLButtonElement>("[data-picked-go]");
  const said = asking.querySelector<HTMLElement>(".said");
  if (!reason || !button || !said) return;
  button.disabled = true;
  try {
    const body = { act, job_ids: concerned(act), reason: reason.value };
    tell(asking, (await call<{ items: Outcome[] }>("POST", "/api/v1/admin/jobs/acts", body)).items);
    reason.value = "";
  } catch (error) {
    sayError(said, error);
  } finally {
    button.disabled = false;
    await refresh("#jobs");
  }
}

/** If all succeeded, closes and reports it; else keeps the refused ones selected, each with its reason. */
function tell(asking: HTMLDialogElement, outcomes: Outcome[]): void {
  const refused = outcomes.filter((one) => one.failure);
  for (const one of outcomes) if (!one.failure) picked.delete(one.job_id);
  const done = outcomes.length - refused.length;
  const items = refused.map((one) => {
    const item = document.createElement("li");
    const name = Object.assign(document.createElement("strong"), { textContent: picked.get(one.job_id)?.name ?? one.job_id });
    item.append(name, ` ${one.failure?.sentence ?? ""}`);
    return item;
  });
  asking.querySelector("[data-outcomes]")?.replaceChildren(...items);
  show();
  if (!refused.length) asking.close();
  else text(asking, "[data-picked-says]", `${done} ${WORDS[act].done}, ${refused.length} refused:`);
  if (done) toast(`${done} ${done === 1 ? "job" : "jobs"} ${WORDS[act].done}.`);
}

function text(root: ParentNode, selector: string, words: string): void {
  const place = root.querySelector(selector);
  if (place) place.textContent = words;
}
