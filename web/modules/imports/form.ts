// The form that imports a dataset: its archive is checked, hashed, sent and submitted, and resumes after an
// interruption.
//
// An archive that the server can already read is named by root and path instead.

import { call } from "../api.js";
import { sha256Of } from "../file_hash.js";
import { sayError, sayProblem } from "../notices.js";
import { meter } from "../submission/meter.js";
import { type Heard, sent, summed } from "../upload/file_upload.js";

const COMPRESSED: [string, number[]][] = [
  ["gzip", [0x1f, 0x8b]],
  ["bzip2", [0x42, 0x5a, 0x68]],
  ["xz", [0xfd, 0x37, 0x7a, 0x58, 0x5a]],
  ["zstd", [0x28, 0xb5, 0x2f, 0xfd]],
];
const NAMED = ["layout", "grid"];
const TEXTS = ["name", "environment", "illumination", "region", "platform"];
const MOST_CLASSES_BYTES = 64 * 1024;

const form = document.querySelector<HTMLFormElement>("form#import");
if (form) install(form);

function install(form: HTMLFormElement): void {
  let sending: AbortController | undefined;
  fileOf(form, "archive").addEventListener("change", () => chosen(form));
  form.querySelector("[name=path]")?.addEventListener("input", () => chosen(form));
  form.querySelector("[name=path]")?.addEventListener("change", () => {
    const name = form.querySelector<HTMLInputElement>("[name=name]");
    if (name && !name.value) name.value = nameOf(pathOf(form).split("/").at(-1) ?? "", name);
  });
  if (fileOf(form, "archive").files?.length || pathOf(form)) chosen(form); // the browser restored the form
  form.querySelector("#stop")?.addEventListener("click", () => sending?.abort());
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (!sending) void begin();
  });

  async function begin(): Promise<void> {
    const stop = new AbortController();
    sending = stop;
    const said = part(form, "#said");
    said.replaceChildren();
    const values = new FormData(form); // before its fields are disabled
    show(form, true);
    try {
      location.assign(`/imports/${await imported(form, values, stop.signal)}`);
    } catch (error) {
      if (stop.signal.aborted) said.textContent = "Stopped. Uploaded data is kept; start again to resume.";
      else sayError(said, error);
      sending = undefined;
      show(form, false);
    }
  }
}

/** Starts the import of the archive, after an upload unless it is in place; returns the import's id. */
async function imported(form: HTMLFormElement, values: FormData, signal: AbortSignal): Promise<string> {
  const classes = await classesOf(values);
  const path = pathOf(form);
  const source = path
    ? { in_place: { root: String(values.get("root")), path } }
    : { upload_id: await uploaded(form, signal) };
  signal.throwIfAborted();
  const body = {
    ...source,
    ...Object.fromEntries(TEXTS.map((name) => [name, String(values.get(name) ?? "").trim()])),
    ...Object.fromEntries(NAMED.map((name) => [name, values.get(name) || null])),
    classes,
    existing: values.has("adds") ? "add" : "refuse",
    sets_splits: values.has("splits"),
    is_public: values.has("public"),
  };
  // A repeated upload is the same import. An archive in place may have changed, so each click is a new import.
  const asked = JSON.stringify(path ? { ...body, at_ms: Date.now() } : body);
  const key = `import-${await sha256Of(new Blob([asked]))}`;
  const made = await call<{ id: string }>("POST", "/api/v1/dataset-imports", body, { "Idempotency-Key": key });
  return made.id;
}

/** The id of the complete upload of the chosen archive. */
async function uploaded(form: HTMLFormElement, signal: AbortSignal): Promise<string> {
  const archive = fileOf(form, "archive").files?.[0];
  if (!archive) throw new Error("Choose a tar or ZIP first.");
  const { act, bytes } = meter(form);
  act("Computing the checksum");
  const heard: Heard = {
    counted: (_file, done_bytes) => bytes(done_bytes, archive.size),
    sent: (_file, done_bytes) => bytes(done_bytes, archive.size),
    away: (problem, wait_ms) => act(`${problem.title}. Trying again in ${Math.ceil(wait_ms / 1000)} s`),
    back: () => act("Uploading"),
  };
  const sum = await summed(archive, heard, signal);
  act("Uploading");
  return sent(archive, sum, { name: "dataset", target_id: null }, heard, signal);
}

/** The text of the class map file; null if no file was chosen. */
async function classesOf(values: FormData): Promise<string | null> {
  const file = values.get("classes");
  if (!(file instanceof File) || !file.size) return null;
  if (file.size > MOST_CLASSES_BYTES) throw new Error(`${file.name} has ${file.size} bytes; a file of classes has at most ${MOST_CLASSES_BYTES}.`);
  return file.text();
}

/** Proposes the archive's name for the import, and shows at once why an archive cannot be imported. */
function chosen(form: HTMLFormElement): void {
  const file = fileOf(form, "archive").files?.[0];
  const path = pathOf(form);
  const name = form.querySelector<HTMLInputElement>("[name=name]");
  if (name && file && !path && !name.value) name.value = nameOf(file.name, name);
  part(form, "#chosen").textContent = path ? "" : (file?.name ?? "");
  fileOf(form, "archive").disabled = path !== "";
  part(form, "#said").replaceChildren();
  const begin = form.querySelector<HTMLButtonElement>("[type=submit]");
  if (begin) begin.disabled = !file && !path;
  if (file && !path) void looked(form, file);
}

async function looked(form: HTMLFormElement, file: File): Promise<void> {
  const begin = new Uint8Array(await file.slice(0, 8).arrayBuffer());
  const tool = COMPRESSED.find(([, magic]) => magic.every((byte, at) => begin[at] === byte))?.[0];
  if (!tool || pathOf(form) || fileOf(form, "archive").files?.[0] !== file) return;
  const detail = `${file.name}: it is compressed by ${tool} (unpack it, or \`gunzip\` it first)`;
  sayProblem(part(form, "#said"), { title: "Compressed", status: 422, detail, code: "DST-003", request_id: "" });
  const button = form.querySelector<HTMLButtonElement>("[type=submit]");
  if (button) button.disabled = true;
}

function show(form: HTMLFormElement, isSending: boolean): void {
  for (const field of form.elements) {
    if (!(field instanceof HTMLInputElement || field instanceof HTMLSelectElement || field instanceof HTMLButtonElement) || field.id === "stop") continue;
    field.disabled = isSending;
  }
  part(form, "#sending").toggleAttribute("hidden", !isSending);
  form.querySelector<HTMLElement>("#acts")?.toggleAttribute("hidden", isSending);
}

/** The name of a file without its ending, as long as the field takes. */
function nameOf(file: string, field: HTMLInputElement): string {
  return file.replace(/\.(tar|zip)$/i, "").slice(0, field.maxLength);
}

/** The path of an archive in place, trimmed; empty if none is named. */
function pathOf(form: HTMLFormElement): string {
  return form.querySelector<HTMLInputElement>("input[name=path]")?.value.trim() ?? "";
}

function fileOf(form: HTMLFormElement, name: string): HTMLInputElement {
  return form.querySelector<HTMLInputElement>(`input[name="${name}"]`)!;
}

function part(form: HTMLFormElement, selector: string): HTMLElement {
  return form.querySelector<HTMLElement>(selector)!;
}
