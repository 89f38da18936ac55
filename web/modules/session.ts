// A session that ends while its page is open: the reader signs in again on the page, and the request is repeated.
//
// The same user must sign in; for another user the page is reloaded and nothing is sent. A session opened in another
// tab has another CSRF token, which is fetched silently.

import type { Problem } from "./api.js";

/** Event on the window: `detail` is true while the sign-in dialog is open, and false afterwards. */
export const ASKING = "session-asking";

interface Session {
  user_id: string;
  csrf_token: string | null;
}

let asking: Promise<boolean> | undefined;
let isDeclined = false; // until the reader acts: automatic requests do not open the dialog again
document.addEventListener("click", () => (isDeclined = false), true);

export function csrfToken(): string {
  return meta("csrf-token")?.content ?? "";
}

/** Whether a refused request may be sent again because there is a session again. `sentWith` is its CSRF token. */
export async function again(problem: Problem, sentWith: string): Promise<boolean> {
  const isEnded = problem.status === 401 && problem.code !== "wrong_password";
  if (!(isEnded || problem.code === "csrf") || !meta("user-id")) return false;
  if (sentWith !== csrfToken()) return true; // for another request it was renewed meanwhile
  if (isDeclined) return false;
  asking ??= (isEnded ? signedIn() : renewed()).finally(() => {
    asking = undefined;
  });
  return asking;
}

/** Take over the session that this browser has now. */
async function renewed(): Promise<boolean> {
  const answer = await fetch("/api/v1/me", { headers: { Accept: "application/json" } });
  if (answer.ok) return taken((await answer.json()) as Session);
  return answer.status === 401 ? signedIn() : false;
}

function taken({ user_id, csrf_token }: Session): boolean {
  const token = meta("csrf-token");
  if (user_id !== meta("user-id")?.content || !token) {
    location.reload();
    return false;
  }
  token.content = csrf_token ?? "";
  return true;
}

/** Opens the sign-in dialog; resolves with whether the reader signed in. */
async function signedIn(): Promise<boolean> {
  const template = document.querySelector<HTMLTemplateElement>("template#session-ended");
  const dialog = template?.content.firstElementChild?.cloneNode(true);
  if (!(dialog instanceof HTMLDialogElement)) return false;
  document.body.append(dialog);
  dialog.showModal();
  dispatchEvent(new CustomEvent(ASKING, { detail: true }));
  const isDone = await answered(dialog);
  dialog.remove();
  isDeclined = !isDone;
  dispatchEvent(new CustomEvent(ASKING, { detail: false }));
  return isDone;
}

function answered(dialog: HTMLDialogElement): Promise<boolean> {
  let isDone = false;
  const tried = async (asked: Promise<Response>): Promise<void> => {
    const refused = await refusalOf(asked, (session) => {
      isDone = taken(session);
      dialog.close();
    });
    const said = dialog.querySelector<HTMLElement>(".said");
    if (said) said.textContent = refused;
  };
  dialog.querySelector("form")?.addEventListener("submit", (event) => {
    event.preventDefault();
    const body = JSON.stringify(Object.fromEntries(new FormData(event.target as HTMLFormElement)));
    void tried(fetch("/api/v1/sessions", { method: "POST", headers: { "Content-Type": "application/json" }, body }));
  });
  dialog.querySelector("[data-signed-in]")?.addEventListener("click", () => void tried(fetch("/api/v1/me")));
  return new Promise((resolve) => dialog.addEventListener("close", () => resolve(isDone), { once: true }));
}

/** Returns the reason why there is no session, or an empty string if `taken` was called with one. */
async function refusalOf(asked: Promise<Response>, taken: (session: Session) => void): Promise<string> {
  try {
    const answer = await asked;
    if (!answer.ok) {
      const { code, detail } = (await answer.json()) as Problem;
      return code === "unauthenticated" ? "You are not signed in yet. Sign in first." : detail;
    }
    taken((await answer.json()) as Session);
    return "";
  } catch {
    return "The platform cannot be reached. Check the network connection and try again.";
  }
}

function meta(name: string): HTMLMetaElement | null {
  return document.querySelector<HTMLMetaElement>(`meta[name="${name}"]`);
}
