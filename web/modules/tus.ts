// A file goes to the platform by tus 1.0: created by one call, then sent, and resumed after any interruption.
//
// This module creates uploads itself, because the response contains the number of bytes already stored, possibly all.

import "tus-js-client";
import type { DetailedError, HttpRequest } from "tus-js-client";

import { RefusedError, type Problem } from "./api.js";
import { CheckedPieces, Pace } from "./pieces.js";
import { again, csrfToken } from "./session.js";

const AT = "/api/v1/uploads";
const VERSION = "1.0.0";
const RETRY_MS = [0, 500, 1000, 2000, 4000, 8000, 15_000, 30_000, 30_000, 30_000];
const AGAIN = [0, 408, 423, 429, 500, 502, 503, 504];
const MOST_SESSIONS = 10;

/** An upload that is open: its id, and how many bytes of it are there. */
export interface Opened {
  id: string;
  offset_bytes: number;
}

/** Announces a file with purpose, target_id and sha256. Throws `RefusedError`. */
export async function createUpload(file: File, said: Record<string, string>, key: string): Promise<Opened> {
  const metadata = Object.entries({ filename: file.name, ...said }).map(([name, text]) => `${name} ${base64(text)}`);
  const answer = await asked("POST", AT, {
    "Upload-Length": String(file.size),
    "Upload-Metadata": metadata.join(","),
    "Idempotency-Key": key,
  });
  const id = (answer.headers.get("Location") ?? "").split("/").at(-1) ?? "";
  return { id, offset_bytes: Number(answer.headers.get("Upload-Offset") ?? 0) };
}

/** The current upload; null if it is gone, or another user's. */
export async function findUpload(id: string): Promise<Opened | null> {
  try {
    const answer = await asked("HEAD", `${AT}/${encodeURIComponent(id)}`, {});
    return { id, offset_bytes: Number(answer.headers.get("Upload-Offset") ?? 0) };
  } catch (error) {
    if (error instanceof RefusedError && [404, 410].includes(error.problem.status)) return null;
    throw error;
  }
}

/** Sends the missing bytes, each piece with its checksum; `heard` receives the number of stored bytes. Callers with
 * their own retries pass `retry_ms` as null. If the session ends, sending resumes once the reader has signed in again.
 * Throws `RefusedError`, and `AbortError`. */
export async function sendMissing(
  file: File,
  upload: Opened,
  heard: (done_bytes: number) => void,
  signal: AbortSignal,
  retry_ms: number[] | null = RETRY_MS,
): Promise<void> {
  for (let sessions = 1; ; sessions++) {
    const sentWith = csrfToken();
    try {
      return await sendRest(file, upload, heard, signal, retry_ms);
    } catch (error) {
      const isOver = !(error instanceof RefusedError) || sessions >= MOST_SESSIONS;
      if (isOver || !(await again(error.problem, sentWith))) throw error;
    }
  }
}

function sendRest(
  file: File,
  upload: Opened,
  heard: (done_bytes: number) => void,
  signal: AbortSignal,
  retry_ms: number[] | null,
): Promise<void> {
  return new Promise((resolve, reject) => {
    signal.throwIfAborted(); // a signal that has already fired sends no event
    const pieces = new CheckedPieces(file);
    const pace = new Pace();
    const sending = new tus.Upload(file, {
      uploadUrl: `${AT}/${encodeURIComponent(upload.id)}`,
      chunkSize: pace.bytes,
      fileReader: { openFile: async () => pieces },
      retryDelays: retry_ms,
      storeFingerprintForResuming: false,
      onBeforeRequest: (request: HttpRequest) => {
        request.setHeader("X-CSRF-Token", csrfToken());
        if (request.getMethod() === "PATCH") request.setHeader("Upload-Checksum", pieces.checksum);
      },
      onShouldRetry: (error: DetailedError) => AGAIN.includes(error.originalResponse?.getStatus() ?? 0),
      onChunkComplete: () => {
        sending.options.chunkSize = pace.next();
      },
      onProgress: (sent_bytes: number) => heard(sent_bytes),
      onSuccess: () => resolve(),
      onError: (error: Error | DetailedError) => reject(refusal(error)),
    });
    signal.addEventListener("abort", () => {
      void sending.abort();
      reject(signal.reason as Error);
    });
    sending.start();
  });
}

async function asked(method: string, path: string, headers: Record<string, string>): Promise<Response> {
  const sentWith = csrfToken();
  try {
    return await answered(method, path, headers);
  } catch (error) {
    if (!(error instanceof RefusedError) || !(await again(error.problem, sentWith))) throw error;
    return answered(method, path, headers);
  }
}

async function answered(method: string, path: string, headers: Record<string, string>): Promise<Response> {
  const own = { "Tus-Resumable": VERSION, "X-CSRF-Token": csrfToken(), Accept: "application/json" };
  let answer: Response;
  try {
    answer = await fetch(path, { method, headers: { ...own, ...headers }, credentials: "same-origin" });
  } catch {
    throw new RefusedError(unsaid(0), new Headers());
  }
  if (answer.ok) return answer;
  const text = await answer.text();
  throw new RefusedError(problemOf(text, answer.status), answer.headers);
}

function refusal(error: Error | DetailedError): Error {
  if (!("originalResponse" in error)) return error;
  const answer = error.originalResponse;
  return new RefusedError(problemOf(answer?.getBody() ?? "", answer?.getStatus() ?? 0), new Headers());
}

function problemOf(text: string, status: number): Problem {
  try {
    return JSON.parse(text) as Problem;
  } catch {
    return unsaid(status);
  }
}

function unsaid(status: number): Problem {
  const detail = status
    ? `The platform answered ${status}; uploaded data is kept. Try again.`
    : "The platform cannot be reached; uploaded data is kept, and the upload resumes from there. Try again.";
  return { title: "The file was not uploaded", status, detail, code: "not_sent", request_id: "" };
}

/** Base64 of the text's UTF-8, as tus writes metadata. */
function base64(text: string): string {
  return btoa(String.fromCharCode(...new TextEncoder().encode(text)));
}
