// A submission from a file to the queue: hashed, announced, sent and finalised; it resumes after any interruption.
//
// Nothing is stored in the browser: the platform is queried for the team's submission of the same bytes under the same
// name. So a page that was left resumes, and the same file is never scored twice by accident.

import { call, RefusedError } from "../api.js";
import { sha256Of } from "../file_hash.js";
import { createUpload, findUpload, type Opened, sendMissing } from "../tus.js";

const GONE_ON = ["draft", "queued", "scoring", "scored", "valid", "invalid"];
const MOST_PAGES = 10;
const WAIT_MS = [500, 1000, 2000, 4000, 8000];

/** The facts of a submission: phase, team, method. */
export interface Entry {
  phase_id: string;
  team_id: string;
  method: string;
  modality: string;
  description: string;
  kind: "entry" | "validation";
}

/** Progress callbacks. */
export interface Heard {
  act: (name: string) => void;
  bytes: (done_bytes: number, total_bytes: number) => void;
}

interface Submission {
  id: string;
  state: string;
  sha256: string;
  size_bytes: number;
  method: string;
  modality: string;
  description: string;
  revision: number;
  withdrawn_at: string | null;
  upload_id: string | null;
}

/** Returns the URL of the submission; `isKnown` if this very file was submitted before. Throws `RefusedError`,
 * `AbortError`. */
export async function submit(
  file: File,
  entry: Entry,
  heard: Heard,
  signal: AbortSignal,
): Promise<{ id: string; isKnown: boolean }> {
  heard.act("Computing the checksum");
  const sha256 = await sha256Of(file, (done_bytes) => heard.bytes(done_bytes, file.size), signal);
  const found = await standing(entry, file, sha256);
  if (found && found.state !== "draft") return { id: found.id, isKnown: true };
  const draft = await described(found ?? (await announced(entry, file, sha256)), entry);
  heard.act("Uploading");
  const upload = await opened(draft, file, sha256);
  heard.bytes(upload.offset_bytes, file.size);
  if (upload.offset_bytes < file.size) {
    await sendMissing(file, upload, (done_bytes) => heard.bytes(done_bytes, file.size), signal);
  }
  heard.act("Queueing");
  signal.throwIfAborted();
  await patiently("POST", `/api/v1/submissions/${draft.id}/finalize`, { upload_id: upload.id }, `finalize-${upload.id}`);
  return { id: draft.id, isKnown: false };
}

/** The newest submission of this file to this phase by this team, under this name and in this track. */
async function standing(entry: Entry, file: File, sha256: string): Promise<Submission | null> {
  const { phase_id, team_id, kind } = entry;
  let query = new URLSearchParams({ phase_id, team_id, kind, limit: "200" });
  for (let page = 0; page < MOST_PAGES; page++) {
    const listed = await call<{ items: Submission[]; next: string | null }>("GET", `/api/v1/submissions?${query}`);
    const same = listed.items.find(
      (one) =>
        one.sha256 === sha256 && one.size_bytes === file.size && one.method === entry.method &&
        one.modality === entry.modality && GONE_ON.includes(one.state) && one.withdrawn_at === null,
    );
    if (same) return call<Submission>("GET", `/api/v1/submissions/${same.id}`);
    if (!listed.next) return null;
    query = new URLSearchParams({ phase_id, team_id, kind, limit: "200", cursor: listed.next });
  }
  return null;
}

async function announced(entry: Entry, file: File, sha256: string): Promise<Submission> {
  const { phase_id, kind, ...said } = entry;
  const body = { ...said, sha256, size_bytes: file.size, ...(kind === "entry" ? { kind } : {}) };
  const where = kind === "entry" ? "submissions" : "validations";
  return (await patiently("POST", `/api/v1/phases/${phase_id}/${where}`, body, newKey())) as Submission;
}

/** The draft with the page that was written now. */
async function described(draft: Submission, entry: Entry): Promise<Submission> {
  if (!entry.description || draft.description === entry.description) return draft;
  const match = { "If-Match": `"${draft.revision}"` };
  const changed = await call<Submission>("PATCH", `/api/v1/submissions/${draft.id}`, { description: entry.description }, match);
  return { ...changed, upload_id: draft.upload_id };
}

/** The draft's unfinished upload, or a new one. */
async function opened(draft: Submission, file: File, sha256: string): Promise<Opened> {
  const begun = draft.upload_id ? await findUpload(draft.upload_id) : null;
  return begun ?? createUpload(file, { purpose: "submission", target_id: draft.id, sha256 }, newKey());
}

/** Sends the call with its key, again if there was no response: the platform executes it once. */
async function patiently(method: string, path: string, body: unknown, key: string): Promise<unknown> {
  for (const wait_ms of WAIT_MS) {
    try {
      return await call(method, path, body, { "Idempotency-Key": key });
    } catch (error) {
      if (!(error instanceof RefusedError) || ![0, 502, 503, 504].includes(error.problem.status)) throw error;
      await new Promise((resolve) => setTimeout(resolve, wait_ms));
    }
  }
  return call(method, path, body, { "Idempotency-Key": key });
}

/** 128 random bits; `crypto.randomUUID` is only there over TLS. */
function newKey(): string {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}
