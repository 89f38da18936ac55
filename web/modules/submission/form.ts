// The form of a submission: a zip is checked when it is chosen, and sent once, when the reader submits it.

import { call } from "../api.js";
import { sayError } from "../notices.js";
import { checkArrays } from "./frame_arrays.js";
import { examined, type Manifest, manifestOf } from "./frames.js";
import { type Entry, submit } from "./file_upload.js";
import { installSenses, modalityOf, sayModality } from "./senses.js";
import { meter } from "./meter.js";
import { isUnreadable, showProgress, showVerdict, sized } from "./verdict.js";

const form = document.querySelector<HTMLFormElement>("form#submit");
if (form) install(form);

function install(form: HTMLFormElement): void {
  const state: { file: File | null; why: string; sending: AbortController | null } = { file: null, why: "Choose a zip first.", sending: null };
  const manifest = call("GET", form.dataset["manifest"] ?? "").then(manifestOf);
  manifest.catch(() => undefined); // reported when a zip is checked

  const show = (): void => showActs(form, state.why, state.sending !== null);
  installSenses(form);
  installDrop(form);
  fileOf(form).addEventListener("change", () => void chosen());
  if (fileOf(form).files?.length) void chosen(); // before this module was there
  form.querySelector("select[name=team_id]")?.addEventListener("change", () => showQuota(form));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const kind = (event.submitter as HTMLButtonElement | null)?.value === "validation" ? "validation" : "entry";
    if (state.file && !state.why && !state.sending) void send(state.file, kind);
  });
  form.querySelector("#stop")?.addEventListener("click", () => state.sending?.abort());
  if (fileOf(form).files?.length) void chosen(); // the browser restored the form

  async function chosen(): Promise<void> {
    const file = fileOf(form).files?.[0] ?? null;
    state.file = file;
    state.why = file ? "Checking the zip…" : "Choose a zip first.";
    if (file) goOnWith(form, file);
    show();
    if (!file) return;
    const why = await looked(form, file, manifest, () => state.file === file);
    if (state.file !== file) return; // another file was chosen meanwhile
    state.why = why;
    show();
  }

  async function send(file: File, kind: Entry["kind"]): Promise<void> {
    state.sending = new AbortController();
    const entry = entryOf(form, kind); // before its fields are disabled
    const heard = meter(form);
    said(form).replaceChildren();
    show();
    try {
      const { id, isKnown } = await submit(file, entry, heard, state.sending.signal);
      location.assign(`/submissions/${id}${isKnown ? "?known=true" : ""}`);
    } catch (error) {
      if (state.sending?.signal.aborted) said(form).textContent = "Stopped. Uploaded data is kept; submit again to resume.";
      else sayError(said(form), error);
      state.sending = null;
      show();
    }
  }
}

/** Checks the zip and shows the result; returns the reason why it cannot be sent, or "". `isWanted`: no other file was
 * chosen. */
async function looked(form: HTMLFormElement, file: File, manifest: Promise<Manifest>, isWanted: () => boolean): Promise<string> {
  const place = form.querySelector<HTMLElement>("#verdict");
  const most_bytes = Number(form.dataset["mostBytes"]);
  if (!place) return "";
  try {
    const known = await manifest;
    const verdict = await examined(file, known);
    if (!isWanted()) return "";
    showVerdict(place, file, known, verdict);
    if (isUnreadable(verdict)) return "Select another file: this one would be rejected.";
    const heard = showProgress(place, verdict.frames.size);
    const arrays = await checkArrays(file, verdict.frames, known.shape, (done) => heard(done) && isWanted());
    if (!isWanted()) return "";
    for (const { frame } of arrays.problems) verdict.frames.delete(frame ?? "");
    verdict.problems.push(...arrays.problems);
    showVerdict(place, file, known, verdict, arrays);
    if (verdict.problems.length) return "Fix the zip first: it would be rejected.";
    return file.size > most_bytes ? `It has ${sized(file.size)}; frames of this phase never need more than ${sized(most_bytes)}.` : "";
  } catch (error) {
    sayError(place, error);
    return "The zip could not be checked.";
  }
}

function entryOf(form: HTMLFormElement, kind: Entry["kind"]): Entry {
  const values = new FormData(form);
  const text = (name: string): string => String(values.get(name) ?? "").trim();
  return {
    phase_id: form.dataset["phase"] ?? "",
    team_id: text("team_id"),
    method: text("method"),
    description: text("description").replaceAll("\r\n", "\n"),
    modality: modalityOf(form),
    kind,
  };
}

/** Fills in the facts of the unfinished submission if the file has its size. */
function goOnWith(form: HTMLFormElement, file: File): void {
  const draft = document.querySelector<HTMLElement>(`[data-draft][data-bytes="${file.size}"]`);
  const method = form.querySelector<HTMLInputElement>("[name=method]");
  if (!draft || !method || method.value) return;
  method.value = draft.dataset["method"] ?? "";
  const description = form.querySelector<HTMLTextAreaElement>("[name=description]");
  if (description) description.value = draft.dataset["description"] ?? "";
  const team = form.querySelector<HTMLSelectElement>("select[name=team_id]");
  if (team) team.value = draft.dataset["team"] ?? "";
  sayModality(form, draft.dataset["modality"] ?? "");
  showQuota(form);
}

function showActs(form: HTMLFormElement, why: string, isSending: boolean): void {
  for (const field of form.elements) {
    if (!(field instanceof HTMLInputElement || field instanceof HTMLSelectElement || field instanceof HTMLTextAreaElement || field instanceof HTMLButtonElement)) continue;
    if (field.id === "stop") continue;
    field.disabled = isSending || (field.name === "kind" && why !== "");
  }
  const said = form.querySelector<HTMLElement>("#why");
  if (said) said.textContent = isSending ? "" : why;
  form.querySelector<HTMLElement>("#sending")?.toggleAttribute("hidden", !isSending);
  form.querySelector<HTMLElement>("#acts")?.toggleAttribute("hidden", isSending);
}

function showQuota(form: HTMLFormElement): void {
  const team = form.querySelector<HTMLSelectElement>("select[name=team_id]")?.value;
  for (const card of document.querySelectorAll<HTMLElement>("[data-quota]")) card.hidden = team !== undefined && card.dataset["quota"] !== team;
}

/** The field covers the drop area; this only highlights it during a drag. */
function installDrop(form: HTMLFormElement): void {
  const drop = form.querySelector<HTMLElement>("#drop");
  for (const name of ["dragenter", "dragover"]) drop?.addEventListener(name, () => drop.toggleAttribute("data-over", true));
  for (const name of ["dragleave", "drop"]) drop?.addEventListener(name, () => drop.toggleAttribute("data-over", false));
}

function fileOf(form: HTMLFormElement): HTMLInputElement {
  return form.querySelector<HTMLInputElement>("#file")!;
}

function said(form: HTMLFormElement): HTMLElement {
  return form.querySelector<HTMLElement>("#said")!;
}
