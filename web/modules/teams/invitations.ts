// Invitations: the secret of a new one is shown once, with buttons that copy it; a secret in the URL fills in the form.
//
// A link carries the secret behind `#`, which browsers do not send.

import { toast } from "../notices.js";

const SECRET = /^invite_[A-Za-z0-9_-]{43}$/;

document.addEventListener("acted", (event) => {
  const form = event.target;
  if (!(form instanceof HTMLFormElement) || form.dataset["invites"] === undefined) return;
  show((event as CustomEvent<{ secret: string }>).detail.secret);
});

document.addEventListener("click", (event) => {
  const button = event.target instanceof Element ? event.target.closest<HTMLElement>("[data-copies]") : null;
  const field = document.getElementById(button?.dataset["copies"] ?? "");
  if (field instanceof HTMLInputElement) void copy(field.value);
});

const offered = location.hash.slice(1);
const field = document.querySelector<HTMLInputElement>("#join input[name=secret]");
if (field && SECRET.test(offered)) {
  field.value = offered;
  history.replaceState(null, "", location.pathname);
  field.focus();
}

function show(secret: string): void {
  const place = document.querySelector<HTMLElement>("#invited");
  const [shown, link] = [document.querySelector<HTMLInputElement>("#secret"), document.querySelector<HTMLInputElement>("#secret-link")];
  if (!place || !shown || !link) return;
  shown.value = secret;
  link.value = `${location.origin}/teams#${secret}`;
  place.hidden = false;
  shown.focus();
  shown.select();
  shown.scrollLeft = 0;
}

/** Copies to the clipboard; if the browser denies it (no TLS), selects the text to be copied by hand. */
async function copy(text: string): Promise<void> {
  try {
    await navigator.clipboard.writeText(text);
    toast("Copied.");
  } catch {
    const shown = document.querySelector<HTMLInputElement>("#secret");
    if (!shown) return;
    shown.value = text;
    shown.select();
    toast("Selected: copy it with the keyboard.");
  }
}
