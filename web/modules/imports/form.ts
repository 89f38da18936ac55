// The form that imports a dataset: its tar is looked at, counted, sent and handed over; begun again, it goes on.

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
  ["zip", [0x50, 0x4b, 0x03, 0x04]],
];
const TEXTS = ["name", "environment", "illumination", "region", "platform"];
const MOST_CLASSES_BYTES = 64 * 1024;

const form = document.querySelector<HTMLFormElement>("form#import");
if (form) install(form);

function install(form: HTMLFormElement): void {
  let sending: AbortController | undefined;
  fileOf(form, "tar").addEventListener("change", () => chosen(form));
  if (fileOf(form, "tar").files?.length) chosen(form); // a browser that came back to this page kept it
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

/** The tar on the platform, and its import asked for; the id of that. */
async function imported(form: HTMLFormElement, values: FormData, signal: AbortSignal): Promise<string> {
  const tar = fileOf(form, "tar").files?.[0];
  if (!tar) throw new Error("Choose a tar first.");
  const classes = await classesOf(values);
  const { act, bytes } = meter(form);
  act("Computing the checksum");
  const heard: Heard = {
    counted: (_file, done_bytes) => bytes(done_bytes, tar.size),
    sent: (_file, done_bytes) => bytes(done_bytes, tar.size),
    away: (problem, wait_ms) => act(`${problem.title}. Trying again in ${Math.ceil(wait_ms / 1000)} s`),
    back: () => act("Uploading"),
  };
  const sum = await summed(tar, heard, signal);
  act("Uploading");
  const uploadId = await sent(tar, sum, { name: "dataset", target_id: null }, heard, signal);
  signal.throwIfAborted();
  const body = {
    upload_id: uploadId,
    ...Object.fromEntries(TEXTS.map((name) => [name, String(values.get(name) ?? "").trim()])),
    classes,
    existing: values.has("adds") ? "add" : "refuse",
    sets_splits: values.has("splits"),
    is_public: values.has("public"),
  };
  const key = `import-${await sha256Of(new Blob([JSON.stringify(body)]))}`; // asked again, it is the same import
  const made = await call<{ id: string }>("POST", "/api/v1/dataset-imports", body, { "Idempotency-Key": key });
  return made.id;
}

/** What the file of classes says; null where none was chosen. */
async function classesOf(values: FormData): Promise<string | null> {
  const file = values.get("classes");
  if (!(file instanceof File) || !file.size) return null;
  if (file.size > MOST_CLASSES_BYTES) throw new Error(`${file.name} has ${file.size} bytes; a file of classes has at most ${MOST_CLASSES_BYTES}.`);
  return file.text();
}

/** A tar is there: what it is called is proposed, and what cannot be imported is said at once. */
function chosen(form: HTMLFormElement): void {
  const file = fileOf(form, "tar").files?.[0];
  const name = form.querySelector<HTMLInputElement>("[name=name]");
  if (file && name && !name.value) name.value = file.name.replace(/\.tar$/, "").slice(0, name.maxLength);
  part(form, "#chosen").textContent = file ? file.name : "";
  part(form, "#said").replaceChildren();
  const begin = form.querySelector<HTMLButtonElement>("[type=submit]");
  if (begin) begin.disabled = !file;
  if (file) void looked(form, file);
}

async function looked(form: HTMLFormElement, file: File): Promise<void> {
  const begin = new Uint8Array(await file.slice(0, 8).arrayBuffer());
  const tool = COMPRESSED.find(([, magic]) => magic.every((byte, at) => begin[at] === byte))?.[0];
  if (!tool || fileOf(form, "tar").files?.[0] !== file) return;
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

function fileOf(form: HTMLFormElement, name: string): HTMLInputElement {
  return form.querySelector<HTMLInputElement>(`input[name="${name}"]`)!;
}

function part(form: HTMLFormElement, selector: string): HTMLElement {
  return form.querySelector<HTMLElement>(selector)!;
}
