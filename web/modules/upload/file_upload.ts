// One file: hashed, announced once, and sent from the platform's offset.
//
// The browser stores only sha256 sums. The platform is queried for an upload of the same bytes for the same purpose. So
// a reloaded page, another browser, or the command resumes at the stored offset, and nothing is sent twice
// (`stone_client/files/tus.py` does the same).

import { call, type Problem } from "../api.js";
import { sha256Of } from "../file_hash.js";
import { createUpload, findUpload, type Opened, sendMissing } from "../tus.js";
import { Lane, patiently } from "./concurrency.js";
import { knownSum, keepSum } from "./checksums.js";

/** An upload as `GET /uploads` lists it. */
export interface UploadItem {
  id: string;
  purpose: string;
  target_id: string | null;
  filename: string;
  length_bytes: number;
  offset_bytes: number;
  declared_sha256: string | null;
  state: string;
  created_at: string;
  expires_at: string;
}

interface Listed<T> {
  items: T[];
  next: string | null;
}

/** The purpose of an upload: a recording of a sequence, or a dataset, which has no target. */
export interface Purpose {
  name: "recording" | "dataset";
  target_id: string | null;
}

/** Callbacks for progress, and for the reason of a pause. */
export interface Heard {
  counted(file: File, bytes: number): void;
  sent(file: File, bytes: number): void;
  away(problem: Problem, wait_ms: number): void;
  back(): void;
}

const counting = new Lane(1);
const sending = new Lane(3);

/** The sha256 of the file; computed once, one file at a time. */
export function summed(file: File, heard: Heard, signal: AbortSignal): Promise<string> {
  const known = knownSum(file);
  if (known) {
    heard.counted(file, file.size);
    return Promise.resolve(known);
  }
  return counting.run(async () => {
    const sum = await sha256Of(file, (bytes) => heard.counted(file, bytes), signal);
    keepSum(file, sum);
    return sum;
  }, signal);
}

/** Sends the missing bytes of the file; returns the id of the complete upload. Throws refusals. */
export function sent(file: File, sha256: string, purpose: Purpose, heard: Heard, signal: AbortSignal): Promise<string> {
  const away = (problem: Problem, wait_ms: number): void => heard.away(problem, wait_ms);
  return sending.run(() => patiently(async () => {
    const upload = (await begun(file, sha256, purpose)) ?? (await created(file, sha256, purpose));
    heard.back();
    heard.sent(file, upload.offset_bytes);
    if (upload.offset_bytes < file.size) {
      signal.throwIfAborted();
      await sendMissing(file, upload, (bytes) => heard.sent(file, bytes), signal, null);
    }
    heard.sent(file, file.size);
    return upload.id;
  }, signal, away), signal);
}

/** The unfinished or complete upload of these bytes for this purpose, with its current offset. */
async function begun(file: File, sha256: string, purpose: Purpose): Promise<Opened | null> {
  for (const state of ["open", "complete"]) {
    for (const item of await all<UploadItem>(`/api/v1/uploads?state=${state}`)) {
      const isSame = item.purpose === purpose.name && item.target_id === purpose.target_id && item.filename === file.name;
      if (isSame && item.length_bytes === file.size && item.declared_sha256 === sha256) return findUpload(item.id);
    }
  }
  return null;
}

function created(file: File, sha256: string, purpose: Purpose): Promise<Opened> {
  const said = { purpose: purpose.name, ...(purpose.target_id ? { target_id: purpose.target_id } : {}), sha256 };
  return createUpload(file, said, freshKey());
}

/** An Idempotency-Key of a request that is meant once. */
export function freshKey(): string {
  return crypto.randomUUID?.() ?? `${Date.now()}-${Math.random()}`; // missing on plain HTTP sites
}

/** All of a list, page by page. */
export async function all<T>(path: string): Promise<T[]> {
  const found: T[] = [];
  const joint = path.includes("?") ? "&" : "?";
  for (let cursor: string | null = ""; cursor !== null; ) {
    const more: string = cursor ? `&cursor=${encodeURIComponent(cursor)}` : "";
    const page: Listed<T> = await call<Listed<T>>("GET", `${path}${joint}limit=200${more}`);
    found.push(...page.items);
    cursor = page.next;
  }
  return found;
}
