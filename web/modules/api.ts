// The API as the pages call it: same origin, the session's CSRF token, problems as errors.

import { again, csrfToken } from "./session.js";

/** A refusal of the API (RFC 9457). */
export interface Problem {
  title: string;
  status: number;
  detail: string;
  code: string;
  request_id: string;
  errors?: { code: string; where?: string; file?: string; frame?: string; expected?: string; actual?: string; detail?: string }[];
  errors_total?: number;
}

/** Thrown by `call` for every refusal. */
export class RefusedError extends Error {
  constructor(readonly problem: Problem, readonly headers: Headers) {
    super(problem.detail);
  }
}

/** Sends the request, with a body (a form, else JSON) if given; returns the response's JSON, or null. Throws
 * `RefusedError`. */
export async function call<T = unknown>(
  method: string,
  path: string,
  body?: unknown,
  headers: Record<string, string> = {},
): Promise<T> {
  const isForm = body instanceof FormData; // the browser sets the multipart boundary
  const answer = await ask(method, path, {
    headers: body === undefined || isForm ? headers : { "Content-Type": "application/json", ...headers },
    ...(body === undefined ? {} : { body: isForm ? body : JSON.stringify(body) }),
  });
  return (answer.status === 204 ? null : await answer.json()) as T;
}

/** The bytes at a path. Throws `RefusedError`. */
export async function bytes(path: string, signal?: AbortSignal): Promise<Uint8Array> {
  const answer = await ask("GET", path, signal ? { signal } : {});
  return new Uint8Array(await answer.arrayBuffer());
}

/** Returns the response; if the session has ended, the one after the reader has signed in again. */
async function ask(method: string, path: string, init: RequestInit): Promise<Response> {
  const sentWith = csrfToken();
  try {
    return await asked(method, path, init);
  } catch (error) {
    if (!(error instanceof RefusedError) || !(await again(error.problem, sentWith))) throw error;
    return asked(method, path, init);
  }
}

async function asked(method: string, path: string, init: RequestInit): Promise<Response> {
  const headers = new Headers(init.headers);
  headers.set("Accept", headers.get("Accept") ?? "application/json");
  if (method !== "GET") headers.set("X-CSRF-Token", csrfToken());
  let answer: Response;
  try {
    answer = await fetch(path, { ...init, method, headers, credentials: "same-origin" });
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    throw new RefusedError(away(), new Headers());
  }
  if (answer.ok) return answer;
  throw new RefusedError(await problemOf(answer), answer.headers);
}

async function problemOf(answer: Response): Promise<Problem> {
  try {
    return (await answer.json()) as Problem;
  } catch {
    return { ...away(), status: answer.status, title: answer.statusText };
  }
}

function away(): Problem {
  const detail = "The platform cannot be reached. Check the network connection; nothing was changed. Try again.";
  return { title: "No answer", status: 0, detail, code: "no_answer", request_id: "" };
}
