// Turns complete uploads into a recording, once, and follows it until the platform has registered or refused it.

import { call, type Problem, RefusedError } from "../api.js";
import { sha256Of } from "../file_hash.js";
import type { Bag } from "./bags.js";
import { patiently, pause } from "./concurrency.js";
import { all, type Heard } from "./file_upload.js";
import { linesOf } from "./checksums.js";

export interface Finding {
  code: string;
  severity: string;
  topic: string;
  message: string;
}

export interface Recording {
  id: string;
  filename: string;
  sha256: string;
  state: string;
  findings: Finding[];
}

interface Job {
  id: string;
  state: string;
  progress: { stage: string; done: number; total: number };
  failure: { code: string; sentence: string } | null;
}

const LOOK_MS = 700;

/** The recording with these very bytes that the sequence already has; hashes only if one has this name. */
export async function standing(
  bag: Bag,
  sums: () => Promise<string[]>,
  sequenceId: string,
): Promise<Recording | undefined> {
  const recordings = await all<Recording>(`/api/v1/sequences/${sequenceId}/recordings`);
  const named = recordings.filter((one) => one.filename === bag.name && one.state !== "refused");
  if (!named.length) return undefined;
  const counted = await sums();
  const files = bag.files.map((file, at) => ({ name: file.name, sum: counted[at] ?? "" }));
  const whole = files.length > 1 ? await sha256Of(linesOf(files)) : counted[0];
  return named.find((one) => one.sha256 === whole);
}

/** Creates the recording of complete uploads; a repetition returns the same one. */
export async function sealed(
  bag: Bag,
  uploads: readonly string[],
  sequenceId: string,
): Promise<{ recording: Recording; job: Job }> {
  const several = { upload_ids: uploads, name: bag.name };
  const body = uploads.length > 1 ? several : { upload_id: uploads[0] };
  const key = `seal-${[...uploads].sort()[0]}-${uploads.length}`;
  return call("POST", `/api/v1/sequences/${sequenceId}/recordings`, body, { "Idempotency-Key": key });
}

/** Polls until it is registered or refused. Throws `RefusedError` if the job ended with neither. */
export async function read(
  recording: Recording,
  sequenceId: string,
  jobId: string | undefined,
  heard: Heard & { reading(done: number, total: number): void },
  signal: AbortSignal,
): Promise<Recording> {
  const away = (problem: Problem, wait_ms: number): void => heard.away(problem, wait_ms);
  const ask = <T>(path: string): Promise<T> => patiently(() => call<T>("GET", path), signal, away);
  for (let now = recording; ; ) {
    if (now.state !== "received") return now;
    const job = jobId ? await ask<Job>(`/api/v1/jobs/${jobId}`) : undefined;
    now = await ask<Recording>(`/api/v1/sequences/${sequenceId}/recordings/${recording.id}`);
    heard.back();
    if (now.state !== "received") return now;
    if (job && ["failed", "cancelled"].includes(job.state)) throw new RefusedError(ended(job), new Headers());
    if (job) heard.reading(job.progress.done, job.progress.total);
    await pause(LOOK_MS, signal);
  }
}

function ended(job: Job): Problem {
  const detail = job.failure?.sentence ?? `The job that reads it was ${job.state}.`;
  return { title: "Not read", status: 409, detail, code: job.failure?.code ?? job.state, request_id: "" };
}
